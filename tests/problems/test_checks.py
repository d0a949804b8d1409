"""Bad ingredients of a scene are refused where they are made, with the field and the remedy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf, nan

import pytest

from problems import simulate
from problems.bodies.bodies import Body, box
from problems.bodies.forces import Impulse, Load, SpringDamper
from problems.contacts.geometry import HalfPlane
from solvers import make_solver
from tests.fakes.runs import one_box

PUSH = (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: HalfPlane(normal=(0.0, 0.0)), r"HalfPlane: normal .* point somewhere"),
        (lambda: HalfPlane(normal=(nan, 1.0)), r"HalfPlane: normal .* 2 finite numbers"),
        (lambda: HalfPlane(point=(0.0, inf)), r"HalfPlane: point .* 2 finite numbers"),
        (lambda: HalfPlane(point=(0.0, 1.0, 2.0)), r"HalfPlane: point .* 2 finite numbers"),
        (lambda: Impulse(nan, 0, PUSH), r"Impulse: t = nan.* finite number, at least 0"),
        (lambda: Impulse(-1.0, 0, PUSH), r"Impulse: t = -1.0; .* at least 0"),
        (lambda: Impulse(0.1, -2, PUSH), r"Impulse: body = -2; .* index of a body, from 0"),
        (lambda: Impulse(0.1, 0.5, PUSH), r"Impulse: body = 0.5; .* index"),  # type: ignore
        (lambda: Impulse(0.1, 0, (inf, 0.0, 0.0)), r"Impulse: value .* 3 finite numbers"),
        (lambda: Impulse(0.1, 0, (1.0, 0.0)), r"Impulse: value .* 3 finite"),  # type: ignore
        (lambda: Impulse(0.1, 0, ("a", 0.0, 0.0)), r"Impulse: value .* 3 finite"),  # type: ignore
        (lambda: Load(0, (nan, 0.0, 0.0)), r"Load: value .* 3 finite numbers"),
        (lambda: Load(0, PUSH, nan), r"Load: start = nan; it must be a finite number"),
        (lambda: Load(0, PUSH, 1.0, 1.0), r"Load: end = 1.0; it must be after start = 1.0"),
        (lambda: Load(0, PUSH, 0.0, nan), r"Load: end = nan; it must be after"),
        (lambda: SpringDamper(0, (0, nan), (0, 0), 1.0, 0.0), r"SpringDamper: point"),
        (lambda: SpringDamper(0, (0, 0), (0, 0), -1.0, 0.0), r"stiffness = -1.0; .* at least 0"),
        (lambda: SpringDamper(0, (0, 0), (0, 0), 1.0, inf), r"SpringDamper: damping = inf"),
        (lambda: Body((), 1.0, 1.0), r"Body: polygons is empty"),
        (lambda: Body(box(1, 1).polygons, 0.0, 1.0), r"Body: mass = 0.* both must be positive"),
        (lambda: Body(box(1, 1).polygons, 1.0, nan), r"Body: inertia = nan; .* finite number"),
        (lambda: box(inf, 1.0), r"a box needs positive sides"),
        (lambda: one_box(forces=(Load(1, PUSH),)), r"Load: body = 1; .* from 0 to 0"),
        (lambda: one_box(impulses=(Impulse(0.0, 3, PUSH),)), r"Impulse: body = 3; .* from 0 to 0"),
    ],
)
def test_bad_ingredients_are_refused(make: Callable[[], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize("keep", [True, False])
def test_impulses_within_two_steps_of_the_shortest_length_act_once_each(keep: bool) -> None:
    times = (0.3, 0.3 + 0.9e-9, 0.3 + 1.8e-9)
    free = one_box(impulses=tuple(Impulse(t, 0, PUSH) for t in times), gravity=0.0)
    run = simulate(replace(free, ground=()), make_solver("glambda"), keep_qps=keep)
    assert run.v[-1, 0].tolist() == [3.0, 0.0, 0.0]
