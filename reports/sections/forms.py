"""The same package posed the same QP in three forms: what does squaring the condition cost?

normal is P = AᵀA; residual has y = A x as rows; velocity is (3.4) (`solvers.adapters.programs`).
All are given the same scaled A and d and asked for the same accuracy.  Only rows of packages posed
in a form by name, such as `clarabel[residual]`, are looked at.

The condition of a QP is σ_max/σ_min of A with columns of length 1 and without fixed rows, as the
packages get it, over the σ above 1e-10 σ_max.  That of the paper's scenes is small; recordings made
by `glambda stretch` reach the decades beyond.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from harness.judging.facts import RANK_COLUMNS
from harness.judging.tolerances import RANK_TOL
from harness.names import STRETCHED
from problems.qp import ContactQP
from reports.parts.names import in_order
from reports.parts.sentences import Answer, join
from reports.parts.style import BLUE, GREEN, INK, PAGE_WIDTH, SOFT, VERMILLION, drawing, save
from reports.parts.table import Table, microseconds, percent, scientific, short, times, whole
from reports.rows.results import FORMS, Results, form_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {"normal": VERMILLION, "residual": BLUE, "velocity": GREEN}
MARKERS = {"normal": "o", "residual": "s", "velocity": "^"}
STRICT = "high"
"""The setting from which accuracy is told, where it was run."""
UNIT = float(np.finfo(float).eps)
NOTABLE = 0.05
"""Share of the answers that is worth a word, lost or gained."""
FEW = 20
"""QPs below which a decade is not spoken of."""


def form_rows(results: Results) -> pd.DataFrame:
    """Rows of packages in a form of choice, with `package`, `form`, `condition` and `decade`.

    decade : floor of log10 of the condition; NaN where the recording is not stored
    """
    rows = results.everything
    rows = rows[(rows["k"] > 0) & ~rows["skipped"]]
    rows = rows[rows["solver"].map(form_of).notna()]
    known = conditions({scene: results.recordings[scene] for scene in rows["scene"].unique()
                        if scene in results.recordings})  # fmt: skip
    condition = rows["problem"].map(known).astype(float)
    return rows.assign(
        package=rows["solver"].str.replace(r"\[.*", "", regex=True),
        form=rows["solver"].map(form_of),
        condition=condition,
        decade=np.floor(np.log10(condition) + 1e-9),
        error=rows["glambda_error"].fillna(rows["error_bound"] / rows["scale"]),
    )


def as_recorded(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of recordings that were not stretched; all where there is no other."""
    stretched = rows["scene"].str.contains(STRETCHED, regex=False)
    return rows if stretched.all() else rows[~stretched]


def conditions(recordings: Mapping[str, Any]) -> dict[str, float]:
    """Problem → condition of its A as the packages get it; 1 where nothing is left of A."""
    return {
        f"{scene}/{i:06d}": condition_of(qp)
        for scene, recording in recordings.items()
        for i, qp in enumerate(recording.qps)
        if 0 < qp.k <= RANK_COLUMNS
    }


def condition_of(qp: ContactQP) -> float:
    """σ_max/σ_min of A with unit columns, over what is not rounding and not fixed."""
    A = qp.dense_A[:, qp.lower < qp.upper]
    if A.size == 0:
        return 1.0
    lengths = np.linalg.norm(A, axis=0)
    sigma = np.linalg.svd(A / np.where(lengths > 0, lengths, 1.0), compute_uv=False)
    sigma = sigma[sigma > RANK_TOL * sigma[0]]
    return float(sigma[0] / sigma[-1]) if sigma.size else 1.0


def accuracy_setting(rows: pd.DataFrame, results: Results) -> str:
    """The setting from which accuracy is told."""
    there = in_order(rows["settings"].unique(), tuple(results.settings))
    return STRICT if STRICT in there else there[0]


def forms_tables(results: Results) -> list[Table]:
    """Time and accuracy per package and form, and accuracy by decades of the condition."""
    rows = form_rows(results)
    if rows.empty:
        return []
    made = [_forms_table(as_recorded(rows), results)]
    if rows["decade"].notna().any():
        made.append(_decades_table(rows, results))
    return made


def _forms_table(rows: pd.DataFrame, results: Results) -> Table:
    strict = accuracy_setting(rows, results)
    settings = in_order(rows["settings"].unique(), tuple(results.settings))
    out = []
    for (package, form), part in rows.groupby(["package", "form"]):
        at = part[part["settings"] == strict]
        row: dict[str, Any] = {"package": package, "form": form, "solves": len(part)}
        for arm in ("cold", "warm"):
            row[f"{arm} median"] = at.loc[at["arm"] == arm, "runtime"].median()
        row["iterations"] = at["iterations"].mean()
        for setting in settings:
            row[f"verified, {setting}"] = part.loc[part["settings"] == setting, "verified"].mean()
        row["Gλ error, median"], row["Gλ error, max"] = at["error"].median(), at["error"].max()
        row["no answer"] = int(at["verdict"].isin(["failed", "timeout", "crashed"]).sum())
        out.append(row)
    data = pd.DataFrame(out)
    data = data.sort_values(
        ["package", "form"], key=lambda c: c.map(FORMS.index) if c.name == "form" else c
    ).reset_index(drop=True)
    normal = data[data["form"] == "normal"].set_index("package")["cold median"]
    data.insert(4, "÷ normal", data["cold median"] / data["package"].map(normal))
    shares = [name for name in data.columns if name.startswith("verified")]
    errors = [name for name in data.columns if name.startswith("Gλ")]
    return Table(
        name="forms",
        title="One package, three forms",
        reading=(
            "normal: P = AᵀA, the adapters' own choice.  residual: y = A x as rows.  velocity: the "
            "strictly convex problem (3.4), whose multipliers are x.  Times in µs, iterations and "
            f"errors at setting {strict}, over all QPs with a multiplier as recorded; ÷ normal is "
            "of the cold medians.  Gλ error is of the scale; the judge's bound stands in where "
            "there is no reference."
        ),
        data=data,
        formats={
            "solves": whole, "cold median": microseconds, "warm median": microseconds,
            "÷ normal": times, "iterations": short, "no answer": whole,
            **dict.fromkeys(shares, percent), **dict.fromkeys(errors, scientific),
        },
        notes=_better_forms(data, shares),
    )  # fmt: skip


def _better_forms(data: pd.DataFrame, shares: list[str]) -> list[str]:
    """Where another form is both verified as often and faster than the adapter's."""
    said = []
    for package, part in data.groupby("package"):
        part = part.set_index("form")
        if "normal" not in part.index:
            continue
        own = part.loc["normal"]
        for form in part.index:
            row = part.loc[form]
            as_sound = all(row[name] >= own[name] for name in shares)
            if as_sound and row["cold median"] < own["cold median"]:
                said.append(
                    f"{package} is verified no less often and is faster in form {form}: "
                    f"{microseconds(row['cold median'])} µs instead of "
                    f"{microseconds(own['cold median'])} µs."
                )
    return said


def _decades_table(rows: pd.DataFrame, results: Results) -> Table:
    strict = accuracy_setting(rows, results)
    at = rows[(rows["settings"] == strict) & (rows["arm"] == "cold") & rows["decade"].notna()]
    out = []
    for (package, decade), part in at.groupby(["package", "decade"]):
        row: dict[str, Any] = {
            "package": package,
            "condition": f"1e{int(decade)} to 1e{int(decade) + 1}",
            "QPs": part["problem"].nunique(),
        }
        for form in FORMS:
            own = part[part["form"] == form]
            row[f"{form}, verified"] = own["verified"].mean() if len(own) else np.nan
            row[f"{form}, max error"] = own["error"].max()
        out.append(row)
    data = pd.DataFrame(out)
    return Table(
        name="forms_by_condition",
        title="Forms by the condition of A",
        reading=(
            f"Cold solves at setting {strict}, by decades of σ_max/σ_min of A with columns of "
            "length 1.  The normal form works with the square of it."
        ),
        data=data,
        formats={
            "QPs": whole,
            **{f"{form}, verified": percent for form in FORMS},
            **{f"{form}, max error": scientific for form in FORMS},
        },
    )


def plot_forms(results: Results, path: str | Path) -> Path:
    """Error in Gλ against the condition of A, one panel per package, one line per form.

    Raises ValueError where no form was run or no recording is stored.
    """
    rows = form_rows(results)
    if rows.empty or rows["condition"].isna().all():
        raise ValueError("no package was run in a form of choice on a recording that is stored")
    strict = accuracy_setting(rows, results)
    at = rows[(rows["settings"] == strict) & (rows["arm"] == "cold")]
    packages = sorted(at["package"].unique())
    with drawing() as Figure:
        across = min(4, len(packages))
        down = -(-len(packages) // across)
        figure = Figure(figsize=(PAGE_WIDTH, 2.0 * down + 0.6), layout="constrained")
        grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True)
        for axes in grid.ravel()[len(packages) :]:
            axes.set_visible(False)
        for axes, package in zip(grid.ravel(), packages, strict=False):
            _panel(axes, at[at["package"] == package])
            axes.set_title(package)
        for axes in grid[:, 0]:
            axes.set_ylabel("error in Gλ / scale")
        for column in range(across):
            lowest = [axes for axes in grid[:, column] if axes.get_visible()][-1]
            lowest.tick_params(labelbottom=True)
        for axes in grid[-1]:
            axes.set_xlabel("condition of A")
        lines, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower center", ncols=len(labels))
        return save(figure, Path(path))


def _panel(axes: Axes, part: pd.DataFrame) -> None:
    """Median of each half decade as a line, and the largest error as a thin one."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major")
    half = np.floor(2 * np.log10(part["condition"]) + 1e-9) / 2
    ends = np.array([1.0, 10 ** (half.max() + 0.5)])
    for power, label in ((1, "u κ"), (2, "u κ²")):
        axes.plot(
            ends, np.minimum(UNIT * ends**power, 1.0) if power == 1 else UNIT * ends**power,
            color=SOFT, linewidth=0.8, linestyle=(0, (1, 2)) if power == 1 else (0, (4, 3)),
            label=label, zorder=1,
        )  # fmt: skip
    axes.axhline(float((part["asked"] / part["scale"]).median()), color=INK, linewidth=0.8)
    axes.set_ylim(1e-17, 10.0)
    for form in FORMS:
        own = part[part["form"] == form]
        grouped = own["error"].replace(0.0, UNIT / 10).clip(upper=5.0).groupby(half)
        middle, most = grouped.median(), grouped.max()
        x = 10 ** (middle.index.to_numpy(float) + 0.25)
        axes.plot(
            x, middle, color=COLOURS[form], marker=MARKERS[form], markersize=3.4, linewidth=1.5,
            label=form, zorder=3,
        )  # fmt: skip
        axes.plot(x, most, color=COLOURS[form], linewidth=0.7, alpha=0.7, zorder=2)


def forms_answer(results: Results) -> Answer | None:
    """What squaring the condition costs, in sentences; None where too little is known of it."""
    rows = form_rows(results)
    if rows.empty or not {"normal"} < set(rows["form"]):
        return None
    strict = accuracy_setting(rows, results)
    at = rows[(rows["settings"] == strict) & (rows["arm"] == "cold")]
    share = _shares(at)
    if "normal" not in share:
        return None
    lossy = share.index[share["normal"] < 1 - NOTABLE]
    return Answer(
        "What does squaring the condition cost?",
        f"1e{int(lossy[0])}" if len(lossy) else "nothing",
        f"the condition from which the normal form loses over {percent(NOTABLE)} of the answers"
        if len(lossy)
        else f"in no decade does the normal form lose {percent(NOTABLE)} of the answers",
        (_time_of_forms(as_recorded(at)), *_by_decades(at, share, strict)),
        "forms",
    )


def _shares(at: pd.DataFrame) -> pd.DataFrame:
    """Share verified by decade and form, in decades of `FEW` QPs or more."""
    count = at.groupby("decade")["problem"].nunique()
    known = at[at["decade"].isin(count.index[count >= FEW])]
    return known.groupby(["decade", "form"])["verified"].mean().unstack("form")


def _time_of_forms(at: pd.DataFrame) -> str:
    medians = at.groupby(["package", "form"])["runtime"].median().unstack("form")
    fastest = medians.idxmin(axis=1)
    parts = [
        f"{form} is the fastest form of {join(sorted(fastest.index[fastest == form]), 8)}"
        for form in FORMS
        if (fastest == form).any()
    ]
    others = [
        f"{form} takes {short((medians[form] / medians['normal']).median())} times as long"
        for form in FORMS[1:]
        if form in medians
    ]
    return f"{_capital(join(parts))}.  In the middle of the packages {join(others)} as normal."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _by_decades(at: pd.DataFrame, share: pd.DataFrame, strict: str) -> list[str]:
    """Share verified in each decade, and for whom another form keeps what the normal one loses."""
    said = []
    for decade, shares in share.iterrows():
        listed = [f"{percent(shares[form])} {form}" for form in FORMS if form in shares]
        low = int(float(str(decade)))
        said.append(
            f"At conditions of 1e{low} to 1e{low + 1} this share of answers is verified at "
            f"{strict}: {join(listed)}."
        )
    each = at[at["decade"].isin(share.index)]
    each = each.groupby(["package", "decade", "form"])["verified"].mean().unstack("form")
    for form in FORMS[1:]:
        if form not in each:
            continue
        gain = (each[form] - each["normal"]).groupby("package").agg(["min", "max"])
        parts = []
        for word, who in (
            ("more", gain.index[gain["max"] > NOTABLE]),
            ("fewer", gain.index[gain["min"] < -NOTABLE]),
        ):
            if len(who):
                parts.append(f"{word} of those of {join(sorted(who), 8)}")
        if parts:
            said.append(
                f"Against normal, form {form} keeps, in some decade and by more than "
                f"{percent(NOTABLE)} of the answers, {join(parts)}."
            )
    return said
