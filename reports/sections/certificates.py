"""Can the verdicts be trusted?  What references rest on, and what the error bound is worth.

1. `references_table`: of every recording, how many A x* are proved in exact arithmetic.
2. `certificates_tables`, `plot_certificates`: the error bound against the true error of answers of
   every sort, `harness.judging.certificates`.  No solver is run for it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from harness.judging.certificates import ROUNDING, certificates, summary
from harness.judging.facts import facts_of
from harness.names import DISTURBED, STRETCHED
from harness.progress import Progress
from harness.recordings.recording import PROOFS
from reports.parts.sentences import Answer
from reports.parts.style import BLUE, GREEN, INK, ORANGE, PAGE_WIDTH, PURPLE, SOFT, drawing, save
from reports.parts.table import Table, percent, scientific, short, whole
from reports.rows.results import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AT_MOST = 100
"""QPs of a recording that are asked about."""
TICKS = (1, 2, 5, 10, 20, 50, 100)
"""Where no bound is larger; else decades."""
LINES = (BLUE, ORANGE, GREEN, PURPLE, INK)
STYLES = ("-", "--", ":")
"""Of scenes beyond the first five, whose colours are used again."""
MADE_OF = f"(?:{DISTURBED}|{STRETCHED}).*"
"""What the name of a recording says of how it was made of another; both are drawn as one."""
NAMES, NAME = 2, 0.19
"""Scenes beside each other in the legend, and the height of one [in]."""


def certificates_of(results: Results, progress: Progress | None = None) -> pd.DataFrame:
    """`harness.judging.certificates` of all recordings that are stored; seconds, not minutes."""
    found = [
        certificates(recording, at_most=AT_MOST, progress=progress)
        for recording in results.recordings.values()
    ]
    filled = [part for part in found if len(part)]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame()


def references_table(results: Results) -> Table:
    """What the references of each recording rest on."""
    out = []
    for scene, recording in results.recordings.items():
        known = [reference for reference in recording.references if reference is not None]
        radii = [
            reference.error_bound / facts_of(qp).scale
            for qp, reference in zip(recording.qps, recording.references, strict=True)
            if reference is not None
        ]
        out.append(
            {
                "recording": scene,
                "QPs": len(recording.qps),
                **{proof: sum(r.proof == proof for r in known) for proof in PROOFS},
                "none": len(recording.qps) - len(known),
                "largest radius": max(radii, default=np.nan),
            }
        )
    names = ["recording", "QPs", *PROOFS, "none", "largest radius"]
    return Table(
        name="references",
        title="What the references rest on",
        reading=(
            "exact: A x* of the recorded data in rational arithmetic, wrong by its own rounding "
            "only.  bound: within the error bound, which is proved.  nearby: within that of a QP "
            "that differs by rounding, for columns that are dependent but for it; no proof.  "
            "ill-posed: the same, where the exact answer changes with the last bit of A; no answer "
            "is verified by it.  none: judged by the error bound.  The radius is of the scale."
        ),
        data=pd.DataFrame(out, columns=names),
        formats={**dict.fromkeys(names[1:-1], whole), "largest radius": scientific},
    )


def certificates_tables(found: pd.DataFrame) -> list[Table]:
    """How sharp the error bound is, per sort of answer; none without recordings."""
    if found.empty:
        return []
    data = summary(found).rename(
        columns={
            "qps": "answers", "below": "below the error", "error": "error, median",
            "median": "bound/error, median", "q90": "90 %", "q99": "99 %", "floor": "when right",
        }
    )  # fmt: skip
    notes = [
        f"{whole(len(found))} answers to {whole(len(found[['scene', 'step']].drop_duplicates()))} "
        "QPs with a proved A x*: the bound is below the error "
        f"{whole(found['below'].sum())} times.",
    ]
    return [
        Table(
            name="certificates",
            title="The error bound against the true error",
            reading=(
                "Each line is a sort of answer, given to recorded QPs.  Errors are of the scale; "
                "bound/error is over those whose error is more than rounding.  when right: the "
                "largest bound on an answer within its bounds that is right to rounding."
            ),
            data=data,
            formats={
                "answers": whole, "below the error": whole, "error, median": scientific,
                "bound/error, median": _ratio, "90 %": _ratio, "99 %": _ratio, "worst": _ratio,
                "when right": scientific,
            },
            notes=notes,
        )
    ]  # fmt: skip


def _ratio(value: float) -> str:
    return f"{value:.3f}" if value < 10 else short(value)


def certificates_answer(results: Results, found: pd.DataFrame) -> Answer | None:
    """Whether verdicts can be trusted, in sentences; None without recordings."""
    references = references_table(results).data
    total = int(references["QPs"].sum())
    if total == 0:
        return None
    exact = int(references["exact"].sum())
    said = [
        f"A x* is proved in exact arithmetic for {whole(exact)} of {whole(total)} recorded QPs."
    ]
    if references["largest radius"].notna().any():
        said.append(
            "No reference is further off than "
            f"{scientific(references['largest radius'].max())} of the scale, by its own bound."
        )
    for name, text in (
        ("bound", "rest on the error bound"),
        ("nearby", "rest on the error bound of a QP that differs by rounding"),
        ("ill-posed", "are ill-posed: their exact answer changes with the last bit of A"),
        ("none", "have no reference and are judged by the error bound"),
    ):
        if count := int(references[name].sum()):
            said.append(f"{whole(count)} {text}.")
    if len(found):
        sharp = found["sharp"].dropna()
        said.append(
            f"Of {whole(len(found))} answers, most of them wrong on purpose, the error bound was "
            f"below the error {whole(found['below'].sum())} times; it is {_ratio(sharp.median())} "
            f"times the error in the median and {_ratio(sharp.quantile(0.99))} times at 99 %."
        )
    return Answer(
        "Can the verdicts be trusted?",
        percent(exact / total),
        "of the QPs have a proved reference",
        tuple(said),
        "trust",
    )


def plot_certificates(found: pd.DataFrame, path: str | Path) -> Path:
    """Left: bound over error by decades of the error.  Right: its distribution, by scene.

    Raises ValueError where nothing was found.
    """
    if found.empty:
        raise ValueError("no recording with proved references is stored")
    found = found.assign(scene=found["scene"].str.replace(MADE_OF, "", regex=True))
    below = -(-found["scene"].nunique() // NAMES)
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, 3.3 + NAME * (below - 1)), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        _by_decades(left, found)
        _by_scenes(right, found)
        return save(figure, Path(path))


def _by_decades(axes: Axes, found: pd.DataFrame) -> None:
    part = found.dropna(subset="sharp")
    decade = np.floor(np.log10(part["error"]))
    grouped = part["sharp"].groupby(decade)
    x = 10 ** (grouped.median().index.to_numpy(float) + 0.5)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="major")
    axes.axhline(1.0, color=INK, linewidth=0.8)
    axes.plot(x, grouped.max(), color=SOFT, linewidth=0.8, label="worst")
    axes.plot(x, grouped.quantile(0.99), color=ORANGE, linewidth=1.5, marker="s", markersize=3,
              label="99 %")  # fmt: skip
    axes.plot(x, grouped.median(), color=BLUE, linewidth=1.5, marker="o", markersize=3.4,
              label="median")  # fmt: skip
    axes.set_xlim(ROUNDING, 10 * x.max())
    axes.set_xlabel("true error / scale")
    axes.set_ylabel("error bound / true error")
    most = max(2.0, 1.2 * part["sharp"].max())
    if most <= TICKS[-1]:
        ticks = [tick for tick in TICKS if tick <= most]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    axes.set_title("By size of the error")
    _legend_below(axes, 3)


def _by_scenes(axes: Axes, found: pd.DataFrame) -> None:
    axes.grid(True, which="major")
    axes.axhline(1.0, color=INK, linewidth=0.8)
    for place, (scene, part) in enumerate(found.groupby("scene")):
        sharp = np.sort(part["sharp"].dropna().to_numpy())
        share = (np.arange(sharp.size) + 1) / max(sharp.size, 1)
        again, colour = divmod(place, len(LINES))
        style = STYLES[again % len(STYLES)]
        axes.plot(share, sharp, color=LINES[colour], linestyle=style, linewidth=1.4, label=scene)
    axes.set_xlabel("share of the answers")
    axes.set_title("By scene")
    _legend_below(axes, NAMES)


def _legend_below(axes: Axes, columns: int) -> None:
    """Below the axis, where it hides no line."""
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=columns, columnspacing=1.0,
        handlelength=1.4,
    )  # fmt: skip
