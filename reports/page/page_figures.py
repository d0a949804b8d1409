"""Figures as they stand in a page: SVG in its colours, and small enough for many.

Matplotlib draws every figure for itself and to a millionth of a point.  For a page

    1. numbers are rounded to a hundredth of a point, 1/8000 inch;  comments and layout are dropped;
    2. the outlines of letters, which figures share, stand in the page once;
    3. so does every style, as a class;  names become short, and are another figure's never;
    4. ink and paper become the page's colours, so that one drawing serves light and dark.

A drawing that is large before that stands in the page as PNG.
"""

from __future__ import annotations

import base64
import re
from html import escape
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from reports.parts.style import FAINT, INK, PAPER, SOFT

LARGEST_SVG = 200_000
"""A figure that is written with more bytes than this stands in the page as PNG."""

COLOURS = {INK: "var(--ink)", SOFT: "var(--soft)", FAINT: "var(--faint)", PAPER: "var(--paper)"}
"""Variables that a page defines."""

OUTLINE = "scale(0.015625)"
"""The transformation that marks the outline of a letter: it is drawn in 1/64 of its units."""

LENGTHS = ("d", "x", "y", "width", "height")
"""Attributes whose numbers are lengths [pt]."""


class PageFigures:
    """The figures of one page.

    A page that holds what `add` returns must hold `outlines` and the style sheet `styles`, too, as
    they are when the last figure was added.
    """

    def __init__(self) -> None:
        self._outlines: dict[str, str] = {}
        self._styles: dict[str, str] = {}
        self._names = 0

    def add(self, stem: Path, description: str) -> str:
        """The figure `stem`.svg, or `stem`.png where that is much smaller, as mark-up.

        description : what a reader who cannot see the figure is told
        """
        drawn, painted = stem.with_name(f"{stem.name}.svg"), stem.with_name(f"{stem.name}.png")
        if drawn.stat().st_size > LARGEST_SVG:
            data = base64.b64encode(painted.read_bytes()).decode("ascii")
            return f'<img alt="{escape(description)}" src="data:image/png;base64,{data}">'
        root = ElementTree.parse(drawn).getroot()
        _without_namespaces(root)
        names = self._names_in(root)
        for element in root.iter():
            self._shorten(element, names)
        _flatten(root)
        box = root.attrib["viewBox"]
        root.attrib = {"role": "img", "aria-label": description, "viewBox": box}
        return ElementTree.tostring(root, encoding="unicode").replace(" />", "/>")

    @property
    def outlines(self) -> str:
        """The letters of all figures, which draw nothing where they stand."""
        letters = "".join(
            f'<path id="{name}" d="{d}" transform="{OUTLINE}"/>'
            for d, name in self._outlines.items()
        )
        return f'<svg width="0" height="0" aria-hidden="true"><defs>{letters}</defs></svg>'

    @property
    def styles(self) -> str:
        """The classes of all figures."""
        return "\n".join(f".{name} {{ {style} }}" for style, name in self._styles.items())

    def _names_in(self, root: Element) -> dict[str, str]:
        """Name in the drawing → in the page, of all that is referred to; letters are taken out.

        A blank has no outline; what refers to it is to be left out, and its name is empty.
        """
        names = {}
        for parent in list(root.iter()):
            for child in list(parent):
                if child.get("transform") != OUTLINE:
                    continue
                d = _rounded(child.get("d", ""))
                fresh = f"g{len(self._outlines)}"
                names[child.attrib["id"]] = self._outlines.setdefault(d, fresh) if d else ""
                parent.remove(child)
        for element in root.iter():
            for value in element.attrib.values():
                for name in re.findall(r"^#(.+)|url\(#([^)]+)\)", value):
                    if (old := "".join(name)) not in names:
                        names[old] = f"p{self._names}"
                        self._names += 1
        return names

    def _shorten(self, element: Element, names: dict[str, str]) -> None:
        """Write an element's attributes as they stand in the page."""
        old, element.attrib = element.attrib, {}
        for key, value in old.items():
            value = re.sub(r"url\(#([^)]+)\)", lambda name: f"url(#{names[name[1]]})", value)
            for colour, variable in COLOURS.items():
                value = value.replace(colour, variable)
            if key == "id" and value not in names:
                continue
            if key == "id":
                value = names[value]
            elif key == "href" and value.startswith("#"):
                value = f"#{names[value[1:]]}"
            elif key in LENGTHS:
                value = _rounded(value)
            elif key == "transform":
                value = re.sub(r"translate\([^)]*\)", lambda part: _rounded(part[0]), value)
            elif key == "style":
                key, value = "class", self._styles.setdefault(value, f"s{len(self._styles)}")
            element.set(key, value)
        moved = re.fullmatch(r"translate\((\S+) (\S+)\)", element.get("transform", ""))
        if element.tag == "use" and moved is not None:
            del element.attrib["transform"]
            for key, by in (("x", moved[1]), ("y", moved[2])):
                if by != "0":
                    element.set(key, by)


def _without_namespaces(root: Element) -> None:
    """Give tags and attributes the names that they have in HTML; leave out text and layout."""
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
        element.attrib = {key.rpartition("}")[2]: value for key, value in element.attrib.items()}
        element.text = element.tail = None
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in ("metadata", "style"):
                parent.remove(child)


def _flatten(parent: Element) -> None:
    """Leave out groups that say nothing of what is in them, and references to blanks."""
    kept: list[Element] = []
    for child in parent:
        _flatten(child)
        if child.get("href") == "#" or (child.tag in ("g", "defs") and not len(child)):
            continue
        kept += list(child) if child.tag == "g" and not child.attrib else [child]
    parent[:] = kept


def _rounded(text: str) -> str:
    """A path or a list of numbers with two digits behind the point, and no space to spare."""
    text = re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda number: _short(float(number[0])), text)
    return re.sub(r" ?([A-Za-z]) ?", r"\1", " ".join(text.split()))


def _short(number: float) -> str:
    text = f"{number:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
