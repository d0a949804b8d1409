"""The site: pages of what is stored under the results, linked both ways; the rest is named."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from harness.recordings.recording import write_recording
from reports.page.page import write_report
from reports.page.site import body_of, write_site
from tests.reports.browser import Browser, found
from tests.reports.test_reports import make_recording

GROWTH = """# Time against size

![times](growth.png)

| family | bodies | <b>k</b> |
|:-------|-------:|---------:|
| tower  |     10 |       20 |

[growth.csv](growth.csv)
"""
RACE = "scene,arm,clock,best,ratio\nfig2,cold,inside the package,daqp,0.5\n"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    results = tmp_path_factory.mktemp("results")
    for folder in ("recordings", "growth", "stability", "older", "race", "solves"):
        (results / folder).mkdir()
    write_recording(results / "recordings" / "fig2.h5", make_recording("fig2"))
    (results / "growth" / "growth.md").write_text(GROWTH, encoding="utf-8")
    (results / "growth" / "growth.csv").write_text("k\n20\n", encoding="utf-8")
    (results / "growth" / "rows.parquet").write_bytes(b"not for a reader")
    (results / "stability" / "stability.md").write_text("# Figure 1 & more\n", encoding="utf-8")
    (results / "race" / "race.md").write_text("# A race\n", encoding="utf-8")
    (results / "race" / "race_ratios.csv").write_text(RACE, encoding="utf-8")
    (results / "older" / "findings.md").write_text("# Another study\n", encoding="utf-8")
    return write_report(results, results / "report").parent


def links(page: Path) -> list[str]:
    return re.findall(r'href="([^"#]+)', page.read_text(encoding="utf-8"))


def test_pages_are_linked_both_ways_and_every_link_leads_somewhere(site: Path) -> None:
    first = site / "index.html"
    others = [site / "growth/index.html", site / "stability/index.html", site / "player_fig2.html"]
    for page in others:
        assert page.relative_to(site).as_posix() in links(first)
        assert any((page.parent / link).resolve() == first.resolve() for link in links(page))
    assert "../stability/index.html" in links(others[0])
    for page in (first, *others):
        for link in links(page):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_what_is_not_stored_is_named_and_what_is_is_not(site: Path) -> None:
    text = (site / "index.html").read_text(encoding="utf-8")
    (said,) = re.findall(r"Left out, not stored: (.*?)\.<", text)
    assert "glambda peers" in said and "glambda closed-loop" in said and "growth" not in said


def test_what_a_race_has_lost_is_said_first(site: Path) -> None:
    (said,) = write_site(site.parent, site).losses
    assert "fig2 cold (daqp, 2.00×)" in said


def test_only_what_a_page_consists_of_is_copied(site: Path) -> None:
    names = {path.name for path in (site / "growth").iterdir()}
    assert names == {"index.html", "growth.md", "growth.csv"}
    assert not (site / "older").exists()


def test_markdown_becomes_tables_and_never_markup_of_its_own() -> None:
    body = body_of(GROWTH)
    assert body.count('<div class="scroll"><table>') == 1 and "&lt;b&gt;k" in body
    assert '<td style="text-align:right">20</td>' in body


def test_a_page_fits_a_phone(site: Path, tmp_path: Path) -> None:
    if found() is None:
        pytest.skip("no Chromium is installed")
    with Browser(tmp_path, 400, 800) as browser:
        browser.size(400, 800, phone=True)
        browser.open(site / "stability" / "index.html")
        assert browser("document.documentElement.scrollWidth") <= 400
        assert browser.said == []
