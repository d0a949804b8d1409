"""Three clocks per solve: who is first by which, and whether they agree.

    inside the package       by its own clock, where it has one; of our methods, the compiled call
    from ready arrays        setup and solve, with what was seen and not told (`runtime`)
    from A, d and bounds     the whole call in Python, building the package's arrays included

An adapter can make a package look slow by any of the last two, and a package itself by the first.
So a lead is stated only where all clocks agree on it, with the least of its ratios.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from harness.names import is_own
from reports.parts.names import solver_order
from reports.parts.sentences import join
from reports.parts.table import Table, microseconds, short, times
from reports.rows.comparison import SHIFT, compare, pool, shifted_geometric_mean
from reports.rows.results import METHOD, Results

CLOCKS = {
    "inside the package": "inside_time",
    "from ready arrays": "runtime",
    "from A, d and bounds": "call_time",
}
"""Clock → column of a row."""


class Lead(NamedTuple):
    """Our method beside the fastest of everybody else, all verified on every QP, by a clock.

    ratio : the rival's mean over ours, above 1 where ours is faster
    """

    clock: str
    rival: str
    ratio: float


def by_clock(rows: pd.DataFrame) -> pd.DataFrame:
    """Shifted geometric means [s] by each clock, one row per solver; and `verified`, its share.

    rows : of compared runs on common QPs.  NaN by a clock that a solver does not have.
    """
    columns = ["verified", *CLOCKS]
    out = {
        str(solver): [part["verified"].mean(), *(_mean(part[column]) for column in CLOCKS.values())]
        for solver, part in rows.groupby("solver")
    }
    table = pd.DataFrame.from_dict(out, orient="index", columns=columns)
    return table.loc[sorted(table.index, key=solver_order)]


def _mean(times: pd.Series) -> float:
    return float("nan") if times.isna().any() else shifted_geometric_mean(times)


def leads(table: pd.DataFrame) -> list[Lead]:
    """Our method's lead by each clock that it and somebody else have, of `by_clock`."""
    sound = table[table["verified"] == 1.0]
    if METHOD not in sound.index:
        return []
    others = sound[[not is_own(str(name)) for name in sound.index]]
    out = []
    for clock in CLOCKS:
        known = others[clock].dropna()
        own = float(sound.loc[METHOD, clock])
        if len(known) and np.isfinite(own):
            out.append(Lead(clock, str(known.idxmin()), float(known.min()) / own))
    return out


def agreement(found: list[Lead]) -> str:
    """What may be said of our method: by all clocks, or by which not; empty where nothing may."""
    if not found:
        return ""
    behind = [lead for lead in found if lead.ratio <= 1.0]
    ahead = [lead for lead in found if lead.ratio > 1.0]
    lost = [f"{each.clock} {each.rival} is {short(1 / each.ratio)} times faster" for each in behind]
    won = [f"{each.clock} {METHOD} is {short(each.ratio)} times faster than {each.rival}"
           for each in ahead]  # fmt: skip
    if lost and won:
        return f"The clocks do not agree: {join(lost)}; {join(won)}."
    if lost:
        return f"{METHOD} is not the fastest by any clock: {join(lost)}."
    least = min(ahead, key=lambda lead: lead.ratio)
    return (
        f"{METHOD} is ahead of everybody else by all clocks that there are ({len(found)}), by a "
        f"factor of {short(least.ratio)} at least, {least.clock}, over {least.rival}."
    )


def clocks_table(results: Results, setting: str, arm: str) -> Table:
    """Means by each clock per scene, and over all scenes together."""
    compared = {scene: compare(results.rows, scene, setting, arm) for scene in results.scenes}
    parts = {scene: each.rows for scene, each in compared.items() if len(each.rows)}
    if len(parts) > 1:
        parts["all scenes"] = pool(list(compared.values()))
    out, notes = [], []
    for scene, rows in parts.items():
        table = by_clock(rows)
        sound = table[table["verified"] == 1.0]
        for solver, means in table.iterrows():
            row: dict[str, object] = {"scene": scene, "solver": solver}
            for clock in CLOCKS:
                best = sound[clock].min() if len(sound) else np.nan
                row[clock], row[f"{clock} ÷ best"] = means[clock], means[clock] / best
            out.append(row)
        if said := agreement(leads(table)):
            notes.append(f"{scene}: {said}")
    data = pd.DataFrame(out)
    return Table(
        name="clocks",
        key={"setting": setting},
        title="Three clocks",
        reading=(
            "µs per QP, shifted geometric means with shift "
            f"{1e6 * SHIFT:g} µs, on the QPs that all compared backends answered.  Inside: by the "
            "package's own clock, of ours the compiled call; a dash where a package has none.  "
            "From ready arrays: setup and solve.  From A, d and bounds: the whole call as a user "
            "in Python makes it, the package's arrays built within.  ÷ best is over the fastest "
            "verified on every QP by that clock."
        ),
        data=data,
        formats={
            **dict.fromkeys(CLOCKS, microseconds),
            **dict.fromkeys([f"{clock} ÷ best" for clock in CLOCKS], times),
        },
        notes=notes,
    )
