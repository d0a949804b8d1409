"""When to refactorize: the paper's criterion (§3.2) against what was counted and what was timed.

C_QR, the cost of a factorization, and C_IT, that of a conjugate gradient iteration, are counted
from the sizes of the recorded QPs (`harness.criterion.cost_model`).  Beside them stands what the
paper's method did when it was started warm: how often it factorized, how many iterations it took,
how many operations that cost.  Whether the criterion is worth its trouble is then a matter of
comparing with its variants, in operations, and with all backends, in time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from harness.names import METHOD, PAPER, is_own
from reports.parts.names import solver_order
from reports.parts.sentences import Answer, join
from reports.parts.table import Table, microseconds, percent, short, times, whole
from reports.rows.results import Results

DO = {
    PAPER: "at once where a direction would take more iterations than √(2 C_QR/C_IT)",
    f"{PAPER}[deferred]": (
        "at the next QP where a direction took more iterations than √(2 C_QR/C_IT)"
    ),
    f"{PAPER}[online]": (
        "at the next QP where the last cost more than the average since the last factorization"
    ),
}
"""Methods that keep R at every size, and what their rules say."""
SLOW = 100.0
"""Operations per µs below which the time of a solve cannot be that of its arithmetic."""


def thresholds(results: Results) -> dict[str, float]:
    """√(2 C_QR/C_IT) of every recorded scene that has a factorization at all."""
    from harness.criterion.cost_model import criterion_of

    found = {scene: criterion_of(recording) for scene, recording in results.recordings.items()}
    return {scene: counted.threshold for scene, counted in found.items() if counted.calls}


def sequence_rows(results: Results, scene: str) -> pd.DataFrame:
    """Rows of the QPs that a warm start can serve, at the study's first setting.

    The QPs are those that `keeper` solved warm; a backend without a warm start stands
    with its cold rows on the same QPs.
    """
    rows = results.rows
    rows = rows[
        (rows["scene"] == scene)
        & (rows["settings"] == results.headline)
        & (rows["k"] > 0)
        & ~rows["skipped"]
    ]
    warm = rows[(rows["arm"] == "warm") & rows["warm_started"].astype(bool)]
    served = warm.loc[warm["solver"] == keeper(results), "problem"]
    without = ~rows["solver"].isin(rows.loc[rows["arm"] == "warm", "solver"])
    rows = pd.concat([warm, rows[without & (rows["arm"] == "cold")]])
    return rows[rows["problem"].isin(served)]


def keeper(results: Results) -> str:
    """The paper's method, which the criterion is of, if it was run; else ours."""
    return PAPER if PAPER in results.solvers else METHOD


def criterion_tables(results: Results) -> list[Table]:
    """The criterion per scene, and what variants and backends cost on the same QPs.

    Empty where neither the paper's method nor ours was run warm on any scene.
    """
    scenes = [scene for scene in results.scenes if len(sequence_rows(results, scene))]
    if not scenes:
        return []
    return [model_table(results, scenes), alternatives_table(results, scenes)]


def model_table(results: Results, scenes: list[str]) -> Table:
    """Counted costs, threshold and prediction of each scene beside the work that was done."""
    data = pd.DataFrame([_model_row(results, scene) for scene in scenes])
    counts = ["warm QPs", "C_QR", "C_IT", "factorizations", "C(n*)/T", "QR + CG", "flops"]
    small = ["√(2 C_QR/C_IT)", "CG per QP", "QPs per factorization", "s*"]
    return Table(
        name="criterion",
        title="The criterion and the work done",
        reading=(
            "C_QR and C_IT are operations per factorization and per conjugate gradient iteration, "
            "means over the scene's time-step QPs.  The paper factorizes anew when a solve takes "
            "more than √(2 C_QR/C_IT) iterations, assuming that iterations grow by one per step; "
            "it then expects a factorization every s* QPs.  The other columns are what "
            f"{keeper(results)} did on the QPs that it started warm.  C(n*)/T is the predicted "
            "cost of factorizations and iterations per QP, QR + CG the same as counted; flops is "
            "all the work per QP."
        ),
        data=data,
        formats={
            **dict.fromkeys(counts, whole),
            **dict.fromkeys(small, short),
            "above": percent,
        },
        notes=_model_notes(data),
    )


def _model_row(results: Results, scene: str) -> dict[str, Any]:
    from harness.criterion.cost_model import criterion_of, optimal_interval

    rows = sequence_rows(results, scene)
    own = rows[rows["solver"] == keeper(results)]
    recording = results.recordings.get(scene)
    counted = criterion_of(recording) if recording is not None else None
    known = counted is not None and counted.calls > 0
    factorizations, cg = own["qr_factorizations"].sum(), own["cg_iterations"].mean()
    row: dict[str, Any] = {"scene": scene, "warm QPs": len(own)}
    if counted is not None and known:
        row |= {
            "C_QR": counted.C_QR,
            "C_IT": counted.C_IT,
            "√(2 C_QR/C_IT)": counted.threshold,
            "s*": optimal_interval(counted.C_QR, counted.C_IT),
        }
    else:
        row |= dict.fromkeys(["C_QR", "C_IT", "√(2 C_QR/C_IT)", "s*"], np.nan)
    row |= {
        "CG per QP": cg,
        "above": (own["cg_iterations"] > row["√(2 C_QR/C_IT)"]).mean() if known else np.nan,
        "factorizations": factorizations,
        "QPs per factorization": len(own) / factorizations if factorizations else np.nan,
        "C(n*)/T": counted.cost_per_call if counted is not None and known else np.nan,
        "QR + CG": row["C_QR"] * factorizations / len(own) + row["C_IT"] * cg,
        "flops": own["flops"].mean(),
    }
    return row


def _model_notes(data: pd.DataFrame) -> list[str]:
    """How far the prediction is from what was counted, per scene."""
    notes = []
    for row in data.to_dict("records"):
        predicted, done = row["C(n*)/T"], row["QR + CG"]
        if not predicted > 0 or not done > 0:
            continue
        more = done > predicted
        factor = done / predicted if more else predicted / done
        notes.append(
            f"On {row['scene']} factorizations and iterations cost {whole(done)} operations per "
            f"QP, {short(factor)} times {'more' if more else 'less'} than the {whole(predicted)} "
            f"that the paper's model predicts; they are {percent(min(1, done / row['flops']))} of "
            "all operations."
        )
    return notes


def alternatives_table(results: Results, scenes: list[str]) -> Table:
    """Work and time of variants and backends on the QPs that `keeper` started warm."""
    out: list[dict[str, Any]] = []
    name = keeper(results)
    for scene in scenes:
        rows = sequence_rows(results, scene)
        own = rows[rows["solver"] == name]
        for solver, part in rows.groupby("solver"):
            counted = is_own(str(solver))
            flops = part["flops"].mean() if counted else np.nan
            median = part["runtime"].median()
            out.append(
                {
                    "scene": scene,
                    "solver": solver,
                    "QPs": len(part),
                    "verified": part["verified"].mean(),
                    "factorizations per QP": part["qr_factorizations"].mean()
                    if counted
                    else np.nan,
                    "CG per QP": part["cg_iterations"].mean() if counted else np.nan,
                    "flops per QP": flops,
                    "flops ratio": flops / own["flops"].mean(),
                    "median": median,
                    "time ratio": median / own["runtime"].median(),
                    "flops per µs": part["flops"].sum() / (1e6 * part["runtime"].sum())
                    if counted
                    else np.nan,
                }
            )
    data = pd.DataFrame(
        sorted(out, key=lambda row: (row["scene"], solver_order(str(row["solver"]))))
    )
    return Table(
        name="criterion_alternatives",
        title="The same QPs by the variants and by everybody else",
        reading=(
            f"The QPs that {name} started warm, at setting {results.headline}.  Ratios are to "
            f"{name}: below 1 is cheaper.  Operations are counted by our method, the paper's and "
            "its variants only; median is the time per QP in µs.  flops per "
            "µs tells how much of the time is arithmetic and how much the program around it."
        ),
        data=data,
        formats={
            "QPs": whole,
            "verified": percent,
            "factorizations per QP": short,
            "CG per QP": short,
            "flops per QP": whole,
            "flops ratio": times,
            "median": microseconds,
            "time ratio": times,
            "flops per µs": short,
        },
        notes=_variant_notes(data, name),
    )


def _variant_notes(data: pd.DataFrame, name: str) -> list[str]:
    """How fast the arithmetic is, and variants that need less of it, or less time."""
    notes = []
    own = data[data["solver"] == name]
    if len(own) and own["flops per µs"].max() < SLOW:
        notes.append(
            f"{name} does {_span(own['flops per µs'])} operations per µs, far from what a "
            "processor can do: its time here is mostly that of the program around the arithmetic."
        )
    variants = data[[is_own(other) and other != name for other in data["solver"]]]
    for row in variants.to_dict("records"):
        where = f"On {row['scene']} {row['solver']} needs"
        if row["flops ratio"] < 1 and row["time ratio"] < 1:
            notes.append(
                f"{where} {short(row['flops ratio'])} of the operations of {name} and "
                f"{short(row['time ratio'])} of its time."
            )
        elif row["flops ratio"] < 1:
            notes.append(f"{where} {short(row['flops ratio'])} of the operations of {name}.")
        elif row["time ratio"] < 1:
            notes.append(f"{where} {short(row['time ratio'])} of the time of {name}.")
    return notes


def criterion_answer(results: Results) -> Answer | None:
    """Whether to keep R, and if so when to give it up, by what the fewest operations were.

    None where nothing was started warm.  Who factorizes at every QP without conjugate gradients is
    told from who keeps R by the counts, over all scenes.
    """
    tables = criterion_tables(results)
    if not tables:
        return None
    model, work = tables[0].data, _pooled(tables[1].data)
    limits = model["√(2 C_QR/C_IT)"].dropna()
    anew, keepers = (work[work["CG"] == 0], work[work["CG"] > 0])
    keepers = keepers[keepers.index.isin(DO)]
    said = []
    if len(keepers) and len(anew):
        said.append(_whether(anew.iloc[0], keepers.iloc[0], list(model["scene"])))
    if len(keepers):
        said.append(_when(keepers, limits))
    if len(keepers) and (not len(anew) or anew["flops"].iloc[0] > keepers["flops"].iloc[0]):
        figure, caption = _span(limits) if len(limits) else "–", "iterations are the printed limit"
    elif len(anew):
        figure, caption = "at every QP", f"by {anew.index[0]}, on {join(list(model['scene']))}"
    else:
        return None
    return Answer("When to refactorize?", figure, caption, tuple(said), "criterion")


def _pooled(alternatives: pd.DataFrame) -> pd.DataFrame:
    """flops, CG, factorizations and median time per QP of who counts them, the fewest flops first.

    Means over the scenes on which all of them were run, weighted by QPs.
    """
    counted = alternatives[alternatives["flops per QP"].notna()]
    scenes = counted.groupby("scene")["solver"].nunique()
    counted = counted[counted["scene"].isin(scenes.index[scenes == counted["solver"].nunique()])]
    rows = {
        str(solver): {
            head: float(np.average(part[column], weights=part["QPs"]))
            for head, column in {
                "flops": "flops per QP",
                "CG": "CG per QP",
                "factorizations": "factorizations per QP",
                "median": "median",
            }.items()
        }
        for solver, part in counted.groupby("solver")
    }
    return pd.DataFrame.from_dict(rows, orient="index").sort_values("flops", kind="stable")


def _whether(anew: pd.Series, keeper: pd.Series, scenes: list[str]) -> str:
    """Whether R is worth keeping."""
    ratio, time = anew["flops"] / keeper["flops"], anew["median"] / keeper["median"]
    compared = (
        f"{anew.name}, which factorizes at every QP and needs no conjugate gradients, does "
        f"{short(ratio)} times the operations of {keeper.name}, the cheapest that keeps R, and "
        f"takes {short(time)} times as long"
    )
    advice = "Do not keep R" if ratio <= 1 else "Keep R"
    return f"{advice} on QPs like those of {join(scenes)}: {compared}."


def _when(keepers: pd.DataFrame, limits: pd.Series) -> str:
    """By which rule to give R up, and how the printed one fares."""
    best = keepers.iloc[0]
    printed = f" (√(2 C_QR/C_IT) is {_span(limits)} here)" if len(limits) else ""
    text = f"Where R is kept, factorize {DO[str(best.name)]}{printed}: {best.name} did so " + (
        f"every {short(1 / best['factorizations'])} QPs"
        if best["factorizations"] > 0
        else "only after restarts"
    )
    others = [
        f"{name} does {short(row['flops'] / best['flops'])} times its operations"
        for name, row in keepers.iloc[1:].iterrows()
    ]
    return f"{text}{'; ' if others else ''}{join(others)}."


def _span(values: pd.Series) -> str:
    """The range of some numbers, one number where they print the same."""
    low, high = f"{values.min():.2g}", f"{values.max():.2g}"
    return low if low == high else f"{low} to {high}"
