"""What a study found as a short page in Markdown, which names the files of its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from reports.parts.sentences import Answer
from reports.parts.table import Table


def findings_page(
    lead: str,
    answers: Sequence[Answer],
    missing: Sequence[str],
    unflattering: Sequence[str] | None,
    tables: Mapping[str, Sequence[Table]],
) -> str:
    """Where our method loses, the answers, what is missing, and where the numbers are.

    tables : by name, those of one file together
    """
    parts = ["# One Gλ, many solvers", lead]
    if unflattering is not None:
        parts += ["## Where our method does not win", _listed(unflattering)]
    for answer in answers:
        parts += [f"## {answer.question}", f"**{answer.figure}** {answer.caption}"]
        parts.append(_listed(answer.sentences))
    if missing:
        parts += ["## What these results do not hold", _listed(missing)]
    files = [f"[{name}](tables/{name}.csv): {_contents(same)}." for name, same in tables.items()]
    parts += ["## The numbers", "[index.html](index.html) shows all of them.", _listed(files)]
    return "\n\n".join(parts) + "\n"


def _contents(tables: Sequence[Table]) -> str:
    """What a file holds, such as "Accuracy, by setting"."""
    first = tables[0]
    return first.title + "".join(f", by {name}" for name in first.key)


def _listed(sentences: Sequence[str]) -> str:
    return "\n".join(f"- {sentence}" for sentence in sentences)
