"""What the answers are worth that came with a recording: of the engine that posed its QPs.

They are judged from x alone, as every backend's are (`harness.judging.judge`), at the accuracy
`default`.  Beside the verdicts there is one figure without tolerances, the *KKT residual*: with
Δ = Aᵀ(A x + d), the largest of

    |min(x − l, u − x)⁻| ‖a_i‖      a bound is violated
    |Δ_i| / ‖a_i‖                   no bound can carry it: x_i is between its bounds, or Δ_i has
                                    the sign that the bound at x_i cannot carry

over the scale of the QP.  An x_i that is off its bound by rounding is at it: of |Δ_i|/‖a_i‖ and the
distance to the bound times ‖a_i‖ the smaller counts.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from harness.judging.facts import Facts, facts_of
from harness.judging.judge import judge
from harness.progress import Progress
from harness.recordings.recording import Recording
from problems.qp import Vector

SETTING = "default"


@dataclass(frozen=True)
class RecordedAnswers:
    """answers : how many there are;  verdicts : {verdict: how many}
    kkt_median, kkt_worst : of the KKT residual;  error_worst : largest glambda_error
    """

    answers: int
    verdicts: dict[str, int]
    kkt_median: float
    kkt_worst: float
    error_worst: float

    def sentence(self) -> str:
        """All of it in words."""
        told = ", ".join(f"{count} {verdict}" for verdict, count in self.verdicts.items())
        return (
            f"KKT residual {self.kkt_median:.1e} (median), {self.kkt_worst:.1e} (worst) of the "
            f"scale, error in A x at most {self.error_worst:.1e}; {told} at setting {SETTING}"
        )


def recorded_answers(
    recording: Recording, progress: Progress | None = None
) -> RecordedAnswers | None:
    """Judge the answers of a recording; None where it has none."""
    residuals, errors, verdicts = [], [], Counter[str]()
    for i, (qp, solution, known) in enumerate(
        zip(recording.qps, recording.solutions, recording.references, strict=True)
    ):
        if progress is not None:
            progress(f"answers of {recording.scene}", i, len(recording.qps))
        if solution.x is None or qp.k == 0:
            continue
        facts = facts_of(qp)
        found = judge(qp, solution.x, asked=facts.asked(SETTING), reference=known, facts=facts)
        verdicts[found.verdict] += 1
        errors.append(found.glambda_error)
        residuals.append(kkt_residual(facts, solution.x))
    if not residuals:
        return None
    return RecordedAnswers(
        len(residuals),
        dict(verdicts),
        float(np.median(residuals)),
        max(residuals),
        float(np.nanmax(errors)),
    )


def kkt_residual(facts: Facts, x: Vector) -> float:
    """The KKT residual of x (k,), over the scale."""
    qp, norms = facts.qp, facts.norms
    slope = np.asarray(facts.A.T @ (facts.A @ x + facts.d), float) / norms
    with np.errstate(invalid="ignore"):
        below, above = (x - qp.lower) * norms, (qp.upper - x) * norms
    outside = np.maximum(np.maximum(-below, -above), 0.0)
    uncarried = np.where(slope > 0, np.minimum(slope, below), np.minimum(-slope, above))
    uncarried[slope == 0] = 0.0
    return float(np.maximum(outside, np.abs(uncarried)).max(initial=0.0)) / facts.scale
