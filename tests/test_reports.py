"""Reports from stored results: known numbers in, known tables out; the page stands alone."""

from __future__ import annotations

import numpy as np
import pandas as pd

from reports.results import Results, prepare

SCENES = ("fig2", "fig4")


def make_rows(
    scenes=SCENES,
    solvers=("lotstedt", "daqp", "osqp"),
    settings=("paper",),
    arms=("cold", "warm"),
    qps=10,
    runtime=None,
    verdict=None,
    **changes,
):
    """Rows of a study as a store holds them.

    runtime, verdict : functions (scene, solver, settings, arm, i) → seconds, word
    changes : column → value for all rows
    """
    out = []
    for scene in scenes:
        for solver in solvers:
            for setting in settings:
                for arm in arms:
                    for i in range(qps):
                        key = (scene, solver, setting, arm, i)
                        word = verdict(*key) if verdict else "verified"
                        own = solver.startswith("lotstedt")
                        row = {
                            "problem": f"{scene}/{i:06d}",
                            "solver": solver,
                            "settings": setting,
                            "runtime": runtime(*key) if runtime else 10e-6,
                            "found": True,
                            "primal_residual": 0.0,
                            "dual_residual": 1e-14,
                            "duality_gap": 1e-14,
                            "scene": scene,
                            "recording_digest": f"digest of {scene}",
                            "step": i,
                            "kind": "impulse" if i == 3 else "step",
                            "accepted": i != 5,
                            "restart": i == 4,
                            "t": 0.01 * i,
                            "m": 9,
                            "k": 4 + i % 3,
                            "rank": 4,
                            "arm": arm,
                            "verdict": word,
                            "status_text": "too many contacts" if word == "skipped" else "",
                            "build_time": 1e-6,
                            "setup_time": 1e-6,
                            "solve_time": 9e-6,
                            "call_time": 30e-6,
                            "runtime_median": 11e-6,
                            "iterations": 1 if arm == "warm" else 4,
                            "descent_directions": (1 if arm == "warm" else 4) if own else 0,
                            "working_set_changes": 0,
                            "qr_factorizations": int(own and i % 4 == 0),
                            "qr_updates": 0,
                            "cg_iterations": 2 if own else 0,
                            "flops": 1200 if own else 0,
                            "glambda_error": 1e-13 if word == "verified" else 1e-3,
                            "eps0_ratio": 1e-4 if word == "verified" else 1e4,
                            "error_bound": 1e-12,
                            "objective_error": 1e-15,
                            "lambda_distance": 1e-12,
                            "machine": "one machine",
                            "versions": '{"daqp": "0.7.2"}',
                            "study": "test",
                        }
                        out.append({**row, **changes})
    return pd.DataFrame(out)


def results_of(rows, recordings=None):
    return Results(prepare(rows), recordings or {})
