"""Are the certificates true, and how sharp are they?  Asked of answers whose error is known.

The error bound (`harness.judging.error_bound`) says how far A x can be from A x*, without knowing
x*.  Here it is asked about answers of every sort to recorded QPs whose A x* is proved in exact
arithmetic (`harness.judging.proof`): the stepper's own, the same off by a little and by much, and
answers to something else.  A bound below the true error, by more than the radius of the proof, is a
failure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd

from harness.judging.error_bound import error_bound
from harness.judging.facts import Facts, facts_of
from harness.progress import Progress
from harness.recordings.recording import Recording
from problems.qp import Vector, positions_of

SIZES = (1e-12, 1e-9, 1e-6, 1e-3, 1.0)
"""Errors of the perturbed answers, relative to the largest |x_i|."""
ROUNDING = 1e-13
"""Errors below this fraction of the scale are rounding: a bound cannot be sharp about them."""

Maker = Callable[[Facts, Vector, np.random.Generator], Vector]


def _perturbed(size: float) -> Maker:
    def make(facts: Facts, x: Vector, rng: np.random.Generator) -> Vector:
        return x + size * np.abs(x).max(initial=1e-3) * rng.standard_normal(x.size)

    return make


def _inside(size: float) -> Maker:
    def make(facts: Facts, x: Vector, rng: np.random.Generator) -> Vector:
        off = _perturbed(size)(facts, x, rng)
        return np.clip(off, facts.qp.lower, facts.qp.upper)

    return make


def _unbounded(facts: Facts, x: Vector, rng: np.random.Generator) -> Vector:
    """Least squares without any bounds: the least residual of all, by forces of the wrong sign."""
    return np.asarray(np.linalg.lstsq(facts.qp.dense_A, -facts.qp.d, rcond=None)[0])


ANSWERS: dict[str, Maker] = {
    "the stepper's": lambda facts, x, rng: x,
    **{f"off by {size:.0e}": _perturbed(size) for size in SIZES},
    **{f"within bounds, off by {size:.0e}": _inside(size) for size in SIZES},
    "signs turned": lambda facts, x, rng: -x,
    "nothing": lambda facts, x, rng: np.zeros_like(x),
    "without bounds": _unbounded,
}
"""How each sort of answer is made of the stepper's x."""
PREVIOUS = "of the QP before"
"""The sort of answer that needs the QP before: its x, mapped by row_id."""


def certificates(
    recording: Recording, *, at_most: int = 200, seed: int = 0, progress: Progress | None = None
) -> pd.DataFrame:
    """Error and bound of every sort of answer to up to `at_most` QPs, evenly spaced.

    Returns one row per QP and answer: scene, step, kind, k, independent (`Facts.independent`),
    answer, error and bound over the scale, radius (of the proof, likewise), below (whether the
    bound is below the error by more than the radius), feasible (whether x is within its bounds)
    and sharp (bound/error; NaN for an error that is rounding).  QPs without columns or without a
    proof are left out.
    """
    rng = np.random.default_rng(seed)
    chosen = np.unique(np.linspace(0, len(recording.qps) - 1, at_most).astype(int))
    rows = []
    for done, step in enumerate(chosen.tolist() if len(recording.qps) else []):
        if progress is not None and done % 20 == 0:
            progress(f"certificates of {recording.scene}", done, len(chosen))
        qp, known = recording.qps[step], recording.references[step]
        if qp.k == 0 or known is None or known.proof != "exact":
            continue
        facts = facts_of(qp)
        for answer, x in _answers(recording, step, facts, rng):
            error = float(np.linalg.norm(facts.A @ x - known.Ax))
            bound = error_bound(qp, x, facts)
            rows.append(
                {
                    "scene": recording.scene,
                    "step": step,
                    "kind": qp.kind,
                    "k": qp.k,
                    "independent": facts.independent,
                    "answer": answer,
                    "error": error / facts.scale,
                    "bound": bound / facts.scale,
                    "radius": known.error_bound / facts.scale,
                    "below": bound < error - known.error_bound,
                    "feasible": bool(((qp.lower <= x) & (x <= qp.upper)).all()),
                    "sharp": bound / error if error > ROUNDING * facts.scale else np.nan,
                }
            )
    return pd.DataFrame(rows, columns=COLUMNS)


COLUMNS = (
    *("scene", "step", "kind", "k", "independent", "answer"),
    *("error", "bound", "radius", "below", "feasible", "sharp"),
)
"""What `certificates` returns."""


def _answers(
    recording: Recording, step: int, facts: Facts, rng: np.random.Generator
) -> Iterator[tuple[str, Vector]]:
    qp = facts.qp
    x = recording.solutions[step].x
    known = recording.references[step]
    x = np.asarray(known.x if x is None and known is not None else x)
    for name, make in ANSWERS.items():
        yield name, make(facts, x, rng)
    before = recording.solutions[step - 1] if step else None
    if before is not None and before.x is not None and before.x.size:
        place = positions_of(qp.row_id, before.row_id)
        yield PREVIOUS, np.where(place >= 0, before.x[place], 0.0)


def summary(found: pd.DataFrame, by: tuple[str, ...] = ("answer",)) -> pd.DataFrame:
    """One line per sort of answer: how many, how many below, and how sharp the others.

    found : of `certificates`, of one or more recordings;  by : columns that make a line

    Columns: qps, below, error (median), quantiles 0.5, 0.9, 0.99 and 1 of sharp as median, q90,
    q99, worst, and floor: the largest bound on a feasible answer whose error is rounding.
    """
    lines = []
    for key, part in found.groupby(list(by), sort=False):
        quantiles = part["sharp"].quantile([0.5, 0.9, 0.99, 1.0]).tolist()
        right = part.loc[part["sharp"].isna() & part["feasible"], "bound"]
        counts = len(part), int(part["below"].sum()), part["error"].median()
        lines.append((*key, *counts, *quantiles, right.max()))
    names = ("qps", "below", "error", "median", "q90", "q99", "worst", "floor")
    return pd.DataFrame(lines, columns=[*by, *names])
