"""All that is checked of the method besides its criterion, on a set of recordings.

The estimates that it trusts (`harness.estimates`), the accuracy that (3.20) promises
(`harness.accuracy`), and guessing the active set beside it (`harness.enumeration_growth`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from harness.accuracy import accuracy_of
from harness.enumeration_growth import SIZES, randomly, recorded
from harness.estimates import Estimates, estimates_of
from harness.recording import Recording, read_recording

Progress = Callable[[str, float, float], None]
"""Called with what is being done, how much of it is done, and how much there is."""


@dataclass(frozen=True, eq=False)
class Examination:
    """What was found.

    estimates : one per recording
    accuracy : the rows of `accuracy_of`, and the scene of each
    enumeration : the rows of `recorded` and `randomly`
    """

    estimates: Sequence[Estimates]
    accuracy: pd.DataFrame
    enumeration: pd.DataFrame

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
    steps = 3 * len(recordings) + len(sizes)
    done = 0

    def tell(what: str) -> None:
        nonlocal done
        if progress is not None:
            progress(what, done, steps)
        done += 1

    estimates, accuracy, enumeration = [], [], []
    for recording in recordings:
        tell(f"{recording.scene}: ‖R⁻¹‖ and ranks")
        estimates.append(estimates_of(recording))
        tell(f"{recording.scene}: accuracy reached")
        accuracy.append(accuracy_of(recording).assign(scene=recording.scene))
        tell(f"{recording.scene}: enumeration")
        enumeration.append(recorded(recording))
    enumeration.append(randomly(lambda k: tell(f"enumeration of {k} rows"), sizes))
    return Examination(
        estimates,
        pd.concat(accuracy, ignore_index=True),
        pd.concat(enumeration, ignore_index=True),
    )


def examine_files(paths: Sequence[str | Path], *, progress: Progress | None = None) -> Examination:
    """Check everything on recordings; raises RecordingError for a file that is none."""
    return examine([read_recording(path) for path in paths], progress=progress)
