"""`glambda disturb`: recordings whose QPs are put otherwise, or slightly wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import Files, app, split_names, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def disturb(
    files: Files,
    kinds: Annotated[
        str,
        typer.Option(
            help="with commas between: permuted, scaled, duplicated, or the size of noise"
        ),
    ] = "permuted,scaled,duplicated,1e-12,1e-9,1e-6",
    seed: Annotated[int, typer.Option(help="of everything that is drawn")] = 1984,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("recordings"),
) -> None:
    """Number contacts and bodies otherwise, change signs and scales, repeat contacts, add noise.

    Who solves the original should solve these, in about the same time. The report of results with
    both tells who does not:

    glambda disturb recordings/fig4.h5 -o disturbed

    glambda replay disturbed/*.h5 -o results
    """
    from harness.progress import shown
    from harness.recordings.recording import read_recording, write_recording
    from harness.study.disturb import EVERY_KIND, disturbance, disturbed

    chosen = split_names(kinds, list(EVERY_KIND))
    for kind in chosen:
        disturbance(kind)
    for path in files:
        recording = read_recording(path)
        for kind in chosen:
            with shown("disturb", terminal(err=True)) as tell:
                made = disturbed(recording, kind, seed, tell)
            target = output / f"{made.scene}.h5"
            write_recording(target, made)
            known = sum(reference is not None for reference in made.references)
            say(f"{target}: {len(made.qps)} QPs, {known} with a reference")
