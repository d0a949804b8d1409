"""What the closed loops found, in sentences made from their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from harness.judging.judge import VERIFIED_WITHIN
from harness.motions.closed_loop import Findings
from harness.motions.in_loop import EXACT, SLOPPY
from harness.names import METHOD
from reports.parts.sentences import join
from reports.parts.table import percent, scientific, short, times

AS_GOOD = 2.0
"""Times the error of ε within which a motion counts as good as that of exact QPs."""
NOTABLE_ENERGY = 1e-3
"""Energy pumped in, over the largest kinetic energy, that is worth a sentence."""
NOTABLE_RANK = 0.1
"""Share of QPs that lack full rank that is worth a sentence."""
DEEPER = 10.0
"""Times the overlap or the reach of exact QPs that is worth a sentence."""


def metres(value: Any) -> str:
    """0.00012 → 0.12 mm; below a nanometre as an exponent."""
    size = float(value)
    for unit, one in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9)):
        if size >= one:
            return f"{short(size / one)} {unit}"
    return "0" if size == 0 else f"{scientific(size)} m"


def discretization(each: Findings) -> float:
    """Largest error of exact QPs at ε up to the time judged to [m]."""
    return each.twin_error.largest(each.common)


def own_error(each: Findings) -> float:
    """Estimated error of the reference up to there [m]: ε of the check is `ratio` times its ε."""
    ratio = each.check.loop.eps / each.reference.loop.eps
    return each.check_error.largest(each.common) / (ratio - 1)


def allowed(each: Findings) -> float:
    """Largest error [m] of a motion that is as good as that of exact QPs."""
    return AS_GOOD * max(discretization(each), own_error(each))


def is_good(each: Findings) -> pd.Series:
    """Per row, whether the motion came to its end as good as that of exact QPs."""
    return (each.rows["verdict"] == "finished") & (each.rows["error"] <= allowed(each))


def factor(setting: str) -> float:
    """100x → 100."""
    return float(setting[:-1])


def harmless(each: Findings, solver: str) -> float:
    """Largest multiple of ε₀ up to which every motion of a sloppy solver is good; NaN if none."""
    own = each.rows[(each.rows["solver"] == solver)].assign(good=is_good(each))
    own = own[own["setting"].str.endswith("x")]
    best = float("nan")
    for row in sorted(own.itertuples(), key=lambda row: factor(row.setting)):
        if not row.good:
            break
        best = factor(row.setting)
    return best


def as_large_as_eps(each: Findings, solver: str) -> float:
    """Multiple of ε₀ at which a sloppy solver moves the motion as far as ε does; NaN if it never.

    Where the distance from exact QPs first reaches the error of ε, both axes logarithmic.
    """
    own = each.rows[(each.rows["solver"] == solver) & (each.rows["verdict"] == "finished")]
    own = own[own["setting"].str.endswith("x")]
    points = sorted(zip(map(factor, own["setting"]), own["from_twin"], strict=True))
    target = discretization(each)
    for (low, near), (high, far) in pairwise(points):
        if near < target <= far:
            share = np.log(target / near) / np.log(far / near) if near > 0 else 1.0
            return float(low * (high / low) ** share)
    return points[0][0] if points and points[0][1] >= target else float("nan")


def backends(each: Findings) -> pd.DataFrame:
    """Rows of the backends: neither sloppy on purpose nor the exact QPs."""
    rows = each.rows
    exact = (rows["solver"] == METHOD) & (rows["setting"] == EXACT)
    return rows[~exact & ~rows["solver"].isin(SLOPPY)]


def findings_of(found: Sequence[Findings]) -> list[str]:
    """The sentences."""
    return [
        *_reference(found),
        *_finished(found),
        *_good(found),
        *_sloppy(found),
        *_physics(found),
        *_cost(found),
    ]


def _named(rows: pd.DataFrame, values: Sequence[str] | None = None) -> list[str]:
    """ "osqp at default (3.1×)" for each row."""
    names = [f"{row.solver} at {row.setting}" for row in rows.itertuples()]
    if values is None:
        return names
    return [f"{name} ({value})" for name, value in zip(names, values, strict=True)]


def _reference(found: Sequence[Findings]) -> list[str]:
    said = []
    for each in found:
        twin, own = discretization(each), own_error(each)
        text = (
            f"{each.scene}: with exact QPs, ε = {each.eps:g} leaves a largest pose error of "
            f"{metres(twin)} up to t = {each.common:.2f}; the reference itself is off by "
            f"about {metres(own)}."
        )
        for error, who in ((each.check_error, "its check"), (each.twin_error, "exact QPs at ε")):
            if not np.isnan(error.apart):
                text += f" At t = {error.apart:.2f} {who} and the reference separate."
        if each.common < each.reference.reached:
            text += (
                " Loops are judged up to the impact before: what comes after is not settled by "
                "making ε smaller."
            )
        said.append(text)
    return said


def _finished(found: Sequence[Findings]) -> list[str]:
    parts = [backends(each) for each in found]
    total = sum(len(part) for part in parts)
    if not total:
        return []
    lost = [
        f"{each.scene}: "
        + join(_named(bad, [f"{r.verdict} at t = {r.reached:.2f}" for r in bad.itertuples()]))
        for each, part in zip(found, parts, strict=True)
        if len(bad := part[part["verdict"] != "finished"])
    ]
    ended = total - sum(int((part["verdict"] != "finished").sum()) for part in parts)
    text = f"{ended} of {total} loops of the backends came to their end."
    return [text + (" The others: " + "; ".join(lost) + "." if lost else "")]


def _good(found: Sequence[Findings]) -> list[str]:
    said = []
    for each in found:
        rows = backends(each)
        if not len(rows):
            continue
        good = is_good(each)[rows.index]
        bad = rows[~good & (rows["verdict"] == "finished")].sort_values("error", ascending=False)
        text = (
            f"{each.scene}: {int(good.sum())} of {len(rows)} loops of the backends are as good as "
            f"exact QPs (within {times(AS_GOOD)} their error)."
        )
        if len(bad):
            within = bad[["eps0_ratio", "impulse_ratio"]].max(axis=1) <= VERIFIED_WITHIN
            unnoticed = bad[(bad["missed"] == 0) & within]
            named = join(_named(bad, [metres(error) for error in bad["error"]]), most=8)
            text += f" Not so: {named}; the stepper noticed nothing."
            if len(unnoticed):
                text += (
                    f" Of these, {join(_named(unnoticed), most=8)} met the accuracy that every QP "
                    "of a step or impulse asks for, within ten times."
                )
        said.append(text)
    return said


def _sloppy(found: Sequence[Findings]) -> list[str]:
    said = []
    for each in found:
        limits = {name: harmless(each, name) for name in SLOPPY if name in set(each.rows["solver"])}
        factors = [factor(s) for s in each.rows["setting"] if s.endswith("x")]
        if not limits or not factors:
            continue
        least = min(factors)
        noises = {name: name[len("sloppy[") : -1] for name in limits}
        enough = [noises[name] for name, limit in limits.items() if limit >= 1]
        others = [noises[name] for name in limits if noises[name] not in enough]
        if others and least > 1:
            text = f"{each.scene}: the accuracy ε₀ of (3.13) itself was not tried."
        elif not others:
            text = f"{each.scene}: the accuracy ε₀ of (3.13) is enough, for {join(enough)}."
        elif enough:
            text = (
                f"{each.scene}: the accuracy ε₀ of (3.13) is enough for {join(enough)}, "
                f"and not for {join(others)}."
            )
        else:
            text = f"{each.scene}: the accuracy ε₀ of (3.13) is not enough, for {join(others)}."
        known = [
            f"{noises[name]} up to {limit:g} ε₀"
            if limit >= least
            else f"{noises[name]} not even at {least:g} ε₀"
            for name, limit in limits.items()
        ]
        text += f" Harmless are {', '.join(known)}."
        deficient = each.twin.measures["rank_deficient"]
        if others and deficient > NOTABLE_RANK:
            text += (
                f" In {percent(deficient)} of its QPs λ is not unique: there ‖A δx‖ bounds the "
                "error of the motion of a step, and not that of λ, on which friction depends."
            )
        said.append(text)
    return said


def _physics(found: Sequence[Findings]) -> list[str]:
    said = []
    for each in found:
        rows = backends(each)
        rows = rows[rows["overlap"].notna()] if "overlap" in rows else rows[:0]
        if not len(rows):
            continue
        peak, exact = each.reference.measures["peak_kinetic"], each.twin.measures
        pumped = rows[rows["pumped"] > NOTABLE_ENERGY * peak].sort_values(
            "pumped", ascending=False
        )  # fmt: skip
        if len(pumped):
            shares = [percent(value / peak) for value in pumped["pumped"]]
            said.append(
                f"{each.scene}: forces too large pump energy in: {join(_named(pumped, shares))} of "
                "the largest kinetic energy."
            )
        for what, text in (
            ("overlap", "bodies overlap by"),
            ("reach", "contacts that have come apart go on pushing, across"),
        ):
            usual = max(exact[what], each.eps**2)
            deep = rows[rows[what] > DEEPER * usual].sort_values(what, ascending=False)
            if len(deep):
                depths = [metres(value) for value in deep[what]]
                said.append(
                    f"{each.scene}: {text} more than {times(DEEPER)} what they do with exact QPs "
                    f"({metres(usual)}): {join(_named(deep, depths))}."
                )
        approach = rows.loc[rows["approach"].idxmax()]
        if approach["approach"] > 0.1 * each.eps:
            said.append(
                f"{each.scene}: the fastest approach of a closed contact is "
                f"{scientific(approach['approach'])} m/s ({_named(rows.loc[[approach.name]])[0]})."
            )
    return said or ["No backend pumped a notable amount of energy in, or let bodies sink."]


def _cost(found: Sequence[Findings]) -> list[str]:
    said = []
    for each in found:
        rows = each.rows[each.rows["verdict"] == "finished"]
        exact = each.twin.measures["qps"]
        most = rows.loc[rows["qps"].idxmax()]
        if most["qps"] > AS_GOOD * exact:
            said.append(
                f"{each.scene}: inaccurate answers cost QPs as well: "
                f"{_named(rows.loc[[most.name]])[0]} needed {times(most['qps'] / exact)} those of "
                "exact QPs, in rejected and shorter steps."
            )
    own = pd.concat([backends(each) for each in found])
    own = own[own["verdict"] == "finished"]
    if len(own):
        share = own.groupby("solver")["call_time"].sum() / own.groupby("solver")["wall_time"].sum()
        said.append(
            f"The calls of the solver take {percent(share.min())} ({share.idxmin()}) to "
            f"{percent(share.max())} ({share.idxmax()}) of the wall time of a loop; the rest is "
            "the stepper's, and what it takes to know how accurate an answer is to be."
        )
    return said
