"""The race: what a package is called with, who takes part, what is told where ours is not first.

No time is asserted; where times matter they are made up.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from typer.testing import CliRunner

from glambda.cli import app
from harness.judging.judge import judge
from harness.processes.introduction import available
from harness.race import race
from harness.race.by_hand import HANDS, Called, Hand, posed_for_hands, takes
from harness.race.race import CLOCKS, ONE_CALL, POSED, entered, race_claim, raced, raced_by, ratios
from harness.recordings.recording import Recording, read_recording, write_recording
from harness.results.claim import measure
from harness.study.record import recording_of
from problems import ContactQP, simulate
from problems.scenes.calm import calm_scene
from reports.claims.race import clock_table, losses, ratios_table, write_race
from solvers import make_solver

INSTALLED = [name for name in HANDS if name in available()]


def recorded(label: str, **parameters: float) -> Recording:
    scene = calm_scene(label, **parameters)
    run = simulate(scene, make_solver("glambda"), until=0.03, fixed_step=0.005)
    return recording_of(run, "glambda", until=0.03)


@pytest.fixture(scope="module")
def tower() -> Recording:
    return recorded("tower", bodies=3)


@pytest.fixture(scope="module")
def rubbing() -> Recording:
    return recorded("tower", bodies=2, mu=0.5)


@pytest.fixture(scope="module")
def rows(tower: Recording) -> pd.DataFrame:
    found = raced(entered(tower), "warm", ["glambda", POSED, ONE_CALL, "quadprog"], rounds=3)
    return pd.DataFrame(found).assign(scene="tower", arm="warm")


@pytest.mark.parametrize("warm", [True, False])
@pytest.mark.parametrize("name", INSTALLED)
@pytest.mark.parametrize("scene", ["tower", "rubbing"])
def test_each_call_by_hand_is_right(
    name: str, warm: bool, scene: str, request: pytest.FixtureRequest
) -> None:
    recording: Recording = request.getfixturevalue(scene)
    pairs = entered(recording)
    assert pairs
    if not takes(HANDS[name], [qp for qp, _ in pairs]):
        pytest.skip("takes x ≥ 0 only")
    called = Called(HANDS[name], warm)
    for qp, reference in pairs:
        hand = called.ready_for(qp)
        x = hand.answer(hand.arrays(qp))
        hand.after()
        assert judge(qp, x, reference=reference).verdict == "verified"
        inside = hand.inside()
        assert np.isnan(inside) or inside > 0


def test_dense_and_sparse_are_one_question(tower: Recording) -> None:
    (qp, reference), *_ = entered(tower)
    sparse = replace(qp, A=sp.csc_array(qp.A))
    for name in INSTALLED:
        hand = Called(HANDS[name]).ready_for(sparse)
        x = hand.answer(hand.arrays(sparse))
        assert judge(qp, x, reference=reference).verdict == "verified", name


class _Counted(Hand):
    """Counts how often it is made."""

    made = 0

    def __init__(self, *made_for: object) -> None:
        super().__init__(*made_for)  # type: ignore[arg-type]
        type(self).made += 1


def test_a_package_is_kept_while_rows_and_pattern_are_the_same(tower: Recording) -> None:
    qps = [qp for qp, _ in entered(tower)]
    same = [qp for qp in qps if np.array_equal(qp.row_id, qps[0].row_id)]
    other = replace(same[0], row_id=same[0].row_id + 1)
    for warm, made in ((True, 2), (False, len(same) + 1)):
        _Counted.made = 0
        called = Called(_Counted, warm)
        for qp in [*same, other]:
            called.ready_for(qp)
        assert _Counted.made == made


def test_qps_with_fixed_rows_or_without_a_reference_do_not_enter(tower: Recording) -> None:
    qp = tower.qps[0]
    assert posed_for_hands(qp)
    assert not posed_for_hands(replace(qp, lower=np.zeros(qp.k), upper=np.zeros(qp.k)))
    unknown = replace(tower, references=[None] * len(tower.qps))
    assert entered(unknown) == []
    assert raced(entered(unknown), "warm", ["glambda"], 1) == []
    with pytest.raises(ValueError, match=r"tower.*no QP"):
        race_claim([unknown], ["glambda"], 1)


def test_no_more_than_so_many_qps_enter(tower: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(race, "MOST", 2)
    pairs = entered(tower)
    assert len(pairs) == 2
    assert all(qp.kind in ("step", "iteration", "corrector") for qp, _ in pairs)


def test_one_row_per_contestant_and_round(rows: pd.DataFrame) -> None:
    assert rows.groupby("solver", sort=False)["round"].apply(list).to_dict() == {
        name: [0, 1, 2] for name in ("glambda", POSED, ONE_CALL, "quadprog")
    }
    assert (rows["verified"] == 1.0).all()
    own = rows[rows["solver"] == "glambda"]
    assert (own["inside"] > 0).all()
    assert (own["inside"] <= own["arrays"]).all()
    assert (own["whole"] > 0).all()
    posed = rows[rows["solver"] == POSED]
    assert posed[["inside", "arrays"]].isna().all(axis=None) and (posed["whole"] > 0).all()
    assert rows.loc[rows["solver"] == "quadprog", "inside"].isna().all()  # it has no clock
    assert rows.loc[rows["solver"] == ONE_CALL, ["inside", "whole"]].isna().all(axis=None)


def test_clocks_of_a_qp_lie_within_each_other(tower: Recording) -> None:
    qps = [qp for qp, _ in entered(tower)]
    inside, arrays, whole = race._posed("glambda", qps, True)[0].T
    assert (inside > 0).all() and (inside <= arrays).all() and (arrays <= whole).all()


class _Wrong(Hand):
    """Answers 0, and says that it took a second."""

    def arrays(self, qp: ContactQP) -> ContactQP:
        return qp

    def answer(self, arrays: ContactQP) -> np.ndarray:
        return np.zeros(arrays.k)

    def inside(self) -> float:
        return 1.0


class _Without(_Wrong):
    def answer(self, arrays: ContactQP) -> None:
        return None


class _Raises(_Wrong):
    """Answers no QP but the first that it is asked after it was made."""

    def __init__(self, *made_for: object) -> None:
        super().__init__(*made_for)  # type: ignore[arg-type]
        self.asked = 0

    def answer(self, arrays: ContactQP) -> np.ndarray:
        self.asked += 1
        if self.asked > 1:
            raise RuntimeError("data formatting error")
        found = make_solver("velocity").solve(arrays).x
        assert found is not None
        return found


def test_wrong_answers_and_impossible_clocks_do_not_count(
    tower: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(HANDS, "wrong", _Wrong)
    monkeypatch.setitem(HANDS, "without", _Without)
    names = ["glambda", "wrong", "without"]
    found = pd.DataFrame(raced(entered(tower), "warm", names, 1)).assign(scene="tower", arm="warm")
    bad = found[found["solver"] != "glambda"]
    assert (bad["verified"] == 0.0).all()
    assert list(bad["error"]) == [pytest.approx(1.0), np.inf]
    assert bad["inside"].isna().all()
    assert ratios(found).empty
    table = clock_table(found, "whole")
    assert "wrong" not in table.data and len(table.notes) == 2


def test_who_raises_loses_that_qp_and_begins_anew(
    tower: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(HANDS, "raises", _Raises)
    found = pd.DataFrame(raced(entered(tower), "warm", ["glambda", "raises"], 2))
    his = found[found["solver"] == "raises"]
    count = his["qps"].iloc[0]
    assert list(his["round"]) == [0, 1]
    assert (his["verified"] == -(-count // 2) / count).all()  # every other QP
    assert his[list(CLOCKS)].isna().all(axis=None)
    cold = pd.DataFrame(raced(entered(tower), "cold", ["raises"], 1))
    assert (cold["verified"] == 1.0).all()


class _Loops(_Wrong):
    def answer(self, arrays: ContactQP) -> np.ndarray:
        while True:
            pass


class _Dies(_Wrong):
    def answer(self, arrays: ContactQP) -> np.ndarray:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_who_loops_for_ever_or_dies_costs_nobody_else(
    tower: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(race, "LONGEST", 2.0)
    monkeypatch.setitem(HANDS, "loops", _Loops)
    monkeypatch.setitem(HANDS, "dies", _Dies)
    found = pd.DataFrame(raced(entered(tower), "warm", ["glambda", "loops", "dies"], 2))
    verified = found.groupby("solver")["verified"].first()
    assert verified.to_dict() == {"glambda": 1.0, "loops": 0.0, "dies": 0.0}
    assert (found.loc[found["solver"] != "glambda", "error"] == np.inf).all()


def made_up(solver: str, inside: float, whole: Sequence[float]) -> pd.DataFrame:
    """Rounds of a contestant."""
    count = len(whole)
    return pd.DataFrame({
        "scene": "fig2", "arm": "cold", "solver": solver, "qps": 9, "m": 15, "k": 10,
        "verified": 1.0, "error": 0.0, "round": range(count), "inside": inside,
        "arrays": np.array(whole) - 1e-6, "whole": whole,
    })  # fmt: skip


def test_ratios_are_of_rounds_least_ahead_first(tmp_path: Path) -> None:
    # a machine that is slower by the round: ratios are the same in each
    drift = np.array([1.0, 2.0, 3.0, 4.0])
    found = pd.concat([
        made_up("glambda", 2e-6, 4e-6 * drift),
        made_up("daqp", 1e-6, 8e-6 * drift),
        made_up("quadprog", np.nan, 9e-6 * drift),
    ])  # fmt: skip
    table = ratios(found)
    assert list(table["clock"]) == ["inside", "whole", "arrays"]
    assert list(table["best"]) == ["daqp"] * 3
    first, second, _ = table.itertuples()
    assert first.ratio == pytest.approx(0.5)
    assert (second.ratio, second._9, second.to) == pytest.approx((2.0, 2.0, 2.0))
    write_race(found, tmp_path)
    (said,) = losses(tmp_path)
    assert said == (
        "Called by hand, one QP right after the other, a package is faster than glambda inside "
        "the package on 1 of 1: fig2 cold (daqp, 2.00×)."
    )
    assert "0.500×" in ratios_table(found).rows_in_markdown()
    assert {path.name for path in tmp_path.iterdir()} >= {
        "race.md", "race.csv", "race.png", "race_ratios.csv", *(f"race_{c}.csv" for c in CLOCKS)
    }  # fmt: skip


def test_where_ours_leads_nothing_is_lost(tmp_path: Path) -> None:
    found = pd.concat([made_up("glambda", 1e-6, [4e-6]), made_up("daqp", 2e-6, [8e-6])])
    write_race(found, tmp_path)
    assert losses(tmp_path) == []


def test_who_races() -> None:
    assert raced_by()[:2] == ["glambda", "lotstedt"]
    assert raced_by(["quadprog", "glambda"]) == ["quadprog", "glambda"]
    with pytest.raises(ValueError, match="scipy_bvls"):
        raced_by(["scipy_bvls"])
    absent = [name for name in HANDS if name not in available()]
    if absent:
        with pytest.raises(ImportError, match=absent[0]):
            raced_by(absent[:1])


def test_a_race_is_continued_and_told(
    tower: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "tower.h5", tower)
    out = tmp_path / "race"
    command = ["race", str(tmp_path / "tower.h5"), "--solvers", "glambda,quadprog",
               "--rounds", "2", "-o", str(out)]  # fmt: skip
    told = CliRunner().invoke(app, command)
    assert told.exit_code == 0, told.output
    assert "quadprog" in told.output
    before = (out / "race.csv").read_bytes()
    monkeypatch.setattr(race, "raced", None)  # nothing is measured again
    assert CliRunner().invoke(app, command).exit_code == 0
    assert (out / "race.csv").read_bytes() == before
    claim = race_claim([read_recording(tmp_path / "tower.h5")], ["glambda", "quadprog"], 2)
    assert set(measure([claim], out)["race"]["arm"]) == {"warm", "cold"}
