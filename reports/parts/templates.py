"""The templates of pages: one environment for all, and their style and script as one text each."""

from __future__ import annotations

from collections.abc import Sequence

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


def environment_of() -> Environment:
    """Where templates are looked up; an unknown name in one is an error."""
    return Environment(
        loader=PackageLoader("reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def inlined(environment: Environment, **files: Sequence[str]) -> dict[str, Markup]:
    """Texts of files under the names that a template has for them."""
    return {
        name: Markup("\n".join(environment.get_template(file).render() for file in several))
        for name, several in files.items()
    }
