"""The tables of `glambda peers`, each with what its numbers say, whoever that flatters.

peers_least        least CPU time for an error of the pose, of each engine, motion by motion
peers_order        order in the step, smallest error, time per step
peers_whole        whole motions: deepest overlap, energy gained
peers_rest         towers at rest: drift, overlap, time per step
peers_lost         runs that did not end, and why
peers_engines      versions, and how their models differ from ours
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from harness.peers import OURS, REMEDY, EngineInfo
from harness.peers.compare import ABOVE_REFERENCE, TARGETS, cheapest, compared, order_of
from harness.peers.tasks import REST_STEP, REST_STEPS
from reports.parts.sentences import join
from reports.parts.table import Table, duration, power, scientific, times

FREE_FALL = 0.9
"""Share of a free fall beyond which a tower's top is said to fall freely."""
MUCH = 1e-3
"""A rise of energy that is told."""


def least_table(rows: pd.DataFrame, task: str) -> Table:
    """One motion: engines down, errors across, the least CPU time of any setting and step."""
    part = compared(rows)
    part = part[part["task"] == task]
    lines = []
    for engine, own in part.groupby("engine", sort=False):
        line: dict[str, Any] = {"engine": engine}
        for target in TARGETS:
            best = cheapest(own, target)
            line[f"≤ {power(target)}"] = np.nan if best is None else best["cpu"]
        finest = own.loc[own["kept_error"].idxmin()]
        lines.append({**line, "least error": finest["kept_error"], "by": finest["setting"]})
    names = [f"≤ {power(target)}" for target in TARGETS]
    own_error = part["reference_error"].max()
    return Table(
        name="peers_least",
        title="CPU time for an error",
        key={"motion": f"{task} s"},
        reading=(
            "the least CPU time of any setting and step whose error of the pose, over all bodies "
            "and all times compared, is at most that [m or rad], and with which all finer steps "
            "are that accurate, too: what a finer step loses again was luck. An en dash: no run "
            "was that accurate. The reference's own error is estimated at "
            f"{scientific(own_error)}."
        ),
        data=pd.DataFrame(lines, columns=["engine", *names, "least error", "by"]),
        formats={**dict.fromkeys(names, duration), "least error": scientific},
        notes=[*(_who_is_cheapest(part, target) for target in TARGETS), *_lucky_runs(part)],
    )


def _lucky_runs(part: pd.DataFrame) -> list[str]:
    """What engines reach for less, or reach at all, in runs whose finer ones are worse."""
    found = []
    for engine, own in part.groupby("engine", sort=False):
        for target in TARGETS:
            kept, lucky = cheapest(own, target), cheapest(own, target, "error")
            if lucky is not None and (kept is None or lucky["cpu"] < kept["cpu"]):
                instead = "" if kept is None else f" instead of {duration(kept['cpu'])}"
                found.append(f"{engine} ≤ {power(target)} in {duration(lucky['cpu'])}{instead}")
    return [f"Lucky runs, whose finer ones are worse: {'; '.join(found)}."] if found else []


def _who_is_cheapest(part: pd.DataFrame, target: float) -> str:
    """A sentence, whoever it flatters."""
    best = {
        engine: found["cpu"]
        for engine, own in part.groupby("engine", sort=False)
        if (found := cheapest(own, target)) is not None
    }
    asked = f"At an error of {power(target)}"
    if not best:
        return f"{asked} nobody arrives."
    first = min(best, key=lambda engine: best[engine])
    if OURS not in best:
        return f"{asked} {OURS} does not arrive; {first} is cheapest ({duration(best[first])})."
    mine, others = best.pop(OURS), best
    if not others:
        return f"{asked} {OURS} is alone ({duration(mine)})."
    rival = min(others, key=lambda engine: others[engine])
    if first == OURS:
        ratio = times(others[rival] / mine)
        return f"{asked} {OURS} is cheapest: {rival}, the next, takes {ratio} its time."
    cheaper = join([engine for engine in others if others[engine] < mine])
    ratio = times(mine / others[rival])
    return f"{asked} {OURS} takes {ratio} the time of {rival}; cheaper than it: {cheaper}."


def order_table(rows: pd.DataFrame) -> Table:
    """Order and floor of each engine in its most accurate setting, and of ours in all."""
    lines = []
    for (task, engine), part in compared(rows).groupby(["task", "engine"], sort=False):
        best = part.loc[part["error"].idxmin(), "setting"]
        for setting, own in part.groupby("setting", sort=False):
            if engine != OURS and setting != best:
                continue
            order = order_of(own)
            finest = own.loc[own["error"].idxmin()]
            lines.append(
                {
                    "motion": task, "engine": engine, "setting": setting,
                    "order": np.nan if order is None else order.p,
                    "runs": np.nan if order is None else order.points,
                    "least error": finest["error"], "at a mean step of": finest["step"],
                    "CPU time per step": own["cpu_step"].median(),
                    "overlap": finest["penetration"], "energy error": finest["energy_error"],
                }
            )  # fmt: skip
    columns = ["motion", "engine", "setting", "order", "runs", "least error", "at a mean step of"]
    data = pd.DataFrame(lines, columns=[*columns, "CPU time per step", "overlap", "energy error"])
    return Table(
        name="peers_order",
        title="Order in the step",
        reading=(
            "each engine in its most accurate setting. order is p in error ~ (mean step)^p, fitted "
            "by least squares to the runs whose error is below 0.1 and above "
            f"{ABOVE_REFERENCE:g} times the reference's own; one far above 2 says that few steps "
            "make the error, such as the first of a free flight. overlap [m] and energy error, "
            "over the energy at the start, are those of the most accurate run."
        ),
        data=data,
        formats={
            "order": "{:.2f}".format, "runs": "{:.0f}".format, "least error": scientific,
            "at a mean step of": duration, "CPU time per step": duration,
            "overlap": scientific, "energy error": scientific,
        },
        notes=_order_notes(data),
    )  # fmt: skip


def _order_notes(data: pd.DataFrame) -> list[str]:
    notes = []
    for task, part in data.groupby("motion", sort=False):
        known = part[part["order"].notna()]
        mine, others = known[known["engine"] == OURS], known[known["engine"] != OURS]
        text = f"{task} s:"
        if len(mine):
            text += f" {OURS} has order {join([f'{p:.2f} ({s})' for p, s in _pairs(mine)])}"
        if len(others):
            text += f"; the others {others['order'].min():.2f} to "
            text += f"{others['order'].max():.2f}, median {others['order'].median():.2f}"
        notes.append(text + ".")
    return notes


def _pairs(rows: pd.DataFrame) -> list[tuple[float, str]]:
    return list(zip(rows["order"], rows["setting"], strict=True))


def whole_table(rows: pd.DataFrame) -> Table:
    """Overlap and energy of the whole motions, beyond what can be compared in pose."""
    part = rows[(rows["kind"] == "whole") & (rows["status"] == "done")]
    lines = [
        {
            "motion": task, "engine": engine, "run": _run(own.iloc[0]),
            "least overlap": own["penetration"].min(), "most": own["penetration"].max(),
            "most gain": own["gain"].max(), "CPU time": own["cpu"].min(),
        }
        for (task, engine, _), own in part.groupby(["task", "engine", "resolution"], sort=False)
    ]  # fmt: skip
    columns = ["motion", "engine", "run", "least overlap", "most", "most gain", "CPU time"]
    return Table(
        name="peers_whole",
        title="Whole motions",
        reading=(
            "overlap is the deepest of two bodies or of one and the ground, at any multiple of "
            "1/60 s [m], in the best and in the worst setting of the engine; gain is the largest "
            "rise of the energy after any of them, relative to that at the start, where only "
            "losses are physical; CPU time is that of the fastest setting."
        ),
        data=pd.DataFrame(lines, columns=columns),
        formats={
            "least overlap": scientific, "most": scientific, "most gain": scientific,
            "CPU time": duration,
        },
        notes=_whole_notes(part),
    )  # fmt: skip


def _run(row: Any) -> str:
    """What was swept and its value, such as h = 1/240."""
    value = f"1/{round(1 / row.resolution):,}" if row.swept == "h" else f"{row.resolution:.0e}"
    return f"{row.swept} = {value}"


def _whole_notes(part: pd.DataFrame) -> list[str]:
    notes = []
    for task, own in part.groupby("task", sort=False):
        mine, others = own[own["engine"] == OURS], own[own["engine"] != OURS]
        fixed = others[np.isclose(others["resolution"], REST_STEP)]
        if len(mine) and len(fixed):
            notes.append(
                f"{task} s: at h = 1/{round(1 / REST_STEP)} the deepest overlap is "
                f"{scientific(fixed['penetration'].min())} to "
                f"{scientific(fixed['penetration'].max())} m in the others' settings, in {OURS} "
                f"at most {scientific(mine['penetration'].max())} m."
            )
        gains = own[own["gain"] > MUCH]
        if len(gains):
            who = join(list(dict.fromkeys(gains["engine"])))
            notes.append(f"{task} s: energy rises by more than {MUCH:g} in runs of {who}.")
    return notes


def rest_table(rows: pd.DataFrame) -> Table:
    """Towers: who holds them, and at what price."""
    part = rows[rows["kind"] == "rest"]
    lines = []
    for (task, engine), own in part.groupby(["task", "engine"], sort=False):
        held = own[own["status"] == "done"]
        line = {"tower": task.removesuffix(" at rest"), "engine": engine}
        if len(held):
            best = held.loc[held["drift"].idxmin()]
            line |= {
                "setting": best["setting"], "drift": best["drift"], "of the top": best["top"],
                "turn": best["turn"], "overlap": best["penetration"],
                "CPU time per step": best["cpu"] / REST_STEPS,
            }  # fmt: skip
        else:
            line["setting"] = join(list(dict.fromkeys(own["reason"])))
        lines.append(line)
    columns = ["tower", "engine", "setting", "drift", "of the top", "turn", "overlap"]
    numbers = dict.fromkeys(("drift", "of the top", "turn", "overlap"), scientific)
    data = pd.DataFrame(lines, columns=[*columns, "CPU time per step"])
    return Table(
        name="peers_rest",
        title="Towers at rest",
        reading=(
            f"after {REST_STEPS} steps of 1/{round(1 / REST_STEP)} s, in the setting that drifts "
            "least: drift is how far the body that moved most has moved along an axis [m], turn by "
            "how much one has turned [rad]. A rigid tower at rest stays as it is. Sleeping is off."
        ),
        data=data,
        formats={**numbers, "CPU time per step": duration},
        notes=[*_rest_notes(part), *_growth_notes(part)],
    )


def _growth_notes(part: pd.DataFrame) -> list[str]:
    """How the time per step grows with the bodies, where three towers or more differ in them."""
    family = part["scene"].str.replace(r",bodies=\d+", "", regex=True)
    held = part[part["status"] == "done"].assign(family=family)
    notes = []
    for name, own in held.groupby("family", sort=False):
        fastest = own.groupby(["engine", "bodies"], sort=False)["cpu_step"].min().unstack()
        powers = [
            f"{engine} {np.polyfit(np.log(times.index), np.log(times), 1)[0]:.2f}"
            for engine, row in fastest.iterrows()
            if len(times := row.dropna()) > 2
        ]
        if powers:
            text = f"{name}, any number of bodies: CPU time per step, in the fastest setting, grows"
            notes.append(f"{text} with their number to the power {join(powers)}.")
    return notes


def _rest_notes(part: pd.DataFrame) -> list[str]:
    notes = []
    fall = 0.5 * 9.81 * (REST_STEPS * REST_STEP) ** 2
    for task, own in part.groupby("task", sort=False):
        name = task.removesuffix(" at rest")
        held = own[own["status"] == "done"]
        mine, others = held[held["engine"] == OURS], held[held["engine"] != OURS]
        if len(mine):
            notes.append(f"{name}: {OURS} drifts by {scientific(mine['drift'].min())} m.")
        else:
            why = own.loc[own["engine"] == OURS, "reason"]
            notes.append(f"{name}: {OURS} does not finish ({join(list(why))}).")
        if len(others):
            best = others.loc[others["drift"].idxmin()]
            falling = others.groupby("engine")["top"].min() > FREE_FALL * fall
            text = f"{name}: of the others {best['engine']} ({best['setting']}) drifts least, by "
            text += f"{scientific(best['drift'])} m"
            if falling.any():
                text += f"; in no setting of {join(list(falling[falling].index))} is the top held: "
                text += f"it falls by {FREE_FALL:.0%} of a free fall or more"
            notes.append(text + ".")
    return notes


def lost_table(rows: pd.DataFrame) -> Table:
    """Runs that did not end."""
    part = rows[~rows["status"].isin(["done", "skipped"])]
    data = part[["task", "engine", "setting", "swept", "resolution", "status", "reason"]]
    data = data.assign(resolution=[_run(row) for row in data.itertuples()])
    return Table(
        name="peers_lost",
        title="Runs that did not end",
        reading="finer steps of a setting whose pass took too long were not tried.",
        data=data.drop(columns="swept").rename(columns={"resolution": "run"}),
    )


def engines_table(engines: Sequence[EngineInfo]) -> Table:
    """Who was asked, and how their models differ."""
    data = pd.DataFrame(
        [
            {"engine": e.name, "version": e.version or "absent", "model": e.model or e.reason}
            for e in engines
        ]
    )
    return Table(
        name="peers_engines",
        title="Engines",
        reading=(
            "each in the settings it comes with (stock) and in those that its manual recommends "
            f"for accuracy. {REMEDY} installs them all."
        ),
        data=data,
    )


def tables_of(rows: pd.DataFrame, engines: Sequence[EngineInfo]) -> list[Table]:
    """All tables of the page."""
    tasks = list(dict.fromkeys(compared(rows)["task"]))
    made = [*(least_table(rows, task) for task in tasks), order_table(rows)]
    made += [whole_table(rows), rest_table(rows), lost_table(rows)]
    return [*(table for table in made if len(table.data)), engines_table(engines)]
