"""What the rules against drift are worth: gaps, motion, energy, steps and time.

The same scenes as in `harness.claims.convergence`, with the same reference and h ≤ 0.3 √ε.  The
rules run in turn, round after round, each with its QPs kept, so that all go through the same code;
the first line of every ε is the run without a rule whose QPs are left to a compiled method
(`problems.stepping.driver`), as those of neither rule are.  The least time of a rule counts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from harness.claims.reference_motion import Case, Reference, run_case
from harness.motions.run_physics import energy, last_answers, loaded_gaps, overlap
from harness.results.claim import Row
from problems import Run
from problems.qp import Vector
from problems.sequence import SolvesQPs
from problems.stepping.drift import DriftRule

TOLERANCES = (1e-3, 1e-4)
"""ε of the runs."""
TIMES_OF_DECAY = (0.01, 0.03, 0.1, 0.3, 1.0)
"""τ of Baumgarte's stabilization [s]."""
SHALLOW = 1e-12
"""Overlap below which there is no drift, but rounding [m]."""
ROUNDS = 2
"""Timed runs of each rule."""


class Rule(NamedTuple):
    """A rule with its τ [s], and whether QPs are left to a compiled method."""

    drift: DriftRule
    tau: float = np.nan
    compiled: bool = False

    @property
    def name(self) -> str:
        if self.drift == "baumgarte":
            return f"baumgarte, τ = {self.tau:g}"
        return "none, compiled" if self.compiled else self.drift

    @property
    def options(self) -> dict[str, Any]:
        """For `problems.simulate`."""
        tau = {} if np.isnan(self.tau) else {"drift_time": self.tau}
        return {"drift": self.drift, "keep_qps": not self.compiled, **tau}


NONE = Rule("none")
RULES = (
    Rule("none", compiled=True),
    NONE,
    *(Rule("baumgarte", tau) for tau in TIMES_OF_DECAY),
    Rule("projection"),
)


def compare_rules(case: Case, reference: Reference, solver: SolvesQPs, eps: float) -> list[Row]:
    """Every rule at one ε, one row each.

    Columns: rule, drift, tau [s]; depth = −min φ of active contacts [m]; overlap of any
    two parts [m]; gap, mean |φ| of the loaded contacts at the end [m]; pose, largest error before
    and after the first impact [m]; energy, T + V at the end less the reference's, over its largest
    T; steps, events; cpu [s] and its ratio to no rule.
    """
    cpu = dict.fromkeys(RULES, np.inf)
    runs: dict[Rule, Run] = {}
    for _ in range(ROUNDS):
        for rule in RULES:
            runs[rule], spent = run_case(case, solver, eps, **rule.options)
            cpu[rule] = min(cpu[rule], spent)
    return [
        {
            "rule": rule.name,
            "drift": rule.drift,
            "tau": rule.tau,
            **_measures(run, reference),
            "cpu": cpu[rule],
            "ratio": cpu[rule] / cpu[NONE],
        }
        for rule, run in runs.items()
    ]


def _measures(run: Run, reference: Reference) -> dict[str, float]:
    pose, _ = reference.errors(run)
    hit = ~reference.within("before")
    exact, largest = reference.energy
    return {
        "depth": max(0.0, -float(run.gaps.min())),
        "overlap": max(0.0, float(overlap(run.scene, run.q).max())),
        "gap": _last_gap(run),
        "before": _largest(pose[~hit]),
        "after": _largest(pose[hit]),
        "energy": (energy(run)["final_energy"] - exact) / largest,
        "steps": run.counts["steps"],
        "events": len(run.event_log),
    }


def _largest(errors: Vector) -> float:
    return float(errors.max()) if errors.size else np.nan


def _last_gap(run: Run) -> float:
    """Mean |φ| of the contacts that bear a load at the end [m]; NaN where none does."""
    last = [(qp, x) for qp, x in last_answers(run) if qp.t == run.t[-1]]
    gaps = [loaded_gaps(run.scene, run.q[-1], qp, x) for qp, x in last]
    found = np.abs(np.concatenate([np.zeros(0), *gaps]))
    return float(found.mean()) if found.size else np.nan
