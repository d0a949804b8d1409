"""Figures of a report one by one, in a notebook or in a file: `glambda.plot_cost("results")`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from reports.rows.results import Results, load_results


@dataclass(frozen=True)
class Picture:
    """A figure that was drawn; a notebook shows it.

    content : bytes of the file;  kind : png, svg or pdf
    """

    content: bytes = field(repr=False)
    kind: str

    def _repr_png_(self) -> bytes | None:
        return self.content if self.kind == "png" else None

    def _repr_svg_(self) -> str | None:
        return self.content.decode() if self.kind == "svg" else None


def plot_motion(source: Any, path: str | Path | None = None) -> Picture:
    """Frames of a `Run` or a `Recording`.

    path : .png, .svg or .pdf to be written, here and below; None: none
    """
    from reports.motions.frames import plot_scene

    return _drawn(lambda target: plot_scene(source, target), path)


def plot_accuracy(
    results: str | Path, path: str | Path | None = None, setting: str | None = None
) -> Picture:
    """Errors over the accuracy asked, of every backend.

    results : folder of a replay, here and below;  setting : default: the first that was run

    Raises ValueError where it holds no such solves.
    """
    from reports.sections.figures import plot_accuracy as draw

    return _of_setting(draw, results, path, setting)


def plot_cost(
    results: str | Path, path: str | Path | None = None, setting: str | None = None
) -> Picture:
    """Median times per QP, of every backend."""
    from reports.sections.figures import plot_cost as draw

    return _of_setting(draw, results, path, setting)


def plot_profiles(
    results: str | Path, path: str | Path | None = None, setting: str | None = None
) -> Picture:
    """Performance profiles over all recordings."""
    from reports.sections.figures import plot_profiles as draw

    return _of_setting(draw, results, path, setting)


def plot_outside(
    results: str | Path, path: str | Path | None = None, setting: str | None = None
) -> Picture:
    """Times over ours on recordings that are not the paper's scenes."""
    from reports.sections.outside import outside_tables
    from reports.sections.outside import plot_outside as draw

    loaded = load_results(results)
    wanted = setting or loaded.headline
    tables = [table for table in outside_tables(loaded) if table.key["setting"] == wanted]
    if not tables:
        raise ValueError(f"{results}: holds no solves of recordings from outside at {wanted}")
    return _drawn(lambda target: draw(tables[0], target), path)


def _of_setting(
    draw: Callable[[Results, str, Path], Any],
    results: str | Path,
    path: str | Path | None,
    setting: str | None,
) -> Picture:
    loaded = load_results(results)
    chosen = setting or loaded.headline
    if chosen is None:
        raise ValueError(f"{results}: holds no solves; run a replay first")
    return _drawn(lambda target: draw(loaded, chosen, target), path)


def _drawn(draw: Callable[[Path], Any], path: str | Path | None) -> Picture:
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "figure.png" if path is None else Path(path)
        draw(target)
        return Picture(target.read_bytes(), target.suffix.lstrip("."))
