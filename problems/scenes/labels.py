"""Labels of scenes, such as "fig4,mu_I=0.8": read and written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

PAPER_SCENES = ("fig2", "fig3", "fig4", "fig5")


def parse_label(label: str) -> tuple[str, dict[str, Any]]:
    """Scene name and parameters of a label such as "fig4,mu_I=0.8".

    Raises ValueError for a parameter without a value.
    """
    name, *chosen = label.split(",")
    return name, parse_settings(chosen)


def parse_settings(pairs: Sequence[str]) -> dict[str, Any]:
    """{name: value} of "name=value" strings; values become bool, int or float where they can.

    Raises ValueError for a string without "=", or a name that comes twice.
    """
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = (part.strip() for part in pair.partition("="))
        if not (equals and name and text):
            raise ValueError(f"{pair!r} is no setting; write name=value, such as mu_I=0.8")
        if name in values:
            raise ValueError(f"{name} is given twice, {values[name]} and {text}; give it once")
        values[name] = _value(text)
    return values


def _value(text: str) -> Any:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
