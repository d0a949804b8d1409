"""`glambda import | export | certify`: QPs from elsewhere, and for elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glambda.cli.app import Files, app, terminal, told
from glambda.cli.streams import say

FOREIGN = "(.npz, .parquet, .mat, .hdf5, .dat)"


@app.command("import")
@told
def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help=f"of others {FOREIGN}")],
    name: Annotated[
        str | None,
        typer.Option(help="one recording of this name, of all files in the order given"),
    ] = None,
    apart: Annotated[
        bool, typer.Option("--apart", help="no QP has to do with the one before: no warm starts")
    ] = False,
    tolerance: Annotated[
        float, typer.Option(help="relative size of what may be dropped: asymmetry, indefiniteness")
    ] = 1e-9,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="also where another recording of the name is")
    ] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("recordings"),
) -> None:
    """Make recordings of QPs that others have stored.

    NumPy archives of (A, b, lb, ub) or (P, q, G, h, A, b, lb, ub), one problem or a sequence; test
    sets of qpbenchmark; Maros and Mészáros' problems; FCLIB; Siconos. Each file becomes a recording
    with a reference for every QP, which all commands take. What has no contact meaning has no
    physics either.

    Example:  glambda import mpc_*.npz --name mpc -o recordings
    """
    from glambda.cli.simulation import write_new
    from harness.exchange.importing import import_files
    from harness.progress import shown
    from harness.study.kept_recording import kept_recording

    groups = [[path] for path in files] if name is None else [files]
    for group in groups:
        with shown(f"import {group[0].name}", terminal(err=True)) as tell:
            made = import_files(group, name=name, apart=apart, tolerance=tolerance, progress=tell)
        path = output / f"{made.scene}.h5"
        write_new(path, made, None if overwrite else kept_recording(path))
        form = made.parameters.get("import.form")
        known = sum(reference is not None for reference in made.references)
        say(f"{path}: {len(made.qps)} QPs, {known} with a reference, {form}")


@app.command()
@told
def export(
    files: Files,
    form: Annotated[str, typer.Option("--as", help="npz, qpbenchmark, fclib or benchopt")] = "npz",
    output: Annotated[Path, typer.Option("-o", "--output", help="folder")] = Path("exported"),
) -> None:
    """Write recordings as others read them.

    npz: A, b, lb, ub, to the last bit. qpbenchmark: a test set with P = AᵀA. fclib: a local problem
    in the plane for each QP of contacts. benchopt: a benchmark with the QPs as its dataset.

    Example:  glambda export recordings/fig4.h5 --as qpbenchmark -o exported
    """
    from harness.exchange.exporting import export as export_recording
    from harness.recordings.recording import read_recording

    for path in files:
        written = export_recording(read_recording(path), form, output)
        say(str(written[0]) + (f" and {len(written) - 1} more" if len(written) > 1 else ""))


@app.command()
@told
def certify(
    files: Files,
    certificate: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="F.cert", help="default: beside the recording"),
    ] = None,
) -> None:
    """Write certificates: of each QP the working set and x as fractions, which anybody can check.

    The checker that is named at the end needs nothing but Python.

    Example:  glambda certify recordings/fig4.h5 -o fig4.cert
    """
    from harness.exchange.certificates import CHECKER
    from harness.exchange.certificates import certify as certify_recording
    from harness.progress import shown
    from harness.recordings.recording import read_recording

    if certificate is not None and len(files) > 1:
        raise ValueError(f"-o {certificate}: is one file for {len(files)} recordings; leave it out")
    for path in files:
        target = path.with_suffix(".cert") if certificate is None else certificate
        with shown(f"certify {path.name}", terminal(err=True)) as tell:
            made = certify_recording(read_recording(path), target, tell)
        say(f"{target}: {made.made} QPs certified, {len(made.without)} without")
    say(f"to check: python {CHECKER} {target}")
