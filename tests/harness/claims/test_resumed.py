"""Campaigns that are interrupted: what was finished is kept, and the same command continues."""

from __future__ import annotations

from functools import partial
from math import inf
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.criterion.examination import examination_claims
from harness.recordings.recording import write_recording
from harness.results.claim import Claim
from tests.fakes.runs import short_recording

SMALLER: dict[str, Any] = {
    "harness.claims.stability.STEPS": 20,
    "harness.claims.convergence.SWEEP": (1e-2, 1e-3, 1e-4),
    "harness.claims.reference_motion.REFERENCE": 1e-4,
    "harness.criterion.criterion.SWEEP": (1, 5, inf),
    "harness.criterion.criterion.ENOUGH": 1e-3,
    "harness.criterion.kept_factors.INTERVALS": (1, 5),
    "harness.criterion.kept_factors.LONGEST": 10,
    "harness.criterion.examination.examination_claims": partial(examination_claims, largest=2),
    "harness.claims.painleve.STEPS": (1e-4, 1e-5, 1e-6),
    "harness.claims.painleve.APPROACHES": (2.0, 3.0),
    "harness.claims.painleve.TOLERANCES": (1e-3, 1e-4),
}
COMMANDS = {
    "stability": ["stability"],
    "painleve": ["painleve"],
    "convergence": ["convergence", "wall,bodies=3"],
    "criterion": ["criterion", "fig5.h5", "--repeats", "1"],
}


def stored(folder: Path) -> dict[Path, int]:
    """Files of rows, and when each was written."""
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.parquet")}


def tables(folder: Path) -> dict[str, bytes]:
    """The page and its tables."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.suffix in (".csv", ".md")}


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupted_campaign_continues(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(Path("fig5.h5"), short_recording("fig5", 24))
    output = tmp_path / name
    for constant, value in SMALLER.items():
        monkeypatch.setattr(constant, value)
    store, units = Claim.store, []

    def run(most: float) -> Any:
        """Run the command until Ctrl-C comes after so many units."""
        units.clear()

        def store_some(claim: Claim, folder: Path, unit: Any) -> None:
            if len(units) >= most:
                raise KeyboardInterrupt
            store(claim, folder, unit)
            units.append(unit)

        monkeypatch.setattr(Claim, "store", store_some)
        return CliRunner().invoke(app, [*COMMANDS[name], "-o", name])

    stopped = run(2)
    assert stopped.exit_code == 130
    assert "what was finished is kept: the same command continues" in stopped.stderr
    kept = stored(output)
    assert len(kept) == 2 and not tables(output)

    finished = run(inf)
    assert finished.exit_code == 0, finished.output
    whole = stored(output)
    assert len(units) == len(whole) - 2 > 0 and kept.items() <= whole.items()

    page = tables(output)
    for path in output.glob("*.*"):
        path.unlink()
    again = run(0)  # the report is made from the stored rows alone
    assert again.stdout == finished.stdout
    assert tables(output) == page and f"{name}.md" in page
