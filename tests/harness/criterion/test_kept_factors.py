"""What packages keep from QP to QP: renewals, answers, and the table of them."""

from __future__ import annotations

from functools import cache
from math import inf
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from harness.criterion.factor_rules import sequence
from harness.criterion.kept_factors import (
    INTERVALS,
    KINDS,
    METHOD,
    Kind,
    follow,
    hooked,
    kept_factors,
)
from reports.criterion.kept import kept_factors_table, plot_kept
from solvers import describe
from tests.fakes.fake_recordings import fake_recording
from tests.fakes.runs import scene_recording
from tests.harness.criterion.test_criterion import short_recording

INSTALLED = [kind for kind in KINDS if describe(kind.package).available]


def named(kind: Kind) -> str:
    return f"{kind.package}-{kind.kept}"


@cache
def runs_of_fig5() -> pd.DataFrame:
    """Of 40 QPs, however long a run takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("harness.criterion.kept_factors.LIMIT", inf)
        return kept_factors(short_recording("fig5", 40), turns=1)


@pytest.mark.parametrize("kind", INSTALLED, ids=named)
def test_kept_or_renewed_the_answer_is_that_of_todays_qp(kind: Kind) -> None:
    recording = short_recording("fig4", 60)
    keep, renew = hooked(kind.package, kind.keep), hooked(kind.package, kind.renew)
    for interval in (1, 3, inf):
        steps = follow(recording, sequence(recording), keep, renew, interval)
        if (kind.package, kind.kept) == ("osqp", "P") and interval > 1:
            assert steps["error"].max() > 100.0  # another QP was solved
        else:
            assert steps["error"].max() <= 1.0


def test_renewals_come_every_so_many_qps_and_at_restarts() -> None:
    recording = short_recording("fig5", 60)
    links = sequence(recording)
    solver = hooked("glambda" if not INSTALLED else INSTALLED[0].package, KINDS[0].keep)
    third = follow(recording, links, solver, solver, 3)
    chains = np.array([link.chain for link in links])
    for chain in range(chains.max() + 1):
        renewed = third.loc[chains == chain, "renewed"].to_numpy()
        np.testing.assert_array_equal(renewed, np.arange(renewed.size) % 3 == 0)
    never = follow(recording, links, solver, solver, inf)
    assert (never["renewed"] == ~never["warm"]).all()


def test_every_kind_is_run_at_every_interval_beside_the_method() -> None:
    runs = runs_of_fig5()
    assert len(runs) == len(INSTALLED) * len(INTERVALS) + 1
    assert (runs["mean"] > 0).all() and (runs["QPs"] == runs["QPs"].iloc[0]).all()
    method = runs[runs["package"] == METHOD]
    assert len(method) == 1 and method["verified"].iloc[0] == 1.0


def test_nothing_is_run_where_no_qp_starts_warm() -> None:
    assert not len(kept_factors(fake_recording(length=1), turns=1))


def test_the_best_interval_is_one_whose_answers_are_right(tmp_path: Path) -> None:
    runs = runs_of_fig5()
    table = kept_factors_table(runs)
    data = table.data.set_index(["package", "kept"])
    wrong = (runs["package"] == INSTALLED[0].package) & (runs["interval"] > 1)
    spoilt = runs.assign(
        mean=runs["mean"].where(~wrong, 1e-9), verified=runs["verified"].where(~wrong, 0.5)
    )
    rows = kept_factors_table(spoilt).data.set_index("package").loc[[INSTALLED[0].package]]
    assert (rows["best s"] == 1).all() and (rows["best"] == rows["always"]).all()
    assert data.loc[("osqp", "P"), "best s"] == 1
    assert any("osqp with P never renewed" in note for note in table.notes)
    assert "nan" not in table.to_markdown()
    assert plot_kept(runs_of_fig5(), tmp_path / "kept.png").stat().st_size > 5000
    assert scene_recording("fig5").scene in set(data["scene"])
