"""Drawing begins before the order is known, and a plot that goes on later finds the same order."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from planning.geometry.stroke import Layer
from planning.motion.plan import Draw, LayerStart
from plotter.board_setup import board_setup
from plotter.cli.streaming import guesses_s
from plotter.journals import Part, head, part_actions, part_program
from plotter.pipeline import Job, Ordering, planned, prepare
from plotter.settings import resolve
from plotter.svg.options import ReadOptions


def job_of(tmp_path: Path, count: int = 500) -> tuple[str, Job]:
    rng = np.random.default_rng(4)
    begin = rng.uniform((10, 10), (260, 190), (count, 2))
    ends = np.concatenate((begin, begin + rng.normal(0, 2, (count, 2))), axis=1)
    lines = "".join(f'<path d="M{a:.2f} {b:.2f}L{c:.2f} {d:.2f}"/>' for a, b, c, d in ends)
    file = tmp_path / "many.svg"
    view = 'width="280mm" height="200mm" viewBox="0 0 280 200" stroke="black"'
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {view}>{lines}</svg>')
    return str(file), prepare(str(file), ReadOptions(), resolve({"order_time": "0.5s"}).values)


def test_the_plan_begins_before_the_order_is_known(tmp_path: Path) -> None:
    _, job = job_of(tmp_path)
    assert not job.ordering.found
    actions = planned(job)
    begun = list(islice(actions, 20))
    assert sum(isinstance(action, Draw) for action in begun) >= 4
    assert not job.ordering.complete
    assert len(guesses_s(job)) == job.drawing.stroke_count
    rest = list(actions)
    assert job.ordering.complete
    assert len(job.ordering.found) == 2
    assert len(guesses_s(job)) == job.stroke_count
    assert sum(isinstance(action, LayerStart) for action in begun + rest) == 1, "a layer begins once"
    assert [a.stroke for a in begun + rest if isinstance(a, Draw)] == sorted(
        a.stroke for a in begun + rest if isinstance(a, Draw)
    )


def test_the_journal_does_not_wait_for_the_order(tmp_path: Path) -> None:
    file, job = job_of(tmp_path)
    head(job, file, ReadOptions())
    assert not job.ordering.found


def test_the_same_part_is_the_same_program(tmp_path: Path) -> None:
    """Once as it goes on in the program that paused, where pieces are found already, and once made anew as `resume` does."""
    _, job = job_of(tmp_path)
    setup = board_setup(job.settings, job.machine)
    opening = len(next(iter(job.ordering)).strokes)
    for stroke in (1, opening, opening + 7):
        at = job.layers[0].strokes[stroke].points_mm
        left = tuple(float(value) for value in at[0] + 0.4 * (at[1] - at[0]))
        part = Part(stroke, 0.4 * float(np.hypot(*(at[1] - at[0]))), left, left, False)  # type: ignore[arg-type]
        _, fresh = job_of(tmp_path)
        one, other = (list(islice(part_program(j, setup, part), 3000)) for j in (job, fresh))
        assert one == other
        assert next(action.stroke for action in part_actions(fresh, part) if isinstance(action, Draw)) == stroke


def test_what_is_found_is_there_while_the_next_piece_is_looked_for() -> None:
    """A pause in the opening looks for what is left of it, while the planner's thread waits for the rest."""
    looking, paused = threading.Event(), threading.Event()
    in_time: list[bool] = []

    def pieces() -> Iterator[Layer]:
        yield Layer(1, "", ())
        looking.set()
        in_time.append(paused.wait(5))

    ordering = Ordering(pieces())
    planner = threading.Thread(target=list, args=(ordering,))
    planner.start()
    looking.wait(5)
    assert next(iter(ordering)).number == 1
    paused.set()
    planner.join()
    assert in_time == [True]


def test_pieces_are_made_once_whoever_asks() -> None:
    made: list[int] = []
    go = threading.Event()

    def slowly() -> object:
        for number in (1, 2, 3):
            go.wait(5)
            made.append(number)
            yield Layer(number, "", ())

    ordering = Ordering(slowly())  # type: ignore[arg-type]
    seen: list[list[int]] = []
    threads = [threading.Thread(target=lambda: seen.append([piece.number for piece in ordering])) for _ in range(4)]
    for thread in threads:
        thread.start()
    go.set()
    for thread in threads:
        thread.join(5)
    assert seen == [[1, 2, 3]] * 4
    assert made == [1, 2, 3]
