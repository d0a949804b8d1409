"""Ratios of times: what is planted is found, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from harness.results.time_ratios import LEAST_SPREAD, ComparedRun, TimeRatios, time_ratios

SOLVERS = ("glambda", "lotstedt[exact_qr]", "daqp", "osqp", "piqp")
PLACES = (("fig4", "high"), ("fig4", "paper"))
ARMS = 2


def study(
    rng: np.random.Generator, passes: int = 3, qps: int = 60, process: float = 0.03
) -> dict[tuple[str, tuple[str, str], int], np.ndarray]:
    """Times (passes, qps) of every run: drift shared in a pass, a process's own, and noise."""
    size = np.random.default_rng(5).lognormal(0, 0.7, qps)  # the QPs are the same in every study
    times = {}
    for place in PLACES:
        drift = rng.normal(0, 0.05, passes)
        for i, solver in enumerate(SOLVERS):
            for arm in range(ARMS):
                own = rng.normal(0, process)
                noise = rng.lognormal(0, 0.05, (passes, qps))
                hiccups = np.where(rng.random((passes, qps)) < 0.03, 4.0, 1.0)
                pace = np.exp(own + drift + rng.normal(0, 0.02, passes))[:, None]
                times[solver, place, arm] = 1e-6 * (i + 1) * size * pace * noise * hiccups
    return times


def compared(seed: int, slower: dict[str, float] | None = None, **how: float) -> TimeRatios:
    """Two studies, the second with some solvers slower by a factor; `""` stands for all."""
    factors = slower or {}
    rng = np.random.default_rng(seed)
    before, after = study(rng, **how), study(rng, **how)
    return time_ratios(
        [
            ComparedRun(
                name, place, before[name, place, arm], times * factors.get(name, factors.get("", 1))
            )
            for (name, place, arm), times in after.items()
        ]
    )


def alarms(found: TimeRatios) -> list[str]:
    """Solvers, and places in the list of runs, that are said to be slower or faster."""
    changed = [name for name, ratio in found.solvers.items() if ratio.slower or ratio.faster]
    return changed + [str(i) for i, ratio in enumerate(found.runs) if ratio.slower or ratio.faster]


@pytest.mark.parametrize("process", [0.0, 0.02, 0.05])
def test_a_study_agrees_with_another_like_it(process: float) -> None:
    """Both are told to differ in fewer than one of twenty comparisons."""
    found = [compared(seed, process=process) for seed in range(40)]
    assert sum(bool(alarms(each)) for each in found) <= 2


@pytest.mark.parametrize("slow", ["glambda", "daqp"])
def test_a_slowdown_of_a_fifth_is_found_and_nobody_else_blamed(slow: str) -> None:
    """All intervals hold the true ratios, and the slow one's lies above 1, in 19 cases of 20."""
    seen, wrong = 0, 0
    for seed in range(40):
        found = compared(seed, {slow: 1.2})
        seen += found.solvers[slow].slower
        wrong += any(
            not ratio.low < (1.2 if name == slow else 1.0) < ratio.high
            for name, ratio in found.solvers.items()
        )
    assert seen >= 38 and wrong <= 2


def test_a_speedup_is_found() -> None:
    assert compared(1, {"piqp": 1 / 1.2}).solvers["piqp"].faster


def test_a_slower_machine_is_not_blamed_on_the_solvers() -> None:
    found = compared(3, {"": 1.5})
    assert found.machine == pytest.approx(1.5, rel=0.1) and not alarms(found)
    found = compared(3, {"": 1.5, "osqp": 1.5 * 1.2})
    assert found.machine == pytest.approx(1.5, rel=0.1)
    assert [s for s, r in found.solvers.items() if r.slower] == ["osqp"]


def test_variants_of_a_method_are_one_package() -> None:
    """Both being slower is their doing, not the machine's."""
    found = compared(4, {"glambda": 1.3, "lotstedt[exact_qr]": 1.3})
    assert found.packages == 4 and found.machine == pytest.approx(1.0, abs=0.1)
    assert found.solvers["glambda"].slower and found.solvers["lotstedt[exact_qr]"].slower


def test_two_packages_cannot_be_told_from_the_machine() -> None:
    rng = np.random.default_rng(0)
    before, after = study(rng), study(rng)
    runs = [
        ComparedRun(name, place, before[name, place, arm], 1.3 * times)
        for (name, place, arm), times in after.items()
        if name in ("daqp", "osqp")
    ]
    found = time_ratios(runs)
    assert found.packages == 2 and found.machine == 1.0
    assert found.solvers["daqp"].slower and found.solvers["osqp"].slower


def test_how_far_processes_lie_apart_is_seen() -> None:
    spreads = [compared(seed, process=0.08).spread for seed in range(10)]
    assert np.median(spreads) == pytest.approx(np.sqrt(2) * 0.08, rel=0.3)
    calm = [compared(seed, process=0.0).spread for seed in range(10)]
    assert np.median(calm) == LEAST_SPREAD


def test_the_same_times_have_the_ratio_one_and_the_same_answer() -> None:
    times = study(np.random.default_rng(0))
    runs = [ComparedRun(name, place, t, t) for (name, place, _), t in times.items()]
    first, second = time_ratios(runs), time_ratios(runs)
    assert first == second
    assert all(ratio.ratio == 1.0 for ratio in first.runs)


def test_times_that_are_missing_are_left_out() -> None:
    times = study(np.random.default_rng(0))
    runs = [ComparedRun(name, place, t, t) for (name, place, _), t in times.items()]
    holes = runs[0].after.copy()
    holes[0, 5:] = np.nan  # five QPs are left
    zero = np.zeros_like(holes)
    some = runs[2].after.copy()
    some[1, 20:] = np.nan  # twenty are
    changed = [replace(runs[0], after=holes), replace(runs[1], before=zero)]
    found = time_ratios([*changed, replace(runs[2], after=some), *runs[3:]])
    assert np.isnan(found.runs[0].ratio) and np.isnan(found.runs[1].low)
    assert not found.runs[0].slower and not found.runs[0].faster
    assert found.runs[2].ratio == 1.0
    nothing = time_ratios(changed)
    assert nothing.solvers == {} and nothing.packages == 0


def test_one_pass_and_different_numbers_of_passes_are_compared() -> None:
    rng = np.random.default_rng(2)
    before, after = study(rng, passes=1), study(rng, passes=4)
    runs = [
        ComparedRun(name, place, before[name, place, arm], t)
        for (name, place, arm), t in after.items()
    ]
    assert not any(ratio.slower for ratio in time_ratios(runs).solvers.values())
