"""Newton–Coulomb impulses, by the laws that they must obey and beside the paper's model."""

from __future__ import annotations

import numpy as np
import pytest

from problems import Scene, scene, simulate
from problems.assembly import Assembly
from problems.bodies import box
from problems.sequence import SolvesQPs
from problems.stepper import Stepper, StepperOptions
from solvers import make_solver

MU_I = 0.4


def falling_box(vx: float, spin: float, angle: float) -> Scene:
    """A box whose lowest corner touches the ground and approaches it."""
    body = box(2.0, 1.0)
    c, s = np.cos(angle), np.sin(angle)
    height = -(body.polygons[0] @ np.array([s, c])).min()
    return Scene(
        bodies=(body,),
        q0=np.array([[0.0, height, angle]]),
        v0=np.array([[vx, -1.0, spin]]),
        mu=MU_I,
        mu_I=MU_I,
    )


def after_collision(made: Scene, rule: str, solver: SolvesQPs) -> tuple[np.ndarray, Assembly]:
    options = StepperOptions(1e-3, 1e-3, rest_speed=1e-3, impulses=rule)  # type: ignore[arg-type]
    stepper = Stepper(made, solver, options)
    stepper.start()
    return stepper.history.v, Assembly(stepper.graph, stepper.q)


@pytest.mark.parametrize("vx", [-3.0, -0.2, 0.0, 0.5, 3.0])
@pytest.mark.parametrize("spin", [-1.0, 0.0, 2.0])
def test_the_laws_hold_at_one_corner(vx: float, spin: float) -> None:
    made = falling_box(vx, spin, angle=0.3)
    v, assembly = after_collision(made, "newton_coulomb", make_solver("lotstedt"))
    if not assembly.normals:
        return  # the corner did not approach
    M = np.array([2.0, 2.0, made.bodies[0].inertia])
    change = M * (v - made.v0.ravel())
    G = np.column_stack([assembly.G_N.toarray(), assembly.G_F.toarray()])
    normal, tangent = np.linalg.lstsq(G, change, rcond=None)[0]
    np.testing.assert_allclose(G @ [normal, tangent], change, atol=1e-9)
    slip = float((assembly.G_F.T @ v)[0])
    assert normal > 0 and abs(float((assembly.G_N.T @ v)[0])) < 1e-9
    assert abs(tangent) <= MU_I * normal * (1 + 1e-9)
    if abs(slip) > 1e-6:
        assert tangent == pytest.approx(-np.sign(slip) * MU_I * normal)


def test_both_models_agree_where_contacts_stick() -> None:
    made, solver = falling_box(vx=0.0, spin=0.0, angle=0.0), make_solver("lotstedt")
    paper, _ = after_collision(made, "paper", solver)
    newton, _ = after_collision(made, "newton_coulomb", solver)
    np.testing.assert_allclose(newton, paper, atol=1e-9)


def test_a_sliding_contact_bounces_in_the_paper_s_model_alone() -> None:
    made, solver = falling_box(vx=3.0, spin=0.0, angle=0.0), make_solver("lotstedt")
    newton, _ = after_collision(made, "newton_coulomb", solver)
    paper, _ = after_collision(made, "paper", solver)
    assert abs(newton[1]) < 1e-9 < 0.1 < paper[1]
    assert paper[1] == pytest.approx(MU_I * paper[0])


def test_the_motion_of_fig5_does_not_depend_on_the_model_and_that_of_fig4_does() -> None:
    solver, ends = make_solver("lotstedt"), {}
    for name, until in (("fig4", 0.8), ("fig5", 1.0)):
        made = scene(name, mu_I=0.8)
        runs = [
            simulate(made, solver, until=until, impulses=rule)
            for rule in ("paper", "newton_coulomb")
        ]
        ends[name] = float(np.abs(runs[0].q[-1] - runs[1].q[-1]).max())
    assert ends["fig5"] < 1e-6
    assert ends["fig4"] > 1e-3


def test_an_unknown_model_is_refused() -> None:
    with pytest.raises(ValueError, match="newton_coulomb"):
        simulate(scene("fig5"), make_solver("lotstedt"), impulses="newton")  # type: ignore[arg-type]
