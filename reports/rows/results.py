"""A folder of stored results, read once and checked, for everything that reports.

A results folder holds `recordings/<label>.h5`, one per scene, and `solves/*.parquet`, one row per
(solver, settings, arm, QP).  Either may be missing: a page of scenes alone, or of tables alone, is
still a page.  What is missing is said in `Results.missing`, never passed over.

1. Read the recordings and the rows.
2. Check that the rows have the columns that the tables need, that no (solver, settings, arm, QP)
   occurs twice, that one scene has one recording, and that it is the one that is stored.
3. Add what every table needs: `verified`, `skipped`, `asked_ratio` = error / accuracy asked, and
   the time that is `charged`.
4. Set the rows of campaigns apart: other arms than cold and warm, accuracies given as numbers,
   packages posed in a form of choice, recordings that were disturbed.
   `Results.rows` is the study without them; the sections on starts, accuracy against time, and
   forms read `Results.everything`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from harness.judging.facts import SETTINGS
from harness.names import DISTURBED, METHOD
from harness.passes.limits import TIME_LIMIT
from harness.passes.starts import ARMS
from reports.parts.names import in_order, is_number, solver_order

FORMS = ("normal", "residual", "velocity")
"""Forms in which a package is posed the QP, in campaigns as `name[form]`."""

COLUMNS = (
    "problem",
    "solver",
    "settings",
    "runtime",
    "scene",
    "recording_digest",
    "step",
    "kind",
    "accepted",
    "restart",
    "t",
    "m",
    "k",
    "rank",
    "arm",
    "verdict",
    "status_text",
    "iterations",
    "descent_directions",
    "cg_iterations",
    "qr_factorizations",
    "flops",
    "glambda_error",
    "eps0_ratio",
    "error_bound",
    "machine",
    "versions",
    "asked",
    "scale",
    "warm_started",
)
"""Columns without which no table can be made; a store may hold more."""

KEY = ["solver", "settings", "arm", "problem"]


@dataclass(frozen=True)
class Results:
    """Rows and recordings of one study.

    rows : one row per solve, with the columns of the store and those added by `prepare`, but for
        those of campaigns
    recordings : label → recording, in the order of the labels
    missing : sentences on what the folder does not hold
    campaigns : the rows that are set apart
    passes : what the machine did, a row per pass (`harness.results.store.read_passes`)
    study : what study.json says;  spent : seconds of the replay
        (`harness.results.store.read_spent`)
    time_limit : [s] per solve
    """

    rows: pd.DataFrame
    recordings: Mapping[str, Any] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    campaigns: pd.DataFrame | None = None
    passes: pd.DataFrame = field(default_factory=pd.DataFrame)
    study: Mapping[str, Any] = field(default_factory=dict)
    spent: Mapping[str, float] = field(default_factory=dict)
    time_limit: float = TIME_LIMIT

    @property
    def everything(self) -> pd.DataFrame:
        """The rows with those of campaigns."""
        if self.campaigns is None or self.campaigns.empty:
            return self.rows
        return pd.concat([self.rows, self.campaigns], ignore_index=True)

    @property
    def scenes(self) -> list[str]:
        """Labels of all scenes, recorded or solved, in alphabetical order.

        Recordings that were solved in campaigns alone are not among them.
        """
        solved = set(self.rows["scene"].unique())
        apart = set() if self.campaigns is None else set(self.campaigns["scene"].unique()) - solved
        return sorted({*self.recordings, *solved} - apart)

    @property
    def settings(self) -> list[str]:
        """Settings that were run, in the order of `SETTINGS`."""
        return in_order(self.rows["settings"].unique(), SETTINGS)

    @property
    def headline(self) -> str | None:
        """The setting from which headlines are drawn, or None without rows."""
        return self.settings[0] if self.settings else None

    @property
    def solvers(self) -> list[str]:
        """Names of the solvers that were run: our method first, then the paper's and variants."""
        return sorted(self.rows["solver"].unique(), key=solver_order)


def form_of(solver: str) -> str | None:
    """The form of choice that a package is posed, or None: `clarabel[residual]` → residual."""
    form = solver.partition("[")[2].rstrip("]")
    return form if form in FORMS else None


def set_apart(rows: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of the study, and those of campaigns.

    Where all rows are of a campaign in one respect, that is the study: a folder that holds nothing
    but accuracies given as numbers is reported with these.
    """
    apart = [
        ~rows["arm"].isin(ARMS),
        rows["settings"].map(is_number).astype(bool),
        rows["solver"].map(form_of).notna(),
        rows["scene"].str.contains(DISTURBED, regex=False),
    ]
    aside = pd.Series(False, index=rows.index)
    for of_campaign in apart:
        if not of_campaign.all():
            aside |= of_campaign
    return rows[~aside].reset_index(drop=True), rows[aside].reset_index(drop=True)


def empty_rows() -> pd.DataFrame:
    """A prepared frame without rows."""
    text = {"problem", "solver", "settings", "scene", "arm", "verdict", "kind"}
    return prepare(pd.DataFrame({c: pd.Series(dtype=str if c in text else float) for c in COLUMNS}))


def prepare(rows: pd.DataFrame, time_limit: float = TIME_LIMIT) -> pd.DataFrame:
    """Check stored rows and add `verified`, `skipped`, `asked_ratio` and `charged`, by problem.

    `charged` [s] is the runtime, but `time_limit` for what is not verified, whatever was claimed.
    `asked_ratio` is ‖A(x − x*)‖ over the accuracy that the verdict is measured against; NaN where
    no reference was accepted.  Counts that a solver does not keep become NaN.

    Raises ValueError for missing columns, a solve stored twice, or a scene with two recordings.
    """
    absent = [name for name in COLUMNS if name not in rows.columns]
    if absent:
        raise ValueError(f"the stored results lack the columns {', '.join(absent)}; replay again")
    twice = rows.duplicated(KEY)
    if twice.any():
        first = rows.loc[twice, KEY].iloc[0]
        raise ValueError(
            f"{int(twice.sum())} solves are stored twice, the first: {', '.join(map(str, first))}; "
            "replay into an empty folder"
        )
    digests = rows.groupby("scene")["recording_digest"].nunique()
    mixed = digests.index[digests > 1]
    if len(mixed):
        raise ValueError(
            f"scene {mixed[0]} holds solves of {digests[mixed[0]]} different recordings; "
            "a report must not mix them"
        )
    rows = rows.sort_values(["problem", "solver", "settings", "arm"], ignore_index=True)
    counts = [name for name in rows.columns if rows[name].dtype == pd.Int64Dtype()]
    rows = rows.astype(dict.fromkeys(counts, np.float64))
    return rows.assign(
        verified=rows["verdict"] == "verified",
        skipped=rows["verdict"] == "skipped",
        asked_ratio=rows["glambda_error"] * rows["scale"] / rows["asked"],
        charged=rows["runtime"].where(rows["verdict"] == "verified", time_limit),
    )


def load_results(folder: str | Path) -> Results:
    """Read a results folder.

    Raises ValueError, saying what to run, where there is no folder or nothing in it, and passes on
    the ValueError of a damaged recording.
    """
    from harness.recordings.recording import read_recording
    from harness.results.store import (
        read_passes,
        read_results,
        read_spent,
        read_study,
        read_time_limit,
    )

    folder = Path(folder)
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder; give one that `glambda study` has written")
    recorded = sorted((folder / "recordings").glob("*.h5"))
    solved = sorted((folder / "solves").glob("*.parquet"))
    if not recorded and not solved:
        raise ValueError(
            f"{folder} holds neither recordings/*.h5 nor solves/*.parquet; "
            "run `glambda study`, or `glambda record` and `glambda replay`, first"
        )
    recordings: dict[str, Any] = {}
    for path in recorded:
        recording = read_recording(path)
        if recording.scene in recordings:
            raise ValueError(f"{folder} holds two recordings of {recording.scene}; keep one")
        recordings[recording.scene] = recording
    time_limit = read_time_limit(folder)
    everything = prepare(read_results(folder), time_limit) if solved else empty_rows()
    for scene, digest in everything.groupby("scene")["recording_digest"].first().items():
        if scene in recordings and recordings[scene].digest != digest:
            raise ValueError(
                f"{folder}: the solves of {scene} are of another recording (digest "
                f"{digest[:12]}…) than recordings/{scene}.h5 ({recordings[scene].digest[:12]}…); "
                "a report must not mix them: replay into an empty folder"
            )
    rows, campaigns = set_apart(everything)
    of_study = set(recordings) - (set(campaigns["scene"]) - set(rows["scene"]))
    return Results(
        rows=rows,
        recordings=recordings,
        missing=tuple(_missing(rows, {scene: recordings[scene] for scene in of_study})),
        campaigns=campaigns,
        passes=read_passes(folder),
        study=read_study(folder),
        spent=read_spent(folder),
        time_limit=time_limit,
    )


def _missing(rows: pd.DataFrame, recordings: Mapping[str, Any]) -> list[str]:
    """Sentences on what a study of all scenes would hold and this one does not."""
    said = []
    solved = set(rows["scene"].unique())
    if not recordings:
        said.append("No recordings are stored, so there are no frames and no work over time.")
    if not solved:
        said.append("No solves are stored, so there are no tables of accuracy or cost.")
    for scene in sorted(set(recordings) - solved) if solved else []:
        said.append(f"{scene} was recorded but not replayed.")
    for scene in sorted(solved - set(recordings)) if recordings else []:
        said.append(f"{scene} was replayed, but its recording is not stored: no frames.")
    if solved and METHOD not in set(rows["solver"]):
        said.append(f"Our method ({METHOD}) was not run, so nothing is compared with it.")
    arms = set(rows["arm"].unique())
    said.extend(
        f"The {arm} arm was not run, so the worth of a warm start is not known."
        for arm in ARMS
        if solved and arm not in arms
    )
    for arm in ARMS:
        if arm not in arms:
            continue
        for setting in sorted(set(rows["settings"].unique())):
            part = rows[(rows["settings"] == setting) & (rows["arm"] == arm)]
            gone = sorted(solved - set(part["scene"].unique()))
            if gone:
                said.append(f"Setting {setting}, {arm}, has no rows for {', '.join(gone)}.")
    return said
