"""Settings of algorithm 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from problems.friction.impulses import ImpulseRule
from problems.friction.rules import FrictionRule
from problems.stepping.drift import DRIFT_RULES, DRIFT_TIME, DriftRule
from problems.stepping.restitution import RestitutionRule

StopRule = Literal["located", "held"]


@dataclass(frozen=True)
class StepperOptions:
    """Settings of algorithm 1.

    eps : ε of (3.5), (3.13) and the tolerance for g_Fᵀq̇ = 0
    drop_tol : separation speed at which a contact is dropped (step 4); default ε
    friction : "corrected" or "paper", see `problems.friction.rules`
    fixed_step : a constant h [s] without error control, cut only by events; None: (3.5)
    stops : where slip ends: "located", an event, or "held": what would stop within a step may stick
        for all of it, and the step is not cut
    h_first, h_max : first and largest step [s]
    order : r of AB-r and BDF-r once it has started, 1 or 2
    impulses : "paper" or "newton_coulomb", see `problems.friction.impulses`
    restitution : "poisson" or "newton", where a scene has coefficients, see
        `problems.stepping.restitution`
    rest_speed : at rest, ‖q̇_i‖_M ≤ rest_speed and ‖q̈_i‖_M ≤ rest_speed / `REST_HORIZON` for every
        body; default 2 ε
    drift, drift_time : "none", "baumgarte" with τ = drift_time [s], or "projection", see
        `problems.stepping.drift`

    Raises ValueError, naming the option, for a number that is not positive or an unknown choice.
    """

    eps: float
    drop_tol: float
    friction: FrictionRule = "corrected"
    fixed_step: float | None = None
    stops: StopRule = "located"
    h_first: float = 1e-3
    h_max: float = 0.02
    rest_speed: float = 0.0
    order: int = 2
    impulses: ImpulseRule = "paper"
    restitution: RestitutionRule = "poisson"
    drift: DriftRule = "none"
    drift_time: float = DRIFT_TIME

    @classmethod
    def of(
        cls, eps: float, drop_tol: float | None = None, rest_speed: float | None = None, **more: Any
    ) -> StepperOptions:
        """With the defaults that follow from ε where there is None."""
        drop_tol = eps if drop_tol is None else drop_tol
        rest_speed = 2 * eps if rest_speed is None else rest_speed
        return cls(eps=eps, drop_tol=drop_tol, rest_speed=rest_speed, **more)

    def refuse_all_but(self, used: Sequence[str], reason: str) -> None:
        """Raise ValueError for an option that is not the default and not one of `used`."""
        default = asdict(StepperOptions.of(self.eps))
        for name, value in asdict(self).items():
            if name not in used and value != default[name]:
                raise ValueError(
                    f"{name} = {value!r} {reason}; leave it out ({', '.join(used)} are used)"
                )

    def __post_init__(self) -> None:
        for name in ("eps", "drop_tol", "h_first", "h_max", "rest_speed", "drift_time"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} = {value!r}; it must be a positive number")
        if self.fixed_step is not None and not 0 < self.fixed_step < np.inf:
            raise ValueError(f"fixed_step = {self.fixed_step!r}; it must be a positive number")
        if self.stops not in ("located", "held"):
            raise ValueError(f'stops = {self.stops!r}; choose "located" or "held"')
        if self.impulses not in ("paper", "newton_coulomb"):
            raise ValueError(f'impulses = {self.impulses!r}; choose "paper" or "newton_coulomb"')
        if self.restitution not in ("poisson", "newton"):
            raise ValueError(f'restitution = {self.restitution!r}; choose "poisson" or "newton"')
        if self.drift not in DRIFT_RULES:
            raise ValueError(f"drift = {self.drift!r}; choose one of {', '.join(DRIFT_RULES)}")
        if self.order not in (1, 2):
            raise ValueError(f"order = {self.order!r}; choose 1 or 2")
        if self.friction not in ("paper", "corrected"):
            raise ValueError(f'friction = {self.friction!r}; choose "paper" or "corrected"')


def end_of(end_time: float, until: float | None) -> float:
    """When a simulation ends: `until` [s] if it is given, else with the scene.

    Raises ValueError, with the name of the one that is wrong.
    """
    name, end = ("end_time", end_time) if until is None else ("until", float(until))
    if not (np.isfinite(end) and end > 0):
        raise ValueError(f"{name} = {end!r}; it must be a positive time")
    return end
