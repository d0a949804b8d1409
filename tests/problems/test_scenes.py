"""Scenes by name: parameters, labels, and what is refused."""

import numpy as np
import pytest

from problems import describe_scene, scene, scene_names, simulate
from problems.bodies.bodies import box
from problems.scenes import Scene
from problems.scenes.registry import chosen_scenes
from solvers import make_solver


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
        ("fig9", {}, "unknown scene 'fig9'; did you mean 'fig"),
        ("qwerty", {}, "unknown scene 'qwerty'; there are: fig2"),
        ("Tower", {}, "did you mean 'tower'?"),
        ("fig2", {"bodies": 3}, "no parameter 'bodies'; did you mean 'boxes'"),
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


def test_the_default_accuracy_falls_with_the_mass_below_a_kilogram():
    """‖δq‖_M = ε leaves a gram an error in lengths that is 30 times that of a kilogram."""

    def eps_of(mass, **given):
        bodies = (box(1.0, 1.0, mass / 4), box(1.0, 3.0, mass / 4))
        return Scene(bodies, [[0.0, 0.5, 0.0], [2.0, 1.5, 0.0]], np.zeros((2, 3)), **given).eps

    assert eps_of(1.0) == eps_of(1e6) == 1e-3
    assert eps_of(0.01) == pytest.approx(1e-4)
    assert eps_of(0.01, eps=2e-3) == 2e-3


def test_an_accuracy_of_zero_is_refused_and_not_taken_for_the_default():
    with pytest.raises(ValueError, match=r"eps = 0\.0"):
        simulate(scene("fig3", eps=0.0), make_solver("lotstedt"), until=0.1)


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


def test_scenes_are_chosen_by_kind():
    assert chosen_scenes("fig4,mu_I=0.8 networks") == (
        "fig4,mu_I=0.8", "half_wave", "bridge", "boost",
    )  # fmt: skip
    assert set(chosen_scenes("all")) == set(scene_names()) and chosen_scenes("fig9") == ("fig9",)
