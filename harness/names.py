"""The words that rows are written in."""

from __future__ import annotations

METHOD = "lotstedt"
"""The paper's method; its variants are called `lotstedt[variant]`."""
