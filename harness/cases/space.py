"""Cases in space: numbers of a run beside what mechanics says they are."""

from __future__ import annotations

from math import asin, atan2, cos, hypot, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import ellipk, ellipkinc

from harness.cases.bodies import Found, found, g, observed_order, run_of
from problems.qp import Vector
from problems.sequence import SolvesQPs
from problems.space.attitude import rotations
from problems.space.run import SpaceRun
from problems.space.scenes.top import precession

STEPS = (0.01, 0.005, 0.0025)
STILL = 1e-9
"""What moves less has stopped [m/s], [rad/s]."""


def flips(run: SpaceRun) -> Vector:
    """Times at which a free top turns over [s]: no spin is left about its middle axis.

    From a cubic through the four states around each change of sign.
    """
    R = rotations(run.poses[:, 0, 3:])
    spin = np.einsum("ni,ni->n", run.velocities[:, 0, 3:], R[:, :, 1])
    times = []
    for k in np.flatnonzero(np.sign(spin[1:-2]) != np.sign(spin[2:-1])) + 1:
        near = slice(k - 1, k + 3)
        roots = np.roots(np.polyfit(run.t[near] - run.t[k], spin[near], 3))
        real = roots[np.abs(roots.imag) < 1e-9].real
        times.append(
            run.t[k] + float(real[np.argmin(np.abs(real - (run.t[k + 1] - run.t[k]) / 2))])
        )
    return np.array(times)


class Flips(NamedTuple):
    """Of a free top that starts as `free_top` does [s]."""

    first: float
    interval: float


def euler_flips(
    spin: float, nudge: float, inertia: tuple[float, float, float] = (1.0, 2.0, 2.5)
) -> Flips:
    """By Euler's solution ω₂ = A sn(p t + u₀ | m), which falls to 0 at p t + u₀ = 2 K(m)."""
    J, omega = np.array(inertia), np.array([nudge, spin, nudge])
    L2, T2 = float((J * omega) @ (J * omega)), float(omega @ (J * omega))
    one, two, three = J if T2 * J[1] < L2 else J[::-1]
    fast, slow = (three - two) * (L2 - T2 * one), (two - one) * (T2 * three - L2)
    m, p = slow / fast, sqrt(fast / (one * two * three))
    peak = sqrt((T2 * three - L2) / (two * (three - two)))
    begin = ellipkinc(asin(spin / peak), m)
    return Flips((2 * ellipk(m) - begin) / p, 2 * ellipk(m) / p)


def precession_rate(run: SpaceRun) -> float:
    """Mean rate at which the centre of gravity goes round the vertical [rad/s]."""
    angle = np.unwrap(np.arctan2(run.poses[:, 0, 1], run.poses[:, 0, 0]))
    return float((angle[-1] - angle[0]) / run.t[-1])


def _runs(solver: SolvesQPs, name: str, **parameters: Any) -> list[SpaceRun]:
    return [run_of(solver, name, {"fixed_step": h}, **parameters) for h in STEPS]


def _ordered(quantity: str, values: list[float], exact: float) -> Found:
    """The last value, and the order of the errors."""
    order = observed_order([abs(value - exact) for value in values])
    return found(quantity, values[-1], exact, order)


def free_top(solver: SolvesQPs) -> list[Found]:
    """Energy, momentum, the first flip and the time between two."""
    exact, runs = euler_flips(6.0, 2.0), _runs(solver, "free_top", nudge=2.0, end_time=1.7)
    drift = [float(np.abs(run.energy / run.energy[0] - 1).max()) for run in runs]
    start = runs[-1].momenta[0, 0, 3:]
    turned = np.abs(runs[-1].momenta[:, 0, 3:] - start).max() / np.linalg.norm(start)
    firsts = [float(flips(run)[0]) for run in runs]
    longer = run_of(solver, "free_top", {"fixed_step": STEPS[-1]}, nudge=2.0, end_time=3.7)
    return [
        _ordered("greatest change of energy, relative", drift, 0.0),
        found("greatest change of angular momentum, relative", turned, 0.0),
        _ordered("first flip: (2K(m) − u₀)/p [s]", firsts, exact.first),
        found("time between flips: 2K(m)/p [s]", float(np.diff(flips(longer))[0]), exact.interval),
    ]


def heavy_top(solver: SolvesQPs) -> list[Found]:
    """The rate of steady precession."""
    rates = [precession_rate(run) for run in _runs(solver, "heavy_top", end_time=0.6)]
    exact = precession(40.0, 0.5, 1.0, 0.3, 0.1, 0.2, g)
    return [_ordered("rate of precession [rad/s]", rates, exact)]


def slope(solver: SolvesQPs) -> list[Found]:
    """How far a box slides in 1 s, and how far off the steepest line, whichever way that points."""
    rows, way = [], 0.5 * g * (sin(0.4) - 0.2 * cos(0.4))
    for heading in (0.0, 0.35, 0.8):
        runs = _runs(solver, "slope", heading=heading)
        moved = [run.poses[-1, 0, :3] - run.poses[0, 0, :3] for run in runs]
        ways = [float(np.linalg.norm(each)) for each in moved]
        off = atan2(moved[-1][1], moved[-1][0]) - heading
        rows.append(_ordered(f"way in 1 s, heading {heading:g} [m]", ways, way))
        rows.append(found(f"off the steepest line, heading {heading:g} [rad]", off, 0.0))
    return rows


def skid(solver: SolvesQPs) -> list[Found]:
    """A box that skids to rest: straight on, aside by polygons; and one that also spins."""
    rows, along = [], np.array([cos(0.35), sin(0.35)])
    for faces in (0, 4, 8, 16):
        run = run_of(solver, "skid", {"fixed_step": 0.01}, faces=faces)
        end = 9 / g * along if faces == 0 else end_of_skid(faces, 3.0 * along, 0.5 * g)
        what = f"polygon of {faces}" if faces else "Coulomb's disc"
        for words, way in (("way to rest", along), ("off to the side", along[::-1] * (-1, 1))):
            value = float(run.poses[-1, 0, :2] @ way)
            rows.append(found(f"{words}, {what} [m]", value, float(end @ way)))
    same = {"speed": 3.0, "mu": 0.5, "height": 0.4, "eps": 1e-6}
    how = {"fixed_step": 0.01, "until": 0.5}
    deep = run_of(solver, "skid", how, heading=0.0, **same)
    flat = run_of(solver, "braking", {**how, "stops": "held"}, **same)
    apart = np.abs(deep.poses[:, 0, 0] - flat.q[:, 0, 0]).max()
    rows.append(found("off the motion of the plane's box [m]", apart, 0.0))
    spinning = {"spin": 4.0, "speed": 1.5, "mu": 0.3, "height": 0.1, "heading": 0.0}
    run = run_of(solver, "skid", {"fixed_step": 0.005}, **spinning)
    stops = [
        run.t[int(np.argmax(np.abs(motion) < STILL))]
        for motion in (np.linalg.norm(run.velocities[:, 0, :2], axis=1), run.velocities[:, 0, 5])
    ]
    rest, angle = skid_by_an_ode(1.5, 4.0, 0.3, 0.1)
    far, turned = float(np.linalg.norm(run.poses[-1, 0, :2])), 2 * asin(run.poses[-1, 0, 6])
    return [
        *rows,
        found("ends of slip and spin apart [s]", stops[0] - stops[1], 0.0),
        found("way of a spinning box, beside an ODE [m]", far, rest),
        found("its turn [rad]", turned, angle),
    ]


def end_of_skid(faces: int, v: Vector, a: float) -> Vector:
    """Where a point that a friction polygon brakes comes to rest (2,) [m]; a : μ g [m/s²].

    Along each direction t of the polygon the point is braked by a sin(π/faces) while it moves that
    way, so v̇ is constant until the first of these motions ends, which then is held at 0.
    """
    angles = 2 * np.pi / faces * np.arange(faces // 2)
    t, most = np.column_stack([np.cos(angles), np.sin(angles)]), a * sin(np.pi / faces)
    place = np.zeros(2)
    while np.linalg.norm(v) > STILL:
        signs = np.where(np.abs(t @ v) > STILL, np.sign(t @ v), 0.0)
        brake = -most * signs @ t
        for held in t[signs == 0]:
            brake = brake - held * (held @ brake)
        ends = [-(each @ v) / (each @ brake) for each in t[signs != 0]]
        length = min(time for time in ends if time > 0)
        place, v = place + length * v + 0.5 * length**2 * brake, v + length * brake
    return place


def skid_by_an_ode(speed: float, spin: float, mu: float, height: float) -> tuple[float, float]:
    """Way [m] and turn [rad] to rest of a cube's base of side 1 on its corners, by SciPy.

    The loads of the corners carry weight and the moment of friction with the least sum of squares.
    """
    corners = np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])

    def rate(_: float, state: Vector) -> Vector:
        c, s = cos(state[2]), sin(state[2])
        arms = corners @ np.array([(c, s), (-s, c)])
        slips = state[3:5] + state[5] * np.column_stack([-arms[:, 1], arms[:, 0]])
        pulls = -mu * slips / np.linalg.norm(slips, axis=1, keepdims=True)  # for a load of 1
        balance = np.vstack([np.ones(4), arms.T])
        tips = np.vstack([np.zeros(4), 0.5 * height * pulls.T])
        loads = np.full(4, 0.25 * g)
        for _pass in range(20):
            loads = np.linalg.pinv(balance) @ (np.array([g, 0.0, 0.0]) - tips @ loads)
        forces = pulls * loads[:, None]
        moment = float((arms[:, 0] * forces[:, 1] - arms[:, 1] * forces[:, 0]).sum())
        return np.array([*state[3:], *forces.sum(axis=0), 6 * moment])

    def moving(_: float, state: Vector) -> float:
        return hypot(state[3], state[4], state[5]) - 1e-5

    moving.terminal = True  # type: ignore[attr-defined]
    start = np.array([0.0, 0.0, 0.0, speed, 0.0, spin])
    end = solve_ivp(rate, (0.0, 5.0), start, rtol=1e-9, atol=1e-10, events=moving).y[:, -1]
    return hypot(end[0], end[1]), float(end[2])


def bowl(solver: SolvesQPs) -> list[Found]:
    """A thrown ball rolls at 5/7 of its speed, after a way that is known."""
    runs = _runs(solver, "bowl")
    rolls = 2 * 2.0 / (7 * 0.3 * g)
    way = 2.0 * rolls - 0.5 * 0.3 * g * rolls**2 + (1 - rolls) * 10 / 7
    speed = float(np.linalg.norm(runs[-1].velocities[-1, 0, :2])) / 2.0
    return [
        found("speed when rolling, over the first: 5/7", speed, 5 / 7),
        found("way in 1 s [m]", float(np.linalg.norm(runs[-1].poses[-1, 0, :2])), way),
    ]


def _at_rest(solver: SolvesQPs, name: str) -> list[Found]:
    run = run_of(solver, name, {"fixed_step": 0.01, "until": 1.0})
    return [found("greatest drift in 100 steps [m]", np.abs(run.poses - run.poses[0]).max(), 0.0)]


def space_tower(solver: SolvesQPs) -> list[Found]:
    """A tower of 10 cubes stands."""
    return _at_rest(solver, "space_tower")


def space_pyramid(solver: SolvesQPs) -> list[Found]:
    """A pyramid of 30 cubes stands."""
    return _at_rest(solver, "space_pyramid")
