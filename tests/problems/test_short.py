"""What is shown at a prompt and in a notebook: sizes, whatever the arrays hold."""

from __future__ import annotations

from typing import Any

import pytest

from problems import scene
from problems.short import Short
from tests.fakes.fake_recordings import fake_recording


class Heap(Short):
    """One thing of everything."""

    def __init__(self, title: str, **sizes: Any) -> None:
        self.title, self.sizes = title, sizes

    def _title(self) -> str:
        return self.title

    def _sizes(self) -> dict[str, Any]:
        return self.sizes


def test_counts_and_amounts_in_one_line() -> None:
    heap = Heap("fig4", t="3.2 s", bodies=1, events=1, QPs=1204)
    assert repr(heap) == "Heap(fig4: t = 3.2 s, 1 body, 1 event, 1,204 QPs)"
    assert repr(Heap("", QPs=0)) == "Heap(0 QPs)"


def test_a_table_in_a_notebook() -> None:
    html = Heap("a < b", bodies=1204)._repr_html_()
    assert "<caption>Heap a &lt; b</caption>" in html
    assert "<tr><th>bodies</th><td>1,204</td></tr>" in html


def test_a_scene_is_named_and_counted() -> None:
    assert repr(scene("fig4", mu_I=0.8)).startswith("Scene(fig4,mu_I=0.8: 3 bodies, mu = ")


@pytest.mark.parametrize("made", [scene("fig2"), fake_recording()], ids=["scene", "recording"])
def test_short(made: Short) -> None:
    assert len(repr(made)) < 200 and "\n" not in repr(made)
    assert len(made._repr_html_()) < 2000


def test_a_recording_counts_its_qps() -> None:
    recording = fake_recording()
    assert f", {len(recording.qps)} QPs, " in repr(recording)
