"""How far one motion is from another: poses in time, and the events that both went through.

Poses.  The reference is read at the times of the run by cubic interpolation
(`harness.motions.hermite`). A motion that has come to rest goes on standing there.

The error of a body is ‖δ(x, y)‖ + R |δφ| [m], R being the distance of its farthest corner: no point
of the body is farther off.  `largest` is over bodies and times, `rms` over both, weighted by time.
Once it exceeds `APART` two motions have separated: what comes after tells little of the solver,
because impacts enlarge whatever difference there is, and `apart` is when that was.

Events.  Those that restart the integration are matched in order, each with one of its kind within
`WINDOW` seconds; as many as possible, then with the least total difference in time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from harness.motions.hermite import hermite
from problems import Run
from problems.qp import Vector
from problems.stepping.run import Event

APART = 0.01
"""Pose error [m] beyond which two motions have separated."""
WINDOW = 0.05
"""Events farther apart than this [s] are not the same one."""
MATCHED_KINDS = ("impulse", "slide_off", "roll_over", "slip_to_stick", "force_jump")
"""Kinds of event that are matched.  The others are bookkeeping (drop, hand_over), or their time is
set by ε (stick_to_slip, rest)."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What is compared of a run.

    t : (n,) [s];  q, v : (n, bodies, 3);  radius : (bodies,) [m]
    events : of all kinds, in order;  at_rest : whether it ended because everything stood still
    """

    t: Vector
    q: Vector
    v: Vector
    radius: Vector
    events: Sequence[Event]

    @property
    def at_rest(self) -> bool:
        return any(event.kind == "rest" for event in self.events)

    @property
    def first_impact(self) -> float:
        """Time of the first impulse after t = 0 [s], or the end."""
        times = [event.t for event in self.events if event.kind == "impulse" and event.t > 0]
        return times[0] if times else float(self.t[-1])

    def at(self, times: Vector) -> Vector:
        """Poses (n, bodies, 3) at some times; beyond the end the last one."""
        return hermite(self.t, self.q, self.v, times)[0]


def motion_of(run: Run) -> Motion:
    """The motion of a finished simulation."""
    radius = np.array([body.radius for body in run.scene.bodies])
    return Motion(run.t, run.q, run.v, radius, run.event_log)


@dataclass(frozen=True, eq=False)
class PoseError:
    """Error of one motion against another: t (n,) [s] and error (n, bodies) [m]."""

    t: Vector
    error: Vector

    def largest(self, until: float = np.inf) -> float:
        """Over bodies and times up to `until` [s]; 0 where there is none."""
        return float(self.error[self.t <= until].max(initial=0.0))

    def rms(self, until: float = np.inf) -> float:
        """Root of the mean square over bodies and time up to `until` [s]."""
        t = self.t[self.t <= until]
        square = (self.error[: len(t)] ** 2).mean(axis=1)
        if len(t) < 2 or t[-1] == t[0]:
            return float(np.sqrt(square.max(initial=0.0)))
        return float(np.sqrt(np.trapezoid(square, t) / (t[-1] - t[0])))

    @property
    def apart(self) -> float:
        """First time at which some body is more than `APART` off [s]; NaN where none ever is."""
        beyond = np.flatnonzero(self.error.max(axis=1) > APART)
        return float(self.t[beyond[0]]) if beyond.size else float("nan")


def pose_error(motion: Motion, reference: Motion) -> PoseError:
    """Error of `motion` at its own times, and until the reference ends if it has come to rest."""
    t, q = motion.t, motion.q
    if not reference.at_rest:
        t, q = t[t <= reference.t[-1]], q[t <= reference.t[-1]]
    elif motion.at_rest and reference.t[-1] > t[-1]:
        t, q = np.append(t, reference.t[-1]), np.concatenate([q, q[-1:]])
    return PoseError(t, displacement(q - reference.at(t), motion.radius))


def displacement(off: Vector, radius: Vector) -> Vector:
    """‖δ(x, y)‖ + R |δφ| of differences off (..., bodies, 3), for R (bodies,); also of q̇."""
    return np.hypot(off[..., 0], off[..., 1]) + radius * np.abs(off[..., 2])


class EventMatch(NamedTuple):
    """How the events of a run go with those of a reference.

    matched : pairs;  missing : of the reference only;  extra : of the run only
    largest : time difference of a pair [s], 0 without pairs
    mismatch : time of the first event without a partner [s];  NaN where there is none
    """

    matched: int
    missing: int
    extra: int
    largest: float
    mismatch: float


def match_events(
    events: Sequence[Event], reference: Sequence[Event], until: float = np.inf
) -> EventMatch:
    """Match the restarting events (module, "Events").

    until : [s] only what happens up to there counts, for a pair in the reference
    """
    ours = [event for event in events if event.kind in MATCHED_KINDS]
    theirs = [event for event in reference if event.kind in MATCHED_KINDS]
    pairs = _best_pairs(ours, theirs)
    extra = _without(ours, {i for i, _ in pairs}, until)
    missing = _without(theirs, {j for _, j in pairs}, until)
    apart = [abs(ours[i].t - theirs[j].t) for i, j in pairs if theirs[j].t <= until]
    return EventMatch(
        matched=len(apart),
        missing=len(missing),
        extra=len(extra),
        largest=max(apart, default=0.0),
        mismatch=min([*missing, *extra], default=float("nan")),
    )


def _without(events: Sequence[Event], paired: set[int], until: float) -> list[float]:
    """Times of the events that have no partner."""
    return [e.t for i, e in enumerate(events) if i not in paired and e.t <= until]


def _best_pairs(ours: Sequence[Event], theirs: Sequence[Event]) -> list[tuple[int, int]]:
    """Indices of matched events: the longest common subsequence, then the least time difference."""
    n, m = len(ours), len(theirs)
    # value of the best matching of ours[i:] with theirs[j:]; a pair is worth more than any times
    worth = np.zeros((n + 1, m + 1))
    gain = np.full((n, m), -np.inf)
    for i in range(n - 1, -1, -1):
        for j in range(m - 1, -1, -1):
            apart = abs(ours[i].t - theirs[j].t)
            if ours[i].kind == theirs[j].kind and apart <= WINDOW:
                gain[i, j] = 1.0 - apart / (WINDOW * (n + m))
            worth[i, j] = max(
                worth[i + 1, j], worth[i, j + 1], worth[i + 1, j + 1] + gain[i, j]
            )  # fmt: skip
    pairs, i, j = [], 0, 0
    while i < n and j < m:
        if worth[i, j] == worth[i + 1, j + 1] + gain[i, j]:
            pairs.append((i, j))
            i, j = i + 1, j + 1
        elif worth[i, j] == worth[i + 1, j]:
            i += 1
        else:
            j += 1
    return pairs
