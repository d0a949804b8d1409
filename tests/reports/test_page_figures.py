"""Figures in a page are what their files are, and nothing else is asked for."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from reports.page import page_figures
from reports.page.page_figures import figure_markup
from reports.parts.style import BLUE, DPI, PAPER, drawing, save


def draw(stem: Path) -> None:
    """A figure as SVG and PNG."""
    with drawing() as Figure:
        figure = Figure(figsize=(4, 3))
        figure.subplots().plot(np.sin(np.arange(50)), color=BLUE)
        for suffix in (".svg", ".png"):
            save(figure, stem.with_suffix(suffix))


@pytest.mark.parametrize("largest", [10**6, 10])
def test_a_figure_is_one_image_with_its_file_in_it(tmp_path, monkeypatch, largest) -> None:
    draw(tmp_path / "one")
    monkeypatch.setattr(page_figures, "LARGEST_SVG", largest)
    markup = figure_markup(tmp_path / "one", 'a "b" < c')
    assert markup.startswith('<img alt="a &quot;b&quot; &lt; c" src="data:image/')
    kind, data = re.findall(r"data:image/([a-z+]+);base64,([^\"]+)", markup)[0]
    file = tmp_path / ("one.svg" if kind == "svg+xml" else "one.png")
    assert (kind == "png") == (largest == 10)
    assert base64.b64decode(data) == file.read_bytes()


def test_a_palette_loses_nothing_that_is_seen(tmp_path: Path) -> None:
    draw(tmp_path / "one")
    with drawing() as Figure:
        figure = Figure(figsize=(4, 3))
        axes = figure.subplots()
        axes.plot(np.sin(np.arange(50)), color=BLUE)
        painted = io.BytesIO()
        figure.savefig(painted, format="png", dpi=DPI, facecolor=PAPER)
        path = save(figure, tmp_path / "a.png")
    with Image.open(painted) as before, Image.open(path) as after:
        assert before.size == after.size and after.mode == "P"
        old, new = (np.asarray(image.convert("RGB"), dtype=int) for image in (before, after))
    assert np.abs(old - new).mean() < 0.1
    assert path.stat().st_size < 0.6 * len(painted.getvalue())
