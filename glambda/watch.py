"""A window on a simulation while it runs (§5): pause, step, look at a QP, change J_N by hand.

`Watch` holds the stepper, and its methods are what keys do; `show` joins them to a window.  Without
a window they are called one by one, as tests do.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from problems import Scene
from problems.formulas.multistep import SHORTEST_STEP
from problems.sequence import SolvesQPs
from problems.stepping.options import StepperOptions
from problems.stepping.stepper import Stepper
from reports.motions.frames import draw_bodies, window_of
from reports.motions.motion import Motion, motion_of
from reports.parts.style import INK, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import KeyEvent

FRAME = 1 / 30
"""Seconds between two pictures."""
KEYS = {
    " ": "pause",
    "right": "step",
    "up": "faster",
    "down": "slower",
    "a": "arrows",
    "s": "save",
    "d": "drop",
    "i": "introduce",
}
"""Key → method of `Watch`."""
HELP = "space pause · → step · ↑↓ speed · a λ · s save QP · tab choose · d drop · i introduce"


@final
class Watch:
    """A simulation that is looked at.

    paused, speed : whether it goes on by itself, and seconds of motion in one second
    shows_arrows : whether λ is drawn;  chosen : place in J_N of the constraint to be dropped
    said : what the last key did
    """

    def __init__(self, scene: Scene, solver: SolvesQPs, folder: Path = Path()) -> None:
        self.scene, self.folder = scene, folder
        self.stepper = Stepper(scene, solver, StepperOptions.of(scene.eps))
        self.stepper.start()
        self.paused, self.speed, self.shows_arrows, self.chosen = True, 1.0, True, 0
        self.said = "paused"

    @property
    def system(self) -> Any:
        """State and constraints of the simulation."""
        return self.stepper.system

    def tick(self) -> None:
        """What happens between two pictures."""
        end = self.system.t + self.speed * FRAME
        while not self.paused and self.system.t < end - SHORTEST_STEP:
            self.stepper.advance(end)

    def pause(self) -> None:
        self.paused = not self.paused
        self.said = "paused" if self.paused else "runs"

    def step(self) -> None:
        """To the next event, or by the longest step."""
        self.paused = True
        self.stepper.advance(self.system.t + self.stepper.system.options.h_max)
        self.said = f"{self.system.counts['steps']} steps"

    def faster(self) -> None:
        self.speed *= 2.0
        self.said = f"{self.speed:g} × as fast"

    def slower(self) -> None:
        self.speed /= 2.0
        self.said = f"{self.speed:g} × as fast"

    def arrows(self) -> None:
        self.shows_arrows = not self.shows_arrows

    def choose(self) -> None:
        """The next constraint of J_N."""
        self.chosen += 1

    def save(self) -> Path | None:
        """Write the last QP as A, b, lb, ub, row_id, which `glambda import` reads."""
        if not self.system.qps.qps:
            self.said = "no QP has been posed yet"
            return None
        qp = self.system.qps.qps[-1]
        path = self.folder / f"{self.scene.name}_{self.system.qps.count}.npz"
        np.savez(path, A=qp.dense_A, b=-qp.d, lb=qp.lower, ub=qp.upper, row_id=qp.row_id)
        self.said = f"{path}: a {qp.kind} QP with {qp.k} columns"
        return path

    def drop(self) -> None:
        """Take the chosen constraint out of J_N; what still presses is found again as a hit."""
        active = self.system.graph.active()
        if not active:
            self.said = "no constraint is active"
            return
        normal = active[self.chosen % len(active)]
        self.said = f"dropped: {self.system.place_name(normal.place)}"
        self.system.graph.remove(normal, self.system.clearance(self.system.pose(), normal))
        self.stepper.transitions.restart(0)

    def introduce(self) -> None:
        """Put the nearest corner and edge that approach into J_N: they approach no further."""
        graph, pose = self.system.graph, self.system.pose()
        near = graph.candidates
        free = np.flatnonzero(near.free)
        if not free.size:
            self.said = "no corner is near an edge"
            return
        phi = graph.geometry.clearance(pose, near.corner[free], near.part[free])
        for i in free[np.argsort(phi)].tolist():
            corner, part = int(near.corner[i]), int(near.part[i])
            made = graph.insert(pose, corner, part, graph.geometry.hit_edge(pose, corner, part))
            if made is None:
                continue
            self.stepper.transitions.impulse([], np.zeros_like(self.system.q))
            if made.row_id in graph.normals:  # those that separate are dropped at once
                self.said = f"introduced: {self.system.place_name(made.place)}"
                return
        self.said = "nothing that is near approaches"

    def press(self, key: str) -> None:
        """What a key does, if anything."""
        if key == "tab":
            self.choose()
        elif key in KEYS:
            getattr(self, KEYS[key])()

    def motion(self) -> Motion:
        """The bodies as they are."""
        q, v = (x.reshape(1, -1, 3).copy() for x in (self.system.q, self.system.history.v))
        return motion_of(SimpleNamespace(scene=self.scene, t=np.array([self.system.t]), q=q, v=v))

    def draw(self, axes: Axes) -> None:
        """The bodies, λ as arrows, and what is said."""
        motion = self.motion()
        axes.clear()
        window = window_of(motion, [motion.q[0]])
        draw_bodies(axes, motion, motion.q[0], window)
        axes.set_aspect("equal")
        axes.set_title(f"{self.scene.label}  t = {self.system.t:.4f} s   {self.said}", size=9)
        if self.shows_arrows:
            self._draw_arrows(axes, 0.25 * window.height)

    def _draw_arrows(self, axes: Axes, longest: float) -> None:
        """λ_N at its corner along the normal; the chosen constraint in red."""
        assembly = self.system.assembly()
        active, pose = assembly.active, assembly.pose
        largest = max(float(active.lam[0].max(initial=0.0)), 1e-12)
        for i, normal in enumerate(active.normals):
            outward = assembly.columns.normal[i, :2]
            x, y = self.system.graph.geometry.touched(pose, normal.corner, outward)
            dx, dy = longest * active.lam[0][i] / largest * outward
            colour = VERMILLION if i == self.chosen % len(active.normals) else INK
            axes.plot(x, y, marker="o", markersize=4, color=colour, zorder=6)
            axes.annotate("", xy=(x + dx, y + dy), xytext=(x, y), zorder=6,
                          arrowprops={"arrowstyle": "-|>", "color": colour})  # fmt: skip


def _pressed(watch: Watch) -> Callable[[KeyEvent], None]:
    def press(event: KeyEvent) -> None:
        watch.press(event.key or "")

    return press


def show(watch: Watch) -> Callable[[], None]:
    """Open a window whose keys are `KEYS`, until it is closed; returns what redraws it."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    figure.text(0.5, 0.01, HELP, ha="center", size=8)

    def redraw() -> None:
        watch.tick()
        watch.draw(axes)
        figure.canvas.draw_idle()

    handler = getattr(figure.canvas.manager, "key_press_handler_id", None)
    if handler is not None:
        figure.canvas.mpl_disconnect(handler)  # matplotlib's own s would save the figure
    figure.canvas.mpl_connect("key_press_event", _pressed(watch))
    timer = figure.canvas.new_timer(interval=round(1000 * FRAME))
    timer.add_callback(redraw)
    timer.start()
    redraw()
    plt.show()
    timer.stop()
    return redraw
