"""`glambda watch`: a window on a simulation while it runs."""

from __future__ import annotations

from glambda.cli.app import SceneName, Sets, app, scene_of_bodies, told


@app.command()
@told
def watch(
    scene: SceneName,
    settings: Sets = None,
) -> None:
    """Watch a scene in a window: pause, step, save a QP, drop or introduce a constraint.

    Keys: space pauses, → takes a step, ↑ and ↓ set the speed, a shows λ, s saves the last QP, tab
    chooses a constraint, d drops it, i introduces the nearest.

    Example:  glambda watch fig4
    """
    from glambda.watch import Watch, show
    from solvers import make_solver

    made = scene_of_bodies(scene, settings, "which has no bodies to watch; simulate it")
    show(Watch(made, make_solver("glambda")))
