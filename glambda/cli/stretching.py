"""`glambda stretch`: recordings with QPs as ill-conditioned as asked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import Files, app, split_names, terminal, told
from glambda.cli.streams import say


@app.command()
@told
def stretch(
    files: Files,
    condition: Annotated[
        str, typer.Option(help="condition numbers of A, with commas between")
    ] = "1e2,1e4,1e6",
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("recordings"),
) -> None:
    """Make the QPs of recordings as ill-conditioned as asked, with the same x* and working sets.

    The condition of A is 15 at most in the paper's scenes. What squaring it costs shows when the
    stretched recordings are replayed through the packages in each form that they take:

    glambda stretch recordings/fig4.h5 -o stretched

    glambda replay stretched/*.h5 --solvers forms -o results
    """
    from harness.progress import shown
    from harness.recordings.recording import read_recording, write_recording
    from harness.study.stretch import stretched

    for path in files:
        recording = read_recording(path)
        for text in split_names(condition, []):
            with shown("stretch", terminal(err=True)) as tell:
                made = stretched(recording, float(text), tell)
            target = output / f"{made.scene}.h5"
            write_recording(target, made)
            known = sum(reference is not None for reference in made.references)
            say(f"{target}: {len(made.qps)} QPs, {known} with a reference")
