"""Rigid bodies in contact by Lötstedt's 1984 method, and a fair replay of their QPs.

    import glambda

    run = glambda.simulate("fig4")                             # by our own QP method
    recording = glambda.record("fig4", until=1.0)              # every QP, with its reference
    solver = glambda.make_solver("daqp", accuracy=1e-9)
    verdict = glambda.judge(recording.qps[0], solver.solve(recording.qps[0]).x)

Names are loaded from their packages on first use: `import glambda` itself loads nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from glambda.by_name import load_results as load_results
    from glambda.by_name import record as record
    from glambda.by_name import simulate as simulate
    from glambda.pictures import Picture as Picture
    from glambda.pictures import plot_accuracy as plot_accuracy
    from glambda.pictures import plot_cost as plot_cost
    from glambda.pictures import plot_motion as plot_motion
    from glambda.pictures import plot_outside as plot_outside
    from glambda.pictures import plot_profiles as plot_profiles
    from harness.exchange.certificates import certify as certify
    from harness.exchange.exporting import export as export
    from harness.exchange.importing import import_files as import_files
    from harness.judging.judge import Judgement as Judgement
    from harness.judging.judge import judge as judge
    from harness.recordings.of_qps import recording_from as recording_from
    from harness.recordings.recording import Recording as Recording
    from harness.recordings.recording import read_recording as read_recording
    from harness.recordings.recording import write_recording as write_recording
    from harness.study.replay import replay as replay
    from problems.bodies.bodies import GROUND as GROUND
    from problems.bodies.bodies import Body as Body
    from problems.bodies.bodies import box as box
    from problems.bodies.bodies import disc as disc
    from problems.bodies.bodies import ellipse as ellipse
    from problems.bodies.bodies import polygon_body as polygon_body
    from problems.bodies.forces import Drive as Drive
    from problems.bodies.forces import Force as Force
    from problems.bodies.forces import Gravity as Gravity
    from problems.bodies.forces import Impulse as Impulse
    from problems.bodies.forces import Load as Load
    from problems.bodies.forces import SpringDamper as SpringDamper
    from problems.bodies.forces import Switched as Switched
    from problems.contacts.geometry import HalfPlane as HalfPlane
    from problems.joints.joints import Apart as Apart
    from problems.joints.joints import Blade as Blade
    from problems.joints.joints import Gear as Gear
    from problems.joints.joints import Guide as Guide
    from problems.joints.joints import Pin as Pin
    from problems.joints.joints import Rod as Rod
    from problems.joints.joints import Stop as Stop
    from problems.joints.joints import Weld as Weld
    from problems.qp import ContactQP as ContactQP
    from problems.qp import Solution as Solution
    from problems.qp import Status as Status
    from problems.scenes import Scene as Scene
    from problems.scenes import describe_scene as describe_scene
    from problems.scenes import scene as scene
    from problems.scenes import scene_names as scene_names
    from problems.sequence import SimulationError as SimulationError
    from problems.stepping.run import Run as Run
    from solvers.active_set.sequence import PackedQPs as PackedQPs
    from solvers.active_set.sequence import solve_sequence as solve_sequence
    from solvers.base import Answer as Answer
    from solvers.base import Solver as Solver
    from solvers.base import Start as Start
    from solvers.base import Unsupported as Unsupported
    from solvers.registry import make_solver as make_solver
    from solvers.registry import solver_names as solver_names

HOMES = {
    "glambda.by_name": "load_results record simulate",
    "glambda.pictures": "Picture plot_accuracy plot_cost plot_motion plot_outside plot_profiles",
    "harness.exchange.certificates": "certify",
    "harness.exchange.exporting": "export",
    "harness.exchange.importing": "import_files",
    "harness.judging.judge": "Judgement judge",
    "harness.recordings.of_qps": "recording_from",
    "harness.recordings.recording": "Recording read_recording write_recording",
    "harness.study.replay": "replay",
    "problems.bodies.bodies": "GROUND Body box disc ellipse polygon_body",
    "problems.bodies.forces": "Drive Force Gravity Impulse Load SpringDamper Switched",
    "problems.contacts.geometry": "HalfPlane",
    "problems.joints.joints": "Apart Blade Gear Guide Pin Rod Stop Weld",
    "problems.qp": "ContactQP Solution Status",
    "problems.scenes": "Scene describe_scene scene scene_names",
    "problems.sequence": "SimulationError",
    "problems.stepping.run": "Run",
    "solvers.active_set.sequence": "PackedQPs solve_sequence",
    "solvers.base": "Answer Solver Start Unsupported",
    "solvers.registry": "make_solver solver_names",
}
"""Module → its public names."""
_HOME = {name: module for module, names in HOMES.items() for name in names.split()}
__all__ = sorted([*_HOME, "__version__"])


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib import metadata

        return metadata.version("glambda")
    if name not in _HOME:
        raise AttributeError(f"module 'glambda' has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    return __all__
