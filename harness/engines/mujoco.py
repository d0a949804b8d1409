"""MuJoCo's own QPs, recorded along its own motion.

With the mass matrix M = L Lᵀ and the acceleration a₀ without constraints (`qacc_smooth`), a step of
MuJoCo is, for pyramidal friction cones or contacts without friction,

    minimise ½ fᵀ(J M⁻¹ Jᵀ + R) f + fᵀ(J a₀ − a_ref),   rows of f within bounds

J = efc_J, R = efc_R > 0, a_ref = efc_aref: how far a constraint gives way, and the acceleration
that it strives for.  That is our QP with

    A = [ L⁻¹Jᵀ ]     d = [ Lᵀ a₀        ]     A x + d = [ Lᵀ a           ]
        [ √R    ]         [ −a_ref / √R  ]               [ R^−½ (R f − a_ref) ]

and bounds by kinds of rows: equality free; friction of joints |f| ≤ efc_frictionloss; limits and
contacts (each edge of a pyramid is a row) f ≥ 0.  What MuJoCo's solver finds, efc_force, is kept as
the recorded answer, and judged like any other.

The *rigid twin* is the same motion with the rows √R dropped, so that redundant contacts are
redundant, A lacks rank, and f is not unique.  a_ref goes with √R; in its place the velocity at the
end of the step is asked to be admissible, J (v + h a) ≥ 0: d = Lᵀ(a₀ + v/h).

Rows are numbered by `harness.engines.row_numbers`.  Soft rows say which geoms meet but have no
`direction`: Signorini's and Coulomb's laws do not hold for them, nor are they asked about.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from harness.engines.row_numbers import CONTACT, RowNumbers
from harness.judging.facts import facts_of
from harness.progress import Progress
from harness.recordings.of_qps import recording_from
from harness.recordings.recording import Recording
from problems.qp import ContactQP, Indices, Vector

ASKED = 1e-6
"""ε₀ of the QPs, relative to their scale: nobody else has asked for one."""
UNTIL = 2.0
"""End of a motion [s], if nothing is said."""
SPARSE, MANY = 0.2, 60
"""A is kept sparse with a smaller share of entries, and more columns, than this."""
UNILATERAL, ELLIPTIC = 3, 7
"""mjtConstraint from which on a force is ≥ 0; contacts with a cone that is none of ours."""
GENERATOR = 2
"""`direction` of the first edge of a pyramid."""


def own_models() -> dict[str, Path]:
    """The models that come with this package, by name."""
    folder = Path(str(files("harness.engines"))) / "models"
    return {path.stem: path for path in sorted(folder.glob("*.xml"))}


def record_mujoco(
    model: str, until: float | None = None, *, rigid: bool = False, progress: Progress | None = None
) -> Recording:
    """Step a model and keep the QP of every step that has constraints.

    model : one of `own_models`, or the path of an MJCF file; it starts from its first keyframe
    until : end of the motion [s];  rigid : see the module
    progress : called with "simulate" (seconds of motion) and "reference" (QPs)

    Raises ValueError for a model that cannot be read, has elliptic cones with friction, or comes
    to no constraint.
    """
    until = UNTIL if until is None else float(until)
    if not 0 < until < np.inf:
        raise ValueError(f"until = {until}; give a positive number of seconds")
    name, compiled = _read(model)
    data = mujoco.MjData(compiled)
    if compiled.nkey:
        mujoco.mj_resetDataKeyframe(compiled, data, 0)
    qps: list[ContactQP] = []
    answers: list[Vector] = []
    numbers, steps = RowNumbers(), 0
    while data.time < until - 0.5 * compiled.opt.timestep:
        if progress is not None:
            progress("simulate", data.time, until)
        mujoco.mj_forward(compiled, data)
        if not np.isfinite(data.qacc).all():
            raise ValueError(f"{model}: t = {data.time:.4g}: the motion is no longer finite; "
                             "take a shorter time step in its <option>")  # fmt: skip
        if (data.efc_type == ELLIPTIC).any():
            raise ValueError(
                f"{model}: has elliptic friction cones, which are no bounds; "
                'give <option cone="pyramidal"/>, or condim="1" to every geom'
            )
        if data.nefc:
            qps.append(_pose(compiled, data, numbers, rigid, restart=not qps))
            answers.append(data.efc_force.copy())
        mujoco.mj_step(compiled, data)
        steps += 1
    if not qps:
        raise ValueError(f"{model}: no constraint was active until t = {until:g} s; "
                         "go on for longer, or let something touch")  # fmt: skip
    return recording_from(
        qps,
        f"mujoco_{name}" + (",rigid" if rigid else ""),
        parameters={
            "source": "mujoco",
            "mujoco.version": mujoco.__version__,
            "mujoco.timestep": compiled.opt.timestep,
            "mujoco.until": until,
            "mujoco.rigid": rigid,
            "mujoco.steps": steps,
        },
        answers=None if rigid else answers,  # its forces are of soft rows
        eps=compiled.opt.tolerance,
        gravity=float(np.linalg.norm(compiled.opt.gravity)),
        progress=progress,
    )


def _read(model: str) -> tuple[str, Any]:
    """Name and compiled model, ready for `_pose`."""
    path = own_models().get(model, Path(model))
    if not path.is_file():
        known = ", ".join(own_models())
        raise ValueError(f"{model}: there is no such model; give the path of an .xml, or {known}")
    try:
        compiled = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ValueError(f"{model}: MuJoCo cannot read it ({error}); mend the model") from None
    compiled.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    return path.stem, compiled


def _pose(model: Any, data: Any, numbers: RowNumbers, rigid: bool, restart: bool) -> ContactQP:
    """The QP of the step that begins in the state of `data`."""
    k, h = data.nefc, float(model.opt.timestep)
    L = la.cholesky(_mass_matrix(model, data), lower=True)
    J = data.efc_J.reshape(k, model.nv)
    A, free = la.solve_triangular(L, J.T, lower=True), data.qacc_smooth
    if rigid:
        d = L.T @ (free + data.qvel / h)
    else:
        root = np.sqrt(data.efc_R)
        A, d = np.vstack([A, np.diag(root)]), np.r_[L.T @ free, -data.efc_aref / root]
    kind = data.efc_type
    dry = (kind > 0) & (kind < UNILATERAL)
    limit = np.where(dry, data.efc_frictionloss, np.inf)
    sparse = k > MANY and np.count_nonzero(A) < SPARSE * A.size
    row_id = numbers.of(data, J)
    qp = ContactQP(
        sp.csc_array(A) if sparse else A,
        d,
        np.where(kind >= UNILATERAL, 0.0, -limit),
        limit,
        row_id=row_id,
        feature=_features(model, data, rigid),
        restart=restart,
        t=float(data.time) + h,
        h=h,
    )
    return qp.with_accuracy(ASKED * facts_of(qp).scale)


def _mass_matrix(model: Any, data: Any) -> Vector:
    M = np.zeros((model.nv, model.nv))
    if hasattr(data, "qM"):  # before MuJoCo 4
        mujoco.mj_fullM(model, M, data.qM)
    else:
        mujoco.mj_fullM(model, data, M)
    return M


def _features(model: Any, data: Any, rigid: bool) -> Indices:
    """Bodies and geoms of the rows of contacts; MuJoCo's body 0 is the world, our −1."""
    feature = np.full((data.nefc, 5), -1, np.int64)
    contact = data.efc_type >= CONTACT
    of = data.efc_id[contact]
    first, second = data.contact.geom.reshape(-1, 2)[of].T
    feature[contact, :4] = np.column_stack(
        [model.geom_bodyid[second] - 1, second, model.geom_bodyid[first] - 1, first]
    )
    if rigid:
        feature[:, 4] = GENERATOR
        starts = np.flatnonzero(np.r_[True, np.diff(of) != 0]) if of.size else of
        edge = np.arange(of.size) - np.repeat(starts, np.diff(np.r_[starts, of.size]))
        feature[contact, 4] = GENERATOR + edge
    return feature
