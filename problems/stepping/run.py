"""What a simulation leaves behind: accepted states, events, and every QP that it posed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from problems.qp import ContactQP, Indices, Solution, Vector
from problems.short import Short

if TYPE_CHECKING:
    import pandas as pd

    from problems.scenes import Scene

EVENT_KINDS = (
    "impulse",
    "slide_off",
    "slip_to_stick",
    "roll_over",
    "stick_to_slip",
    "jam",
    "gain",
    "force_jump",
    "drop",
    "hand_over",
    "overlap",
    "rest",
)
"""jam: sliding friction whose gain is 1 or more has stopped contacts, and q̇ jumps; gain: there is
such friction (`problems.stepping.gain`).  roll_over: a disc or an ellipse goes on from an edge to
the corner at its end, or back.  overlap: two parts overlap by more than drift may leave; what
should have kept them apart was found late, or they overlap far too deep whatever keeps them now."""


@contextmanager
def kept_until_then(kept: Sized, finish: Callable[[], Simulated]) -> Iterator[None]:
    """Whatever ends a simulation early, Ctrl-C too, has the motion until then as its `run`.

    kept : accepted states;  finish : makes the run of them
    """
    try:
        yield
    except BaseException as error:
        if len(kept):
            error.run = finish()  # type: ignore[attr-defined]
        raise


class Stretch(NamedTuple):
    """Accepted states, one after the other, with the same active constraints.

    t : (s,) [s];  q, v : (s, 3n);  gaps : (s,) the least φ [m], inf without active constraints
    normal_ids, friction_ids : (N,), (F,) row_id;  lam : (s, N + F) λ_N and λ_F
    """

    t: Vector
    q: Vector
    v: Vector
    gaps: Vector
    normal_ids: Indices
    friction_ids: Indices
    lam: Vector

    @property
    def row_ids(self) -> list[int]:
        """Those of the columns of lam."""
        return [*self.normal_ids.tolist(), *self.friction_ids.tolist()]


class Event(NamedTuple):
    """Something that happened at time t [s]; kind is one of `EVENT_KINDS`."""

    t: float
    kind: str
    detail: str


class Simulated(Short):
    """What every run tells, of bodies or of a network."""

    scene: Any
    event_log: list[Event]

    def _title(self) -> str:
        label: str = self.scene.label
        return label

    @cached_property
    def events(self) -> pd.DataFrame:
        """One row per event: t, kind, detail."""
        import pandas as pd

        return pd.DataFrame(self.event_log, columns=["t", "kind", "detail"])


@dataclass(frozen=True, eq=False, repr=False)
class Run(Simulated):
    """Outcome of `simulate`.

    t : (n,) [s] accepted times; a time stands twice where an impulse changed the velocities
    q, v : (n, bodies, 3) positions and velocities [m, m, rad]
    stretches : the same states with λ, see there
    gaps : (n,) the least φ of the active constraints [m], inf where there are none
    event_log : list of `Event`
    qps, solutions : every QP in solve order, and the solver's answer
    counts : steps, rejected_steps, restarts, impulses, qps
    """

    scene: Scene
    t: Vector
    q: Vector
    v: Vector
    stretches: Sequence[Stretch]
    gaps: Vector
    event_log: list[Event]
    qps: list[ContactQP]
    solutions: list[Solution]
    counts: dict[str, int]
    options: dict[str, Any]

    def _sizes(self) -> dict[str, Any]:
        return {
            **({"t": f"{self.t[-1]:.4g} s"} if len(self.t) else {}),
            "bodies": len(self.scene.bodies),
            "steps": self.counts["steps"],
            "events": len(self.event_log),
            "QPs kept": len(self.qps),
        }

    @cached_property
    def multipliers(self) -> list[dict[int, float]]:
        """(n,) {row_id: λ} of the active constraints."""
        return [
            dict(zip(stretch.row_ids, lam, strict=True))
            for stretch in self.stretches
            for lam in stretch.lam.tolist()
        ]

    @cached_property
    def trajectory(self) -> pd.DataFrame:
        """One row per accepted step and body: t, body (from 1), x, y, phi, vx, vy, omega."""
        import pandas as pd

        n, bodies, _ = self.q.shape
        table = np.concatenate([self.q, self.v], axis=2).reshape(n * bodies, 6)
        frame = pd.DataFrame(table, columns=["x", "y", "phi", "vx", "vy", "omega"])
        frame.insert(0, "t", np.repeat(self.t, bodies))
        frame.insert(1, "body", np.tile(np.arange(1, bodies + 1), n))
        return frame

    def kinetic_energy(self) -> Vector:
        """T = ½ q̇ᵀ M q̇ at each time, (n,) [J]."""
        from problems.bodies.bodies import mass_diagonal

        M = mass_diagonal(self.scene.bodies)
        return 0.5 * (self.v.reshape(len(self.t), -1) ** 2) @ M

    def potential_energy(self) -> Vector:
        """V of gravity (from y = 0) and of the springs at each time, (n,) [J]."""
        forces = self.scene.all_forces()
        return np.array([sum(f.potential(q.ravel()) for f in forces) for q in self.q])
