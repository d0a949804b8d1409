"""Painlevé's rod as a page: the first step, growth over a fixed time, and what becomes of it.

painleve.png    four panels
painleve.md     the same with tables;  painleve_*.csv  their numbers
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from harness.claims.painleve import Painleve
from harness.claims.slide import growth
from reports.claims.painleve_figure import LOOSE, TIGHT, plot_painleve
from reports.parts.table import Table, power, scientific, short, whole, write_page

# --- tables ---------------------------------------------------------------------------------------


def painleve_tables(measured: Painleve) -> list[Table]:
    """The tables in the order of the page."""
    return [
        first_table(measured.firsts),
        growth_table(measured.growths),
        fixed_table(measured.fixed),
        catch_table(measured.catches),
        outcome_table(measured.outcomes),
        approach_table(measured.approaches),
    ]


def first_table(firsts: pd.DataFrame) -> Table:
    """‖q̇_n − q̇_{n−1}‖_M of the first step, one column per h."""
    keys = ["motions", "gain", "rule", "eps"]
    data = firsts.pivot(index=keys, columns="h", values="jump")
    order = list(dict.fromkeys(firsts[keys].itertuples(index=False, name=None)))
    lengths = sorted(data.columns, reverse=True)
    data = data.loc[order, lengths]
    data.columns = [f"h = {power(h)}" for h in lengths]
    caught = firsts[(firsts["rule"] == "corrected") & (firsts["eps"] == TIGHT)]
    caught = caught[(caught["gain"] >= 1) & (caught["lam"] > 0)]
    paper = firsts[firsts["rule"] == "paper"]
    spread = paper[paper["lam"] > 0].groupby("motions", sort=False)["lam"]
    off = float((spread.max() / spread.min()).max() - 1)
    unseen = firsts[(firsts["rule"] == "corrected") & (firsts["eps"] == LOOSE)]
    unseen = unseen[(unseen["gain"] >= 1) & (unseen["lam"] > 0) & (unseen["impulse"] < 1e-2)]
    notes = [
        "Nothing blows up. By the paper's rule λ of the first step is that of (4.4), and the step "
        "of q̇ is O(h), whether a motion exists or not. λ of one case varies over h by "
        f"{off:.1%} at most, which at h = 1e-8 is rounding: (4.4) divides a difference of two φ by "
        "h².",
        "Corrected friction at ε = 1e-9 finds no λ for the signs given and lets the contact catch: "
        "λ grows as 1/h, h λ has a limit, and the jump in q̇ is that of the impulse without a "
        f"collision, to {_largest_error(caught):.1e} of it.",
    ]
    if len(unseen):
        notes.append(
            "At ε = 1e-3 its passes end where another would move q̇ by less than 0.1 ε (3.14), so "
            f"that in steps of {unseen['h'].max():.0e} and less the first step may be as by the "
            "paper's rule: that no motion exists shows later, when λ has grown. The event is "
            "there from the first step."
        )
    return Table(
        name="painleve_first",
        title="The first step after a collision, as h → 0",
        reading=(
            "‖q̇_n − q̇_{n−1}‖_M [kg^½ m/s] of the first step of length h after the impulse of a "
            "collision, by how many motions Coulomb's law leaves."
        ),
        data=data.reset_index(),
        formats={"gain": short, "eps": scientific, **dict.fromkeys(data.columns, scientific)},
        notes=notes,
    )


def _largest_error(caught: pd.DataFrame) -> float:
    return float((caught["jump"] / caught["catch"] - 1).abs().max())


def growth_table(growths: pd.DataFrame) -> Table:
    """Growth of errors in λ per step, measured and by the roots."""
    off = (growths["measured"] / growths["by (4.2)"] - 1).abs().max()
    return Table(
        name="painleve_growth",
        title="Growth of λ per step, by the gain",
        reading=(
            "Factor per step by which an error in λ grows in runs with constant steps and the "
            "paper's rule, beside the largest root |ζ| of ζ² = γ(2ζ − 1) for (4.2) and |γ| for "
            "(4.3); fitted over so many steps, before λ is clipped at 0 or has outgrown its start."
        ),
        data=growths,
        formats={
            "gain": "{:g}".format, "by (4.3)": "{:.4f}".format, "by (4.2)": "{:.4f}".format,
            "steps": whole, "measured": "{:.4f}".format,
        },
        notes=[
            f"Measured and predicted differ by {off:.1e} at most.",
            "(4.2) grows for γ > 1, where Coulomb's law fails, and for γ < −1/3, where it does "
            "not: there the corrected rule is the remedy. Wherever either grows, (4.2) grows "
            "faster.",
        ],
    )  # fmt: skip


def fixed_table(fixed: pd.DataFrame) -> Table:
    """Growth over a fixed time as h → 0."""
    exists = fixed[fixed["gain"].between(-1 / 3, 1)]
    fails = fixed[fixed["gain"] > 1]
    off = (fails["measured"] / fails["predicted"] - 1).abs().max()
    clipped = fixed[fixed["measured"] < 0.9 * fixed["predicted"]]
    notes = [
        "Over a fixed time, growth for γ > 1 has no limit as h → 0: "
        f"{fails['measured'].max():.1e} times in {fails['steps'].max()} steps, and λ = "
        f"{fails['lam'].max():.1e} N; the recurrence says so to {off:.1e}. The bounded first step "
        "says nothing about the later ones.",
        f"Within −1/3 < γ < 1 errors fade: {exists['measured'].max():.2g} times at most.",
    ]
    if len(clipped):
        notes.append(
            "γ = "
            + ", ".join(f"{g:g}" for g in clipped["gain"].unique())
            + ": growth ends where λ "
            "is clipped at 0, and λ goes on to and fro between two values."
        )
    return Table(
        name="painleve_fixed_time",
        title="Growth over a fixed time, as h → 0",
        reading=(
            "The paper's rule over t = 1e-6 s in n steps, slip going on: ζ^(n−2), by "
            "which errors in λ grow in the end; by how much they do from the first two to the last "
            "two steps, by the recurrence from its start and as measured; the last λ [N]."
        ),
        data=fixed.rename(columns={"power": "ζ^(n−2)", "lam": "λ"}),
        formats={
            "gain": "{:g}".format, "steps": whole, "h": scientific, "ζ^(n−2)": short,
            "predicted": short, "measured": short, "λ": short,
        },
        notes=notes,
    )  # fmt: skip


def catch_table(catches: pd.DataFrame) -> Table:
    """Runs with fixed steps until the slip has ended."""
    runs = catches.groupby(["rule", "h"], sort=False)
    data = runs.agg(end=("end", "first"), impulse=("impulse", "max"), error=("error", "first"))
    data = data.reset_index()
    data.insert(3, "÷ h", data["end"] / data["h"])
    data = data.rename(columns={"end": "slip ends", "impulse": "largest h λ"})
    paper = data[data["rule"] == "paper"].sort_values("h", ascending=False)
    steps = np.diff(paper["÷ h"].to_numpy())
    most = int(np.ceil(data.loc[data["rule"] == "corrected", "÷ h"].max()))
    gain = 1.2
    more = np.log(10) / np.log(growth(gain))
    return Table(
        name="painleve_catch",
        title="The rod without a motion, in fixed steps until its slip has ended",
        reading=(
            "When the slip ends [s], in steps; the largest impulse of one step [N·s]; and how far "
            "the jump in q̇ until then is from that of the impulse without a collision, relative."
        ),
        data=data,
        formats={
            "h": scientific, "slip ends": scientific, "÷ h": short,
            "largest h λ": scientific, "error": scientific,
        },
        notes=[
            "Over a fixed time λ of the paper's rule grows by |ζ|^(t/h) until the slip has ended. "
            f"That takes ln 10/ln ζ = {more:.2f} steps more for a tenth of h (measured: "
            f"{', '.join(f'{s:.2f}' for s in steps)}), so as h → 0 it happens at once, and the "
            f"jump is the one that the corrected rule makes in {most} steps at most. The limit of "
            "both rules is the impulse without a collision; neither converges to a sliding motion, "
            "as there is none.",
        ],
    )  # fmt: skip


def outcome_table(outcomes: pd.DataFrame) -> Table:
    """How each rule goes on with its own steps."""
    work = outcomes.groupby("rule")[["steps", "rejected"]].sum().sum(axis=1)
    return Table(
        name="painleve_outcomes",
        title="What becomes of the rod, ε = 1e-3 and variable steps",
        reading=(
            "The gain by theory and as the run reports it in its event; how and when [s] the slip "
            "ended (a jam and slip → stick are catches, a drop leaves the ground); how far the "
            "jump in q̇ is from the impulse without a collision; steps to t = 0.02."
        ),
        data=outcomes.set_index(["motions", "gain"]).reset_index(),
        formats={
            "gain": short, "reported": short, "t": scientific, "error": scientific,
            "steps": whole, "rejected": whole,
        },
        notes=[
            f"The paper's rule took {work['paper']} steps, rejected ones included, corrected "
            f"friction {work['corrected']}.",
            "Where Coulomb's law leaves two motions, λ = 0 and λ > 0, both rules leave the ground: "
            "(4.4) predicts no force, and nothing asks for one. The other motion, and the impulse "
            "that is possible there too, are never tried.",
        ],
    )  # fmt: skip


def approach_table(approaches: pd.DataFrame) -> Table:
    """Rods that rise towards γ = 1, by ε."""
    data = approaches.groupby(["spin", "eps"], sort=False).last().reset_index()
    data = data[["spin", "eps", "end", "t", "gain", "free", "lam", "later"]]
    data = data.rename(columns={"free": "B", "lam": "largest λ", "later": "spin at 0.15"})
    reached = data[data["gain"] > 0.99]["spin"].unique()
    ends = data[data["spin"].isin(reached)].groupby("spin")["end"]
    split = int((ends.nunique() > 1).sum())
    finest = data[data["eps"] == data["eps"].min()]
    worst = approaches.loc[approaches["gain"] > 1, "free"].min()
    left = int((finest[finest["spin"].isin(reached)]["end"] == "drop").sum())
    return Table(
        name="painleve_approach",
        title="The rod that rises towards γ = 1",
        reading=(
            "By its spin at the start [rad/s] and ε, corrected friction: how and when [s] the slip "
            "ended, γ and B [m/s²] then, the largest λ before [N], the spin at t = 0.15."
        ),
        data=data,
        formats={
            "spin": short, "eps": scientific, "t": "{:.5f}".format, "gain": "{:.4f}".format,
            "B": "{:.3f}".format, "largest λ": short, "spin at 0.15": "{:.3f}".format,
        },
        notes=[
            "Theory has B and 1 − γ vanish together (Génot and Brogliato 1999), never B < 0 beyond "
            f"γ = 1, where no motion would be left. The least B of all runs there is {worst:.2g}.",
            f"Beyond that point there are two motions. Of {len(reached)} spins that come near it, "
            f"{left} leave the ground at the finest ε; {split} end otherwise at a coarser one, "
            "which stays on the ground beyond γ = 1, on the other solution, and mostly catches. "
            "Which motion is followed, and all that comes after, is decided by ε.",
        ],
    )  # fmt: skip


# --- page -----------------------------------------------------------------------------------------


def write_painleve(measured: Painleve, folder: str | Path) -> Path:
    """Write painleve.md, the tables and the figure; return the page."""
    folder = Path(folder)
    plot_painleve(measured, folder / "painleve.png")
    tables = painleve_tables(measured)
    return write_page(
        folder / "painleve.md",
        "# Painlevé's rod\n\n"
        "A rod is pushed ahead on its lower end. Friction presses that end into the ground with "
        "the gain γ: for γ < 1 one motion exists; for γ > 1 none where B < 0, and two where B > 0, "
        "B being the gap acceleration without a contact force. The paper claims that the first "
        "step after a jump in q̇ does not blow up as h → 0 even where the equations have no "
        "solution (§4.2). That is so; what λ does over a fixed time is another matter.\n\n"
        "![The first step, growth per step, slip in fixed steps, ways to γ = 1](painleve.png)\n\n"
        + "\n".join(table.to_markdown() for table in tables),
        tables,
    )
