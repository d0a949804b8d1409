"""How the numbers of a report were measured, on what, and how to get them again."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from harness.names import DISTURBED, STRETCHED
from harness.passes.limits import TIME_LIMIT
from harness.recordings.recording import Reference
from harness.study.disturb import SEED
from problems.stepping.options import StepperOptions
from reports.parts.names import in_order, solver_order
from reports.parts.table import Table, percent, scientific, short, whole
from reports.rows.comparison import SHIFT, SKIP_LIMIT
from reports.rows.results import ARMS, Results

RUN_OPTIONS = (
    *("eps", "until", "fixed_step", "stops", "friction", "impulses"),
    *("restitution", "drop_tol", "drift", "drift_time"),
)
"""Options of `glambda record` about how a scene is run."""
UNKNOWN = object()
"""What an option is by default that this version does not know."""
SLOW_PASS = 1.1
"""A pass that begins at more than this multiple of the median pace is counted as slow."""


WHAT = {
    "pressure": "tasks that waited for a processor",
    "memory": "tasks that waited for memory",
    "steal": "processors given to others",
    "switches": "the process put aside",
    "swapped": "memory swapped",
    "frequency": "a slower processor",
}
"""Entries of `harness.machine.unrest.Unrest` in words."""


def protocol(results: Results) -> list[tuple[str, str]]:
    """Terms and what they mean, with the constants that were used."""
    from harness.judging.facts import ASKED_RELATIVE
    from harness.judging.judge import VERIFIED_WITHIN, WRONG_BEYOND

    relative = " and ".join(f"{name} {value:g}" for name, value in ASKED_RELATIVE.items())
    said = [
        (
            "Replay",
            "Every backend sees the identical recorded QPs in order, whatever the others answer. "
            "Cold: each from nothing.  Warm: from its own previous answer, mapped by the identity "
            "of the rows, dropped after a discontinuity; impulses and minimum-norm problems are "
            "always solved cold.",
        ),
        (
            "Settings",
            "paper asks for ε₀ of (3.13), the accuracy that the step's error control needs; the "
            f"others are relative to the scale ‖A A⁺d‖ of the QP: {relative}, where default leaves "
            "each package at its own tolerances and only judges by that.",
        ),
        (
            "Verdict",
            "From x alone, by its error in Gλ against a checked reference, or by a bound on that "
            f"error where none was accepted.  Verified: up to {VERIFIED_WITHIN:g} times what was "
            f"asked.  Claimed wrong: beyond {WRONG_BEYOND:g} times, and called solved.  A bound "
            "proves nothing wrong: without a proof either way the verdict is undecided, which is "
            "counted apart.",
        ),
        (
            "Time",
            "Setup and solve around the package's own call, one thread, the least over the "
            "passes; medians of the passes are in the results.",
        ),
        (
            "Means",
            f"Shifted geometric, shift {1e6 * SHIFT:g} µs.  A solve that is not verified is "
            f"charged {results.time_limit:g} s.  Only over QPs that no compared backend skipped; "
            f"one that skipped more than {percent(SKIP_LIMIT)} of a scene is left out and named.",
        ),
    ]
    said += [(term, text) for term, text in _machine(results) if text]
    machines = sorted(results.rows["machine"].astype(str).unique())
    if machines:
        said.append(("Machine", "; ".join(machines)))
    return said


def _machine(results: Results) -> list[tuple[str, str]]:
    """What is known of the clock, of the pace of the machine and of the cost of the harness."""
    return [
        ("References", _references(results)),
        ("Clock", _clock(results)),
        ("Belief", _belief(results)),
        ("Pace", _pace(results)),
        ("Unrest", _unrest(results)),
        ("Harness", _harness(results)),
    ]


def _references(results: Results) -> str:
    """On what the references rest."""
    known = [each for recording in results.recordings.values() for each in recording.references]
    return f"A x* of the recorded data: {proofs(known)}." if known else ""


def _clock(results: Results) -> str:
    """What the clock can tell apart, and what an empty solve costs."""
    facts = results.study.get("clock", {})
    try:
        resolution, empty, booked = (
            1e6 * float(facts[name]) for name in ("resolution", "empty_call", "empty_runtime")
        )
    except (KeyError, TypeError, ValueError):
        return ""
    return (
        f"Two readings that differ do so by {short(resolution)} µs or more.  A solve that does "
        f"nothing takes {short(empty)} µs as a whole, and {short(booked)} µs of that are booked as "
        "setup and solve."
    )


def _belief(results: Results) -> str:
    """Whose own clocks were not believed."""
    rows = results.rows[results.rows["verified"]]
    if rows.empty:
        return ""
    doubted = rows.loc[~rows["believed"].astype(bool), "solver"].value_counts()
    named = ", ".join(f"{solver} {count:,}" for solver, count in doubted.items())
    return (
        "What a backend tells of its time is held against the wall and processor time that its "
        "process was seen to take, from outside.  Where more was seen, or its stages leave it "
        "unexplained, that is charged, and the row is not believed: "
        f"{named or 'none'}, of {len(rows):,} verified solves."
    )


def _pace(results: Results) -> str:
    """Whether the machine kept its pace from pass to pass."""
    paces = results.passes.get("pace", pd.Series(dtype=float)).to_numpy()
    if paces.size < 2:
        return ""
    middle = float(np.median(paces))
    slow = int((paces > SLOW_PASS * middle).sum())
    low, high = np.quantile(paces, [0.05, 0.95]) / middle
    return (
        f"Before each of the {paces.size:,} passes a fixed piece of work was timed: median "
        f"{short(1e6 * middle)} µs, nine in ten between {low:.2f} and {high:.2f} of it, the "
        f"slowest {paces.max() / middle:.2f}.  {slow:,} passes began more than "
        f"{percent(SLOW_PASS - 1)} slower than the median; passes go round, so that all backends "
        "meet such times."
    )


def _unrest(results: Results) -> str:
    """What else the machine did, and how often that disturbed a pass."""
    passes = results.passes
    known = [] if passes.empty else [name for name in WHAT if passes[name].notna().any()]
    if not known:
        return ""
    causes = passes["disturbed_by"].str.split(", ")
    disturbed = passes["disturbed_by"] != ""
    counts = {words: int(causes.map(lambda of, name=name: name in of).sum())
              for name, words in WHAT.items()}  # fmt: skip
    named = ", ".join(f"{words} {count:,}" for words, count in counts.items() if count)
    unknown = ", ".join(words for name, words in WHAT.items() if name not in known)
    bare = results.rows[~results.rows["quiet"].astype(bool)]
    return (
        f"{int(disturbed.sum()):,} of the {len(passes):,} passes were disturbed"
        + (f" ({named})" if named else "")
        + "; another was taken in place of each, as long as it took no more than twice as many.  "
        f"Of {len(bare):,} rows no pass was quiet."
        + (f"  This system does not tell: {unknown}." if unknown else "")
    )


def _harness(results: Results) -> str:
    """What part of the replay was spent inside the calls of solvers."""
    spent = results.spent
    if not spent.get("replaying"):
        return ""
    calls, passes = (spent[name] / spent["replaying"] for name in ("in_calls", "in_passes"))
    return (
        f"The replay took {short(spent['replaying'])} s, {percent(calls)} of it inside timed calls "
        f"of solvers and {percent(passes - calls)} around them: starting processes, warming up, "
        "reading answers.  The rest is judging and storing."
    )


def versions_table(results: Results) -> Table:
    """Backends with their versions and how much they solved."""
    rows = results.rows
    out = []
    for solver in results.solvers:
        part = rows[rows["solver"] == solver]
        out.append(
            {
                "solver": solver,
                "versions": ", ".join(sorted(part["versions"].astype(str).unique())),
                "arms": ", ".join(in_order(part["arm"].unique(), ARMS)),
                "solves": int((~part["skipped"]).sum()),
                "skipped": int(part["skipped"].sum()),
                "not believed": int((part["verified"] & ~part["believed"].astype(bool)).sum()),
            }
        )
    data = pd.DataFrame(sorted(out, key=lambda row: solver_order(str(row["solver"]))))
    return Table(
        name="versions",
        title="Backends and versions",
        reading="One line per backend, over all scenes, settings and arms.  Not believed: verified "
        "solves that are charged more than they told of.",
        data=data,
        formats={"solves": whole, "skipped": whole, "not believed": whole},
    )


def recordings_table(results: Results) -> Table:
    """Recordings with what identifies them."""
    out = []
    for scene, recording in results.recordings.items():
        chosen = {name: recording.parameters[name] for name in sorted(recording.parameters)}
        out.append(
            {
                "recording": scene,
                "ε": recording.eps,
                "digest": recording.digest[:16],
                "parameters": ", ".join(f"{name} = {value}" for name, value in chosen.items()),
            }
        )
    return Table(
        name="recordings",
        title="Recordings",
        reading="The digest is of the content: the same digest means the same QPs.",
        data=pd.DataFrame(out, columns=["recording", "ε", "digest", "parameters"]),
        formats={"ε": scientific},
    )


def reproduce(results: Results) -> str:
    """Commands that repeat this study."""
    lines = []
    for scene in results.scenes:
        recording = results.recordings.get(scene)
        lines.append(record_command(scene, {} if recording is None else recording.parameters))
    if len(results.rows):
        lines.append(
            f"glambda replay recordings/*.h5 --solvers {_names(results.solvers)} \\\n"
            f"    --settings {_names(results.settings)} "
            f"--arms {_names(in_order(results.rows['arm'].unique(), ARMS))}"
            f"{_limit(results)} -o results"
        )
        problem = str(results.rows["problem"].iloc[0])
        scene, _, number = problem.rpartition("/")
        solver = results.solvers[0]
        lines.append(
            f"glambda replay {_file(scene)} --solvers {_names([solver])} --qp {int(number)}"
            "      # one row again"
        )
    lines += _campaign_commands(results)
    lines.append("glambda report results -o report")
    return "\n".join(lines)


def _campaign_commands(results: Results) -> list[str]:
    """One replay for each setting of the campaigns, which repeats all that was run with it."""
    rows = results.campaigns
    if rows is None or rows.empty:
        return []
    lines = []
    for setting in in_order(rows["settings"].unique(), tuple(results.settings)):
        part = rows[rows["settings"] == setting]
        labels = sorted(part["scene"].unique())
        unknown = sorted(set(labels) - set(results.scenes))
        lines += [record_command(label, {}) for label in unknown]
        files = " ".join(map(_file, labels))
        solvers = _names(sorted(part["solver"].unique(), key=solver_order))
        arms = _names(in_order(part["arm"].unique(), ARMS))
        lines.append(
            f"glambda replay {files} --solvers {solvers} \\\n"
            f"    --settings {_names([setting])} --arms {arms}{_limit(results)} -o results"
        )
    return lines


def _names(names: Iterable[str]) -> str:
    """Names with commas between, as a shell takes them."""
    return shlex.quote(",".join(names))


def _file(label: str) -> str:
    """The recording of a scene, as a shell takes it."""
    return shlex.quote(f"recordings/{label}.h5")


def _limit(results: Results) -> str:
    usual = results.time_limit == TIME_LIMIT
    return "" if usual else f" --time-limit {results.time_limit:g}"


def record_command(label: str, parameters: Mapping[str, Any]) -> str:
    """The command that records a scene, from its label such as "fig4,mu_I=0.8".

    parameters : of the recording; they tell how it was run

    A stretched or disturbed recording is made from that of its scene.
    """
    original, stretched, condition = label.partition(STRETCHED)
    if stretched:
        asked = f"--condition {shlex.quote(condition)}"
        return f"glambda stretch {_file(original)} {asked} -o recordings"
    original, disturbed, kind = label.partition(DISTURBED)
    if disturbed:
        seed = parameters.get("disturbed.seed", SEED)
        asked = f"--kinds {shlex.quote(kind)}" + (f" --seed {seed}" if seed != SEED else "")
        return f"glambda disturb {_file(original)} {asked} -o recordings"
    name, *chosen = label.split(",")
    how: dict[str, Any] = {}
    if chosen and chosen[-1].startswith("friction="):  # of the run, and not of the scene
        how["friction"] = chosen.pop().removeprefix("friction=")
    how |= {name[4:]: value for name, value in parameters.items() if name.startswith("run.")}
    options = "".join(f" --set {shlex.quote(entry)}" for entry in chosen)
    usual = {
        **asdict(StepperOptions.of(_positive(how.get("eps")))),
        "eps": parameters.get("eps"),
        "until": parameters.get("end_time"),
        "solver": how.get("solver"),
    }
    unusual = {name: value for name, value in how.items() if value != usual.get(name, UNKNOWN)}
    for option in [option for option in RUN_OPTIONS if option in unusual]:
        value = shlex.quote(_text(unusual.pop(option)))
        options += f" --{option.replace('_', '-')} {value}"
    more = ", ".join(f"{option}={_text(value)}" for option, value in unusual.items())
    in_python = f"  # from Python: {' '.join(more.split())}" if more else ""  # stays a comment
    return f"glambda record {shlex.quote(name)}{options} -o recordings{in_python}"


def _positive(value: Any) -> float:
    """A stranger's value, if it is a positive number; else 1."""
    number = isinstance(value, (int, float)) and 0 < value <= sys.float_info.max
    return float(value) if number else 1.0


def _text(value: Any) -> str:
    """A number in few digits, as long as they are all."""
    if isinstance(value, float) and float(f"{value:g}") == value:
        return f"{value:g}"
    return str(value)


def proofs(references: Iterable[Reference | None]) -> str:
    """How many references rest on what."""
    words = {
        "exact": "proved in exact arithmetic",
        "bound": "within the error bound",
        "nearby": "within the error bound of a QP that differs by rounding",
        "ill-posed": "within the error bound of an ill-posed QP",
        "none": "without a reference",
    }
    rests_on = ["none" if r is None else r.proof for r in references]
    parts = [f"{rests_on.count(p)} {text}" for p, text in words.items() if p in rests_on]
    return f"of {len(rests_on)}, " + ", ".join(parts)
