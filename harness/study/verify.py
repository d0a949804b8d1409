"""Does every backend reproduce the same Gλ?

1. Replay the recordings through every backend, cold and warm, at the settings `paper` and `high`.
2. Count the rows whose A x is not within ten times the accuracy asked (verdict not verified;
   undecided is counted apart).
3. The accurate class must not miss once.  The others are held to what is expected of them
   (`harness.study.expected_misses`): more misses, larger ones or others are a failure.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd

from harness.passes.starts import ARMS
from harness.progress import Progress
from harness.recordings.recording import Recording, read_recording
from harness.study.cluster import replayer
from harness.study.expected_misses import ACCURATE_CLASS, expected_of

VERIFY_SETTINGS = ("paper", "high")
TIME_LIMIT = 60.0
"""[s] per QP.  Being right is asked here, not being fast: a busy machine must not make misses."""


def verify(
    recordings: Iterable[Recording | str | Path],
    solvers: Sequence[str],
    *,
    results: str | Path | None = None,
    cluster: str | int | None = None,
    progress: Progress | None = None,
) -> pd.DataFrame:
    """Replay and count misses.

    cluster : address of a Dask scheduler, or a number of workers to start here; None: neither

    Returns the table of `misses`, of what was asked for here.  Raises as
    `harness.study.replay.replay` does.
    """
    loaded = [r if isinstance(r, Recording) else read_recording(r) for r in recordings]
    with replayer(cluster, timed=cluster is None and results is not None) as replay:
        rows = replay(
            loaded,
            solvers,
            VERIFY_SETTINGS,
            ARMS,
            results=results,
            repeats=1,
            time_limit=TIME_LIMIT,
            progress=progress,
        )
    asked = rows["solver"].isin(solvers) & rows["scene"].isin([made.scene for made in loaded])
    asked &= rows["settings"].isin(VERIFY_SETTINGS) & rows["arm"].isin(ARMS)
    return misses(rows[asked])


def misses(rows: pd.DataFrame) -> pd.DataFrame:
    """One line per (scene, solver, setting) with columns

    scene, solver, settings, accurate, solves, skipped, missed, undecided, worst, expected, beyond,
    holds, reason

    worst : largest error in A x, in multiples of the accuracy asked; x beyond its bounds counts
        for the verdict, but not here
    undecided : neither within what was asked nor missed, as far as anything is proved
    expected : misses allowed, or NA where nothing is expected
    beyond : misses of a kind or size that is not among those expected
    holds : whether misses are within what is expected
    """
    out = []
    for (scene, solver, setting), part in rows.groupby(["scene", "solver", "settings"]):
        done = part[part["verdict"] != "skipped"]
        undecided = done["verdict"] == "undecided"
        missed = done[(done["verdict"] != "verified") & ~undecided]
        known = expected_of(solver, scene)
        allowed = None if known is None else known.count(len(done))
        beyond = 0 if known is None else known.beyond(missed)
        error = done["glambda_error"] * done["scale"]
        worst = error.fillna(done["error_bound"]) / done["asked"]
        out.append(
            {
                "scene": scene,
                "solver": solver,
                "settings": setting,
                "accurate": solver.partition("[")[0] in ACCURATE_CLASS,
                "solves": len(done),
                "skipped": len(part) - len(done),
                "missed": len(missed),
                "undecided": int(undecided.sum()),
                "worst": float(worst.max()) if len(done) else float("nan"),
                "expected": allowed,
                "beyond": beyond,
                "holds": allowed is None or (len(missed) <= allowed and beyond == 0),
                "reason": known.reason if known and len(missed) else "",
            }
        )
    return pd.DataFrame(out).astype({"expected": "Int64"})
