"""The first screen: what was compared, who ranks where, the answers, and what not to conclude.

Each answer is one sentence of at most `WORDS` words made from the numbers of the study; what does
not flatter our method stands first in it.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from harness.names import METHOD, is_own
from reports.parts.sentences import join
from reports.parts.table import Table, microseconds, percent, scientific, short, times, whole
from reports.rows.comparison import compare, pool
from reports.rows.results import Results
from reports.sections.clocks import CLOCKS, by_clock, leads
from reports.sections.findings import sequence_arm
from reports.sections.ranking import WRONG, scores
from reports.sections.tables import warm_pairs, warm_row
from reports.sections.thresholds import criterion_tables

WORDS = 25
"""Longest answer."""


def facts(results: Results) -> list[tuple[str, str]]:
    """What was compared, on which machine, when, of which commit."""
    own = [name for name in results.solvers if is_own(name)]
    others = len(results.solvers) - len(own)
    study = results.study
    machines = sorted(results.rows["machine"].astype(str).unique())
    return [
        ("Compared", f"{others} solvers with {len(own)} of our method, the paper's and variants"),
        ("Machine", join(machines) or "not stored"),
        ("Day", str(study.get("begun") or "not stored")),
        ("Commit", str(study.get("commit") or "not stored")),
    ]


def pooled(results: Results) -> pd.DataFrame:
    """Rows of all scenes, of who is compared on every one, as in a simulation; what the others of
    this file are handed as `rows`.
    """
    if results.headline is None:
        return pd.DataFrame()
    arm, setting = sequence_arm(results), str(results.headline)
    return pool([compare(results.rows, scene, setting, arm) for scene in results.scenes])


def ranked_tables(results: Results, rows: pd.DataFrame) -> list[Table]:
    """Everybody but our variants, packages first; then the variants, which is an ablation."""
    if rows.empty:
        return []
    ranking = scores(rows, results.time_limit).set_index("solver")
    clocks = by_clock(rows)
    data = clocks.loc[list(ranking.index)].reset_index(names="solver")
    data.insert(2, "wrong", ranking["wrong"].to_numpy())
    variant = data["solver"].map(lambda name: is_own(name) and "[" in name).astype(bool)
    first, own = data[~variant], data[data["solver"].map(is_own).astype(bool)]
    first.insert(0, "rank", range(1, len(first) + 1))
    packages_first = first["solver"].map(is_own).astype(bool).sort_values(kind="stable").index
    tables = [_ranked("ranked", "Ranked", first.loc[packages_first], results)]
    if variant.any():
        tables.append(_ranked("ablation", "Ablation: variants of our methods", own, results))
    return tables


def _ranked(name: str, title: str, data: pd.DataFrame, results: Results) -> Table:
    return Table(
        name=name,
        title=title,
        reading=(
            f"Setting {results.headline}, {sequence_arm(results)} where it can be.  By wrong "
            "answers, unsolved QPs, then time from ready arrays; packages stand above ours, "
            "whatever their rank.  Times are µs per QP, shifted "
            "geometric means by three clocks; a dash: no clock of its own."
        ),
        data=data.reset_index(drop=True),
        formats={
            "rank": whole,
            "wrong": whole,
            "verified": percent,
            **dict.fromkeys(CLOCKS, microseconds),
        },
    )


def short_answers(results: Results, rows: pd.DataFrame) -> list[dict[str, Any]]:
    """Question, sentence and anchor of the evidence, as far as the study tells."""
    if rows.empty:
        return []
    found = [
        ("Which solver?", _which(rows, results), "cost"),
        ("How much faster, by which clock?", _faster(rows), "cost"),
        ("How accurate?", _accurate(results), "accuracy"),
        ("What is a warm start worth?", _warm(results), "warm-start"),
        ("When to refactorize?", _refactorize(results), "criterion"),
    ]
    return [{"question": q, "text": text, "anchor": a} for q, text, a in found if text]


def _which(rows: pd.DataFrame, results: Results) -> str:
    ranking = scores(rows, results.time_limit).set_index("solver")
    kept = [name for name in ranking.index if name == METHOD or not is_own(str(name))]
    if not kept:
        return ""
    first = str(kept[0])
    told = f"{first} ranks first, {microseconds(ranking.at[first, 'mean'])} µs per QP"
    if METHOD in kept and first != METHOD:
        own = ranking.loc[METHOD]
        return (
            f"{METHOD} is number {kept.index(METHOD) + 1} of {len(kept)}, with "
            f"{microseconds(own['mean'])} µs; {told}."
        )
    if len(kept) > 1:
        second = str(kept[1])
        told += f"; {second} is next with {microseconds(ranking.at[second, 'mean'])} µs"
    return f"{told}, of {len(kept)} compared."


def _faster(rows: pd.DataFrame) -> str:
    found = sorted(leads(by_clock(rows)), key=lambda lead: lead.ratio)
    if not found:
        return ""
    parts = [f"{times(lead.ratio)} {lead.clock}" for lead in found]
    rivals = join(sorted({lead.rival for lead in found}))
    return f"Speed of {METHOD} over the best other ({rivals}): {join(parts)}."


def _accurate(results: Results) -> str:
    rows = results.rows[(results.rows["settings"] == results.headline) & ~results.rows["skipped"]]
    if rows.empty:
        return ""
    sound = rows.groupby("solver")["verified"].all()
    worst = rows.loc[rows["solver"].isin(sound.index[sound]), "glambda_error"].max()
    wrong = int((rows["verdict"].isin(WRONG) & rows["found"].astype(bool)).sum())
    told = f"{wrong:,} answers called solved miss the accuracy asked; {int(sound.sum())} of "
    told += f"{len(sound)} solvers are always verified"
    return told + (f", off by {scientific(worst)} of the scale at most." if worst > 0 else ".")


def _warm(results: Results) -> str:
    parts = [warm_pairs(results.rows, scene, str(results.headline)) for scene in results.scenes]
    pairs = pd.concat(parts, ignore_index=True)
    ratio = pd.Series(
        {
            str(solver): warm_row(str(solver), part)["time ratio"]
            for solver, part in pairs.groupby("solver")
        },
        dtype=float,
    ).dropna()
    ratio = ratio[[name == METHOD or not is_own(name) for name in ratio.index]].sort_values()
    if ratio.empty:
        return ""
    slower = int((ratio > 1).sum())
    told = f"{slower} of {len(ratio)} lose by it; {ratio.index[0]} gains most, taking "
    told += f"{short(ratio.iloc[0])} of its cold time"
    if METHOD in ratio.index and ratio.index[0] != METHOD:
        told += f", {METHOD} {short(ratio[METHOD])}"
    return told + "."


def _refactorize(results: Results) -> str:
    tables = criterion_tables(results)
    if not tables:
        return ""
    work = tables[1].data
    work = work[work["flops per QP"].notna()]
    totals = work.assign(flops=work["flops per QP"] * work["QPs"], cg=work["CG per QP"])
    totals = totals.groupby("solver")[["flops", "cg"]].sum().sort_values("flops")
    anew, keep = totals[totals["cg"] == 0], totals[totals["cg"] > 0]
    if anew.empty or keep.empty:
        return ""
    ratio = keep["flops"].iloc[0] / anew["flops"].iloc[0]
    advice = "At every QP" if ratio >= 1 else "Seldom"
    return (
        f"{advice}, at these sizes: keeping R ({keep.index[0]}) does {short(ratio)} times the "
        f"operations of factorizing anew ({anew.index[0]})."
    )


def not_to_conclude(results: Results, rows: pd.DataFrame, lost: bool = False) -> list[str]:
    """What these numbers do not tell; `lost`: whether a package has won a race."""
    posed = results.rows[results.rows["k"] > 0]
    if posed.empty:
        return []
    machines = posed["machine"].nunique()
    said = [
        f"Larger QPs: k ≤ {whole(posed['k'].max())}, {whole(posed['k'].median())} in the median.",
        f"Other machines: times are of {machines} machine{'s' * (machines != 1)} alone.",
    ]
    if lost:
        said.append("Speed in a loop that does nothing else: a package is ahead there, see below.")
    heaps = [scene for scene in results.scenes if scene.startswith(("heap", "pyramid", "wall"))]
    said.append(
        f"Who wins on heaps: {join(heaps)} alone {'is' if len(heaps) == 1 else 'are'} here."
        if heaps
        else "Who wins on heaps: there is none here."
    )
    if len(rows):
        table = by_clock(rows)
        others = table[[not is_own(str(name)) for name in table.index]]
        share = (1 - others["inside the package"] / others["from A, d and bounds"]).dropna()
        if len(share):
            said.append(
                f"Method against method: {percent(max(0.0, share.median()))} of a whole call is "
                "wrapper, in the middle of the packages."
            )
    return said
