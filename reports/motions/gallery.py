"""A gallery: a picture and an animation of each scene, and index.html that shows them by kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment

from problems import describe_scene
from reports.motions.frames import animate_scene, plot_scene
from reports.parts.table import write_text

FRAMES = 6
"""Pictures of a sheet."""
SECONDS, FPS = 3.0, 15
"""Length of an animation [s], and its pictures per second."""
PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Scenes</title>
<meta name="viewport" content="width=device-width">
<style>
body { font-family: sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em; }
article { display: grid; grid-template-columns: 3fr 2fr; gap: 1em; align-items: center; }
img { max-width: 100%; max-height: 26em; }
h3 { margin-bottom: 0; } p { margin-top: .2em; }
</style>
<h1>Scenes</h1>
{% for kind, entries in kinds %}
<h2>{{ kind }}</h2>
{% for entry in entries %}
<h3 id="{{ entry.name }}">{{ entry.name }}</h3><p>{{ entry.summary }}</p>
<article>
<img src="{{ entry.picture }}" alt="frames of {{ entry.name }}">
<img src="{{ entry.film }}" alt="{{ entry.name }} in motion">
</article>
{% endfor %}{% endfor %}
</html>
"""


class Entry(NamedTuple):
    """A scene, what it is, and the names of its files."""

    name: str
    summary: str
    picture: str
    film: str


def draw_entry(name: str, run: Any, folder: Path) -> Entry:
    """Draw a run of a scene into a folder."""
    entry = Entry(name, describe_scene(name)[0], f"{name}.png", f"{name}.gif")
    plot_scene(run, folder / entry.picture, frames=FRAMES)
    motion = float(run.t[-1] - run.t[0])
    animate_scene(run, folder / entry.film, fps=FPS, speed=motion / SECONDS)
    return entry


def write_index(
    folder: Path, kinds: Mapping[str, Sequence[str]], entries: Mapping[str, Entry]
) -> Path:
    """index.html of the entries, by kind."""
    named = [(kind, [entries[name] for name in names if name in entries])
             for kind, names in kinds.items()]  # fmt: skip
    page = Environment(autoescape=True).from_string(PAGE)
    return write_text(folder / "index.html", page.render(kinds=[each for each in named if each[1]]))
