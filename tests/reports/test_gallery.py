"""The gallery draws a scene of bodies and a network, and names both on its page."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner

from glambda.cli import app


def test_pictures_animations_and_an_index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("reports.motions.gallery.FPS", 8)
    monkeypatch.setattr("reports.motions.network.PICTURES", 25)
    done = CliRunner().invoke(app, ["gallery", "sunk", "half_wave", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert page.index("networks") < page.index("cases")
    for name in ("sunk", "half_wave"):
        assert f'src="{name}.png"' in page and f'src="{name}.gif"' in page
        with Image.open(tmp_path / f"{name}.gif") as film:
            assert film.n_frames > 20
    assert "fig2" not in page


def test_an_unknown_scene_draws_nothing(tmp_path: Path) -> None:
    refused = CliRunner().invoke(app, ["gallery", "fig9", "-o", str(tmp_path)])
    assert refused.exit_code == 2 and not list(tmp_path.iterdir())
