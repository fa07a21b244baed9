"""Outlines made batch by batch beside the walk: what is read and said is what one batch would give."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from plotter.errors import BadInput
from plotter.svg import collector
from plotter.svg.batch import Batch, Made
from plotter.svg.options import Budgets
from plotter.svg.read import read_drawing
from tests.plotter.svg_help import HEAD, page

KINDS = (
    '<path id="p{0}" d="M{0} 1l1 2c1 1 2 2 3 {0}z"/>',
    '<circle id="c{0}" cx="{0}" cy="5" r="2"/>',
    '<line id="l{0}" x1="{0}" y1="1" x2="3" y2="4"/>',
    '<polyline id="y{0}" points="1,{0} 2,2 3,3"/>',
    '<path id="d{0}" d="M{0} 1l1 2 broken"/>',
)
SHAPES = [KINDS[(i + i // 7) % len(KINDS)].format(i) for i in range(200)]


@pytest.fixture(params=[300, 10**6], ids=["many batches", "one batch"])
def batches(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    monkeypatch.setattr(collector, "_BATCH_CHARACTERS", request.param)
    monkeypatch.setattr(collector, "_BATCH_NUMBERS", request.param)
    return request.param


def test_many_batches_give_what_one_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = page("".join(SHAPES))
    monkeypatch.setattr(collector, "_BATCH_CHARACTERS", 200)
    monkeypatch.setattr(collector, "_BATCH_NUMBERS", 64)
    parts = page("".join(SHAPES))
    assert parts.warnings == whole.warnings
    assert any("damaged" in warning for warning in whole.warnings)
    assert parts.stroke_count == whole.stroke_count > 150
    for one, other in zip(parts.layers[0].strokes, whole.layers[0].strokes, strict=True):
        assert np.array_equal(one.points_mm, other.points_mm)


@pytest.mark.usefixtures("batches")
@pytest.mark.parametrize("at", [0, 57, 199])
@pytest.mark.parametrize(
    ("bad", "said"),
    [('<path id="bad" d="M0 0L1e999 5"/>', "too large to be finite"), ('<circle id="bad" r="1e12"/>', "larger than 1000 km")],
)
def test_an_outline_that_cannot_be_drawn_is_named_wherever_it_is(at: int, bad: str, said: str) -> None:
    with pytest.raises(BadInput, match=said) as refused:
        page("".join([*SHAPES[:at], bad, *SHAPES[at:]]))
    assert "id='bad'" in str(refused.value)


@pytest.mark.usefixtures("batches")
def test_points_are_counted_together() -> None:
    points = sum(len(stroke.points_mm) for stroke in page("".join(SHAPES)).layers[0].strokes)
    page("".join(SHAPES), budgets=Budgets(points=points))
    with pytest.raises(BadInput, match=rf"at least \d+ points and the limit is {points - 1}; raise --max-points"):
        page("".join(SHAPES), budgets=Budgets(points=points - 1))


def test_a_batch_of_very_many_points_is_made_when_it_is_known_that_they_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the walk a batch makes few, so that a bomb in every batch does not make as many at once as there are threads."""
    monkeypatch.setattr(collector, "_BATCH_CHARACTERS", 100)
    made: list[int] = []
    original = collector.made

    def watched(batch: Batch, matrix: Any, tolerance_mm: Any, point_budget: int) -> Made:
        made.append(point_budget)
        return original(batch, matrix, tolerance_mm, point_budget)

    monkeypatch.setattr(collector, "made", watched)
    monkeypatch.setattr(collector, "_BESIDE_POINTS", 1000)
    curves = '<path d="M0 0C9e3 9e3 -9e3 9e3 50 50"/>' * 12
    assert sum(len(s.points_mm) for s in page(curves, budgets=Budgets(points=10**6)).layers[0].strokes) > 12_000
    assert sorted(set(made))[0] == 1000
    assert len(made) > 12 / 2
    with pytest.raises(BadInput, match="raise --max-points"):
        page(curves, budgets=Budgets(points=10_000))
    assert max(made) == 10**6


def test_a_reading_that_fails_leaves_no_thread_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collector, "_BATCH_CHARACTERS", 100)
    with pytest.raises(BadInput):
        page("".join(SHAPES) + '<path d="M0 0L1e999 5"/>' + "".join(SHAPES))
    end_s = time.monotonic() + 5
    while any(thread.name == "errand" for thread in threading.enumerate()):
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.parametrize("content", [f"{HEAD}{SHAPES[0]}</svg>".encode(), b"no drawing"])
def test_garbage_is_looked_for_again_afterwards(content: bytes) -> None:
    assert gc.isenabled()
    try:
        read_drawing(content)
    except BadInput:
        assert content == b"no drawing"
    assert gc.isenabled()
    gc.disable()
    try:
        page(SHAPES[0])
        assert not gc.isenabled(), "who has switched it off, wants it off"
    finally:
        gc.enable()
