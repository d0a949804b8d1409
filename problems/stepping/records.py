"""What steps are taken with, and what they leave behind.

`problems.stepping.steps` takes steps, `problems.stepping.driver` prepares them and follows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from problems.contacts.active_kernels import Contacts
from problems.contacts.dips import MAX_HALVINGS
from problems.contacts.geometry import Shapes
from problems.friction.passes import GUESS, Passes
from problems.joints.row_kernels import Rows
from problems.qp import Indices, Vector

MOST = 256
"""Steps of one call."""

GOES_ON, AGAIN, LOOK, MEETS, HELD, STANDS, GIVES_UP = range(GUESS + 1, GUESS + 8)
"""Why a call ends, beside what passes may end with: nothing does; there is no more room, or the
candidates have to be listed anew; the stepper has to look at the last step; something may be met on
the way; friction that stops on the way is to stick for all of it; friction stops where the step
begins; it has been tried too often."""

LOOK_BACK, TRY, FORCED, PASS = range(4)
"""Where a call goes on: where steps begin, with another trial, with forces, with passes."""


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
    corrects : whether λ_* is corrected;  depends : whether forces depend on q̇
    supplied : whether forces, or what is added to q̇, have to be asked for at each trial
    switches : whether forces begin and end with functions of the state
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
    corrects: bool
    depends: bool
    supplied: bool
    switches: bool


CLOCK = np.dtype([(name, np.float64) for name in ("time", "h", "wish", "until")], align=True)
"""The time, the last step, the one wished for, and the time at which the stretch ends [s]."""
TALLY = np.dtype(
    [
        (name, np.int64)
        for name in (
            *("steps", "known", "taken", "most", "solves", "rejected"),
            *("is_open", "watched", "ended"),
        )
    ],
    align=True,
)
"""Counts of a stretch.

steps : since the last restart;  known : time points with λ;  taken : steps of this call, and most
solves : QPs of trials that were taken or rejected;  rejected : trials
is_open : whether nothing happens at `until`;  watched : whether the next step is to be looked at
ended : why
"""
TRIAL = np.dtype(
    [
        *((name, np.float64) for name in ("t", "h", "wish", "w", "longest", "cut", "looked")),
        *((name, np.int64) for name in ("stage", "order", "tries", "redone", "located")),
        *((name, np.int64) for name in ("hits", "overlaps", "ends", "stops", "stuck", "asks")),
    ],
    align=True,
)
"""A trial of the next step, and those before it that were in vain.

t : its end;  h : its length, at most `longest` and `cut`;  wish : the one wished for [s]
w : h_n/h_{n−1};  order : of AB-r and BDF-r
looked : h up to which the stepper has looked what is met, 0 where it has not
stage : see `LOOK_BACK`;  tries : trials;  redone, located : those whose error was too large, and
those in which friction stops
hits, overlaps, ends : whether a corner may hit a part, parts overlap, a corner leave its edge
stops : whether a stop is passed
stuck : whether λ_* begins with ∞, as if every contact in J_FO stuck whatever its load
asks : whether QPs are asked for
"""
FIRST_TRIAL = np.zeros((), TRIAL)
"""Of a step whose length is not limited by any before it."""
FIRST_TRIAL["longest"] = FIRST_TRIAL["cut"] = np.inf


class Near(NamedTuple):
    """The L candidates that are near, see `Candidates`; level is updated.

    before, after : (L,) clearances at the ends of the step
    """

    corner: Indices
    part: Indices
    level: Vector
    free: NDArray[np.bool_]
    pairs: Indices
    listed_at: Vector
    before: Vector
    after: Vector


class Ends(NamedTuple):
    """What a trial of N contacts, F of them with friction, begins and ends with.

    q, bend : (3n,) where it ends, and the curvature of (3.1a)
    forces_before : (3n,) f where it begins, for (4.4)
    phi : (N,) and slip : (F,) G_Fᵀq̇ where it begins
    phi_after, along, length, tangent : of the contacts where it ends, see `Columns`
    slip_after, lengths : (F,) G_Fᵀq̇ where it ends, and where friction stops on the way [s], or ∞
    at_bound : (F,) whether a friction force is proportional to λ_*
    """

    q: Vector
    bend: Vector
    forces_before: Vector
    phi: Vector
    slip: Vector
    phi_after: Vector
    along: Vector
    length: Vector
    tangent: Vector
    slip_after: Vector
    lengths: Vector
    at_bound: NDArray[np.bool_]

    @classmethod
    def of(cls, m: int, N: int, F: int) -> Ends:
        """Room for them."""
        motion, normal, friction = (np.zeros((r, n)) for r, n in ((3, m), (4, N), (3, F)))
        friction[2] = np.inf
        tangent, bound = np.zeros((N, 6)), np.zeros(F, np.bool_)
        return cls(
            *(*motion, normal[0], friction[0], *normal[1:], tangent, *friction[1:], bound),
        )


class Stops(NamedTuple):
    """Rows of joints that act only at φ = 0 and are not there; φ (S,) at the ends of a step."""

    rows: Rows
    before: Vector
    after: Vector
    columns: tuple[Vector, Indices]

    @classmethod
    def of(cls, rows: Rows) -> Stops:
        """Room for these."""
        S = rows.kind.size
        return cls(rows, np.zeros(S), np.zeros(S), (np.zeros((S, 6)), np.zeros((S, 2), np.int64)))


class Scratch(NamedTuple):
    """That of `first_dip`."""

    phis: Vector
    right: Vector
    left: Vector

    @classmethod
    def of(cls, edges: int) -> Scratch:
        """For parts with so many edges."""
        rows = MAX_HALVINGS + 2
        return cls(np.empty((rows, edges)), np.empty(rows), np.empty(edges))


class Steps(NamedTuple):
    """What steps are taken with, and what they leave behind, with N normals and F frictions.

    contacts : see there, multipliers and signs are updated
    state, clock, tally, trial : updated; (1,) records the last three
    passes : see there;  ends : of the trial
    track : (MOST, 1 + 6n) t, q, q̇ of every step;  gaps : (MOST,) min φ [m]
    multipliers : (MOST, N + F) λ_N and λ_F
    scratch : room for what is made on the way
    rows : of joints that act, the last of the N normals;  stops : those that do not
    """

    shapes: Shapes
    settings: Settings
    contacts: Contacts
    near: Near
    state: State
    clock: NDArray[np.void]
    tally: NDArray[np.void]
    trial: NDArray[np.void]
    passes: Passes
    ends: Ends
    track: Vector
    gaps: Vector
    multipliers: Vector
    scratch: Scratch
    rows: Rows
    stops: Stops
