"""Currents and voltages of a network over time, as a picture and as an animation.

Above the currents i of the branches, below the voltages v of sources and λ of diodes (6.2); a bar
at the foot says when each diode conducts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from problems import scene
from problems.networks.network import Network
from problems.networks.run import NetworkRun
from reports.motions.film import film
from reports.parts.style import BODIES, FAINT, INK, PAGE_WIDTH, SOFT, drawing, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

HEIGHT = 3.6
"""Of a picture [in]."""
PICTURES = 60
"""Of an animation."""


@dataclass(frozen=True)
class Trace:
    """A network in motion.

    t : (n,) [s];  names : of the branches
    currents : (n, b) [A];  sources, diodes : (n, b) [V], columns without one are left out
    """

    label: str
    t: Array
    names: Sequence[str]
    currents: Array
    sources: dict[str, Array]
    diodes: dict[str, Array]

    def until(self, t: float) -> Trace:
        """The part up to t [s]."""
        n = int(np.searchsorted(self.t, t, side="right"))
        parts = ({k: v[:n] for k, v in part.items()} for part in (self.sources, self.diodes))
        return Trace(self.label, self.t[:n], self.names, self.currents[:n], *parts)


def is_network(source: Any) -> bool:
    """Whether a run or a recording is of a network and not of bodies."""
    if getattr(source, "space", None) is not None:
        return False
    return isinstance(source, NetworkRun) or len(getattr(source, "polygons", [()])) == 0


def trace_of(source: Any) -> Trace:
    """Of a `NetworkRun`, or of the accepted QPs of a `Recording`, i = (h/α₀) D⁻¹ r.

    Raises ValueError for a recording that is not of a network that can be made again.
    """
    if isinstance(source, NetworkRun):
        network, label = source.scene, source.scene.label
        t, currents, diodes = source.t[1:], source.currents[1:], source.diode_voltages[1:]
    else:
        network, label = _recorded_network(source), source.scene
        t, currents, diodes = _recorded_course(source, network)
    sources = np.array([network.voltages(time) for time in t]).reshape(t.size, -1)
    has_diode = [branch.diode for branch in network.branches]
    driven = np.abs(sources).max(axis=0, initial=0.0) > 0

    def chosen(which: Sequence[bool], values: Array) -> dict[str, Array]:
        named = zip(network.names(), which, values.T, strict=True)
        return {name: column for name, take, column in named if take}

    return Trace(
        label, t, network.names(), currents, chosen(driven.tolist(), sources),
        chosen(has_diode, diodes),
    )  # fmt: skip


def _recorded_network(recording: Any) -> Network:
    own = {k: v for k, v in recording.parameters.items() if not k.startswith("run.")}
    try:
        made = scene(recording.scene.partition(",")[0], **own)
    except ValueError:
        made = None
    if not isinstance(made, Network):
        raise ValueError(f"{recording.scene} holds no bodies, so there is nothing to draw")
    return made


def _recorded_course(recording: Any, network: Network) -> tuple[Array, Array, Array]:
    """t, currents and λ of the accepted steps."""
    has_diode = np.array([branch.diode for branch in network.branches])
    nodes, diodes = network.incidence().shape[1], int(has_diode.sum())
    t, currents, voltages = [], [], []
    for qp, solution in zip(recording.qps, recording.solutions, strict=True):
        if not qp.accepted:
            continue
        voltage = np.zeros(has_diode.size)
        voltage[has_diode] = solution.x[nodes : nodes + diodes]
        t.append(qp.t)
        currents.append(qp.h / qp.alpha0 * qp.residual(solution.x) / qp.D)
        voltages.append(voltage)
    return np.array(t), np.array(currents), np.array(voltages)


def plot_network(source: Any, path: str | Path) -> Path:
    """Draw the currents and voltages of a run or a recording (.png, .svg or .pdf)."""
    trace = trace_of(source)
    with drawing() as Figure:
        figure = Figure(figsize=(PAGE_WIDTH, HEIGHT))
        figure.text(0.0, 0.985, trace.label, va="top", weight="bold", size=10)
        _draw(figure, trace, trace)
        return save(figure, Path(path))


def animate_network(source: Any, path: Path, fps: int, pixels: int) -> Path:
    """Write how currents and voltages come about as a film."""
    trace = trace_of(source)
    times = np.linspace(trace.t[0], trace.t[-1], PICTURES)
    with drawing() as Figure:
        figure = Figure(figsize=(6.0, HEIGHT))
        with film(figure, path, fps, pixels) as take:
            for time in times:
                figure.clear()
                _draw(figure, trace.until(time), trace)
                take()
    return path


def _draw(figure: Figure, shown: Trace, whole: Trace) -> None:
    """Both panels, with the axes that the whole course needs."""
    above = figure.add_axes((0.08, 0.56, 0.74, 0.37))
    below = figure.add_axes((0.08, 0.12, 0.74, 0.37))
    unit, factor = ("ms", 1e3) if whole.t[-1] < 1 else ("s", 1.0)
    t, looks = factor * shown.t, _looks(whole.names)
    for name, i in zip(shown.names, shown.currents.T, strict=True):
        above.plot(t, i, label=f"i {name}", **looks[name])
    _frame(above, factor * whole.t, whole.currents)
    above.set_ylabel("current [A]")
    above.tick_params(labelbottom=False)
    for name, e in shown.sources.items():
        below.plot(t, e, label=f"v {name}", color=SOFT, linewidth=1.4)
    for name, lam in shown.diodes.items():
        below.plot(t, lam, label=f"λ {name}", **looks[name])
    voltages = [*whole.sources.values(), *whole.diodes.values()]
    low, step = _frame(below, factor * whole.t, np.array(voltages) if voltages else np.zeros(1))
    for row, (name, lam) in enumerate(shown.diodes.items()):
        conducts = shown.currents[:, list(shown.names).index(name)] > 1e-6
        conducts &= lam <= 1e-6 * max(float(np.abs(whole.diodes[name]).max()), 1e-12)
        bar = low + step * (row + 0.35)
        below.fill_between(t, bar, bar + 0.3 * step, where=conducts.tolist(), linewidth=0,
                           color=looks[name]["color"], alpha=0.7)  # fmt: skip
    below.set_ylabel("voltage [V]")
    below.set_xlabel(f"t [{unit}]        bars: the diode conducts")
    for axes in (above, below):
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), handlelength=1.6)


def _frame(axes: Axes, t: Array, values: Array) -> tuple[float, float]:
    """Limits with room for bars at the foot; that foot, and the height of a bar's row."""
    finite = values[np.isfinite(values)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0))
    room = max(high - low, 1e-12)
    foot = low - 0.3 * room
    axes.set_xlim(0.0, t[-1])
    axes.set_ylim(foot, high + 0.06 * room)
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    return foot, 0.07 * room


def _looks(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """A colour for each branch; every second line is dashed, for those that lie on each other."""
    colours = [*(colour for colour in BODIES if colour != "#f0e442"), INK]
    return {
        name: {
            "color": colours[i % len(colours)],
            "linewidth": 1.2,
            "linestyle": "-" if i % 2 == 0 else (0, (4, 2)),
            "zorder": 2 + i % 2,
        }
        for i, name in enumerate(names)
    }
