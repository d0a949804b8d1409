"""The manifest of claims: each holds, each control fails, and what is wrong with it is told."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.claims import checking
from harness.claims.checking import Outcome, judged, outcome, refuse_unknown
from harness.claims.manifest import MANIFEST, Entry, chosen, read_manifest

ENTRIES = read_manifest()
ROOT = Path(__file__).parents[3]
README = (ROOT / "README.md").read_text(encoding="utf-8")
FINDINGS = (ROOT / "docs/findings.md").read_text(encoding="utf-8")
UNTRIED = {
    **dict.fromkeys(("r-adapter", "r-heap", "r-compile"), "a time, which no test holds"),
    "r-processors": "it compiles all kernels anew; make rounding tests what comes of that",
}
GOOD = """
[[claim]]
id = "one"
short = "r = 2"
says = "r = 2"
source = "§3.1"
check = "orders.hit_time"
with = { speed = 1.0 }
figure = 2.0
range = [1.9, 2.1]
reason = "a parabola"
disposition = "confirmed"
control = { curved = false }
fails = "no parabola"
"""


@pytest.mark.parametrize(
    "entry",
    [
        pytest.param(e, id=e.id, marks=[pytest.mark.slow] if e.slow else [])
        for e in ENTRIES
        if e.id not in UNTRIED
    ],
)
def test_a_claim_holds_and_its_control_fails(entry: Entry, tmp_path: Path) -> None:
    assert outcome(entry, tmp_path).wrong == ""


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.id)
def test_checks_and_sentences_that_are_named_are_there(entry: Entry) -> None:
    refuse_unknown(entry)
    if entry.source.startswith("README.md: "):
        assert entry.source.removeprefix("README.md: ") in re.sub(r"\s+", " ", README)


def test_findings_rest_on_claims_and_leave_out_none_that_does_not_hold() -> None:
    brackets = " ".join(re.findall(r"\(([^()`]*)\)", FINDINGS))
    named = set(re.findall(r"(?<![\w/-])(?:\d+|r)-[a-z][a-z0-9-]*", brackets))
    assert len(named) > 50
    told = {entry.id for name in named for entry in chosen(ENTRIES, [name])}  # raises where absent
    assert {entry.id for entry in ENTRIES if entry.disposition != "confirmed"} <= told


def written(folder: Path, old: str = "", new: str = "") -> Path:
    path = folder / "claims.toml"
    path.write_text(GOOD.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('reason = "a parabola"\n', "", "claim 'one': reason is missing"),
        ("figure = 2.0", "figure = nan", "figure = nan; it must be a number"),
        ("figure = 2.0", "figure = 3.0", "figure is outside the range 1.9 … 2.1"),
        ("[1.9, 2.1]", "[2.1, 1.9]", "two numbers, the lower one first"),
        ('"confirmed"', '"proved"', "disposition must be one of"),
        ('"confirmed"', '"refuted"', "claimed is missing"),
        ('"confirmed"', '"refuted"\nclaimed = [2.0, 3.0]', "not refuted"),
        ('"confirmed"', '"confirmed"\nclaimed = [2.0, 3.0]', "range is not within"),
        ('"confirmed"', '"conditional"', "condition is missing"),
        ("{ curved = false }", "{}", "control is empty"),
        ("{ curved = false }", "{ speed = 1.0 }", "control changes nothing"),
        ("{ curved = false }", "[1]", "control = [1]; it must be a table"),
        ('id = "one"', 'id = "One two"', "id takes small letters"),
        ('id = "one"', 'id = "one"\nowner = "me"', "owner is no field of a claim"),
        ("[[claim]]", "[claims]", "holds [[claim]] tables"),
        ("[[claim]]", "[[claim", "is no TOML"),
    ],
)
def test_what_is_wrong_with_a_manifest_is_told(
    old: str, new: str, told: str, tmp_path: Path
) -> None:
    path = written(tmp_path, old, new)
    with pytest.raises(ValueError, match=re.escape(told)) as error:
        read_manifest(path)
    assert str(path) in str(error.value)


def test_an_id_stands_once(tmp_path: Path) -> None:
    path = tmp_path / "claims.toml"
    path.write_text(GOOD + GOOD, encoding="utf-8")
    with pytest.raises(ValueError, match="id stands twice"):
        read_manifest(path)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("orders.hit_time", "orders.nothing", "is no check; orders.py has orders.dropped"),
        ("orders.hit_time", "nowhere.nothing", "is no check; see harness.claims.checks"),
        ("curved = false", "bent = false", "control has 'bent', which orders.hit_time does not"),
    ],
)
def test_unknown_checks_and_parameters_are_refused(
    old: str, new: str, told: str, tmp_path: Path
) -> None:
    (entry,) = read_manifest(written(tmp_path, old, new))
    with pytest.raises(ValueError, match=re.escape(told)):
        refuse_unknown(entry)


def test_claims_are_chosen_by_what_their_ids_begin_with() -> None:
    assert {entry.id for entry in chosen(ENTRIES, ["1"])} == {"1-starts", "1-eigenvalues"}
    assert chosen(ENTRIES, []) == ENTRIES
    with pytest.raises(ValueError, match="is not in the manifest"):
        chosen(ENTRIES, ["1-starts", "x"])


@pytest.mark.parametrize(
    ("figure", "control", "told"),
    [
        (2.0, 0.0, ""),
        (2.2, 0.0, "outside"),
        (float("nan"), 0.0, "outside"),
        (2.0, 2.0, "its negative control passes"),
        (2.0, float("nan"), "no number"),
    ],
)
def test_it_fails_closed(figure: float, control: float, told: str, tmp_path: Path) -> None:
    (entry,) = read_manifest(written(tmp_path))
    said = judged(entry, figure, control)
    assert told in said and bool(said) == bool(told)


def test_a_check_that_raises_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(speed: float, curved: bool = True) -> float:
        raise ZeroDivisionError("no")

    (entry,) = read_manifest(written(tmp_path))
    checking.check_named(entry.check)
    monkeypatch.setitem(checking._CHECKS, entry.check, broken)
    found = outcome(entry, tmp_path)
    assert found.wrong == "its check raised ZeroDivisionError: no" and found.figure != found.figure


def invoke(*words: Any) -> Any:
    return CliRunner().invoke(app, ["claims", *map(str, words)])


def test_the_command_stores_rows_and_a_page(tmp_path: Path) -> None:
    found = invoke("--manifest", written(tmp_path), "-o", tmp_path / "out")
    assert found.exit_code == 0 and "1 claims: 1 confirmed." in found.output, found.output
    assert len(list((tmp_path / "out/one").glob("*.parquet"))) == 2
    page = (tmp_path / "out/claims.md").read_text(encoding="utf-8")
    assert "one: confirmed" in page and "no parabola" in page


def test_the_command_fails_where_a_control_passes(tmp_path: Path) -> None:
    path = written(tmp_path, "{ curved = false }", "{ speed = 2.0 }")
    found = invoke("--manifest", path)
    assert found.exit_code == 1 and "its negative control passes" in found.output


def test_slow_claims_are_told_and_kept(tmp_path: Path) -> None:
    path, out = written(tmp_path, "fails =", "slow = true\nfails ="), tmp_path / "out"
    left = invoke("--manifest", path, "-o", out)
    assert left.exit_code == 0 and "1 slow ones were not run" in left.output
    assert invoke("--manifest", path, "-o", out, "--slow").exit_code == 0
    again = invoke("--manifest", path, "-o", out)
    assert "1 claims: 1 confirmed." in again.output


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    assert invoke("nothing").exit_code == 2
    assert invoke("--manifest", tmp_path / "absent.toml").exit_code == 2


def test_an_outcome_without_a_run_is_none(tmp_path: Path) -> None:
    (entry,) = read_manifest(written(tmp_path))
    assert checking.kept(entry, tmp_path) == Outcome(
        entry, pytest.approx(float("nan"), nan_ok=True), pytest.approx(float("nan"), nan_ok=True),
        0.0, "it was not run", ran=False,
    )  # fmt: skip


def test_the_manifest_is_beside_its_code() -> None:
    assert MANIFEST.is_file() and len(ENTRIES) > 40
