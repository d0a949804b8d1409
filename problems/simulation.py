"""`simulate`: whatever a scene is made of, bodies of the plane or in space, or a network."""

from __future__ import annotations

from typing import Any, overload

from problems.networks.network import Network
from problems.networks.run import NetworkRun
from problems.networks.stepper import simulate as simulate_network
from problems.scenes.scene import Scene
from problems.sequence import SolvesQPs
from problems.space.run import SpaceRun
from problems.space.scene import SpaceScene
from problems.space.stepper import simulate as simulate_in_space
from problems.stepping.run import Run
from problems.stepping.stepper import simulate as simulate_bodies


@overload
def simulate(scene: Scene, solver: SolvesQPs, **how: Any) -> Run: ...
@overload
def simulate(scene: Network, solver: SolvesQPs, **how: Any) -> NetworkRun: ...
@overload
def simulate(scene: SpaceScene, solver: SolvesQPs, **how: Any) -> SpaceRun: ...
def simulate(
    scene: Scene | Network | SpaceScene, solver: SolvesQPs, **how: Any
) -> Run | NetworkRun | SpaceRun:
    """Simulate a scene with `solver` in the loop, to its end time or rest.

    how : eps, until, keep_qps, progress and settings, see `problems.stepping.stepper.simulate`,
        `problems.networks.stepper.simulate` and `problems.space.stepper.simulate`
    """
    if isinstance(scene, SpaceScene):
        return simulate_in_space(scene, solver, **how)
    if isinstance(scene, Network):
        return simulate_network(scene, solver, **how)
    return simulate_bodies(scene, solver, **how)
