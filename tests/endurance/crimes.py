"""Everything that a backend may do to a study, in one study: crime, verdict, and what the row says.

    python -m tests.endurance.crimes

The criminals are in `tests/fakes/crimes.py`: each answers rightly but for one QP.  Columns of the
table:

    verdict    of the row of the crime
    says       its status_text, cut short
    clock      whose time counts: the solver's own, or ours around the whole call
    expected   whether verdict and text are those that `tests/fakes/crimes.py` expects
    others     verified answers among the other QPs of the same solver

Exit code 1 if a crime is not caught, or if the honest solver beside them is not verified
throughout.
"""

from __future__ import annotations

import re
import sys

import pandas as pd

TIME_LIMIT = 0.3
"""[s]; a solve is killed after 4 s."""
CUT = 76
"""Characters of the status text that are printed."""


def main() -> int:
    """Run the study and print the table."""
    from harness import replay
    from solvers.registry import register
    from tests.fakes.crimes import CRIMES, MEMORY_LIMIT, targets
    from tests.fakes.fake_recordings import fake_recording

    for name, target in targets().items():
        register(name, target)
    rows = replay(
        fake_recording(),
        list(targets()),
        arms=["cold"],
        repeats=1,
        time_limit=TIME_LIMIT,
        memory_limit=MEMORY_LIMIT,
    ).sort_values("step")
    lines = []
    for name, crime in CRIMES.items():
        own = rows[rows["solver"] == name]
        row = crime.row(own)
        caught = row["verdict"] == crime.verdict and re.search(crime.text, row["status_text"])
        others = own.drop(index=row.name)["verdict"]
        text = row["status_text"]
        lines.append(
            {
                "crime": name.replace("_", " "),
                "verdict": row["verdict"],
                "says": text if len(text) <= CUT else text[: CUT - 1] + "…",
                "clock": "own" if row["runtime"] < row["call_time"] else "ours",
                "expected": "yes" if caught else "NO",
                "others": f"{(others == 'verified').sum()} of {len(others)}",
            }
        )
    table = pd.DataFrame(lines)
    print(table.to_markdown(index=False))
    honest = (rows.loc[rows["solver"] == "Honest", "verdict"] == "verified").all()
    print(f"\nthe honest solver beside them: {'verified throughout' if honest else 'NOT VERIFIED'}")
    return 0 if honest and (table["expected"] == "yes").all() else 1


if __name__ == "__main__":
    sys.exit(main())
