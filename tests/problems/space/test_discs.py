"""A QP with discs: what bounds alone find, what packages find that take cones, and the bound."""

from __future__ import annotations

import numpy as np
import pytest

from harness.cases.cones import BY_DISCS, by_clarabel
from harness.cases.friction_discs import friction_discs
from harness.judging.disc_bound import disc_error_bound
from problems import scene, simulate
from problems.space.discs import DiscQP
from solvers import make_solver

SOLVER = make_solver("glambda")


def random_discs(seed: int) -> DiscQP:
    """One to four contacts, each with a normal and a pair across it, columns at times dependent."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 5)), int(rng.integers(3, 13))
    A = rng.standard_normal((m, 3 * n))
    discs = n + np.arange(2 * n).reshape(n, 2)
    lower = np.concatenate([np.zeros(n), np.full(2 * n, -np.inf)])
    radius = rng.uniform(0.0, 1.0, n) * rng.integers(0, 2, n)
    return DiscQP(A, rng.standard_normal(m), lower, np.full(3 * n, np.inf), discs, radius)


@pytest.mark.parametrize("seed", range(40))
def test_the_bound_is_never_below_the_error_and_small_where_that_is(seed: int) -> None:
    qp, rng = random_discs(seed), np.random.default_rng([seed, 1])
    best = by_clarabel(qp, 1e-12)
    scale = float(np.linalg.norm(qp.d))
    known = disc_error_bound(qp, best)
    assert known < 1e-3 * scale  # interior points miss an edge by √gap
    for size in (1e-6, 1e-3, 0.1, 10.0):
        x = best + size * rng.standard_normal(qp.k)
        assert disc_error_bound(qp, x) >= np.linalg.norm(qp.A @ (x - best)) - known


@pytest.mark.parametrize("seed", range(10))
def test_projection_is_the_nearest_point(seed: int) -> None:
    qp, rng = random_discs(seed), np.random.default_rng([seed, 2])
    x = 3 * rng.standard_normal(qp.k)
    near = qp.projected(x)
    assert (np.linalg.norm(near[qp.discs], axis=1) <= qp.radius + 1e-12).all()
    for _ in range(20):  # the angle at it is not acute
        other = qp.projected(3 * rng.standard_normal(qp.k))
        assert (x - near) @ (other - near) <= 1e-10


def test_more_faces_come_closer_to_the_disc() -> None:
    run = simulate(scene("slope", heading=0.3), SOLVER, until=0.05, fixed_step=0.01, eps=1e-6)
    qp, x = run.discs[-1]
    off = []
    for faces in (4, 8, 16, 64):
        posed, T = qp.faceted(faces)
        y = T @ SOLVER.solve(posed).x
        assert np.linalg.norm(y[qp.discs], axis=1).max() <= qp.radius.max() * (1 + 1e-9)
        off.append(np.linalg.norm(qp.A @ (y - x)) / np.linalg.norm(qp.A @ x))
    assert off[0] > 0.02 and off[-1] < 0.01 < off[1]


def test_bounds_alone_find_what_packages_find_that_take_cones() -> None:
    found = {row["quantity"]: row["value"] for row in friction_discs(SOLVER)}
    assert len(found) == 3 * (1 + 2 * len(BY_DISCS) + 3)
    for words, value in found.items():
        if words.endswith("off the disc"):
            assert value < 0.2
        else:
            assert value < 1e-4, words  # of the packages, which end at √gap
    ours = [value for words, value in found.items() if "by bounds alone" in words]
    assert len(ours) == 3 and max(ours) < 1e-5


def test_nothing_is_kept_where_qps_are_not_or_polygons_stand_for_discs() -> None:
    how = {"until": 0.05, "fixed_step": 0.01}
    assert simulate(scene("skid"), SOLVER, keep_qps=False, **how).discs == []
    assert simulate(scene("skid", faces=8), SOLVER, **how).discs == []
    assert len(simulate(scene("skid"), SOLVER, **how).discs) == 5


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"radius": np.array([-1.0])}, "at least 0"),
        ({"lower": np.zeros(3)}, "has a bound"),
        ({"discs": np.array([[1, 1]])}, "another disc"),
        ({"discs": np.array([[1, 3]])}, "that there is not"),
        ({"discs": np.array([[1, -1]])}, "that there is not"),
        ({"d": np.zeros(5)}, "shape"),
        ({"radius": np.zeros(2)}, "shape"),
    ],
)
def test_what_is_no_qp_with_discs_is_refused(changed: dict[str, np.ndarray], words: str) -> None:
    sound = {
        "A": np.eye(4)[:, :3],
        "d": np.ones(4),
        "lower": np.array([0.0, -np.inf, -np.inf]),
        "upper": np.full(3, np.inf),
        "discs": np.array([[1, 2]]),
        "radius": np.array([0.5]),
    }
    DiscQP(**sound)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=words):
        DiscQP(**{**sound, **changed})  # type: ignore[arg-type]
