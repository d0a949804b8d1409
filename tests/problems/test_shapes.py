"""Polygons and bodies: areas and moments against textbook values, and what is refused."""

import numpy as np
import pytest

from problems.bodies.bodies import box, mass_diagonal, polygon_body
from problems.bodies.shapes import box_corners, convex_polygon, polygon_area, polygon_second_moment

HEXAGON = [(-0.75, -1.5), (0.75, -1.5), (1.75, 0), (0.75, 1.5), (-0.75, 1.5), (-1.75, 0)]


def test_box_has_the_textbook_inertia():
    body = box(2.0, 1.0, density=3.0)
    assert body.mass == pytest.approx(6.0)
    assert body.inertia == pytest.approx(6.0 * (4.0 + 1.0) / 12)


def test_hexagon_of_figure_3_has_mass_7_5():
    assert polygon_body(HEXAGON).mass == pytest.approx(7.5)


def test_second_moment_obeys_steiner():
    corners = box_corners(2.0, 1.0)
    shift = np.array([3.0, -4.0])
    moved = polygon_second_moment(corners + shift)
    assert moved == pytest.approx(polygon_second_moment(corners) + polygon_area(corners) * 25.0)


def test_a_body_in_parts_equals_the_whole():
    whole = box(2.0, 1.0)
    halves = polygon_body(
        [[(0, 0), (1, 0), (1, 1), (0, 1)], [(1, 0), (2, 0), (2, 1), (1, 1)]], density=1.0
    )
    assert halves.mass == pytest.approx(whole.mass)
    assert halves.inertia == pytest.approx(whole.inertia)
    assert halves.polygons[0].min() == pytest.approx(-1.0)


def test_clockwise_is_turned_round():
    corners = np.array([(0, 0), (0, 1), (1, 1), (1, 0)], float)
    made = convex_polygon(corners)
    assert polygon_area(made) == pytest.approx(1.0)
    np.testing.assert_array_equal(made[0], corners[0])


@pytest.mark.parametrize(
    ("corners", "words"),
    [
        ([(0, 0), (1, 0)], "corners of shape"),
        ([(0, 0), (1, 0), (np.nan, 1)], "finite"),
        ([(0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2)], "several convex parts"),
        ([(0, 0), (1, 0), (2, 0), (1, 1)], "not strictly convex at corner 1"),
        ([(0, 0), (0, 1), (0, 2), (2, 2), (2, 0)], "not strictly convex at corner 1"),
        ([(0, 0), (0, 0), (1, 0), (1, 1)], "not strictly convex"),
        ([(np.cos(a), np.sin(a)) for a in 4 * np.pi * np.arange(5) / 5], "crosses itself"),
    ],
)
def test_bad_polygons_are_refused(corners, words):
    with pytest.raises(ValueError, match=words):
        convex_polygon(corners)


def test_mass_diagonal():
    np.testing.assert_allclose(mass_diagonal([box(1, 1), box(2, 1)]), [1, 1, 1 / 6, 2, 2, 5 / 6])


def test_a_body_has_parts():
    with pytest.raises(ValueError, match="at least one convex part"):
        polygon_body([])


def test_density_must_be_positive():
    with pytest.raises(ValueError, match="density"):
        box(1, 1, density=0.0)
