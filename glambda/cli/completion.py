"""What a shell may complete: names of scenes and solvers, after `glambda --install-completion`."""

from __future__ import annotations


def complete_scenes(incomplete: str) -> list[str]:
    """Scenes whose names begin like this."""
    from problems.scenes.registry import scene_names

    return [name for name in scene_names() if name.startswith(incomplete)]


def complete_solvers(incomplete: str) -> list[str]:
    """The same of solvers; of a list with commas between, its last name is completed."""
    from solvers.registry import solver_names

    before, comma, last = incomplete.rpartition(",")
    return [f"{before}{comma}{name}" for name in solver_names() if name.startswith(last)]
