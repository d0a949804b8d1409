"""What a simulation starts from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import sqrt
from typing import Any, TypeVar

import numpy as np

from problems.bodies.bodies import GROUND, Body
from problems.bodies.checks import check_body
from problems.bodies.forces import Force, Gravity, Impulse
from problems.contacts.geometry import HalfPlane
from problems.joints.joints import Joint
from problems.qp import Vector
from problems.short import Short

MOST_BODIES = 20_000
"""Of bricks and boxes: so many have been stepped in less than a gigabyte."""
MOST_POLYGONS, MOST_CORNERS = 10_000, 100
"""Of polygons, which touch any of their neighbours, and of the corners of each."""

Maker = TypeVar("Maker", bound=Callable[..., Any])


def at_most(**limits: float) -> Callable[[Maker], Maker]:
    """Declare the largest values of parameters of a scene, by name: those that cost memory.

    `problems.scene` refuses larger ones before it calls the function that is decorated.
    """

    def declare(maker: Maker) -> Maker:
        maker.at_most = limits  # type: ignore[attr-defined]
        return maker

    return declare


def default_eps(bodies: Sequence[Body]) -> float:
    """ε = 1e-3, or less where all bodies together weigh less than 1 kg: 1e-3 √Σm.

    What ε bounds in (3.5) is ‖δq‖_M (2.19), which grows with the root of the mass: without that,
    grams would be stepped so coarsely that T + V rises by thousandths.
    """
    return 1e-3 * min(1.0, sqrt(sum(body.mass for body in bodies)))


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Short):
    """Bodies, their initial state, and everything that acts on them.

    bodies : the bodies, numbered from 1 in everything that people read
    q0, v0 : (n, 3) initial positions and velocities [m, m, rad], per second
    ground : half planes that do not move
    joints : what connects bodies, see `problems.joints.joints`
    forces : beside gravity;  impulses : external, at given times
    mu : friction coefficient;  mu_pairs : of particular pairs (body numbers from 1, 0 the ground)
    mu_I : impulse friction coefficient, of contacts with mu > 0 (§5);  gravity : [m/s²]
    restitution, restitution_pairs : coefficient from 0, plastic, to 1, of all and particular pairs
    eps : ε, by default `default_eps`
    end_time : [s];  stop_at_rest : end as soon as everything has been still for a while
    name, parameters : the function that made it and all its named parameters

    Raises ValueError, naming the field, for wrong shapes, NaN, negative coefficients or a force on
    a body that there is not.
    """

    bodies: tuple[Body, ...]
    q0: Vector
    v0: Vector
    ground: tuple[HalfPlane, ...] = (HalfPlane(),)
    joints: tuple[Joint, ...] = ()
    forces: tuple[Force, ...] = ()
    impulses: tuple[Impulse, ...] = ()
    mu: float = 0.0
    mu_pairs: Mapping[tuple[int, int], float] = field(default_factory=dict)
    mu_I: float = 0.0
    restitution: float = 0.0
    restitution_pairs: Mapping[tuple[int, int], float] = field(default_factory=dict)
    gravity: float = 9.81
    eps: float = None  # type: ignore[assignment]
    end_time: float = 1.0
    stop_at_rest: bool = False
    name: str = "scene"
    label: str = ""
    parameters: Mapping[str, float | int | bool | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.bodies)
        if n == 0:
            raise ValueError("a scene needs at least one body")
        for name in ("q0", "v0"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.shape != (n, 3):
                raise ValueError(f"{name} needs shape {(n, 3)} for {n} bodies; got {value.shape}")
            if not np.isfinite(value).all():
                raise ValueError(f"{name} holds NaN or an infinity")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        for acting in (*self.forces, *self.impulses):
            check_body(type(acting).__name__, getattr(acting, "body", 0), n)
        for joint in self.joints:
            for body in (joint.body, joint.other):
                if body != GROUND:
                    check_body(type(joint).__name__, body, n)
        if self.eps is None:
            object.__setattr__(self, "eps", default_eps(self.bodies))
        for name in ("mu", "mu_I", "restitution", "gravity", "eps", "end_time"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise ValueError(f"{name} = {value!r}; it must be a finite number, not negative")
            object.__setattr__(self, name, float(value))
        for name, most in (("mu", np.inf), ("restitution", 1.0)):
            if not getattr(self, name) <= most:
                raise ValueError(f"{name} = {getattr(self, name):g}; it may be {most:g} at most")
            for pair, value in getattr(self, f"{name}_pairs").items():
                if not (
                    np.isfinite(value) and 0 <= value <= most and all(0 <= b <= n for b in pair)
                ):
                    raise ValueError(
                        f"{name}_pairs[{pair}] = {value!r}: needs two body numbers from 0 (the "
                        f"ground) to {n} and a coefficient from 0 to {most:g}"
                    )
        if self.mu_I > 0 and not (self.mu > 0 or any(mu > 0 for mu in self.mu_pairs.values())):
            raise ValueError(
                f"mu_I = {self.mu_I:g} acts on contacts with friction only, and mu is 0 "
                "everywhere; set mu above 0 as well"
            )
        if not self.label:
            object.__setattr__(self, "label", self.name)

    def _title(self) -> str:
        return self.label

    def _sizes(self) -> dict[str, Any]:
        return {"bodies": len(self.bodies), "mu": f"{self.mu:g}", "end": f"{self.end_time:g} s"}

    def mu_between(self, a: int, b: int) -> float:
        """Friction coefficient of two bodies by index, `GROUND` for the ground."""
        return _of_pair(self.mu_pairs, a, b, self.mu)

    def restitution_between(self, a: int, b: int) -> float:
        """Coefficient of restitution of two bodies by index."""
        return _of_pair(self.restitution_pairs, a, b, self.restitution)

    @property
    def bounces(self) -> bool:
        """Whether any pair has a coefficient of restitution above 0."""
        return self.restitution > 0 or any(e > 0 for e in self.restitution_pairs.values())

    def all_forces(self) -> tuple[Force, ...]:
        """Gravity and the scene's own forces."""
        masses = np.array([body.mass for body in self.bodies])
        return (Gravity(masses, self.gravity), *self.forces)


def _of_pair(values: Mapping[tuple[int, int], float], a: int, b: int, otherwise: float) -> float:
    """What a mapping by body numbers says of two bodies by index."""
    one, two = (0 if body == GROUND else body + 1 for body in (a, b))
    return values.get((one, two), values.get((two, one), otherwise))
