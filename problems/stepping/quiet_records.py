"""What a stretch of quiet steps is taken with, and what it leaves behind.

Between events a step is always the same: AB-r, columns, passes of QPs, BDF-r, the length of the
next.  `problems.stepping.quiet_steps` takes such steps, `problems.stepping.quiet` prepares them and
follows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.contacts.active_kernels import Contacts
from problems.contacts.geometry import Shapes
from problems.kernels.arena import Arena
from problems.qp import Indices, Vector

MOST = 256
"""Steps of one call."""

EVENT, LOOK, AGAIN, CHANGED = range(4)
"""Why there were no more steps: the next one is the stepper's; it has to look at the last one
first; there is no more room, or the candidates have to be listed anew; on the way, contacts have
changed."""


class State(NamedTuple):
    """Position, velocities and accelerations at the last two time points, (3n,) each."""

    q: Vector
    v: Vector
    v_before: Vector
    a: Vector
    a_before: Vector


class Settings(NamedTuple):
    """What the stepper is set to.

    eps, drop_tol, h_max, fixed, rest_speed : see `StepperOptions`; fixed is 0 with error control
    reach : how far bodies may move from where candidates were listed [m]
    allowed : overlap that drift may leave [m]
    highest : r of AB-r and BDF-r;  cuts : whether steps are cut where friction stops
    """

    eps: float
    drop_tol: float
    h_max: float
    fixed: float
    rest_speed: float
    reach: float
    allowed: float
    highest: int
    cuts: bool


CLOCK = np.dtype([(name, np.float64) for name in ("time", "h", "wish", "until")], align=True)
"""The time, the last step, the one wished for, and the time at which the stretch ends [s]."""
TALLY = np.dtype(
    [
        (name, np.int64)
        for name in (
            *("steps", "known", "taken", "solves", "counted", "rejected"),
            *("most_passes", "passes", "changes", "is_open", "ended"),
        )
    ],
    align=True,
)
"""Counts of a stretch.

steps : since the last restart;  known : time points with λ;  taken : steps of this stretch
solves : QPs;  counted : those of them that belong to steps taken or rejected
rejected : trials whose error turned out too large, or in which friction stops
most_passes : of friction (1: lagged);  passes : of the last step;  changes : of the contacts
is_open : whether nothing happens at `until`;  ended : `EVENT`, `LOOK`, `AGAIN` or `CHANGED`
"""


class QuietSteps(NamedTuple):
    """What steps are taken with, and what they leave behind.

    For n bodies and at first N active normals and F frictions, of which some leave on the way; what
    is left of arrays of these lengths is in front then.

    D : (3n,);  forces : (3n,) f;  eps0 : the accuracy asked of a QP (3.13)
    contacts : see there, multipliers and signs are updated
    corner, part, level, free : (L,) the candidates themselves, updated;  pairs : (P, 2) their parts
    listed_at : (3n,) where the candidates were listed
    state, clock, tally : updated; (1,) records the last two
    track : (MOST, 1 + 6n) t, q, q̇ of every step;  gaps : (MOST,) min φ [m]
    multipliers : (MOST, N + F) λ_N and λ_F
    at_bound, stopped : (F,) of the last step: `VelocityStep.at_bound`, whether a sliding one stops
    changes : (N + F, 2) steps taken and the row_id of a normal that left after them, or of a
        friction that began to slip
    sense : (N + F,) the sign s of that friction, 0 of a normal
    arena : room for what is made on the way
    """

    shapes: Shapes
    D: Vector
    forces: Vector
    eps0: float
    contacts: Contacts
    corner: Indices
    part: Indices
    level: Vector
    free: NDArray[np.bool_]
    pairs: Indices
    listed_at: Vector
    state: State
    settings: Settings
    clock: NDArray[np.void]
    tally: NDArray[np.void]
    track: Vector
    gaps: Vector
    multipliers: Vector
    at_bound: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    changes: Indices
    sense: Vector
    arena: Arena
