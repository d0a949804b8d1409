"""Painlevé's rod in one figure: first steps, growth per step, the catch, ways to γ = 1."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from harness.claims.painleve import Painleve
from harness.claims.slide import growth
from reports.parts.style import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    SKY,
    SOFT,
    VERMILLION,
    drawing,
    save,
)
from reports.parts.table import power

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOOSE, TIGHT = 1e-3, 1e-9
"""The two ε of the first steps."""


def plot_painleve(measured: Painleve, path: Path) -> Path:
    """First steps, growth per step, the catch in fixed steps, ways to γ = 1."""
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, 5.8), layout="constrained")
        (first, second), (third, fourth) = figure.subplots(2, 2)
        _draw_firsts(first, measured.firsts)
        _draw_growth(second, measured.growths)
        _draw_catches(third, measured.catches)
        _draw_approaches(fourth, measured.approaches)
        return save(figure, path)


def _draw_firsts(axes: Axes, firsts: pd.DataFrame) -> None:
    none = firsts[firsts["motions"] == "none"]
    looks = {
        ("paper", LOOSE): (BLUE, "o", "paper"),
        ("corrected", LOOSE): (ORANGE, "s", "corrected, ε = 1e-3"),
        ("corrected", TIGHT): (VERMILLION, "^", "corrected, ε = 1e-9"),
    }
    for (rule, eps), (colour, marker, label) in looks.items():
        part = none[(none["rule"] == rule) & (none["eps"] == eps)]
        axes.loglog(
            part["h"], part["jump"], color=colour, marker=marker, markersize=4, linewidth=1.1,
            label=label,
        )  # fmt: skip
    axes.axhline(none["catch"].iloc[0], color=INK, linewidth=0.8, linestyle=(0, (4, 2)))
    axes.annotate(
        "impulse without a collision", (none["h"].min(), none["catch"].iloc[0]),
        xytext=(0, 4), textcoords="offset points", fontsize=7.5,
    )  # fmt: skip
    axes.set_ylim(top=2.0)
    axes.set_title("first step, no motion exists")
    axes.set_xlabel("h [s]")
    axes.set_ylabel("‖q̇ₙ − q̇ₙ₋₁‖ in M")
    axes.legend(loc="lower right")
    axes.grid(True)


def _draw_growth(axes: Axes, growths: pd.DataFrame) -> None:
    gain = np.linspace(-0.7, 2.1, 281)
    axes.plot(gain, [growth(g) for g in gain], color=BLUE, linewidth=1.2, label="(4.2), theory")
    axes.plot(gain, np.abs(gain), color=GREEN, linewidth=1.0, linestyle="--", label="(4.3), theory")
    axes.plot(
        growths["gain"], growths["measured"], "o", color=VERMILLION, markersize=4,
        label="(4.2), measured",
    )  # fmt: skip
    axes.axhline(1.0, color=SOFT, linewidth=0.7)
    axes.set_title("growth of λ per step")
    axes.set_xlabel("γ")
    axes.set_ylabel("|ζ|")
    axes.legend(loc="upper left")
    axes.grid(True)


def _draw_catches(axes: Axes, catches: pd.DataFrame) -> None:
    paper = catches[catches["rule"] == "paper"]
    colours = (ORANGE, SKY, GREEN, PURPLE, BLUE, VERMILLION, INK)
    for (h, run), colour in zip(paper.groupby("h", sort=False), colours, strict=False):
        axes.semilogx(run["t"][1:], run["slip"][1:], color=colour, marker=".", markersize=3.5)
        axes.annotate(
            power(h), (run["end"].iloc[0], 0.0), xytext=(0, -10),
            textcoords="offset points", ha="center", fontsize=7.5, color=colour,
        )  # fmt: skip
    axes.set_ylim(-0.14, 1.06)
    steps = f"{power(paper['h'].max())} … {power(paper['h'].min())}"
    axes.set_title(f"slip by the paper's rule, h = {steps}")
    axes.set_xlabel("t [s]")
    axes.set_ylabel("slip [m/s]")
    axes.grid(True)


def _draw_approaches(axes: Axes, approaches: pd.DataFrame) -> None:
    finest = approaches["eps"].min()
    runs = approaches[approaches["eps"] == finest].groupby("spin", sort=False)
    for (spin, run), colour in zip(runs, (ORANGE, SKY, GREEN, PURPLE, BLUE), strict=False):
        axes.plot(run["gain"], run["free"], color=colour, linewidth=1.2, label=f"{spin:g} rad/s")
        axes.plot(run["gain"].iloc[-1], run["free"].iloc[-1], "o", color=colour, markersize=4)
    axes.axhline(0.0, color=SOFT, linewidth=0.7)
    axes.axvline(1.0, color=SOFT, linewidth=0.7)
    low, high = axes.get_ylim()
    axes.set_ylim(low, max(high, -0.5 * low))
    axes.set_xlim(right=1.02)
    axes.set_title(f"ways to γ = 1, ε = {power(finest)}")
    axes.set_xlabel("γ")
    axes.set_ylabel("B [m/s²]")
    axes.legend(loc="upper left", ncols=2)
    axes.grid(True)
