"""Scenes by name: parameters, labels, and what is refused."""

import numpy as np
import pytest

from problems import describe_scene, scene, scene_names
from problems.bodies.bodies import box
from problems.scenes import Scene


def test_the_paper_s_scenes_are_there():
    assert scene_names()[:4] == ["fig2", "fig3", "fig4", "fig5"]
    summary, defaults = describe_scene("fig4")
    assert "Three standing boxes" in summary
    assert defaults["mu"] == 0.5


def test_parameters_are_all_recorded_and_changes_make_the_label():
    made = scene("fig4", mu_I="0.8", boxes=3)
    assert made.label == "fig4,mu_I=0.8"
    assert made.parameters["mu_I"] == 0.8
    assert made.parameters["push"] == 10.0
    assert scene("fig4").label == "fig4"


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("fig9", {}, "unknown scene 'fig9'; there are: fig2"),
        ("fig2", {"bodies": 3}, "no parameter 'bodies'; it has: boxes"),
        ("fig2", {"boxes": "many"}, "must be of type int"),
        ("fig2", {"boxes": 2.5}, "must be a whole number"),
        ("fig2", {"boxes": np.inf}, "must be of type int"),
        ("rain", {"walls": "no"}, "must be true or false"),
        ("fig2", {"velocity": "nan"}, "must be finite"),
        ("fig2", {"pushed": 9}, "must be a box from 1 to 5"),
        ("fig2", {"mu": -1.0}, "mu = -1.0"),
    ],
)
def test_bad_requests_are_refused(name, parameters, words):
    with pytest.raises(ValueError, match=words):
        scene(name, **parameters)


def test_friction_per_pair_with_a_default():
    made = Scene(
        bodies=(box(1, 1), box(1, 1)),
        q0=np.zeros((2, 3)),
        v0=np.zeros((2, 3)),
        mu=0.1,
        mu_pairs={(0, 1): 0.7},
    )
    assert made.mu_between(-1, 0) == made.mu_between(0, -1) == 0.7
    assert made.mu_between(0, 1) == 0.1


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("q0", np.zeros((1, 3)), "q0 needs shape"),
        ("v0", np.full((2, 3), np.nan), "v0 holds NaN"),
        ("mu_pairs", {(0, 5): 0.1}, "needs two body numbers"),
        ("end_time", np.inf, "end_time"),
    ],
)
def test_bad_scenes_are_refused(field, value, words):
    good = {"bodies": (box(1, 1),) * 2, "q0": np.zeros((2, 3)), "v0": np.zeros((2, 3))}
    with pytest.raises(ValueError, match=words):
        Scene(**(good | {field: value}))
