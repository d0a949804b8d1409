"""Sphinx: the documentation as a site, with the command line as Typer tells it.

Pages are Markdown (MyST), so that they can be read without being built.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

project = "glambda"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
html_theme = "furo"
html_title = "glambda"
html_copy_source = False
exclude_patterns = ["_*"]
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"exclude-members": "__init__, __new__"}
python_use_unqualified_type_names = True
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing"]
"""Of links to files of the repository that are no pages."""


def commands() -> str:
    """The page of all commands, in Markdown, as their own help tells them."""
    import typer
    from typer.cli import get_docs_for_click

    from glambda.cli import app

    command: Any = typer.main.get_command(app)
    context: Any = typer.Context(command, info_name="glambda")
    return get_docs_for_click(obj=command, ctx=context, name="glambda", title="Command line")


def line_by_line(*event: Any) -> None:
    """Set docstrings as they are written, line by line; they are the last of what is told."""
    lines: list[str] = event[-1]
    for i, line in enumerate(lines):
        marks = "*" if line.count("`") % 2 == 0 else "*`"
        line = "".join(f"\\{c}" if c in marks else c for c in line)
        lines[i] = "| " + re.sub(r"(`[^`]+`)(?=\w)", r"\1\\ ", line)


def setup(app: Any) -> None:
    """What Sphinx calls first."""
    (HERE / "reference" / "commands.md").write_text(commands(), encoding="utf-8")
    app.connect("autodoc-process-docstring", line_by_line)
