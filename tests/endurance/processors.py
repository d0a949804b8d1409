"""The same scenes as other types of processor would round them: how far apart are the motions?

    python -m tests.endurance.processors                    the paper's scenes, seven environments
    python -m tests.endurance.processors --scenes fig4      one of them
    python -m tests.endurance.processors --run another -m pytest -m rounding     any module, as one

Environments are those of `harness.motions.as_elsewhere`.  Columns of the table, against the first:

    recording   "same" if the content of the recordings is the same, bit for bit
    apart       largest error of a pose [m] (`harness.motions.motion_error`) over the whole motion
    at impact   the same up to the first impact
    events      those that restart the integration: in both, and in one of the two only
    time        largest difference in time of a pair of events [s]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.progress import track
from rich.table import Table

from harness.machine.threads import ask_for_one_thread
from harness.motions.as_elsewhere import ENVIRONMENTS, motion_in, record_in
from harness.motions.motion_error import match_events, pose_error
from harness.recordings.recording import read_recording

SCENES = ("fig2", "fig3", "fig4", "fig5")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", default=SCENES, metavar="SCENE")
    parser.add_argument(
        "--run",
        nargs=argparse.REMAINDER,
        metavar="ENVIRONMENT ARGUMENTS",
        help=f"run `python ARGUMENTS` in one of {', '.join(ENVIRONMENTS)}",
    )
    options = parser.parse_args(arguments)
    if options.run is not None:
        name, *command = options.run or [""]
        if name not in ENVIRONMENTS:
            parser.error(f"--run {name!r} is unknown; choose from {', '.join(ENVIRONMENTS)}")
        variables = {**os.environ, **ENVIRONMENTS[name]}
        return subprocess.run([sys.executable, *command], env=variables).returncode
    with TemporaryDirectory() as folder:
        Console().print(table(Path(folder), options.scenes))
    return 0


def table(folder: Path, scenes: Sequence[str]) -> Table:
    """One line per environment and scene."""
    out = Table("environment", "scene", "recording", "apart", "at impact", "events", "time")
    watched = track(ENVIRONMENTS.items(), "environments", console=Console(stderr=True))
    for number, (name, variables) in enumerate(watched):
        into = folder / str(number)
        into.mkdir()
        failure = record_in(variables, into, scenes)
        for label in scenes:
            if failure:
                out.add_row(name, label, failure, "", "", "", "")
            elif number:
                out.add_row(name, label, *difference(folder / "0", into, label))
    return out


def difference(first: Path, other: Path, label: str) -> list[str]:
    """The columns of one line."""
    ours, theirs = (read_recording(folder / f"{label}.h5") for folder in (other, first))
    motion, reference = motion_in(ours), motion_in(theirs)
    error = pose_error(motion, reference)
    events = match_events(motion.events, reference.events)
    return [
        "same" if ours.digest == theirs.digest else "differs",
        f"{error.largest():.1e}",
        f"{error.largest(reference.first_impact):.1e}",
        f"{events.matched} / {events.missing + events.extra}",
        f"{events.largest:.1e}",
    ]


if __name__ == "__main__":
    ask_for_one_thread()
    sys.exit(main())
