"""The command that begins a plug-in: a package with a solver or a scene that works."""

from __future__ import annotations

import keyword
from pathlib import Path
from typing import Annotated, Literal

import typer

from glambda.cli.app import app, terminal, told

TEMPLATES = Path(__file__).parents[1] / "templates"


@app.command()
@told
def new(
    kind: Annotated[Literal["solver", "scene"], typer.Argument(help="what it adds")],
    name: Annotated[str, typer.Argument(help="of the package, and on the command line")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="folder to make; default: NAME")
    ] = None,
) -> None:
    """Begin a solver or a scene of your own: a package that works, with an entry point and a test.

    Example:  glambda new solver mine && pip install -e mine && glambda check solver mine
    """
    folder = Path(name) if output is None else output
    files = {folder / path: text for path, text in package(kind, name).items()}
    for place in files:
        if place.exists():
            raise ValueError(f"{place} is there already; name another folder with -o")
    for place, text in files.items():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text, encoding="utf-8")
    console = terminal()
    console.print(
        f"{folder}/src/{name}.py has a {kind} that works; make it yours, then", markup=False
    )
    console.print(f"  pip install -e {folder}\n  glambda check {kind} {name}", markup=False)


def package(kind: str, name: str) -> dict[str, str]:
    """Path → text of the files of a plug-in.

    Raises ValueError for a name that is no name of a module.
    """
    import jinja2

    if not name.isidentifier() or keyword.iskeyword(name) or not name.islower():
        raise ValueError(f"name {name!r}: give one that Python can import, in small letters")
    target = "".join(map(str.capitalize, name.split("_"))) if kind == "solver" else name
    loader = jinja2.FileSystemLoader(TEMPLATES)
    make = jinja2.Environment(loader=loader, keep_trailing_newline=True)
    files = {
        "pyproject.toml": "pyproject.toml.jinja",
        f"src/{name}.py": f"{kind}/module.py.jinja",
        f"tests/test_{name}.py": f"{kind}/test.py.jinja",
    }
    words = {"kind": kind, "name": name, "target": target}
    return {path: make.get_template(file).render(words) for path, file in files.items()}
