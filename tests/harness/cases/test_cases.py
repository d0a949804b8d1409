"""Scenes with known answers are answered right, and the command stores what it shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.cases import foils
from harness.cases.bodies import threshold
from harness.cases.table import CASES, cases_claim
from harness.peers.tasks import started
from problems.scenes.registry import scene_kinds
from solvers import make_solver

BOUNDS = {
    "ramp": 1e-3,
    "braking": 1e-5,
    "mass_ratio": 1e-9,
    "arch": 2e-3,
    "cards": 1e-3,
    "dominoes": 1e-4,
    "sunk": 1e-6,
    "rocking": 1e-4,
    "slider_crank": 1e-3,
    "double_pendulum": 1e-4,
    "skate": 1e-5,
    "bungee": 1e-5,
    "motor": 1e-5,
    "bounce": 1e-4,
    "frame": 1e-4,
    "arm": 1e-9,
    "human": 1e-9,
    "half_wave": 1e-4,
    "bridge": 1e-3,
    "boost": 0.05,
    "heavy_top": 1e-3,
    "skid": 2e-3,
    "bowl": 1e-4,
}
"""Largest error of each case, in the unit of its numbers."""
OF_SEVERAL = {"friction_discs"}
ELSEWHERE = {"free_top", "slope", "space_tower", "space_pyramid", *OF_SEVERAL}
"""Cases that take long, and are held by tests/problems/space."""


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    solver = make_solver("glambda")
    parts = [pd.DataFrame(CASES[case](solver)).assign(case=case) for case in BOUNDS]
    return pd.concat(parts, ignore_index=True)


@pytest.mark.parametrize("case", BOUNDS)
def test_numbers_are_those_that_are_known(case: str, rows: pd.DataFrame) -> None:
    part = rows[rows["case"] == case]
    assert len(part)
    np.testing.assert_allclose(part["value"], part["expected"], rtol=0, atol=BOUNDS[case])


def test_the_method_is_of_second_order_where_that_can_be_seen(rows: pd.DataFrame) -> None:
    seen = rows["order"].dropna()
    assert len(seen) == 17
    assert (seen > 1.9).all() and (seen < 2.5).all()  # the crank's error passes through 0


def test_more_stones_come_closer_to_milankovitch(rows: pd.DataFrame) -> None:
    few, many = rows[rows["case"] == "arch"]["value"]
    assert few < many < 0.1076


def test_a_bracket_that_encloses_nothing_gives_no_threshold() -> None:
    assert np.isnan(threshold(lambda _: True, 0.0, 1.0))
    assert threshold(lambda x: x > 0.3, 0.0, 1.0) == pytest.approx(0.3, abs=1 / 256)


def test_the_scenes_are_listed_and_other_engines_can_read_them() -> None:
    listed = scene_kinds()["cases"]
    kinds = scene_kinds()
    assert {*BOUNDS, *ELSEWHERE} == set(CASES)
    others = {*kinds["wheels"], *kinds["networks"], *kinds["linkages"], *kinds["space"]}
    assert set(listed) < set(CASES) and set(CASES) - set(listed) - OF_SEVERAL < others
    for name in listed:
        assert not started(name).impulses


def test_the_command_stores_prints_and_writes_its_table(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["cases", "sunk", "cards", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "least μ" in done.output and (tmp_path / "cases/sunk.parquet").exists()
    written = pd.read_csv(tmp_path / "cases.csv")
    assert set(written["case"]) == {"sunk", "cards"}
    assert "cards" in (tmp_path / "cases.md").read_text(encoding="utf-8")


def test_an_unknown_case_is_refused() -> None:
    with pytest.raises(ValueError, match="no case"):
        cases_claim(["bicycle"], make_solver("glambda"))


def test_foils_stand_beside_the_paper_s_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foils, "UNTIL", 0.5)
    monkeypatch.setattr(foils, "SPRING_STEPS", (1 / 960,))
    monkeypatch.setattr(foils, "SCENES", ("fig4,mu_I=0.8",))
    done = CliRunner().invoke(app, ["cases", "sunk", "--foils", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    rows = pd.read_csv(tmp_path / "foils.csv").set_index("way")
    assert rows.loc["impulses of the paper", "off"] == 0.0
    assert rows.loc["impulses by Newton and Coulomb", "off"] > 1e-4
    assert 1e-3 < rows.loc["springs, h = 1/960 s", "off"] < 0.5
    assert "springs, h = 1/960 s" in (tmp_path / "cases.md").read_text(encoding="utf-8")
