"""How things that hold many numbers are shown: by their sizes, in one line or a small table."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

ONE = {"bodies": "body"}
"""What one of them is called where that is not the word without its s."""


class Short:
    """Shown by what `_title` and `_sizes` say, at a prompt and in a notebook.

    A dataclass that derives from it is declared with repr=False.
    """

    def _title(self) -> str:
        """What it is called, or nothing."""
        return ""

    def _sizes(self) -> Mapping[str, Any]:
        """{what: how many, a whole number, or how much, anything else}."""
        raise NotImplementedError

    def __repr__(self) -> str:
        sizes = ", ".join(_phrase(what, size) for what, size in self._sizes().items())
        title = self._title()
        return f"{type(self).__name__}({title}{': ' if title else ''}{sizes})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{escape(what)}</th><td>{escape(_amount(size))}</td></tr>"
            for what, size in self._sizes().items()
        )
        caption = " ".join([type(self).__name__, self._title()]).strip()
        return f"<table><caption>{escape(caption)}</caption>{rows}</table>"


def _phrase(what: str, size: Any) -> str:
    """ "1,204 QPs", or "t = 3.2 s"; one of several is told without its s."""
    if not isinstance(size, int):
        return f"{what} = {size}"
    return f"{_amount(size)} {ONE.get(what, what.removesuffix('s')) if size == 1 else what}"


def _amount(size: Any) -> str:
    return f"{size:,}" if isinstance(size, int) else str(size)
