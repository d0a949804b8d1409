"""The judge: what an answer is worth, from x alone and never by the solver's word.

1. The KKT conditions of min ½‖A x + d‖², lower ≤ x ≤ upper, with Δ = Aᵀ(A x + d).  x determines
   the multipliers: a positive Δᵢ belongs to the lower bound, a negative one to the upper; where
   that bound is infinite nothing can carry it.
   `primal_residual` = largest violation of a bound;
   `dual_residual`   = largest |Δᵢ| that no bound can carry (stationarity and sign);
   `duality_gap`     = |Σ Δ⁺(x − l) + Δ⁻(u − x) + what is not carried times x| (complementarity).
2. `error_bound` (`harness.judging.error_bound`) on ‖A(x − x*)‖, which needs no reference.
3. With a reference (`harness.judging.oracle`): the error ‖A(x − x*)‖, relative to the scale of the
   QP (`glambda_error`) and to the accuracy that the stepper needs (`eps0_ratio`). What it rests on
   is `Reference.proof`, which rows hold.
4. The laws of contact in SI units (`harness.judging.physics`).
5. The verdict, from e and the accuracy asked.  e is the greatest of the error in A x (the bound
   where there is no reference, or one that is known not to be that of the recorded data), of
   ‖a_i‖ times the violation of a bound, so that no A x is bought with forces that contacts cannot
   give, and of u ‖|A||x|‖ with u = 2⁻⁵³, so that no x is taken whose A x is lost to whoever
   evaluates it in float64:

       verified       e ≤ 10 × asked
       inaccurate     beyond, and the reference is proved
       claimed_wrong  the error or the violation is proved to be beyond 1000 × asked, and the solver
                      said that it had succeeded
       failed         likewise, and it did not; or no x, or an x that is not finite
       undecided      nothing of this is known

   Upper bounds prove nothing wrong.  Neither the error bound nor u ‖|A||x|‖ makes an answer
   inaccurate or wrong; a proved reference does, and a violation of bounds.  So does a point within
   the bounds whose objective is lower than x's by more than an error of that size allows: that is
   what a reference is good for that is not proved.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from harness.judging.error_bound import ROUND_UP, error_bound, rounding_of
from harness.judging.facts import Facts, facts_of
from harness.judging.oracle import UNIT_ROUNDOFF
from harness.judging.oracle import reference as find_reference
from harness.judging.physics import NAN, Physics, physics
from harness.recordings.recording import Reference
from problems.qp import ContactQP, Vector

VERIFIED_WITHIN = 10.0
WRONG_BEYOND = 1000.0
"""Multiples of the accuracy asked."""

VERDICTS = (
    "verified",
    "inaccurate",
    "undecided",
    "claimed_wrong",
    "failed",
    "timeout",
    "crashed",
    "skipped",
)
"""All verdicts; the last three come from the replay, which saw the solve."""


@dataclass(frozen=True)
class Judgement(Physics):
    """What one answer is worth, with the measures of `harness.judging.physics`.

    verdict : one of `VERDICTS`
    error : e of the verdict, in ‖A δx‖;  asked : the accuracy that it is measured against
    glambda_error : ‖A(x − x*)‖/scale, dimensionless; NaN without a reference, as are
    eps0_ratio : ‖A(x − x*)‖/eps0
    objective_error : ½‖A x + d‖² less its minimum, relative to ½ scale²
    lambda_distance : ‖λ − λ*‖, λ* being the reference's.  A diagnostic, since λ is not unique where
        A lacks rank; for the QPs of kind minimum_norm, z of (4.8), which is unique
    error_bound : bound on ‖A(x − x*)‖ that needs no reference
    primal_residual, dual_residual, duality_gap : item 1 of the module's list
    """

    verdict: str
    error: float
    asked: float
    glambda_error: float = NAN
    eps0_ratio: float = NAN
    error_bound: float = float("inf")
    objective_error: float = NAN
    lambda_distance: float = NAN
    primal_residual: float = NAN
    dual_residual: float = NAN
    duality_gap: float = NAN


def judge(
    qp: ContactQP,
    x: ArrayLike | None,
    *,
    found: bool = True,
    asked: float | None = None,
    reference: Reference | None = None,
    facts: Facts | None = None,
    seek_reference: bool = True,
    mu: Vector | None = None,
) -> Judgement:
    """Judge the answer x to `qp`.

    x : (k,) or None
    found : whether the solver claims success; it can only turn failed into claimed_wrong
    asked : accuracy in ‖A δx‖; default: the QP's eps0
    reference, facts : of this QP, if they are at hand
    seek_reference : whether to ask the oracle where no reference is given
    mu : (k,) friction coefficients of tangent rows, see `Recording.mu`

    Raises ValueError for an x of the wrong shape.
    """
    asked = qp.eps0 if asked is None else float(asked)
    if x is None:
        return Judgement("failed", float("inf"), asked)
    x = np.asarray(x, float)
    if x.shape != (qp.k,):
        raise ValueError(f"A has shape {(qp.m, qp.k)}, so x needs {qp.k} entries; got {x.shape}")
    if not np.isfinite(x).all():
        return Judgement("failed", float("inf"), asked)
    # an absurd x may overflow; what comes of it is inf or NaN, and no answer
    with np.errstate(over="ignore", invalid="ignore"):
        return _judge(qp, x, found, asked, reference, facts or facts_of(qp), seek_reference, mu)


def _judge(
    qp: ContactQP,
    x: Vector,
    found: bool,
    asked: float,
    reference: Reference | None,
    facts: Facts,
    seek_reference: bool,
    mu: Vector | None,
) -> Judgement:
    if reference is None and seek_reference:
        reference = find_reference(qp, facts, start=x)
    exact = reference if reference is not None and reference.proof == "exact" else None
    bound = error_bound(qp, x, facts, known=exact)
    primal, dual, gap = kkt_residuals(qp, x)
    violated, rounding = _unfit(facts, x)
    error, proved, against = bound, violated, {}
    if reference is not None:
        # Extended precision, so that no digits of A x are lost to cancellation.
        off = _number(np.linalg.norm(facts.A @ x - reference.Ax))
        if exact is not None:  # no row says less than what it says itself of the error
            bound = max(bound, (off + reference.error_bound) * ROUND_UP)
        if reference.proof != "ill-posed":  # where the recorded data have another answer
            error = off
        proved = max(violated, off if reference.proved else _at_least(facts, x, reference))
        against = {
            "glambda_error": off / facts.scale,
            "eps0_ratio": off / qp.eps0,
            "objective_error": _objective_error(facts, x, reference),
            "lambda_distance": _lambda_distance(qp, x, reference),
        }
    error = max(error, violated, rounding)
    decided = reference is not None and reference.proved
    return Judgement(
        verdict=_verdict(error, proved, asked, found, decided),
        error=error,
        asked=asked,
        error_bound=bound,
        primal_residual=primal,
        dual_residual=dual,
        duality_gap=gap,
        **against,
        **asdict(physics(facts, x, mu, against.get("objective_error", NAN))),
    )


def kkt_residuals(qp: ContactQP, x: Vector) -> tuple[float, float, float]:
    """Primal residual, dual residual and duality gap of x (item 1 of the module's list)."""
    if qp.k == 0:
        return 0.0, 0.0, 0.0
    primal = max(0.0, float(np.max(qp.lower - x)), float(np.max(x - qp.upper)))
    gradient = qp.gradient(x)
    up, down = np.maximum(gradient, 0.0), np.maximum(-gradient, 0.0)
    has_lower, has_upper = np.isfinite(qp.lower), np.isfinite(qp.upper)
    uncarried = np.where(has_lower, 0.0, up) - np.where(has_upper, 0.0, down)
    gap = (
        up[has_lower] @ (x - qp.lower)[has_lower]
        + down[has_upper] @ (qp.upper - x)[has_upper]
        + uncarried @ x
    )
    return primal, float(np.abs(uncarried).max()), abs(float(gap))


def _unfit(facts: Facts, x: Vector) -> tuple[float, float]:
    """How far x is from being an answer at all, whatever its A x, in the unit of A x (item 5).

    Returns the violation of bounds, and what rounding to float64 can do to A x.
    """
    beyond = np.maximum(np.maximum(facts.qp.lower - x, x - facts.qp.upper), 0.0)
    violated = _number((beyond * facts.norms).max(initial=0.0))
    return violated, _number(UNIT_ROUNDOFF * np.linalg.norm(facts.absolute @ np.abs(x)))


def _number(value: np.floating) -> float:
    """As a float64; inf for what has overflowed."""
    return float("inf") if np.isnan(value) else float(value)


def _at_least(facts: Facts, x: Vector, reference: Reference) -> float:
    """Less than ‖A(x − x*)‖, from any y within the bounds whose objective is lower by D > 0.

    With e = A(x − x*), D ≤ ½‖r‖² − ½‖r*‖² = ½‖e‖² + r*ᵀe ≤ ½‖e‖² + ‖r_y‖‖e‖, since ‖r*‖ ≤ ‖r_y‖.
    """
    y = reference.x
    r, best = facts.A @ x + facts.d, facts.A @ y + facts.d
    size = np.linalg.norm(best)
    lost = rounding_of(facts, x) @ np.abs(r) + rounding_of(facts, y) @ np.abs(best)
    drop = (r - best) @ (r + best) - 4 * lost
    if not drop > 0:
        return 0.0
    return _number(drop / (size + np.sqrt(size * size + drop)) / ROUND_UP)


def _verdict(error: float, proved: float, asked: float, found: bool, decided: bool) -> str:
    """error : e, if no more is known;  proved : what it is at least;  decided : by a proof"""
    if error <= VERIFIED_WITHIN * asked:
        return "verified"
    if proved > WRONG_BEYOND * asked:
        return "claimed_wrong" if found else "failed"
    return "inaccurate" if decided or proved > VERIFIED_WITHIN * asked else "undecided"


def _objective_error(facts: Facts, x: Vector, reference: Reference) -> float:
    """(½‖r‖² − ½‖r*‖²)/(½ scale²) as ½(r − r*)ᵀ(r + r*), which does not cancel."""
    r = facts.A @ x + facts.d
    best = reference.Ax + facts.d
    return float((r - best) / facts.scale @ ((r + best) / facts.scale))


def _lambda_distance(qp: ContactQP, x: Vector, reference: Reference) -> float:
    if qp.kind != "minimum_norm":
        return float(np.linalg.norm(qp.multipliers(x) - qp.multipliers(reference.x)))
    r, best = qp.residual(x), reference.Ax + qp.d
    if r[-1] == 0 or best[-1] == 0:
        return NAN
    return float(np.linalg.norm(r[:-1] / r[-1] - best[:-1] / best[-1]))
