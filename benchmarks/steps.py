"""Time per accepted step of the stepper, where it goes, how it grows, and drift at rest.

    python benchmarks/steps.py                 scenes of 3 to 1,000 bodies
    python benchmarks/steps.py --bodies 20 100 --no-drift

CPU time of this process, one thread, of all trials of the accepted steps: a rejected step is paid
for by the next one that is accepted.  A first run of each scene, of a few steps, compiles and warms
up and is not counted.  The shares are of the same run:

    qp        the solver's answers, and posing what it is asked
    norm      minimum-norm multipliers (4.8) beside their QPs, and whether any are needed
    steps     compiled steps: positions, constraint functions, columns, friction, what may be met
    events    what is met, looked at; impulses; contacts that come and go

"alone" is the time where QPs are not kept, so that whole stretches are left to compiled code.  The
exponent is that of n in time per step, between the least and the greatest n of a family.  The
drift is the farthest that anything has moved in 100 steps of 1/240 s of an aligned tower with
μ = 0.5, ε = 1e-9: from rest, and after seeded random velocities of at most 1e-6.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import problems.friction.posed as posed_module
import problems.stepping.driver as driver_module
import problems.stepping.stepper as stepper_module
from problems.friction.posed import PosedPasses
from problems.scenes import Scene
from problems.scenes.calm import calm_scene
from problems.sequence import QPSequence
from problems.stepping.stepper import Stepper, StepperOptions
from solvers import make_solver

SMALL = ({"name": "fig2"}, {"name": "fig3"}, {"name": "fig4"}, {"name": "fig5"})
FAMILIES = (
    {"name": "tower"},
    {"name": "tower", "mu": 0.5, "speed": 0.0},
    {"name": "wall"},
    {"name": "wall", "mu": 0.3, "speed": 0.0},
)
STAGES = (
    ("qp", QPSequence, "solve"),
    ("norm", posed_module, "least_norm"),
    ("norm", PosedPasses, "_independent"),
    ("steps", driver_module, "run_steps"),
    ("events", stepper_module, "look_ahead"),
    ("events", Stepper, "_see_to_step"),
)
SHARES = ("qp", "norm", "steps", "events")
WARM_UP = 2
"""Steps that are not counted."""
LIMIT = 3.0
"""CPU time after which a scene is ended [s]."""


class Clock:
    """CPU time of the stages; a stage inside another is its own, not the other's."""

    def __init__(self) -> None:
        self.spent = dict.fromkeys(SHARES, 0.0)
        self._inner: list[float] = []

    def timed(self, stage: str, function: Any) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            start = time.process_time()
            self._inner.append(0.0)
            try:
                return function(*arguments, **named)
            finally:
                whole = time.process_time() - start
                self.spent[stage] += whole - self._inner.pop()
                if self._inner:
                    self._inner[-1] += whole

        return call


@contextmanager
def stages(clock: Clock) -> Iterator[None]:
    """Everything in `STAGES` timed by the clock."""
    before = [getattr(owner, name) for _, owner, name in STAGES]
    try:
        for (stage, owner, name), function in zip(STAGES, before, strict=True):
            setattr(owner, name, clock.timed(stage, function))
        yield
    finally:
        for (_, owner, name), function in zip(STAGES, before, strict=True):
            setattr(owner, name, function)


def started(start: Scene, keep_qps: bool = True, **options: Any) -> Stepper:
    eps = options.pop("eps", start.eps)
    settings = {"eps": eps, "drop_tol": eps, "rest_speed": 2 * eps} | options
    stepper = Stepper(start, make_solver("glambda"), StepperOptions(**settings), keep_qps)
    stepper.start()
    return stepper


def time_of(start: Scene, **options: Any) -> tuple[float, int, dict[str, float]]:
    """CPU seconds per accepted step, accepted steps, and the share of each stage."""
    warm = started(start, **options)
    while warm.system.counts["steps"] < WARM_UP and not warm.at_rest:
        warm.advance(start.end_time)
    stepper, clock = started(start, **options), Clock()
    gc.collect()
    gc.disable()
    try:
        begin = time.process_time()
        with stages(clock):
            while stepper.system.t < start.end_time - 1e-9 and not stepper.at_rest:
                stepper.advance(start.end_time)
                if time.process_time() - begin > LIMIT:
                    break
        whole = time.process_time() - begin
    finally:
        gc.enable()
    steps = stepper.system.counts["steps"]
    return whole / steps, steps, {stage: clock.spent[stage] / whole for stage in SHARES}


def drift(bodies: int, velocity: float, steps: int = 100) -> tuple[float, float]:
    """Farthest motion [m or rad] of a tower at rest, and CPU seconds per step."""
    start = calm_scene("tower", bodies=bodies, mu=0.5, speed=0.0, jitter=0.0)
    kick = velocity * np.random.default_rng(0).uniform(-1.0, 1.0, (bodies, 3))
    stepper = started(replace(start, v0=kick), eps=1e-9, drop_tol=1e-3, fixed_step=1 / 240)
    begin = time.process_time()
    while stepper.system.t < steps / 240 - 1e-9:
        stepper.advance(steps / 240)
    seconds = (time.process_time() - begin) / steps
    return float(np.abs(stepper.system.q.reshape(-1, 3) - start.q0).max()), seconds


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", type=int, nargs="+", default=[20, 100, 1000])
    parser.add_argument("--no-drift", action="store_true")
    chosen = parser.parse_args(arguments)
    console = Console(width=110)
    table = Table("scene", "bodies", "steps", "µs/step", "alone", "× fig2", *SHARES, "exponent")
    cases = [
        *((parameters, 0) for parameters in SMALL),
        *((parameters, bodies) for parameters in FAMILIES for bodies in chosen.bodies),
    ]
    for parameters in SMALL:  # impacts and friction load their kernels, too
        for keep in (True, False):
            time_of(calm_scene(**parameters), keep_qps=keep)
    unit, first = 0.0, (0, 0.0)
    for parameters, bodies in track(cases, console=Console(stderr=True)):
        start = calm_scene(**parameters, **({"bodies": bodies} if bodies else {}))
        seconds, steps, shares = time_of(start)
        alone, _, _ = time_of(start, keep_qps=False)
        unit = unit or seconds
        if bodies == chosen.bodies[0]:
            first = bodies, seconds
        grown = bodies > first[0] > 0
        exponent = np.log(seconds / first[1]) / np.log(bodies / first[0]) if grown else 0.0
        numbers = len(start.bodies), steps, round(1e6 * seconds)
        ratios = round(1e6 * alone), f"{seconds / unit:.1f}"
        percents = (f"{100 * shares[stage]:.0f} %" for stage in SHARES)
        growth = f"{exponent:.2f}" if grown else ""
        table.add_row(start.label, *map(str, numbers), *map(str, ratios), *percents, growth)
    console.print(table)
    if not chosen.no_drift:
        rest = Table("bodies", "velocity", "drift", "ms/step", title="Towers at rest, μ = 0.5")
        for bodies in chosen.bodies:
            for velocity in (0.0, 1e-6):
                moved, seconds = drift(bodies, velocity)
                rest.add_row(str(bodies), f"{velocity:g}", f"{moved:.1e}", f"{1e3 * seconds:.1f}")
        console.print(rest)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
