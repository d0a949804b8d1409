"""The table of foils: springs, and impulses by Newton and Coulomb, beside the paper's model."""

from __future__ import annotations

import pandas as pd

from reports.parts.table import Table, scientific, short, whole


def foils_table(rows: pd.DataFrame) -> Table:
    """Where figures 4 and 5 come to, by each way."""
    return Table(
        name="foils",
        title="Springs and other impulses beside the paper's model",
        reading=(
            "x of the bodies at 3 s [m], the fastest of them, and the largest difference of a pose "
            "from the paper's model [m, rad]. Both rules of impulses take mu_I for their "
            "coefficient: where it is 0 they are one. Cundall's springs, critically damped, are as "
            "stiff as h allows and rub with mu in collisions as well, so that they are another "
            "model: they do not come to the paper's pose as h falls. Their steps have no events."
        ),
        data=rows,
        formats={
            "steps": whole,
            "impulses": whole,
            **{f"x{body}": lambda x: f"{float(x):.4f}" for body in (1, 2, 3)},
            "fastest": scientific,
            "off": short,
        },
    )
