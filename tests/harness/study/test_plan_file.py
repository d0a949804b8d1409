"""A study that is written down: read, refused with a remedy, kept with its results."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.study.plan_file import LONGEST, read_plan
from harness.study.study import QUICK, StudyPlan, estimate, record_into
from problems.scenes.registry import scene_kinds

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs/how_to/study.md"
SHORT = """
scenes = ["fig5"]
solvers = ["glambda", "daqp"]
settings = ["high"]
arms = ["cold"]
repeats = 1
until = 0.05
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    return tmp_path / "plan.toml"


def test_what_is_left_out_is_as_before(plan: Path) -> None:
    plan.write_text('scenes = ["wheels", "fig4,mu_I=0.8"]\nsettings = ["paper", "0.000001"]\n')
    made, text = read_plan(plan, QUICK)
    assert made.scenes == (*scene_kinds()["wheels"], "fig4,mu_I=0.8")
    assert made.settings == ("paper", "1e-6")
    assert (made.solvers, made.repeats) == (QUICK.solvers, QUICK.repeats)
    assert text == plan.read_bytes()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("scene = []", "scene is no field of a study; did you mean 'scenes'? it has: scenes"),
        ('scenes = "fig4"', "scenes = 'fig4'; it must be a list of texts"),
        ("scenes = [4]", "it must be a list of texts"),
        ('scenes = ["fig9"]', "scenes: unknown scene 'fig9'"),
        ('scenes = ["fig4,boxes=1000000000"]', "scenes: scene 'fig4': boxes = 1000000000"),
        ('solvers = ["daqb"]', "solvers: unknown solver 'daqb'; did you mean 'daqp'?"),
        ('settings = ["hihg"]', "settings: setting 'hihg' is unknown"),
        ('arms = ["hot"]', "arms: arm 'hot' is unknown"),
        ("repeats = 0", "repeats = 0; it must be above 0"),
        ("repeats = 1.5", "repeats = 1.5; it must be a whole number"),
        ("repeats = true", "repeats = True; it must be a whole number"),
        ("until = inf", "until = inf; it must be above 0, and finite"),
        ("until = nan", "until = nan; it must be above 0, and finite"),
        ("until = ", "is no TOML"),
        ("only_installed = 1", "only_installed = 1; it must be true or false"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_field(text: str, told: str, plan: Path) -> None:
    plan.write_text(text)
    with pytest.raises(ValueError, match=re.escape(told)) as error:
        read_plan(plan, StudyPlan())
    assert str(error.value).startswith(f"{plan}: ")


def test_what_is_no_text_and_never_ends_is_refused(plan: Path) -> None:
    plan.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="no text in UTF-8"):
        read_plan(plan, StudyPlan())
    plan.write_bytes(b"#" * (LONGEST + 1))
    with pytest.raises(ValueError, match=r"more than 100,000"):
        read_plan(plan, StudyPlan())
    if hasattr(os, "mkfifo"):
        plan.unlink()
        os.mkfifo(plan)
        with pytest.raises(ValueError, match="a pipe or a device"):
            read_plan(plan, StudyPlan())


def test_the_page_shows_a_plan_that_can_be_read(plan: Path) -> None:
    (shown,) = re.findall(r"^```toml\n(.*?)^```$", PAGE.read_text(), flags=re.M | re.S)
    plan.write_text(shown)
    made, _ = read_plan(plan, StudyPlan())
    assert made != StudyPlan()


def test_a_study_follows_its_plan_and_keeps_it(plan: Path, tmp_path: Path) -> None:
    plan.write_text(SHORT)
    done = CliRunner().invoke(app, ["study", str(plan), "--results", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out/study.toml").read_text() == SHORT
    shards = {path.stem for path in (tmp_path / "out/solves").iterdir()}
    assert shards == {"fig5__glambda__high__cold", "fig5__daqp__high__cold"}
    absent = CliRunner().invoke(app, ["study", str(tmp_path / "no.toml")])
    assert absent.exit_code == 2 and "no.toml" in absent.output


def test_the_plan_of_everything_takes_every_scene_through_every_backend() -> None:
    made, _ = read_plan(ROOT / "docs/how_to/everything.toml", StudyPlan())
    assert made.scenes == tuple(name for names in scene_kinds().values() for name in names)
    assert made.named_solvers() == StudyPlan().named_solvers()


def test_motions_are_cut_off_but_not_drawn_out(tmp_path: Path) -> None:
    ends = [
        record_into(tmp_path, f"motor,end_time={end}", until=0.02).t[-1] for end in (0.01, 0.03)
    ]
    assert ends == pytest.approx([0.01, 0.02])


def test_an_estimate_grows_with_the_plan() -> None:
    def minutes(plan: StudyPlan) -> float:
        return float(re.findall(r"some (\d+) minutes", estimate(plan))[0])

    assert minutes(replace(StudyPlan(), repeats=1)) < minutes(StudyPlan())
    assert estimate(replace(QUICK, solvers=("daqp",))) == ""
