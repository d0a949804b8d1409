"""All that is checked of the method besides its criterion, on a set of recordings.

The estimates that it trusts (`harness.criterion.estimates`), the accuracy that (3.20) promises
(`harness.criterion.accuracy`), guessing the active set beside it
(`harness.criterion.enumeration_growth`), two ways to the minimum-norm multipliers
(`harness.criterion.minimum_norm_ways`), and what other packages can keep from QP to QP
(`harness.criterion.kept_factors`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import pandas as pd

from harness.criterion.accuracy import accuracy_of
from harness.criterion.enumeration_growth import SIZES, randomly, recorded
from harness.criterion.estimates import Estimates, estimates_of
from harness.criterion.kept_factors import kept_factors, no_runs
from harness.criterion.minimum_norm_ways import MinimumNormWays, minimum_norm_ways
from harness.progress import Progress
from harness.recordings.recording import Recording


@dataclass(frozen=True, eq=False)
class Examination:
    """What was found.

    estimates : one per recording
    accuracy : the rows of `accuracy_of`, and the scene of each
    enumeration : the rows of `recorded` and `randomly`
    minimum_norm : one per recording
    kept : the rows of `kept_factors`
    """

    estimates: Sequence[Estimates]
    accuracy: pd.DataFrame
    enumeration: pd.DataFrame
    minimum_norm: Sequence[MinimumNormWays]
    kept: pd.DataFrame = field(default_factory=no_runs)

    @property
    def scenes(self) -> list[str]:
        """Labels of the recordings."""
        return [one.scene for one in self.estimates]


def examine(
    recordings: Sequence[Recording],
    *,
    sizes: Sequence[int] = SIZES,
    progress: Progress | None = None,
) -> Examination:
    """Check everything on these recordings; `sizes` are those of the random QPs."""
    steps = 5 * len(recordings) + len(sizes)
    done = 0

    def tell(what: str) -> None:
        nonlocal done
        if progress is not None:
            progress(what, done, steps)
        done += 1

    estimates, accuracy, enumeration, minimum_norm, kept = [], [], [], [], []
    for recording in recordings:
        tell(f"{recording.scene}: ‖R⁻¹‖ and ranks")
        estimates.append(estimates_of(recording))
        tell(f"{recording.scene}: accuracy reached")
        accuracy.append(accuracy_of(recording).assign(scene=recording.scene))
        tell(f"{recording.scene}: enumeration")
        enumeration.append(recorded(recording))
        tell(f"{recording.scene}: minimum norm")
        minimum_norm.append(minimum_norm_ways(recording))
        tell(f"{recording.scene}: what packages can keep")
        kept.append(kept_factors(recording))
    enumeration.append(randomly(lambda k: tell(f"enumeration of {k} rows"), sizes))
    return Examination(
        estimates,
        pd.concat(accuracy, ignore_index=True),
        pd.concat(enumeration, ignore_index=True),
        minimum_norm,
        pd.concat(kept, ignore_index=True),
    )
