"""Every block of code in docs/ runs, every command in it is there, and plug-ins are begun right."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

import glambda
from glambda.cli import app
from glambda.cli.new import package

ROOT = Path(__file__).parents[2]
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "CONTRIBUTING.md"])
SOLVER, SCENE = ROOT / "docs/how_to/solver.md", ROOT / "docs/how_to/scene.md"


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), flags=re.M | re.S)


def commands(page: Path) -> list[list[str]]:
    lines = re.findall(r"^    (glambda .*)$", page.read_text(), flags=re.M)
    return [shlex.split(line, comments=True)[1:] for line in lines]


def named(pages: list[Path]) -> list[str]:
    return [str(page.relative_to(ROOT)) for page in pages]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", named([page for page in PAGES if blocks(page, "python")]))
def test_blocks_run_and_print_what_they_say(
    page: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One after the other, in one namespace; `print(…)  # text: why` prints text."""
    names: dict[str, object] = {"__name__": "page"}
    for number, text in enumerate(blocks(ROOT / page, "python")):
        code = compile(text, f"{page}, block {number}", "exec", dont_inherit=True)
        exec(code, names)
        printed = capsys.readouterr().out
        for said in re.findall(r"^print\(.*\)  # ([\d[].*?)(?::|$)", text, flags=re.M):
            assert said in printed, f"{page}, block {number} prints {printed!r}"


@pytest.mark.parametrize("page", named([page for page in PAGES if commands(page)]))
def test_commands_are_there(page: str) -> None:
    for words in commands(ROOT / page):
        command = [word for word in words if not word.startswith("-")][:1]
        told = CliRunner().invoke(app, [*command, "--help"])
        assert told.exit_code == 0, words
        for option in (word for word in words if word.startswith("--")):
            assert option in told.output, words


def test_commands_of_the_tutorial_run(folder: Path) -> None:
    for words in commands(ROOT / "docs/tutorial.md"):
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, f"{words}\n{result.output}\n{result.exception!r}"
    assert (folder / "report/index.html").stat().st_size


def test_the_reference_names_all_that_is_public() -> None:
    text = (ROOT / "docs/reference/python.md").read_text()
    named = set(re.findall(r"^\.\. auto\w+:: (\w+)$", text, flags=re.M))
    assert set(glambda.__all__) - {"__version__"} <= named
    assert all(hasattr(glambda, name) for name in named)


@pytest.mark.parametrize("page", named(PAGES))
def test_files_that_are_named_are_there(page: str) -> None:
    text = (ROOT / page).read_text()
    for name in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (ROOT / page).parent.joinpath(name).exists(), f"{page}: {name}"


@pytest.mark.parametrize(
    ("page", "kind", "name"), [(SOLVER, "solver", "mine"), (SCENE, "scene", "slide")]
)
def test_pages_show_the_plug_in_that_is_begun(page: Path, kind: str, name: str) -> None:
    files = package(kind, name)
    assert blocks(page, "python")[0] in files[f"src/{name}.py"]
    (shown,) = blocks(page, "toml")
    declared = tomllib.loads(files["pyproject.toml"])["project"]["entry-points"]
    assert tomllib.loads(shown)["project"]["entry-points"] == declared


@pytest.fixture
def importable(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    for place in (folder / "mine/src", folder):  # a folder `mine` that is no package comes first
        monkeypatch.syspath_prepend(str(place))
    yield folder
    sys.modules.pop("mine", None)


@pytest.mark.parametrize("kind", ["solver", "scene"])
def test_a_plug_in_that_is_begun_passes_its_own_test(kind: str, importable: Path) -> None:
    begun = CliRunner().invoke(app, ["new", kind, "mine"])
    assert begun.exit_code == 0, begun.output
    importlib.invalidate_caches()  # the folder has been looked into before the package was there
    tests: dict[str, object] = {}
    exec((importable / "mine/tests/test_mine.py").read_text(), tests)
    (test,) = (value for name, value in tests.items() if name.startswith("test_"))
    assert callable(test)
    test()
    again = CliRunner().invoke(app, ["new", kind, "mine"])
    assert again.exit_code == 2 and "there already" in again.output


@pytest.mark.parametrize("name", ["class", "my-solver", "Mine", ""])
def test_names_that_cannot_be_imported_are_refused(name: str, folder: Path) -> None:
    refused = CliRunner().invoke(app, ["new", "solver", name])
    assert refused.exit_code == 2 and "small letters" in refused.output
    assert not list(folder.iterdir())
