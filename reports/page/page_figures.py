"""Figures as they stand in a page: one image each, whole, without another address.

A figure is as it is in its SVG file, of which the ground is transparent; a page inverts it in the
dark.  A drawing that is large stands in the page as PNG.
"""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path

LARGEST_SVG = 100_000
"""A figure that is written with more bytes than this stands in the page as PNG."""


def figure_markup(stem: Path, description: str) -> str:
    """The figure `stem`.svg, or `stem`.png where that is much smaller, as mark-up.

    description : what a reader who cannot see the figure is told
    """
    path, kind = stem.with_name(f"{stem.name}.svg"), "svg+xml"
    if path.stat().st_size > LARGEST_SVG:
        path, kind = stem.with_name(f"{stem.name}.png"), "png"
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f'<img alt="{escape(description)}" src="data:image/{kind};base64,{data}">'
