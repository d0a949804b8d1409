"""All cases as a claim: one unit each, its rows stored like those of other claims."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pandas as pd

from harness.cases import bodies, friction_discs, linkages, networks, space, wheels
from harness.cases.bodies import Found
from harness.results.claim import Claim, claim_over
from problems.sequence import SolvesQPs

CASES: dict[str, Callable[[SolvesQPs], list[Found]]] = {
    "ramp": bodies.ramp,
    "braking": bodies.braking,
    "mass_ratio": bodies.mass_ratio,
    "arch": bodies.arch,
    "cards": bodies.cards,
    "dominoes": bodies.dominoes,
    "sunk": bodies.sunk,
    "rocking": wheels.rocking,
    "slider_crank": linkages.slider_crank,
    "double_pendulum": linkages.double_pendulum,
    "skate": linkages.skate,
    "bungee": linkages.bungee,
    "motor": linkages.motor,
    "bounce": linkages.bounce,
    "frame": linkages.frame,
    "arm": linkages.arm,
    "human": linkages.human,
    "half_wave": networks.half_wave,
    "bridge": networks.bridge,
    "boost": networks.boost,
    "free_top": space.free_top,
    "heavy_top": space.heavy_top,
    "slope": space.slope,
    "skid": space.skid,
    "bowl": space.bowl,
    "friction_discs": friction_discs.friction_discs,
    "space_tower": space.space_tower,
    "space_pyramid": space.space_pyramid,
}
"""Scene, or several of them → what is measured."""


def cases_claim(names: Iterable[str], solver: SolvesQPs) -> Claim:
    """The rows of these cases: quantity, value, expected, order, error.

    Raises ValueError for a name that is no case.
    """
    chosen = list(names)
    for name in chosen:
        if name not in CASES:
            raise ValueError(f"{name!r} is no case; there are: {', '.join(CASES)}")

    def rows(case: str) -> pd.DataFrame:
        found = pd.DataFrame(CASES[case](solver))
        return found.assign(error=(found["value"] - found["expected"]).abs())

    return claim_over("cases", rows, case=chosen)
