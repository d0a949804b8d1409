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

# rows of `QuietSteps.state`
Q, V, V_BEFORE, A, A_BEFORE = range(5)
# entries of `QuietSteps.reals`: the time, the last step and the one wished for [s] …
TIME, H, WISH = range(3)
# … and what the stepper is set to, the overlap that is allowed last [m]
EPS, DROP_TOL, H_MAX, FIXED, REST_SPEED, UNTIL, REACH, ALLOWED = range(3, 11)
# entries of `QuietSteps.counts`: steps since the last restart, steps taken, QPs solved, those of
# them that belong to steps taken or rejected, highest order, why there were no more, time points
# with λ, passes of friction at most (1: lagged), steps rejected because their error turned out too
# large or friction stops, whether nothing happens at UNTIL, passes of the last step, whether steps
# are cut where friction stops, changes of the contacts
STEPS, TAKEN, SOLVES, COUNTED, HIGHEST, ENDED, KNOWN, MOST_PASSES, REJECTED, OPEN = range(10)
PASSES, CUTS, CHANGES = 10, 11, 12
ENTRIES = 13
# values of `counts[ENDED]`: the next step is the stepper's; it has to look at the last one first;
# there is no more room, or the candidates have to be listed anew; on the way, contacts have changed
EVENT, LOOK, AGAIN, CHANGED = range(4)


class QuietSteps(NamedTuple):
    """What steps are taken with, and what they leave behind.

    For n bodies and at first N active normals and F frictions, of which some leave on the way; what
    is left of arrays of these lengths is in front then.

    D : (3n,);  forces : (3n,) f;  eps0 : the accuracy asked of a QP (3.13)
    contacts : see there, multipliers and signs are updated
    corner, part, level, free : (L,) the candidates themselves, updated;  pairs : (P, 2) their parts
    listed_at : (3n,) where the candidates were listed
    state, reals, counts : see the names above, updated
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
    state: Vector
    reals: Vector
    counts: Indices
    track: Vector
    gaps: Vector
    multipliers: Vector
    at_bound: NDArray[np.bool_]
    stopped: NDArray[np.bool_]
    changes: Indices
    sense: Vector
    arena: Arena
