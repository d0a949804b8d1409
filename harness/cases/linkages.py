"""Cases of joints, limits and forces that switch: beside closed solutions, or fewer coordinates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, inf, pi, radians, sin, sqrt
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from harness.cases.bodies import Found, found, g, observed_order, run_of
from problems import Run, scene, simulate
from problems.joints.tree import allowed_velocities, in_joint_coordinates
from problems.sequence import SolvesQPs
from problems.stepping.restitution import LEAST_BOUNCE

STEPS = (4e-3, 2e-3, 1e-3)
EXACT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
Reading = Callable[[Run], float]


def _reads(body: int, coordinate: int) -> Reading:
    """A coordinate of a body at the end of a run."""
    return lambda run: float(run.q[-1, body, coordinate])


def _with_order(
    solver: SolvesQPs, name: str, quantity: str, read: Reading, expected: float, **how: Any
) -> Found:
    """A number of a run with the last of `STEPS`, and the order over all of them."""
    values = [read(run_of(solver, name, {"fixed_step": h, **how})) for h in STEPS]
    order = observed_order([abs(value - expected) for value in values])
    return found(quantity, values[-1], expected, order)


def slider_crank(solver: SolvesQPs) -> list[Found]:
    """Crank and slider, beside the one freedom θ with ½ J(θ) θ̇² + V(θ) constant."""
    made = scene("slider_crank")
    r, L = 0.3, 1.0
    m, inertia = ([getattr(body, name) for body in made.bodies] for name in ("mass", "inertia"))

    def rod(a: float) -> tuple[float, float]:
        b = -np.arcsin(r * sin(a) / L)
        return b, -r * cos(a) / (L * cos(b))

    def J(a: float) -> float:
        b, rate = rod(a)
        centre = r * np.array([-sin(a), cos(a)]) + rate * L / 2 * np.array([-sin(b), cos(b)])
        slider = -r * sin(a) - rate * L * sin(b)
        turning = m[0] * r * r / 4 + inertia[0] + inertia[1] * rate**2
        return float(turning + m[1] * centre @ centre + m[2] * slider**2)

    def V(a: float) -> float:
        return g * (m[0] * r / 2 * sin(a) + m[1] * (r * sin(a) + L / 2 * sin(rod(a)[0])))

    start, speed = pi / 3, 4.0
    energy = 0.5 * J(start) * speed**2 + V(start)

    def rate(_: float, a: Any) -> list[float]:
        return [sqrt(2 * (energy - V(a[0])) / J(a[0]))]

    exact = float(solve_ivp(rate, (0.0, 1.0), [start], **EXACT).y[0, -1])
    slider = r * cos(exact) + L * cos(rod(exact)[0])
    return [
        _with_order(
            solver, "slider_crank", "angle of the crank after 1 s [rad]",
            _reads(0, 2), exact, until=1.0,
        ),
        _with_order(
            solver, "slider_crank", "place of the slider after 1 s [m]",
            _reads(2, 0), slider, until=1.0,
        ),
    ]  # fmt: skip


def double_pendulum(solver: SolvesQPs) -> list[Found]:
    """Two bars and their stop, beside two angles: free, or one body while the stop is pressed."""
    end, angles = 1.2, _two_bars(1.2)
    rows = [
        _with_order(
            solver, "double_pendulum", f"angle of bar {i + 1} after {end:g} s [rad]",
            _reads(i, 2), angles[i] - pi / 2, until=end,
        )
        for i in range(2)
    ]  # fmt: skip
    run = run_of(solver, "double_pendulum", {"until": end})
    limit = np.abs(run.q[:, 1, 2] - run.q[:, 0, 2]).max() - radians(25.0)
    return [*rows, found("beyond the stop at the most [rad]", max(0.0, float(limit)), 0.0)]


def _two_bars(end: float) -> tuple[float, float]:
    """Their angles to the vertical at the time `end`, in these two coordinates alone."""
    body = scene("double_pendulum").bodies[0]
    m, inertia, length, stop = body.mass, body.inertia, 1.0, radians(25.0)
    own = np.diag([inertia + 1.25 * m * length**2, inertia + 0.25 * m * length**2])
    couple, fold = 0.5 * m * length**2, np.array([-1.0, 1.0])

    def mass(a: Any) -> Any:
        both = couple * cos(a[0] - a[1])
        return own + np.array([[0.0, both], [both, 0.0]])

    def force(a: Any, w: Any) -> Any:
        turn = couple * sin(a[0] - a[1]) * np.array([-(w[1] ** 2), w[0] ** 2])
        return turn - m * g * length * np.array([1.5 * sin(a[0]), 0.5 * sin(a[1])])

    def free(_: float, y: Any) -> Any:
        return [*y[2:], *np.linalg.solve(mass(y[:2]), force(y[:2], y[2:]))]

    def locked(_: float, y: Any) -> Any:
        turn = force(y[:2], y[2:]).sum() / mass(y[:2]).sum()
        return [*y[2:], turn, turn]

    def moment(_: float, y: Any) -> float:
        """Of the stop, along `fold`: what keeps both turning as one."""
        turn = force(y[:2], y[2:]).sum() / mass(y[:2]).sum()
        return float(mass(y[:2])[1].sum() * turn - force(y[:2], y[2:])[1])

    def beyond(_: float, y: Any) -> float:
        return float(stop - abs(y[1] - y[0]))

    for event in (moment, beyond):
        event.terminal = True  # type: ignore[attr-defined]
    beyond.direction = -1  # type: ignore[attr-defined]
    t, y, held = 0.0, np.array([radians(70.0), radians(50.0), 0.0, 0.0]), False
    while t < end:
        motion, watched = (locked, moment) if held else (free, beyond)
        found_ = solve_ivp(motion, (t, end), y, events=watched, **EXACT)
        t, y = float(found_.t[-1]), found_.y[:, -1]
        if t < end and not held:
            push = np.linalg.solve(mass(y[:2]), fold)
            y[2:] -= push * (fold @ y[2:]) / (fold @ push)
        held = not held and moment(t, y) * (y[1] - y[0]) < 0
    return float(y[0]), float(y[1])


def skate(solver: SolvesQPs) -> list[Found]:
    """A knife edge that turns at ω on a slope: v = (g/ω)(cos ωt − 1), a cycloid across it."""
    w, down, t = 2.0, g * sin(radians(10.0)), 2.0
    across = down / w**2 * (w * t / 2 + sin(2 * w * t) / 4 - sin(w * t))
    along = down / w**2 * (sin(w * t) ** 2 / 2 + cos(w * t) - 1)
    return [
        _with_order(
            solver, "skate", f"{name} the slope after 2 s [m]",
            _reads(0, i), value, until=t,
        )
        for i, (name, value) in enumerate((("across", across), ("up", along)))
    ]  # fmt: skip


def bungee(solver: SolvesQPs) -> list[Found]:
    """Free fall for the length of the string, then a swing about where it carries the weight."""
    k, m, fall = 40.0, 1.0, 1.0
    w, speed, t = sqrt(k / m), sqrt(2 * g * fall), 1.0 - sqrt(2 * fall / g)
    sag = m * g / k
    place = -fall - sag + sag * cos(w * t) - speed / w * sin(w * t)
    return [
        _with_order(
            solver, "bungee", "place after 1 s [m]",
            _reads(0, 1), place, until=1.0,
        )
    ]  # fmt: skip


def motor(solver: SolvesQPs) -> list[Found]:
    """Where the force ends, and where the box is when it has coasted."""
    brake = 0.2 * g
    drive = 6.0 - brake
    off = sqrt(2 / drive)
    speed, rest = drive * off, 1.5 - off
    place = 1.0 + speed * rest - 0.5 * brake * rest**2
    switched = run_of(solver, "motor", {})
    at = next(event.t for event in switched.event_log if event.kind == "force_jump")
    return [
        found("time at which the force ends [s]", at, off),
        _with_order(
            solver, "motor", "place after 1.5 s [m]",
            _reads(0, 0), place, until=1.5,
        ),
    ]  # fmt: skip


def frame(solver: SolvesQPs) -> list[Found]:
    """Columns that turn about their feet against one bar that yields at 250 N, under 400 N."""
    column, _, beam = scene("frame").bodies
    J = 2 * (column.inertia + column.mass * 0.45**2) + beam.mass * 0.9**2
    weight = g * (2 * column.mass * 0.45 + beam.mass * 0.9)

    def motion(_: float, y: Any) -> list[float]:
        bar = np.hypot(1.4 + 0.9 * sin(y[0]), 0.9 * cos(y[0]))
        pull = 250.0 * 1.4 * 0.9 * cos(y[0]) / bar
        return [y[1], (400.0 * 0.9 * cos(y[0]) - pull + weight * sin(y[0])) / J]

    def down(_: float, y: Any) -> float:
        return float(y[0] - pi / 2)

    down.terminal = True  # type: ignore[attr-defined]
    after = solve_ivp(motion, (0.0, 0.4), [0.0, 0.0], **EXACT).y[0, -1]
    falls = 0.2 + float(solve_ivp(motion, (0.0, inf), [0.0, 0.0], events=down, **EXACT).t[-1])
    run = run_of(solver, "frame", {})
    struck = next(event.t for event in run.event_log if event.kind == "impulse")
    holds = run_of(solver, "frame", {}, load=200.0)
    return [
        _with_order(
            solver, "frame", "angle of a column after 0.6 s [rad]",
            _reads(0, 2), -float(after), until=0.6,
        ),
        found("time at which the beam strikes the ground [s]", struck, falls),
        found("lean under half the load [rad]", float(np.abs(holds.q[:, 0, 2]).max()), 0.0),
    ]  # fmt: skip


def bounce(solver: SolvesQPs) -> list[Found]:
    """A box that falls flat on the ground with e: its second top, and when it comes to rest."""
    rows, fall = [], sqrt(2 * 1.0 / g)
    for e in (0.5, 0.9):
        run = run_of(solver, "bounce", {"until": fall * (1 + 2 * e)}, restitution=e)
        struck = np.searchsorted(run.t, fall + 1e-6)
        top = float(run.q[struck:, 0, 1].max()) - 0.1
        rows.append(found(f"height after the first impact, e = {e:g} [m]", top, e * e))
    run = run_of(solver, "bounce", {}, restitution=0.5)
    last = [event.t for event in run.event_log if event.kind == "impulse"][-1]
    bounces = sum(g * fall * 0.5**n > LEAST_BOUNCE * run.options["drop_tol"] for n in range(1, 99))
    ended = fall * (1 + 2 * sum(0.5**n for n in range(1, bounces + 1)))
    rows.append(found("time of the last impact, e = 0.5 [s]", last, ended))
    turning = run_of(solver, "bounce", {"until": 1.0}, restitution=0.5, spin=3.0, mu=0.3)
    return [*rows, found("greatest gain at an impact, e = 0.5 [J]", _greatest_gain(turning), 0.0)]


def _greatest_gain(run: Run) -> float:
    """Of kinetic energy where the velocities jump [J], 0 where none rises."""
    mass = np.array([(body.mass, body.mass, body.inertia) for body in run.scene.bodies])
    energy = 0.5 * (mass * run.v**2).sum(axis=(1, 2))
    return float(np.diff(energy)[np.diff(run.t) == 0].max(initial=0.0))


def arm(solver: SolvesQPs) -> list[Found]:
    """Its QPs, and those in joint coordinates."""
    return [_two_forms(solver, "arm", 0.45)]


def human(solver: SolvesQPs) -> list[Found]:
    """Its QPs, and those in joint coordinates."""
    return [_two_forms(solver, "human", 0.3)]


def _two_forms(solver: SolvesQPs, name: str, until: float) -> Found:
    """The largest difference of q̇ between multipliers of the pins and joint coordinates."""
    made, farthest = scene(name), 0.0
    run = simulate(made, solver, until=until)
    place = {float(t): i for i, t in enumerate(run.t)}
    for qp in run.qps:
        if qp.kind != "step" or not qp.accepted or qp.t not in place:
            continue
        exact = replace(qp, eps0=1e-13)
        B = allowed_velocities(made, run.q[place[qp.t]].ravel())
        small, inverse = in_joint_coordinates(exact, B)
        w = inverse @ small.residual(np.asarray(solver.solve(small).x))
        v = exact.residual(np.asarray(solver.solve(exact).x)) / exact.D
        farthest = max(farthest, float(np.abs(B @ w - v).max()) * qp.h / qp.alpha0)
    return found("multipliers or joint coordinates, q̇ apart [m/s, rad/s]", farthest, 0.0)
