"""`glambda doctor`: what is wrong with this machine, before a study is timed on it."""

from __future__ import annotations

import typer

from glambda.cli.app import app, told
from glambda.cli.streams import say

MARKS = {"good": "ok", "wrong": "WRONG", "unknown": "?"}


@app.command()
@told
def doctor() -> None:
    """Is this machine fit to time anything? Exit 1 where something is wrong, with its remedy."""
    from harness.machine.doctor import examine

    found = examine()
    width = max(len(finding.topic) for finding in found)
    for finding in found:
        say(f"{MARKS[finding.level]:<5}  {finding.topic:<{width}}  {finding.said}")
        if finding.remedy:
            say(f"{'':<5}  {'':<{width}}  → {finding.remedy}")
    if any(finding.level == "wrong" for finding in found):
        raise typer.Exit(1)
