"""Newton–Coulomb impulses, by the laws that they must obey and beside the paper's model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from problems import Scene, scene, simulate
from problems.bodies.bodies import box, polygon_body
from problems.contacts.assembly import Assembly
from problems.friction.impulses import solve_impulse
from problems.sequence import SolvesQPs
from problems.stepping.stepper import Stepper, StepperOptions
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
    return stepper.system.history.v, Assembly(stepper.system.graph, stepper.system.q)


@pytest.mark.parametrize("vx", [-3.0, -0.2, 0.0, 0.5, 3.0])
@pytest.mark.parametrize("spin", [-1.0, 0.0, 2.0])
def test_the_laws_hold_at_one_corner(vx: float, spin: float) -> None:
    made = falling_box(vx, spin, angle=0.3)
    v, assembly = after_collision(made, "newton_coulomb", make_solver("glambda"))
    assert assembly.normals
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
    made, solver = falling_box(vx=0.0, spin=0.0, angle=0.0), make_solver("glambda")
    paper, _ = after_collision(made, "paper", solver)
    newton, _ = after_collision(made, "newton_coulomb", solver)
    np.testing.assert_allclose(newton, paper, atol=1e-9)


def test_a_sliding_contact_bounces_in_the_paper_s_model_alone() -> None:
    made, solver = falling_box(vx=3.0, spin=0.0, angle=0.0), make_solver("glambda")
    newton, _ = after_collision(made, "newton_coulomb", solver)
    paper, _ = after_collision(made, "paper", solver)
    assert abs(newton[1]) < 1e-9 < 0.1 < paper[1]
    assert paper[1] == pytest.approx(MU_I * paper[0])


def test_the_motion_of_fig5_does_not_depend_on_the_model_and_that_of_fig4_does() -> None:
    solver, ends = make_solver("glambda"), {}
    for name, until in (("fig4", 0.8), ("fig5", 1.0)):
        made = scene(name, mu_I=0.8)
        runs = [
            simulate(made, solver, until=until, impulses=rule)
            for rule in ("paper", "newton_coulomb")
        ]
        ends[name] = float(np.abs(runs[0].q[-1] - runs[1].q[-1]).max())
    assert ends["fig5"] < 1e-6
    assert ends["fig4"] > 1e-3


@pytest.mark.parametrize("keep", [True, False])
def test_coulomb_s_law_holds_where_a_contact_bears_no_load_at_first(
    keep: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the second pass the λ_* of one contact is rounding."""
    corners = [(0.10947906629022724, 0.6547654531911578)]
    corners += [(-0.5797060318034836, -0.18391476320522984)]
    corners += [(0.47022696551325627, -0.4708506899859279)]
    q0 = [[0.3099667043331453, 0.6664425379820781, np.pi / 2]]
    q0 += [
        [-0.4883864057544748, 2.332897575886032, 0.0],
        [0.29143838801837985, 3.475331432045218, 0.0],
    ]
    v0 = [[-0.6828450043327754, -0.8040304902063203, 0.39154925112121997]]
    v0 += [[0.1993349329781018, -0.36834064540481737, 0.6861675079770544], [0.0, 0.0, 0.0]]
    plates = Scene(
        bodies=(polygon_body(corners), box(2.0, 0.01, 20.0), box(0.2, 0.2)),
        q0=np.array(q0),
        v0=np.array(v0),
        mu=1.2,
        mu_I=0.5,
        end_time=0.6,
    )
    laws = []

    def watched(qps: object, assembly: Assembly, *rest: Any) -> tuple[np.ndarray, np.ndarray]:
        v, impulse = solve_impulse(qps, assembly, *rest)  # type: ignore[arg-type]
        N, slip = len(assembly.normals), assembly.slip_speed(v)
        bound = plates.mu_I / assembly.mu * assembly.bound(impulse[:N])
        slides = np.abs(slip) > 1e-6
        laws.extend(impulse[N:][slides] + np.sign(slip[slides]) * bound[slides])
        return v, impulse

    monkeypatch.setattr("problems.stepping.transitions.solve_impulse", watched)
    simulate(plates, make_solver("glambda"), impulses="newton_coulomb", keep_qps=keep)
    assert len(laws) >= 3
    np.testing.assert_allclose(laws, 0.0, atol=1e-8)


def test_an_unknown_model_is_refused() -> None:
    with pytest.raises(ValueError, match="newton_coulomb"):
        simulate(scene("fig5"), make_solver("glambda"), impulses="newton")  # type: ignore[arg-type]


def test_a_whole_number_is_a_coefficient_too():
    """Compiled collisions read numbers by their type: μ_I = 1 must be no other than 1.0."""
    runs = [
        simulate(
            replace(scene("fig4"), mu_I=mu_I),
            make_solver("glambda"),
            impulses="newton_coulomb",
            keep_qps=False,
            until=0.5,
        )
        for mu_I in (0.01, 1.0, 1)
    ]
    np.testing.assert_array_equal(runs[2].q, runs[1].q)
    assert (runs[1].q[-1] != runs[0].q[-1]).any()
