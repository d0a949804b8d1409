"""What a study found, in sentences computed from its rows.

Nothing here is written in advance: each answer is put together from the numbers of the study at its
headline setting, and says so where they are missing.  The same answer that praises our method says
where it loses.
"""

from __future__ import annotations

import pandas as pd

from reports.parts.names import solver_order
from reports.parts.sentences import Answer, join, ordinal
from reports.parts.table import microseconds, percent, scientific, short
from reports.rows.comparison import compare, pool, summarise
from reports.rows.results import ARMS, METHOD, Results
from reports.sections.clocks import agreement, by_clock, leads
from reports.sections.tables import SLOWER, warm_pairs, warm_row
from reports.sections.warm_worth import warm_answer


def sequence_arm(results: Results) -> str:
    """The arm that stands for a simulation: warm where there is one, else cold."""
    arms = set(results.rows["arm"].unique())
    return "warm" if "warm" in arms else "cold"


def which_method(results: Results) -> Answer | None:
    """The fastest backend verified on every QP, and our method beside it."""
    setting = results.headline
    if setting is None:
        return None
    arm = sequence_arm(results)
    comparisons = [compare(results.rows, scene, setting, arm) for scene in results.scenes]
    table = summarise(pool(comparisons), by="mean")
    question = "Which method?"
    scenes = [comparison.scene for comparison in comparisons if len(comparison.rows)]
    where = f"over {sum(c.common for c in comparisons):,} QPs of {join(scenes)}"
    if not table["best"].any():
        return Answer(
            question,
            "none",
            "backend verified on every QP",
            (f"No backend that was compared on every scene is verified on every QP {where}.",),
            "cost",
        )
    best = table[table["best"]].iloc[0]
    start = "started warm where it can be" if arm == "warm" else "started cold"
    said = [
        f"{best.name} is the fastest of the {len(table)} backends compared on every scene: "
        f"{microseconds(best['mean'])} µs per QP from ready arrays (shifted geometric mean "
        f"{where}, setting {setting}, {start})."
    ]
    sound = table[table["verified"] == 1.0].sort_values("mean", kind="stable")
    if METHOD not in table.index:
        said.append(f"Our method ({METHOD}) is not among them.")
    elif best.name == METHOD:
        if len(sound) > 1:
            second = sound.iloc[1]
            said.append(
                f"It is our method, {short(second['ratio'])} times faster than the next, "
                f"{second.name} ({microseconds(second['mean'])} µs)."
            )
    else:
        own = table.loc[METHOD]
        rank = 1 + int((sound["mean"] < own["mean"]).sum())
        said.append(
            f"Our method ({METHOD}) needs {microseconds(own['mean'])} µs, "
            f"{short(own['ratio'])} times as much"
            + (
                f", and stands {ordinal(rank)} of the {len(sound)} verified on every QP."
                if own["verified"] == 1.0
                else f", and is verified on {percent(own['verified'])} of them only."
            )
        )
    found = leads(by_clock(pool(comparisons)))
    if clocks := agreement(found):
        said.insert(0 if any(lead.ratio <= 1.0 for lead in found) else 1, clocks)
    wins, defeats = scene_wins(results, setting, arm)
    if wins or defeats:
        said.append(
            (f"By the median {METHOD} is the fastest on {join(wins)}" if wins else "")
            + ("; " if wins and defeats else "")
            + (
                ("it loses on " if wins else f"By the median {METHOD} loses on ") + join(defeats)
                if defeats
                else ""
            )
            + "."
        )
    return Answer(question, f"{microseconds(best['mean'])} µs", best.name, tuple(said), "cost")


def scene_wins(results: Results, setting: str, arm: str) -> tuple[list[str], list[str]]:
    """Scenes on which our method has the least median of all verified, and the others."""
    wins: list[str] = []
    defeats: list[str] = []
    for scene in results.scenes:
        table = compare(results.rows, scene, setting, arm).summary()
        if METHOD in table.index and table["best"].any():
            (wins if table.at[METHOD, "best"] else defeats).append(scene)
    return wins, defeats


def how_accurate(results: Results) -> Answer | None:
    """Who reproduces the same Gλ everywhere, how nearly, and who does not."""
    setting = results.headline
    if setting is None:
        return None
    rows = results.rows[(results.rows["settings"] == setting) & ~results.rows["skipped"]]
    shares = rows.groupby("solver")["verified"].mean()
    names = sorted(shares.index, key=solver_order)
    sound = [name for name in names if shares[name] == 1.0]
    worst = rows.loc[rows["solver"].isin(sound), "glambda_error"].max()
    said = []
    if sound:
        said.append(
            f"{len(sound)} of {len(names)} backends reproduce the same Gλ on every QP they were "
            f"given at setting {setting}: {join(sound, 20)}."
            + (f"  Their largest error is {scientific(worst)} of the scale." if worst > 0 else "")
        )
    else:
        said.append(f"No backend is verified on every QP it was given at setting {setting}.")
    missing = [name for name in names if shares[name] < 1.0]
    if missing:
        listed = [f"{name} ({percent(shares[name])})" for name in missing]
        said.append(f"Share verified of the others: {join(listed, 20)}.")
    wrong = rows[rows["verdict"] == "claimed_wrong"]
    if len(wrong):
        said.append(
            f"{len(wrong):,} answers are more than 1000 times off what was asked and were called "
            f"solved, by {join(sorted(wrong['solver'].unique(), key=solver_order))}."
        )
    if undecided := int((rows["verdict"] == "undecided").sum()):
        said.append(
            f"{undecided:,} answers are undecided: neither verified nor shown to be wrong, and "
            "charged like those that are."
        )
    unknown = int(rows["glambda_error"].isna().sum())
    if unknown:
        said.append(f"{unknown:,} of {len(rows):,} solves have no accepted reference or no answer.")
    return Answer(
        "How accurate?",
        f"{len(sound)} of {len(names)}",
        "backends verified on every QP",
        tuple(said),
        "accuracy",
    )


def warm_start_worth(results: Results) -> Answer | None:
    """What the object and what the start is worth, or both where they were not told apart."""
    told_apart = warm_answer(results)
    if told_apart is not None:
        return told_apart
    setting = results.headline
    if setting is None or not set(ARMS) <= set(results.rows["arm"].unique()):
        return None
    parts = [warm_pairs(results.rows, scene, setting) for scene in results.scenes]
    pairs = pd.concat(parts, ignore_index=True)
    rows = [warm_row(str(solver), part) for solver, part in pairs.groupby("solver")]
    table = pd.DataFrame(rows).set_index("solver") if rows else pd.DataFrame()
    if table.empty or table["time ratio"].notna().sum() == 0:
        return None
    said = []
    ratios = table["time ratio"].dropna().sort_values(kind="stable")
    if METHOD in ratios.index:
        own = table.loc[METHOD]
        share = own["one direction, warm"]
        said.append(
            f"{METHOD} needs {short(own['time ratio'])} of its cold time when started warm, what "
            "it saves by keeping its object included, "
            f"over {int(own['pairs']):,} QPs that do not follow a restart"
            + (
                f"; {percent(share)} of them take at most one descent direction, "
                f"{percent(own['one direction, cold'])} when cold."
                if pd.notna(share)
                else "."
            )
        )
    leader = ratios.index[0]
    if leader != METHOD:
        said.append(f"{leader} gains most: {short(ratios.iloc[0])} of its cold time.")
    slower = [f"{name} ({short(ratio)})" for name, ratio in ratios.items() if ratio > SLOWER]
    if slower:
        said.append(f"A warm start costs more than it saves for {join(slower)}.")
    without = [name for name in results.solvers if name not in set(pairs["solver"])]
    if without:
        said.append(f"Without a warm start: {join(without, 10)}.")
    shown = METHOD if METHOD in ratios.index else leader
    return Answer(
        "What is a warm start worth?",
        f"{short(ratios[shown])}×",
        f"the cold time of {shown}",
        tuple(said),
        "warm-start",
    )
