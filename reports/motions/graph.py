"""Figure 6 of a real instant: the bodies, and below them the data structure of their constraints.

Circles are bodies, 0 the ground; squares the active constraints by roman numerals, N of a contact
and F of its friction; the dots between them are contacts.  Broken arrows are the two linked lists,
from A of the bodies and from B of the constraints.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from harness.motions.instant import Instant
from reports.motions.frames import draw_bodies, window_of
from reports.motions.motion import Array, motion_of
from reports.parts.style import BODIES, FAINT, INK, PAGE_WIDTH, PAPER, SOFT, drawing, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROMAN = ((10, "X"), (9, "IX"), (5, "V"), (4, "IV"), (1, "I"))
BODY_ROW, CONTACT_ROW, CONSTRAINT_ROW = 2.0, 1.0, 0.0


def roman(number: int) -> str:
    """14 → XIV."""
    text = ""
    for value, letters in ROMAN:
        count, number = divmod(number, value)
        text += letters * count
    return text


def plot_graph(instant: Instant, path: str | Path) -> Path:
    """Draw the scene and its graph (.png, .svg or .pdf); returns the path."""
    scene = instant.scene
    q = instant.q[None]
    motion = motion_of(SimpleNamespace(scene=scene, t=np.array([instant.t]), q=q, v=0 * q))
    window = window_of(motion, [instant.q])
    height = float(np.clip(PAGE_WIDTH * window.height / window.width, 1.4, 3.2))
    below, title = 2.7, 0.3
    total = height + below + title
    width = height * window.width / window.height / PAGE_WIDTH
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, total))
        words = f"{scene.label} at {instant.t:.4g} s: {len(instant.constraints)} active constraints"
        figure.text(0, 1 - 0.05 / total, words, va="top", weight="bold", size=10)
        axes = figure.add_axes((0.5 - width / 2, (below + 0.02) / total, width, height / total))
        draw_bodies(axes, motion, instant.q, window)
        _mark(axes, instant)
        graph = figure.add_axes((0.03, 0.3 / total, 0.95, (below - 0.4) / total))
        _draw_graph(graph, instant)
        figure.text(0.5, 0.05 / total, _count(instant), ha="center", size=8.5, color=INK)
        return save(figure, Path(path))


def _count(instant: Instant) -> str:
    return (
        f"of {instant.possible:,} possible corner–edge constraints the broad phase leaves "
        f"{instant.near:,}; {sum(c.kind == 'N' for c in instant.constraints):,} are active"
    )


def _mark(axes: Axes, instant: Instant) -> None:
    """Numerals where the constraints are; those of one place stand side by side."""
    places: dict[tuple[float, float], list[str]] = {}
    for number, each in enumerate(instant.constraints, start=1):
        places.setdefault((float(each.at[0]), float(each.at[1])), []).append(roman(number))
    for (x, y), names in places.items():
        axes.plot(x, y, marker="o", markersize=3, color=INK, zorder=5)
        axes.annotate(
            ", ".join(names), (x, y), xytext=(4, 5), textcoords="offset points", size=7.5, zorder=6,
            bbox={"facecolor": PAPER, "edgecolor": "none", "alpha": 0.75, "pad": 0.6},
        )  # fmt: skip


def _draw_graph(axes: Axes, instant: Instant) -> None:
    n, rows = len(instant.q), len(instant.constraints)
    span = max(rows, n + 1, 2)
    body_x = np.linspace(0.5, span - 0.5, n + 1)
    row_x = (np.arange(rows) + 0.5) * span / max(rows, 1)
    axes.set_xlim(-0.7, span + 0.1)
    axes.set_ylim(-0.55, 2.5)
    axes.set_axis_off()
    contact_x = [
        np.mean([row_x[i] for i, c in enumerate(instant.constraints) if c.contact == number])
        for number in range(len(instant.contacts))
    ]
    for x, pair in zip(contact_x, instant.contacts, strict=True):
        for body in pair:
            _arc(
                axes, (float(x), CONTACT_ROW), (body_x[body], BODY_ROW), FAINT if not body else SOFT
            )
        axes.plot(x, CONTACT_ROW, marker="o", markersize=6, color=INK, zorder=3)
    for i, each in enumerate(instant.constraints):
        _arc(axes, (row_x[i], CONSTRAINT_ROW), (float(contact_x[each.contact]), CONTACT_ROW), SOFT)
        colour = BODIES[1] if each.kind == "F" else BODIES[0]
        axes.plot(row_x[i], 0, marker="s", markersize=19, markerfacecolor=colour,
                  markeredgecolor=INK, markeredgewidth=0.8, zorder=3)  # fmt: skip
        axes.text(row_x[i], 0, f"{roman(i + 1)}\n{each.kind}", ha="center", va="center", size=6.5,
                  zorder=4, linespacing=0.95)  # fmt: skip
        axes.text(row_x[i], -0.46, f"{each.lam:.3g}", ha="center", size=6.5, color=SOFT)
    for body, x in enumerate(body_x):
        face = FAINT if body == 0 else BODIES[(body - 1) % len(BODIES)]
        axes.plot(x, BODY_ROW, marker="o", markersize=20, markerfacecolor=PAPER,
                  markeredgecolor="none", zorder=3)  # fmt: skip
        axes.plot(x, BODY_ROW, marker="o", markersize=20, markerfacecolor=face, alpha=0.6,
                  markeredgecolor="none", zorder=3.1)  # fmt: skip
        axes.text(x, BODY_ROW, str(body) if body else "gr.", ha="center", va="center",
                  size=8, weight="bold", zorder=4)  # fmt: skip
    _list(axes, "A", body_x[1:], BODY_ROW)
    _list(axes, "B", row_x, CONSTRAINT_ROW)
    axes.text(-0.62, CONTACT_ROW, "contacts", size=7, color=SOFT, va="center")
    axes.text(-0.62, -0.46, "λ [N]", size=6.5, color=SOFT)


def _arc(axes: Axes, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    """An arrow from one vertex to another, short of both."""
    look = {"arrowstyle": "-|>", "color": colour, "shrinkA": 8, "shrinkB": 10, "linewidth": 0.8}
    axes.annotate("", xy=end, xytext=start, arrowprops=look, zorder=2)


def _list(axes: Axes, head: str, places: Array, y: float) -> None:
    """A linked list: its head, and broken arrows from vertex to vertex."""
    x = [-0.45, *places.tolist()] if head == "B" else [float(places[0]) - 0.6, *places.tolist()]
    axes.text(x[0], y, head, ha="center", va="center", size=9, weight="bold")
    look = {"arrowstyle": "-|>", "color": INK, "shrinkA": 10, "shrinkB": 10, "linewidth": 0.7,
            "linestyle": (0, (3, 2))}  # fmt: skip
    for start, end in pairwise(x):
        axes.annotate("", xy=(end, y), xytext=(start, y), arrowprops=look, zorder=1)
