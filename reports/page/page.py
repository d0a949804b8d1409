"""The report: tables, figures and one page that stands alone.

    OUT/index.html          all inside: figures, style, a small script; no other address
    OUT/player_*.html       each recorded scene in motion, step by step
    OUT/*/index.html        pages of what other commands stored (`reports.page.site`)
    OUT/findings.md         what was found, in sentences
    OUT/tables/*.csv        the same tables, those of all settings in one
    OUT/figures/*.svg, *.png

1. Read the results folder (`reports.rows.results`).
2. Make every table that its rows allow, and write it as CSV.
3. Draw every figure, as SVG for the page and as PNG for elsewhere.
4. Put the answers first, then the evidence, then where our method loses, then how to get
   the same numbers again.

The same results give the same bytes: there is no date on the page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from harness.names import is_own
from reports.motions.frames import plot_scene
from reports.motions.network import is_network
from reports.motions.player import write_player
from reports.page.findings_page import findings_page
from reports.page.headlines import facts, not_to_conclude, pooled, ranked_tables, short_answers
from reports.page.page_figures import figure_markup
from reports.page.site import Site, write_site
from reports.parts.sentences import join
from reports.parts.style import draw_files
from reports.parts.table import Table, write_tables, write_text
from reports.parts.templates import environment_of, inlined
from reports.rows.comparison import compare
from reports.rows.results import ARMS, METHOD, Results, load_results
from reports.sections.certificates import (
    certificates_answer,
    certificates_of,
    certificates_tables,
    plot_certificates,
    references_table,
)
from reports.sections.clocks import clocks_table
from reports.sections.disturbances import disturbances_table
from reports.sections.figures import plot_accuracy, plot_cost, plot_profiles
from reports.sections.findings import (
    how_accurate,
    sequence_arm,
    warm_start_worth,
    which_method,
)
from reports.sections.forms import form_rows, forms_answer, forms_tables, plot_forms
from reports.sections.live_profile import live_profile
from reports.sections.outside import (
    answers_table,
    outside_answer,
    outside_scenes,
    outside_tables,
    plot_outside,
)
from reports.sections.pareto import (
    pareto_answer,
    pareto_tables,
    plot_pareto,
    sweep_rows,
    swept_scenes,
)
from reports.sections.physics import physics_table
from reports.sections.protocol import protocol, recordings_table, reproduce, versions_table
from reports.sections.ranking import ranking_table
from reports.sections.spread import spread_table
from reports.sections.starts import plot_starts, starts_answer, starts_tables
from reports.sections.tables import (
    accuracy_table,
    cost_table,
    losses,
    scene_table,
    slow_starts,
    verified_table,
    warm_table,
)
from reports.sections.thresholds import (
    criterion_answer,
    criterion_tables,
    keeper,
    thresholds,
)
from reports.sections.warm_worth import change_table, split_table
from reports.sections.work import plot_work, work_rows
from reports.sections.worst import worst_table

LONG = 60
"""Characters from which the text of a cell may be broken into lines."""


def write_report(results_dir: str | Path, out_dir: str | Path) -> Path:
    """Write the report of a results folder and return the path of its page.

    What the folder does not hold is said on the page.  Raises ValueError where the folder is not
    there, holds nothing, or holds solves that must not stand in one table.
    """
    results, out = load_results(results_dir), Path(out_dir)
    return report(results, out, write_site(Path(results_dir), out))


def report(results: Results, out: Path, site: Site | None = None) -> Path:
    """Write the report of results that were read already.

    site : the pages beside it (`reports.page.site.write_site`)
    """
    writer = _Writer(results, out, site or Site())
    context = writer.context()
    tables = write_tables(out / "tables", writer.made)
    told = {name: context[name] for name in ("lead", "answers", "missing", "unflattering")}
    write_text(out / "findings.md", findings_page(**told, tables=tables))
    return write_text(out / "index.html", writer.page(context))


class _Writer:
    """Makes each table and figure once, for its file and for the page.

    made : the tables that have a file
    """

    def __init__(self, results: Results, out: Path, site: Site) -> None:
        self.results, self.site = results, site
        self.made: list[Table] = []
        self.out, self.figures = out, out / "figures"

    def table(self, table: Table) -> dict[str, Any]:
        """Keep a table for its file; returns what the template needs."""
        self.made.append(table)
        return table_context(table)

    def figure(self, name: str, caption: str, draw: Callable[[Path], Any]) -> dict[str, str]:
        """Draw a figure as SVG and PNG; returns what the template needs."""
        name = slug(name)
        draw_files(draw, self.figures / name)
        return {"markup": figure_markup(self.figures / name, caption), "caption": caption}

    def page(self, context: dict[str, Any]) -> str:
        """The whole page as text; context : everything that the template shows."""
        from markupsafe import Markup

        environment = environment_of()
        for entry in _figures_in(context):
            entry["markup"] = Markup(entry["markup"])
        environment.filters["prose"] = prose
        texts = inlined(
            environment, style=["page.css"], script=["page.js", "worst.js", "profile.js"]
        )
        page = environment.get_template("page.html.j2").render(**texts, **context)
        return page + "\n"

    def context(self) -> dict[str, Any]:
        """Everything that the template shows."""
        results = self.results
        criterion = [self.table(table) for table in criterion_tables(results)]
        found = certificates_of(results)
        outside = outside_tables(results)
        candidates = [
            which_method(results),
            how_accurate(results),
            certificates_answer(results, found),
            warm_start_worth(results),
            criterion_answer(results),
            starts_answer(results),
            forms_answer(results),
            pareto_answer(results),
            outside_answer(outside),
        ]
        rows = pooled(results)
        context: dict[str, Any] = {
            "lead": lead(results),
            "facts": facts(results),
            "short": short_answers(results, rows),
            "cautions": not_to_conclude(results, rows, bool(self.site.losses)),
            "ranked": [self.table(table) for table in ranked_tables(results, rows)],
            "site": self.site,
            "worst": self.worst(),
            "times": live_profile(rows),
            "scenes": results.scenes,
            "answers": [answer for answer in candidates if answer is not None],
            "missing": results.missing,
            "scene_table": self.table(scene_table(results)),
            "frames": [self.scene(scene) for scene in results.scenes],
            "accuracy": self.accuracy(),
            "trust": self.trust(found),
            "cost": self.cost(),
            "pareto": self.pareto(),
            "warm": self.warm(),
            "starts": self.starts(),
            "forms": self.forms(),
            "disturbed": self.disturbed(),
            "outside": self.outside(outside),
            "criterion": criterion,
            "unflattering": unflattering(results, self.site.losses),
            "protocol": protocol(results),
            "versions": self.table(versions_table(results)) if len(results.rows) else None,
            "recordings": self.table(recordings_table(results)),
            "commands": reproduce(results),
        }
        context["contents"] = _contents(context)
        context["anchors"] = [anchor for anchor, _ in context["contents"]]
        return context

    def worst(self) -> dict[str, Any]:
        """The worst QPs as the page's script shows them."""
        table = worst_table(self.results)
        self.made.append(table)
        return {"rows": table.display().to_numpy().tolist()}

    def scene(self, scene: str) -> dict[str, Any]:
        """Frames and work over time of one scene, as far as they are stored."""
        results = self.results
        entry: dict[str, Any] = {"label": scene, "frames": None, "work": None, "player": None}
        recording = results.recordings.get(scene)
        if recording is not None and len(recording.t):
            entry["frames"] = self.figure(
                f"frames_{scene}",
                f"{scene}: the bodies at {_times(recording)}; the time stands under each frame.",
                lambda path: plot_scene(recording, path),
            )
            if not is_network(recording):
                entry["player"] = self.player(scene, recording)
        if len(work_rows(results, scene)):
            threshold = thresholds(results).get(scene)
            entry["work"] = self.figure(
                f"work_{scene}",
                f"{scene}, {keeper(results)} warm at setting {results.headline}: events, number of "
                "multipliers, descent directions and conjugate gradient iterations along the "
                "motion.  Ticks at the foot: factorizations."
                + ("  Dashed: the paper's threshold √(2 C_QR/C_IT)." if threshold else ""),
                lambda path: plot_work(results, scene, path, threshold=threshold),
            )
        return entry

    def player(self, scene: str, recording: Any) -> str:
        """Write the player of a scene; returns the name of its file."""
        rows, results = self.results.rows, self.results
        chosen = (rows["scene"] == scene) & (rows["settings"] == results.headline)
        if results.headline is not None:
            chosen &= rows["arm"] == sequence_arm(results)
        path = self.out / f"player_{slug(scene)}.html"
        return write_player(recording, path, rows[chosen], home="index.html#scenes").name

    def accuracy(self) -> dict[str, Any] | None:
        results = self.results
        if results.headline is None:
            return None
        shares = (verified_table(results, name) for name in results.settings)
        overviews = [table_context(table) for table in shares]  # in the table of accuracy already
        full = [self.table(accuracy_table(results, name)) for name in results.settings]
        return {
            "overview": {**overviews[0], "notes": full[0]["notes"]},
            "tables": [*full, *overviews[1:]],
            "figures": [self.accuracy_figure(name) for name in _with_errors(results)],
        }

    def trust(self, found: pd.DataFrame) -> dict[str, Any] | None:
        """What verdicts rest on; found : of `certificates_of`."""
        if not self.results.recordings:
            return None
        figures = []
        if len(found):
            figures = [
                self.figure(
                    "certificates",
                    "The bound on the error in Gλ that needs no reference, over the true error, "
                    "for answers that are right, nearly right and wrong on purpose.",
                    lambda path: plot_certificates(found, path),
                )
            ]
        return {
            "references": self.table(references_table(self.results)),
            "tables": [self.table(table) for table in certificates_tables(found)],
            "figures": figures,
            "physics": [
                self.table(physics_table(self.results, name)) for name in self.results.settings
            ],
        }

    def accuracy_figure(self, setting: str) -> dict[str, str]:
        return self.figure(
            f"accuracy_{setting}",
            f"Setting {setting}: error in Gλ over the accuracy asked.  A thin line runs from the "
            "least to the largest error, the thick one over the middle 90 %, the mark is the "
            "median.",
            lambda path: plot_accuracy(self.results, setting, path),
        )

    def cost(self) -> dict[str, Any] | None:
        results = self.results
        if results.headline is None:
            return None
        arm = sequence_arm(results)
        ranked = [self.table(ranking_table(results, name, arm)) for name in results.settings]
        clocks = [self.table(clocks_table(results, name, arm)) for name in results.settings]
        tables = [self.table(cost_table(results, name)) for name in results.settings]
        tables += ranked[1:] + clocks[1:]
        tables += [self.table(spread_table(results, name)) for name in results.settings]
        figures = []
        name = _with_times(results)
        if name is not None:
            figures = [
                self.figure(
                    f"cost_{name}",
                    f"Setting {name}: median time per QP, cold and warm, fastest backends first.",
                    lambda path: plot_cost(results, name, path),
                ),
                self.figure(
                    f"profiles_{name}",
                    f"Setting {name}: share of the QPs on which a backend is verified and within "
                    "a factor τ of the fastest one.  Higher and further left is better; where a "
                    "curve levels off is the share that it solves at all.",
                    lambda path: plot_profiles(results, name, path),
                ),
            ]
        return {
            "ranking": ranked[0],
            "clocks": clocks[0],
            "headline": tables[0],
            "tables": tables[1:],
            "figures": figures,
        }

    def pareto(self) -> dict[str, Any] | None:
        tables = [self.table(table) for table in pareto_tables(self.results)]
        swept = swept_scenes(sweep_rows(self.results))
        if not tables and not swept:
            return None
        figures = [
            self.figure(
                f"pareto_{scene}",
                f"{scene}: error in Gλ against the time of a QP, each backend swept over the "
                "accuracy that is asked of it; left and below is better, and the front is set off.",
                lambda path, scene=scene: plot_pareto(self.results, scene, path),  # type: ignore[misc]
            )
            for scene in swept
        ]
        return {"tables": tables, "figures": figures}

    def starts(self) -> dict[str, Any] | None:
        tables = [self.table(table) for table in starts_tables(self.results)]
        if not tables:
            return None
        figure = self.figure(
            "starts",
            "Time of a QP over that of the same backend's cold solve, by what it is started from, "
            "best first; faint lines are scenes.  Checks stand apart.",
            lambda path: plot_starts(self.results, path),
        )
        return {"headline": tables[0], "tables": tables[1:], "figures": [figure]}

    def forms(self) -> dict[str, Any] | None:
        tables = [self.table(table) for table in forms_tables(self.results)]
        if not tables:
            return None
        figures = []
        if form_rows(self.results)["decade"].notna().any():
            figures = [
                self.figure(
                    "forms",
                    "Error in Gλ against the condition of A, by what the package is posed.",
                    lambda path: plot_forms(self.results, path),
                )
            ]
        return {"headline": tables[0], "tables": tables[1:], "figures": figures}

    def disturbed(self) -> dict[str, Any] | None:
        table = disturbances_table(self.results)
        return None if table is None else self.table(table)

    def outside(self, tables: list[Table]) -> dict[str, Any] | None:
        if not tables:
            return None
        figures = []
        if outside_answer(tables) is not None:
            figures = [
                self.figure(
                    "outside",
                    "Recordings from outside: time of a QP over that of ours, of all backends that "
                    "are verified on every QP; the fastest of the others is named.",
                    lambda path: plot_outside(tables[0], path),
                )
            ]
        own = answers_table(self.results)
        made = [self.table(table) for table in (*tables, *([own] if own else []))]
        return {"headline": made[0], "tables": made[1:], "figures": figures}

    def warm(self) -> dict[str, Any] | None:
        results = self.results
        if not set(ARMS) <= set(results.rows["arm"].unique()):
            return None
        tables = [self.table(warm_table(results, name)) for name in results.settings]
        told_apart = [split_table(results, name) for name in results.settings]
        changed = [change_table(results, name) for name in results.settings[:1]]
        more = [self.table(table) for table in (*told_apart, *changed) if table is not None]
        tables = [*more, *tables]
        return {"headline": tables[0], "tables": tables[1:]}


def table_context(table: Table) -> dict[str, Any]:
    """A table as the template draws it: rows grouped by scene, cells with their classes.

    A share below 100 % and a count of misses are marked, and so is the best of a scene.
    """
    shown = table.display()
    columns = [{"name": name, "numeric": table.numeric(name)} for name in shown.columns]
    grouped = "scene" in shown.columns and shown["scene"].duplicated().any()
    hidden = "scene" if grouped else None
    groups: list[dict[str, Any]] = []
    for index, row in enumerate(shown.to_dict("records")):
        name = row["scene"] if grouped else ""
        if not groups or groups[-1]["name"] != name:
            groups.append({"name": name, "rows": []})
        cells = [
            {
                "text": row[column["name"]],
                "classes": _classes(table, column, index, row[column["name"]]),
            }
            for column in columns
            if column["name"] != hidden
        ]
        own = is_own(str(row.get("solver", "")))
        groups[-1]["rows"].append({"cells": cells, "own": own})
    return {
        "name": table.name,
        "title": table.heading,
        "reading": table.reading,
        "notes": list(table.notes),
        "columns": [column for column in columns if column["name"] != hidden],
        "groups": groups,
        "rows": len(shown),
    }


def _classes(table: Table, column: dict[str, Any], index: int, text: str) -> str:
    names = [] if column["numeric"] else ["t"]
    if len(text) > LONG:
        names.append("long")
    value = table.data[column["name"]].iloc[index]
    share = "verified" in column["name"] or table.name.startswith("verified")
    if share and column["numeric"] and value < 1:
        names.append("miss")
    if column["name"] in ("misses", "claimed wrong", "no answer") and value > 0:
        names.append("miss")
    if "÷ best" in column["name"] and text == "1.00×":
        names.append("best")
    return " ".join(names)


def lead(results: Results) -> str:
    """What was done, in one sentence of counts."""
    apart = outside_scenes(results)
    scenes = [scene for scene in results.scenes if scene not in apart] or results.scenes
    said = f"{len(scenes)} scene{'s' * (len(scenes) != 1)} ({join(scenes, 10)})"
    if 0 < len(apart) < len(results.scenes):
        said += f" and {len(apart)} recording{'s' * (len(apart) != 1)} from outside"
    if results.recordings:
        known = [results.recordings[name] for name in results.scenes if name in results.recordings]
        qps = sum(len(recording.qps) for recording in known)
        imported = all(recording.parameters.get("source") == "import" for recording in known)
        said += f", {'imported' if imported else 'simulated and recorded'}: "
        said += f"{qps:,} quadratic programs"
    rows = results.rows
    if len(rows):
        said += (
            f", solved {int((~rows['skipped']).sum()):,} times by {len(results.solvers)} backends "
            f"at {join([f'setting {name}' for name in results.settings])}, each answer judged"
        )
    return said + "."


def unflattering(results: Results, raced: Sequence[str] = ()) -> list[str] | None:
    """Where our method does not win, or a warm start slows it; None if it was not run.

    raced : the same of a race (`Site.losses`), which comes first
    """
    if METHOD not in results.solvers:
        return None
    return [*raced, *_in_the_study(results)]


def _in_the_study(results: Results) -> list[str]:
    """The same of its solves alone."""
    said: list[str] = []
    against_others = alone = 0
    for setting in results.settings:
        for scene, arm in _runs(results):
            comparison = compare(results.rows, scene, setting, arm)
            said += losses(comparison)
            if METHOD in comparison.solvers and not all(map(is_own, comparison.solvers)):
                against_others += 1
            elif comparison.qps:
                alone += 1
        said += slow_starts(results, setting)
    if said:
        return said
    if not against_others:
        return [f"{METHOD} was compared with nobody else."]
    said = [
        "Nowhere in this study: in each comparison of a scene, an arm and a setting in which it "
        f"stood against others ({against_others}) {METHOD} was verified on every QP and had the "
        "least median time."
    ]
    if alone:
        said.append(f"In {alone} more it, or everybody else, was missing.")
    return said


def prose(text: str) -> Any:
    """A sentence as HTML: numbers keep their units beside them, C_QR and C_IT get an index."""
    from markupsafe import Markup, escape

    text = str(escape(text))
    text = re.sub(r"(?<=\d) (?=%|µs\b|s\b)", "\u00a0", text)
    text = text.replace("√(2 C", "√(2\u00a0C")
    return Markup(re.sub(r"\bC_(QR|IT|0)\b", r"C<sub>\1</sub>", text))


def slug(name: str) -> str:
    """A label as a file name."""
    return re.sub(r"[^\w.=+-]+", "_", name)


def _times(recording: Any) -> str:
    return f"chosen times from {float(recording.t[0]):.2f} s to {float(recording.t[-1]):.2f} s"


def _runs(results: Results) -> list[tuple[str, str]]:
    """All scenes, in either arm."""
    return [(scene, arm) for scene in results.scenes for arm in ARMS]


def _with_times(results: Results) -> str | None:
    """The first setting at which there are times to compare."""
    for setting in results.settings:
        for scene, arm in _runs(results):
            if len(compare(results.rows, scene, setting, arm).rows):
                return setting
    return None


def _with_errors(results: Results) -> list[str]:
    """Settings at which some error is known."""
    rows = results.rows
    known = set(rows.loc[~rows["skipped"] & rows["asked_ratio"].notna(), "settings"].unique())
    return [name for name in results.settings if name in known]


def _figures_in(value: Any) -> list[dict[str, Any]]:
    """All figures of a context, wherever they stand."""
    if isinstance(value, dict):
        if "markup" in value:
            return [value]
        return [entry for part in value.values() for entry in _figures_in(part)]
    if isinstance(value, list):
        return [entry for part in value for entry in _figures_in(part)]
    return []


def _contents(context: dict[str, Any]) -> Sequence[tuple[str, str]]:
    """Anchors and titles of the sections that the page has."""
    return [
        (anchor, title)
        for anchor, title, there in (
            ("unflattering", "Where our method loses", context["unflattering"] is not None),
            ("ablation", "Our variants", len(context["ranked"]) > 1),
            ("scenes", "The scenes", True),
            ("accuracy", "Accuracy", context["accuracy"]),
            ("trust", "Why trust the verdicts", context["trust"]),
            ("cost", "Cost", context["cost"]),
            ("pareto", "Time against accuracy", context["pareto"]),
            ("warm-start", "Warm start", context["warm"]),
            ("starts", "Quality of the start", context["starts"]),
            ("forms", "Forms of the QP", context["forms"]),
            ("disturbed", "Disturbances", context["disturbed"]),
            ("outside", "Outside the four scenes", context["outside"]),
            ("criterion", "Criterion", context["criterion"]),
            ("protocol", "How it was measured", True),
            ("reproduce", "How to reproduce", True),
        )
        if there
    ]
