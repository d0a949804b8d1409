"""What is claimed of algorithm 2 and its criterion, on a set of recordings: claims, and their rows.

The criterion (`harness.criterion.criterion`); and besides it the estimates that it trusts
(`harness.criterion.estimates`), the accuracy that (3.20) promises (`harness.criterion.accuracy`),
guessing the active set beside it (`harness.criterion.enumeration_growth`), two ways to the
minimum-norm multipliers (`harness.criterion.minimum_norm_ways`), and what other packages can keep
from QP to QP (`harness.criterion.kept_factors`).  An examiner makes rows of a recording; all go
through `harness.results.claim`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import pandas as pd

from harness.criterion.accuracy import accuracy_of
from harness.criterion.criterion import moves, rule_runs
from harness.criterion.enumeration_growth import SIZES, randomly, recorded
from harness.criterion.estimates import ages, norms
from harness.criterion.kept_factors import KINDS, kept_factors
from harness.criterion.minimum_norm_ways import MinimumNormWays, case_rows, redundant, way_rows
from harness.names import METHOD, PAPER
from harness.recordings.recording import Recording
from harness.results.claim import Claim, Row, Rows
from solvers import describe


@dataclass(frozen=True, eq=False)
class Examination:
    """What was found besides the criterion: the rows of `examination_claims`, by claim.

    All of them name the scene and the digest of the recording, but those of `random` QPs.

    recordings : one row each, with its calls, the QPs that a warm start can serve, and how many of
        them were examined for redundant columns
    """

    recordings: pd.DataFrame
    norms: pd.DataFrame
    ages: pd.DataFrame
    accuracy: pd.DataFrame
    enumeration: pd.DataFrame
    random: pd.DataFrame
    redundant: pd.DataFrame
    minimum_norm: pd.DataFrame
    kept: pd.DataFrame

    @property
    def scenes(self) -> list[str]:
        """Labels of the recordings."""
        return list(self.recordings["scene"])

    @property
    def ways(self) -> list[MinimumNormWays]:
        """The ways to the minimum-norm multipliers, by recording."""
        return [
            MinimumNormWays(
                scene=one.scene,
                calls=one.calls,
                examined=one.examined,
                cases=rows_of(self.redundant, one.digest),
                ways=rows_of(self.minimum_norm, one.digest),
            )
            for one in self.recordings.itertuples()
        ]


def rows_of(rows: pd.DataFrame, digest: str) -> pd.DataFrame:
    """The rows of one recording."""
    return rows[rows["digest"] == digest].reset_index(drop=True)


def criterion_claims(recordings: Sequence[Recording], repeats: int = 5) -> list[Claim]:
    """The runs of all rules, "runs", and how far A moves, "drift"."""
    return [
        _claim("runs", rule_runs, recordings, repeats=repeats),
        _claim("drift", moves, recordings),
    ]


def examination_claims(recordings: Sequence[Recording], largest: int = SIZES[-1]) -> list[Claim]:
    """The claims besides the criterion; `largest` is the most rows of a random QP."""
    looked = cache(redundant)

    def examined(recording: Recording) -> list[Row]:
        calls, examined, _ = looked(recording)
        return [{"calls": calls, "examined": examined}]

    def random(largest: int) -> pd.DataFrame:
        return randomly([size for size in SIZES if size <= largest])

    packages = [
        name for name in dict.fromkeys(k.package for k in KINDS) if describe(name).available
    ]
    return [
        _claim("recordings", examined, recordings),
        _claim("norms", norms, recordings),
        _claim("ages", ages, recordings),
        _claim("accuracy", accuracy_of, recordings),
        _claim("enumeration", recorded, recordings),
        Claim("random", random, [{"largest": largest}]),
        _claim("redundant", lambda recording: case_rows(looked(recording)[2]), recordings),
        _claim("minimum_norm", lambda recording: way_rows(looked(recording)[2]), recordings),
        _claim("kept", kept_factors, recordings, solvers=(METHOD, *packages)),
    ]


def _claim(
    name: str,
    examiner: Rows,
    recordings: Sequence[Recording],
    solvers: Sequence[str] = (METHOD, PAPER),
    **options: Any,
) -> Claim:
    """A claim with a unit for each recording."""
    known = {recording.digest: recording for recording in recordings}

    def rows(scene: str, digest: str, **options: Any) -> Any:
        return examiner(known[digest], **options)

    units = [{"scene": one.scene, "digest": digest, **options} for digest, one in known.items()]
    return Claim(name, rows, units, solvers)
