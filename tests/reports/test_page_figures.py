"""Figures in a page draw what their files draw, and weigh less."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pytest
from PIL import Image

from reports.page import page_figures
from reports.page.page_figures import COLOURS, PageFigures
from reports.parts.style import BLUE, DPI, INK, PAPER, drawing, save

Drawn = tuple[str, str, list[float]]


def draw(stem: Path, points: int = 40) -> None:
    """A figure with letters, powers, blanks, markers, clipped lines, areas and hatches."""
    with drawing() as Figure:
        figure = Figure(figsize=(4, 3))
        left, right = figure.subplots(1, 2)
        x = np.geomspace(1e-3, 1e3, points)
        left.loglog(x, x**1.37, "o-", color=BLUE, markersize=4)
        left.set_xlim(1e-2, 1e2)
        left.set_title("error in Gλ & <time>")
        right.bar(["a b", "c"], [1.234567, 2.0], hatch="//", color=PAPER, edgecolor=INK)
        right.fill_between([0.0, 1.0], [0.1, 0.2], color=BLUE, alpha=0.3)
        for suffix in (".svg", ".png"):
            save(figure, stem.with_suffix(suffix))


def leaves(
    element: Element, names: dict[str, Element], styles: dict[str, str], before: str = ""
) -> Iterator[Drawn]:
    """Whatever is drawn: its kind, way of drawing, numbers from the outside in, and clipping."""
    tag = element.tag.rpartition("}")[2]
    if tag in ("metadata", "defs", "clipPath"):
        return
    get = {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
    style = styles.get(get.get("class", ""), get.get("style", ""))
    for colour, variable in COLOURS.items():
        style = style.replace(colour, variable)
    place = before + get.get("transform", "")
    if {"x", "y"} & set(get) and tag == "use":
        place += f"translate({get.get('x', 0)} {get.get('y', 0)})"
    if tag == "use":
        yield from leaves(names[get["href"][1:]], names, styles, f"{place};{style};")
    if tag == "path" and get.get("d"):
        clip = names[get["clip-path"][5:-1]] if "clip-path" in get else ()
        numbers = [value for part in clip for value in numbers_in(" ".join(part.attrib.values()))]
        way = re.sub(r"\s", "", re.sub(r"[\d.e+-]+", " ", get["d"]))
        text = re.sub(r"url\(#[^)]+\)", "url", style)
        yield way, text, numbers_in(place) + numbers_in(get["d"]) + numbers
    for child in element:
        yield from leaves(child, names, styles, place)


def numbers_in(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


def named(*roots: Element) -> dict[str, Element]:
    return {e.attrib["id"]: e for root in roots for e in root.iter() if "id" in e.attrib}


def test_a_figure_in_the_page_draws_what_its_file_draws(tmp_path: Path) -> None:
    draw(tmp_path / "one")
    figures = PageFigures()
    markup = figures.add(tmp_path / "one", 'a "b" < c')
    page, letters = ElementTree.fromstring(markup), ElementTree.fromstring(figures.outlines)
    file = ElementTree.parse(tmp_path / "one.svg").getroot()
    styles = dict(re.findall(r"\.(\w+) \{ (.*) \}", figures.styles))
    expected = list(leaves(file, named(file), {}))
    found = list(leaves(page, named(page, letters), styles))
    assert len(found) == len(expected) > 100
    for one, other in zip(found, expected, strict=True):
        assert one[:2] == other[:2]
        a, b = (np.array([x for x in numbers if x != 0]) for numbers in (one[2], other[2]))
        np.testing.assert_allclose(a, b[np.abs(b) >= 0.005], rtol=0, atol=0.00501)
    assert page.get("aria-label") == 'a "b" < c' and page.get("viewBox") == file.get("viewBox")
    assert not any(colour in markup + figures.styles for colour in COLOURS)
    assert len(markup + figures.outlines) < 0.6 * (tmp_path / "one.svg").stat().st_size


def test_figures_share_letters_and_styles_and_no_names(tmp_path: Path) -> None:
    figures, pages = PageFigures(), []
    for name in ("one", "two"):
        draw(tmp_path / name)
        pages.append(ElementTree.fromstring(figures.add(tmp_path / name, name)))
        plain = [line for line in figures.styles.splitlines() if "url(" not in line]
        shared = (figures.outlines, plain)
        if name == "one":
            first = shared
    assert shared == first
    one, two = (set(named(page)) for page in pages)
    assert one and two and not one & two


def test_a_large_figure_stands_as_png(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draw(tmp_path / "one")
    monkeypatch.setattr(page_figures, "LARGEST_SVG", 1000)
    figures = PageFigures()
    markup = figures.add(tmp_path / "one", 'a "b" < c')
    assert markup.startswith('<img alt="a &quot;b&quot; &lt; c" src="data:image/png;base64,')
    assert not figures.styles


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
