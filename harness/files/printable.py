"""Texts of others, made fit to be printed.

What a file says may hold characters that a terminal obeys (escape sequences) or that turn the
direction of the line.  They are printed as Python writes them, such as \\x1b.
"""

from __future__ import annotations

import re
import unicodedata

_UNSEEN = ("Cc", "Cf", "Co", "Cs", "Zl", "Zp")
"""Categories of characters that are obeyed, or not to be seen."""
_NOT_ASCII_LETTERS = re.compile(r"[^ -~\n\t]")


def printable(text: str) -> str:
    """The text without characters that are obeyed instead of printed, but for \\n and \\t."""
    return _NOT_ASCII_LETTERS.sub(_shown, text)


def _shown(found: re.Match[str]) -> str:
    letter = found[0]
    if unicodedata.category(letter) in _UNSEEN:
        return letter.encode("unicode_escape").decode()
    return letter
