"""Networks with diodes against closed solutions: values, times of events, order 2."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from problems import Status, scene, simulate
from problems.networks import Branch, Constant, Network, Pulses, Sine
from problems.networks.run import NETWORK_EVENTS, NetworkRun
from problems.qp import Vector
from problems.sequence import SimulationError
from solvers import make_solver

OMEGA = 2 * np.pi * 50.0


def run(name: str, how: dict[str, float] | None = None, **parameters: float) -> NetworkRun:
    return simulate(scene(name, **parameters), make_solver("glambda"), **(how or {}))


def order(errors: list[float]) -> float:
    """Observed from errors at steps that were halved each time."""
    return float(np.log2(np.array(errors[:-1]) / np.array(errors[1:])).mean())


def sine_response(
    t: Vector, R: float, L: float, i0: float = 0.0, amplitude: float = 100.0
) -> Vector:
    """i of L di/dt + R i = amplitude sin ωt from i0 at t = 0."""
    Z, phi = np.hypot(R, OMEGA * L), np.arctan2(OMEGA * L, R)
    steady = amplitude / Z
    decay = np.exp(-R * np.asarray(t) / L)
    return steady * np.sin(OMEGA * np.asarray(t) - phi) + (i0 + steady * np.sin(phi)) * decay


def extinction(R: float = 10.0, L: float = 0.05) -> float:
    """The time at which the current of the half wave ceases [s]."""
    return float(brentq(lambda t: sine_response(t, R, L), 1.01 * np.pi / OMEGA, 0.0199))


def test_the_half_wave_has_its_closed_solution_to_second_order():
    at, worst, angles = extinction(), [], []
    for h in (1e-4, 5e-5, 2.5e-5):
        found = run("half_wave", {"fixed_step": h}, end_time=0.039)
        t = found.t % 0.02
        exact = np.where(t < at, sine_response(t, 10.0, 0.05), 0.0)
        worst.append(float(np.abs(found.currents[:, 0] - exact).max()))
        stops = [event.t for event in found.event_log if event.kind == "blocks"]
        assert len(stops) == 2
        angles.append(abs(OMEGA * (stops[0] - at)))
    assert order(worst) == pytest.approx(2.0, abs=0.1)
    assert order(angles) == pytest.approx(2.0, abs=0.1)
    assert worst[-1] < 5e-4 and angles[-1] < 2e-5


def test_a_blocked_diode_bears_the_source_and_none_of_its_own_current():
    found = run("half_wave", end_time=0.02)
    blocked = found.t > extinction() + 1e-4
    voltage = [-scene("half_wave").voltages(t)[0] for t in found.t[blocked]]
    np.testing.assert_allclose(found.diode_voltages[blocked, 0], voltage, atol=1e-8)
    assert (found.currents[blocked, 0] <= 1e-10).all()
    assert (found.currents * found.diode_voltages)[1:] == pytest.approx(0.0, abs=1e-8)


def bridge_current(t: float, R: float = 10.003, L: float = 0.5, i0: float = 6.0) -> float:
    """Of the load, which sees |v|; three diode resistances are in series with it."""
    halves = int(t // 0.01)
    for _ in range(halves):
        i0 = float(sine_response(0.01, R, L, i0))
    return float(sine_response(t - 0.01 * halves, R, L, i0))


def test_the_bridge_hands_the_current_over_and_is_of_second_order():
    errors = []
    for h in (2e-4, 1e-4, 5e-5):
        found = run("bridge", {"fixed_step": h}, end_time=0.035)
        exact = [bridge_current(t) for t in found.t]
        errors.append(float(np.abs(found.currents[:, 5] - exact).max()))
    assert order(errors) == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 5e-4
    d1, d2 = found.currents[:, 1], found.currents[:, 2]
    np.testing.assert_allclose((d1 + d2)[1:], found.currents[1:, 5], atol=1e-9)
    stops = [event.t for event in found.event_log if event.kind == "blocks"]
    np.testing.assert_allclose(np.unique(np.round(stops, 6)), [0.01, 0.02, 0.03], atol=1e-5)


def test_a_bridge_with_a_large_inductance_has_the_mean_of_a_rectified_sine():
    level = 200 / np.pi / 10.003
    found = run("bridge", L=5.0, current=level, end_time=0.04)
    load = found.currents[:, 5]
    mean = np.trapezoid(load, found.t) / found.t[-1]
    assert mean == pytest.approx(level, rel=0.01)  # it is still on its way to the steady ripple
    assert np.ptp(load) < 0.05 * level


def boost_cycle(duty: float = 0.5, loss: float = 0.02) -> tuple[Vector, float]:
    """Steady i, u at the beginning of a period, and the mean of u, by matrix exponentials."""
    L, C, load, period = 1e-3, 20e-6, 20.0, 1 / 20e3
    leak = -1 / (load * C)
    on = np.array([[-loss / L, 0, 12 / L], [0, leak, 0], [0, 0, 0]])
    off = np.array([[-loss / L, -1 / L, 12 / L], [1 / C, leak, 0], [0, 0, 0]])
    times = (on, duty * period), (off, (1 - duty) * period)
    whole = expm(off * times[1][1]) @ expm(on * times[0][1])
    x = np.linalg.solve(np.eye(2) - whole[:2, :2], whole[:2, 2])
    state, mean = np.r_[x, 1.0], 0.0
    for matrix, length in times:
        piece = expm(matrix * length / 400)
        for _ in range(400):
            mean += 0.5 * (state[1] + (piece @ state)[1]) * length / 400 / period
            state = piece @ state
    return x, mean


@pytest.mark.parametrize("duty", [0.3, 0.5])
def test_the_boost_converter_raises_the_voltage_as_its_duty_asks(duty: float):
    steady, mean = boost_cycle(duty)
    found = run("boost", duty=duty, current=steady[0], output=steady[1], end_time=1e-3)
    h, u = np.diff(found.t), found.potentials[1:, 1]
    assert float(h @ u) / found.t[-1] == pytest.approx(mean, rel=1e-3)
    assert mean == pytest.approx(12 / (1 - duty), rel=0.01)
    assert (found.currents[:, 0] > 0).all()  # continuous conduction


def test_the_boost_converter_comes_to_its_steady_cycle_and_is_of_second_order():
    (i, u), _ = boost_cycle()
    late = run("boost", end_time=8e-3)
    assert late.currents[-1, 0] == pytest.approx(i, rel=0.02)
    errors = []
    for h in (2e-6, 1e-6, 5e-7):
        found = run("boost", {"fixed_step": h}, current=i, output=u, end_time=5e-4)
        errors.append(abs(found.currents[-1, 0] - i) + abs(found.charges[-1, 3] / 20e-6 - u))
    assert order(errors) == pytest.approx(2.0, abs=0.15)


def test_a_light_load_lets_the_current_cease_within_a_period():
    found = run("boost", load=2000.0, output=40.0, end_time=1e-3)
    assert {event.kind for event in found.event_log} == set(NETWORK_EVENTS)
    assert found.currents[:, 2].min() > -1e-9 and (found.currents[:, 0] < 1e-6).any()


def test_currents_meet_kirchhoff_and_energy_is_lost_in_resistances_alone():
    network = Network(
        (
            Branch(0, 1, L=0.1, R=1.0, current=1.0),
            Branch(1, 0, C=1e-3, voltage=5.0),
            Branch(1, 0, R=50.0),
        ),
        h_max=1e-4,
        end_time=0.05,
    )
    found = simulate(network, make_solver("glambda"), fixed_step=2.5e-5)
    np.testing.assert_allclose((found.currents @ network.incidence())[1:], 0.0, atol=1e-9)
    i, q = found.currents, found.charges
    stored = 0.5 * (0.1 * i[:, 0] ** 2 + q[:, 1] ** 2 / 1e-3)
    lost = np.trapezoid((i[1:] ** 2) @ network.array("R"), found.t[1:])
    assert stored[1] - stored[-1] == pytest.approx(lost, rel=1e-3)


def test_every_solver_is_handed_the_same_qps():
    ours = run("bridge", end_time=0.012)
    theirs = simulate(scene("bridge", end_time=0.012), make_solver("quadprog"))
    assert len(ours.qps) == len(theirs.qps)
    np.testing.assert_allclose(ours.currents, theirs.currents, atol=1e-6)
    assert all(solution.status is Status.SOLVED for solution in ours.solutions)
    taken = [qp for qp in ours.qps if qp.accepted]
    assert len(taken) == ours.counts["steps"] == len(ours.t) - 1
    assert [qp.t for qp in taken] == ours.t[1:].tolist()
    assert sum(qp.restart for qp in ours.qps) == ours.counts["restarts"] + 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Branch(0, 1), "L = 0, R = 0 and no C"),
        (lambda: Branch(0, 1, L=-1.0), "L"),
        (lambda: Branch(0, 1, R=1.0, voltage=2.0), "there is none"),
        (lambda: Branch(-1, 1, R=1.0), "count from 0"),
        (lambda: Network((Branch(0, 1, R=1.0),), 1e-3), "end at node"),
        (lambda: Network((), 1e-3), "at least one"),
        (lambda: Network((Branch(0, 0, R=1.0),), 0.0), "h_max"),
        (lambda: Pulses(0.0, 0.5), "period"),
        (lambda: Pulses(1.0, 1.0), "duty"),
    ],
)
def test_what_is_no_network_is_refused(make, words: str):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize("option", [{"friction": "paper"}, {"drift": "projection"}])
def test_options_about_contacts_are_refused(option: dict[str, str]):
    with pytest.raises(ValueError, match="about contacts of bodies"):
        simulate(scene("half_wave"), make_solver("glambda"), **option)


def test_a_solver_that_gives_no_answer_ends_the_simulation():
    class Mute:
        def solve(self, qp, start=None):
            raise RuntimeError("no")

    with pytest.raises(SimulationError, match="step QP with 1 columns"):
        simulate(scene("half_wave"), Mute())


def test_pulses_keep_the_value_before_a_jump_until_it():
    pulses = Pulses(1e-4 / 3, 0.3, high=5.0, low=-1.0)
    for edge in pulses.jumps(1e-2):
        before, at, after = (
            pulses.value(t) for t in (edge * (1 - 1e-12), edge, edge * (1 + 1e-12))
        )
        assert before == at != after
    assert Constant(2.0).jumps(1.0) == Sine(1.0, 50.0).jumps(1.0) == []


@pytest.mark.skipif(shutil.which("ngspice") is None, reason="ngspice is not installed")
def test_ngspice_agrees_on_the_half_wave(tmp_path: Path):
    netlist = tmp_path / "half_wave.cir"
    netlist.write_text(
        "half wave\nV1 1 0 SIN(0 100 50)\nR1 1 2 10\nL1 2 3 50m\nD1 3 0 ideal\n"
        ".model ideal D(N=0.05 IS=1e-9)\n.tran 10u 39m 0 10u\n.print tran i(L1)\n.end\n"
    )  # this diode drops 0.03 V
    said = subprocess.run(
        ["ngspice", "-b", str(netlist)], check=True, capture_output=True, text=True, timeout=60
    ).stdout
    rows = [line.split() for line in said.splitlines() if re.match(r"\d+\t", line)]
    t, i = np.array(rows, dtype=float)[:, 1:].T
    ours = run("half_wave", {"fixed_step": 2.5e-5}, end_time=0.039)
    theirs = np.interp(ours.t, t, i)
    assert theirs.max() > 6.0
    np.testing.assert_allclose(ours.currents[:, 0], theirs, atol=0.01)
