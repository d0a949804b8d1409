"""Every command and every block of code in README.md runs, so that none can rot.

The commands of "On the command line" run in the order given, in one folder, as they are, or where
that would take long in the variant that `SHORT` states; a line that is new runs as it is.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glambda.cli import app
from harness.criterion.examination import examination_claims
from harness.recordings.recording import write_recording
from harness.study.study import QUICK
from problems.scenes import registry as scenes
from solvers import registry as solvers
from tests.fakes.fake_recordings import fake_recording

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()

SHORT = {
    "glambda record mujoco:arm mujoco:walker -o recordings": "+ --until 0.1",
    "glambda simulate fig4 --plot fig4.png --animate fig4.gif": "+ --until 0.4",
    "glambda record fig4 fig5 -o recordings": "+ --until 0.1",
    "glambda record wall,bodies=1000,speed=0.1,mu=0.3 --until 0.3 --fixed-step 0.005 "
    "--stops held": "glambda record wall,bodies=8,speed=0.1,mu=0.3 --fixed-step 0.005 "
    "--stops held --until 0.01",
    "glambda replay recordings/*.h5 --solvers glambda,daqp,proxqp --settings paper,high "
    "-o results": "glambda replay recordings/fig4*.h5 recordings/mine.h5 "
    "--solvers glambda,daqp,proxqp --settings paper,high -o results --repeats 1",
    "glambda replay recordings/*.h5 --arms cold,warm,exact,stale5,corrupted -o results": "glambda "
    "replay recordings/fig4*.h5 --arms cold,warm,exact,stale5,corrupted -o results "
    "--solvers glambda --settings high --repeats 1",
    "glambda replay recordings/*.h5 --settings 1e-3,1e-6,1e-9 -o results": "glambda replay "
    "recordings/fig4*.h5 --settings 1e-3,1e-6,1e-9 -o results --solvers glambda --arms cold "
    "--repeats 1",
    "glambda replay recordings/*.h5 --solvers forms -o results": "glambda replay "
    "recordings/wall*.h5 --solvers forms -o results --settings high --arms cold --repeats 1",
    "glambda verify": "+ recordings/fig4.h5 --solvers glambda,daqp",
    "glambda closed-loop fig4 -o closed_loop": "+ --until 0.02 --solvers glambda "
    "--settings paper --sweep none",
    "glambda convergence -o convergence": "+ wall,bodies=3",
    "glambda claims -o claims": "+ 3",
    "glambda peers -o peers": "+ fig4@0.05 --engines glambda --limit 0.001",
    "glambda criterion recordings/*.h5 -o criterion": "glambda criterion recordings/wall*.h5 "
    "-o criterion --repeats 1",
    "glambda growth tower wall -o growth": "+ --bodies 3 --solvers glambda",
    "glambda race recordings/*.h5 -o race": "glambda race recordings/wall*.h5 -o race "
    "--solvers glambda,daqp --rounds 1",
    "glambda study --quick": "+ --scenes fig5 --solvers glambda",
    "glambda study --workers 4": "glambda study --workers 1 --quick --scenes fig5 "
    "--solvers glambda --results shared",
}
"""What runs instead of a command, or "+" and what is added to it, so that it takes seconds."""
SMALLER = {
    "harness.claims.convergence.SWEEP": (1e-2, 1e-3, 1e-4),
    "harness.claims.reference_motion.REFERENCE": 1e-4,
    "harness.claims.stability.STEPS": 20,
    "harness.claims.stability.points_to_check": lambda: [(1, 0.0, 1.0), (2, 0.1, 1.0)],
    "harness.criterion.criterion.SWEEP": (1, 5, float("inf")),
    "harness.criterion.criterion.ENOUGH": 1e-3,
    "harness.criterion.unit_times.ROUNDS": 2,
    "harness.criterion.kept_factors.INTERVALS": (1, 5),
    "harness.criterion.kept_factors.LONGEST": 10,
    "harness.criterion.examination.examination_claims": partial(examination_claims, largest=2),
    "harness.study.study.QUICK": replace(QUICK, until=0.05),
    "harness.claims.painleve.STEPS": (1e-4, 1e-5, 1e-6),
    "harness.claims.painleve.GAINS": (-0.4, 0.9, 1.2),
    "harness.claims.painleve.APPROACHES": (2.0, 3.0),
    "harness.claims.painleve.TOLERANCES": (1e-3, 1e-4),
}
"""Campaigns without options for it are made shorter by these constants."""


class Block:
    """A block of the README: the heading it stands under, its language and its lines."""

    def __init__(self, heading: str, language: str, text: str) -> None:
        self.heading, self.language, self.text = heading, language, text


def blocks() -> list[Block]:
    """All blocks, fenced or indented by four columns."""
    found = []
    for section in re.split(r"^## ", README, flags=re.M)[1:]:
        heading, _, body = section.partition("\n")
        for language, text in re.findall(r"^```(\w*)\n(.*?)^```$", body, flags=re.M | re.S):
            found.append(Block(heading, language, text))
        plain = re.sub(r"^```.*?^```$", "", body, flags=re.M | re.S)
        for text in re.findall(r"(?:^    \S.*\n)+", plain, flags=re.M):
            found.append(Block(heading, "", re.sub(r"^    ", "", text, flags=re.M)))
    return found


def lines() -> list[str]:
    """All commands, without their comments."""
    shell = [block for block in blocks() if not block.language]
    return [shlex.join(words) for b in shell for line in b.text.splitlines()
            if (words := shlex.split(line, comments=True))]  # fmt: skip


def commands() -> list[str]:
    """Those of glambda, as they are written."""
    text = next(b.text for b in blocks() if b.heading == "On the command line")
    return [line.split("  #")[0].strip() for line in text.splitlines()]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def plug_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, dict[str, str]]]:
    """The README's entry points, of a package that is installed beside the tests."""
    (block,) = (block for block in blocks() if block.language == "toml")
    declared = tomllib.loads(block.text)["project"]["entry-points"]
    place = folder / "site"
    info = place / "my_package-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    entries = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in of.items())
               for group, of in declared.items()]  # fmt: skip
    (info / "entry_points.txt").write_text("\n".join(entries))
    (place / "my_package.py").write_text(
        "from problems import scene\n"
        "from solvers.adapters.scipy_bvls import ScipyBVLS\n\n"
        "class MySolver(ScipyBVLS):\n"
        '    """A solver of somebody else\'s."""\n\n'
        '    name = "mine"\n\n'
        "def domino():\n"
        '    """Two boxes in a row."""\n'
        '    return scene("fig4", boxes=2)\n'
    )
    monkeypatch.syspath_prepend(str(place))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(place), str(ROOT)]))
    for registry in (solvers, scenes):
        registry._targets.cache_clear()
    yield declared
    monkeypatch.undo()
    sys.modules.pop("my_package", None)
    for registry in (solvers, scenes):
        registry._targets.cache_clear()


def expanded(command: str) -> list[str]:
    """The words of a command, with * as the shell expands it."""
    words = []
    for word in shlex.split(command):
        words += sorted(map(str, Path().glob(word))) if "*" in word else [word]
    return words


def test_every_command_runs(folder: Path, plug_in: object, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in SMALLER.items():
        monkeypatch.setattr(name, value)
    wrong = []
    np.savez("mine.npz", A=np.eye(3), b=np.ones(3), lb=np.zeros(3))
    for command in commands():
        if "mujoco:" in command and importlib.util.find_spec("mujoco") is None:
            continue  # an extra
        if command == "glambda compare results_A results_B":
            for copy in ("results_A", "results_B"):
                shutil.copytree("results", copy)
        words = expanded(SHORT.get(command, "+").replace("+", command, 1))
        assert words[0] == "glambda", command
        began = time.perf_counter()
        result = CliRunner().invoke(app, words[1:])
        print(f"{time.perf_counter() - began:6.1f} s  {command}", flush=True)
        if command == "glambda doctor" and result.exit_code == 1:
            continue  # it has found something, such as other tests beside this one
        if result.exit_code or result.exception is not None:
            said = f"{result.output}\n{result.exception!r}"
            wrong.append(f"{command}: exit {result.exit_code}\n{said}")
    assert not wrong, "\n\n".join(wrong)
    for name in ("fig4.png", "fig4.gif", "fig4.csv", "fig4.events.csv", "report/index.html"):
        assert (folder / name).stat().st_size


def test_every_variant_is_one_of_a_line() -> None:
    assert set(SHORT) <= set(commands()), "strike what README.md has no more"


@pytest.mark.parametrize("number", range(sum(b.language == "python" for b in blocks())))
def test_every_block_of_python_runs(number: int, folder: Path) -> None:
    Path("recordings").mkdir()
    write_recording(Path("recordings/fig4.h5"), fake_recording())
    block = [block for block in blocks() if block.language == "python"][number]
    exec(compile(block.text, f"README.md, block {number}", "exec"), {})


def test_the_plug_in_is_listed(plug_in: dict[str, dict[str, str]]) -> None:
    for kind in ("solvers", "scenes"):
        listed = CliRunner().invoke(app, [kind])
        assert listed.exit_code == 0, listed.output
        for name in plug_in[f"glambda.{kind}"]:
            assert re.search(rf"^{name}\b", listed.stdout, flags=re.M), listed.stdout


def test_every_other_command_is_there(folder: Path) -> None:
    """What installs, or takes minutes: the target, the script or the extra exists."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    seen, known = set(), {shlex.join(shlex.split(command)) for command in commands()}
    for line in lines():
        program, *words = shlex.split(line)
        seen.add(Path(program).name)
        match Path(program).name, words:
            case "make", [target]:
                made = ["make", "-n", "-C", str(ROOT), target]
                assert subprocess.run(made, capture_output=True).returncode == 0, line
            case "python3", ["-m", "venv", _]:
                pass
            case "pip", ["install", "-e", what]:
                assert re.fullmatch(r"\.\[(\w+)\]", what)[1] in project["optional-dependencies"]
            case "glambda", _ if line in known:
                pass
            case "glambda", ["study"]:
                assert "glambda study --quick" in commands()
            case "python", ["-m", "pytest", *_]:
                pass
            case _:
                pytest.fail(f"{line}: say here what is to be tried of it")
    assert {"make", "glambda", "pip"} <= seen


def test_every_file_and_script_that_is_named_is_there() -> None:
    named = set(re.findall(r"\]\(([^)#:]+)\)", README))
    named |= set(re.findall(r"`((?:benchmarks|\.ci|reports|tests)/[\w./]*)`", README))
    named |= set(re.findall(r"`([A-Z]+\.(?:md|cff))`", README))
    assert {"reports/published", "tests/endurance/kill.py"} <= named
    for name in named:
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("script", sorted(set(re.findall(r"(benchmarks/\w+\.py) --", README))))
def test_every_benchmark_tells_its_options(script: str) -> None:
    told = subprocess.run(
        [sys.executable, ROOT / script, "--help"], capture_output=True, text=True, cwd=ROOT
    )
    assert told.returncode == 0 and "usage" in told.stdout, told.stderr
    for used, option in re.findall(r"(benchmarks/\w+\.py) (--\w+)", README):
        assert used != script or option in told.stdout
