"""The templates of pages: one environment for all, and their style and script as one text each."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


def environment_of() -> Environment:
    """Where templates are looked up; an unknown name in one is an error."""
    environment = Environment(
        loader=PackageLoader("reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["json"] = as_json
    return environment


def as_json(value: Any) -> Markup:
    """JSON that can stand in a script of a page: nothing in it ends the script."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return Markup(text.replace("<", "\\u003c"))


def inlined(environment: Environment, **files: Sequence[str]) -> dict[str, Markup]:
    """Texts of files under the names that a template has for them."""
    return {
        name: Markup("\n".join(environment.get_template(file).render() for file in several))
        for name, several in files.items()
    }
