"""Planning ahead: bounded, in order, errors in their place, and gone when closed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from output.ebb.commands import SC, SM, SP
from output.ebb.control import StopFlag
from output.ebb.producer import Item, Producer
from output.ebb.program import StrokeEnd, StrokeMark
from output.ebb.progress import Progress
from output.ebb.session import connect
from tests.output.fake_ebb import FakeEbb


def wait_for(condition: object, timeout_s: float = 3.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.002)


def drain(producer: Producer) -> list[Item]:
    found = []
    while not producer.exhausted:
        item = producer.peek()
        if item is None:
            time.sleep(0.001)
            continue
        found.append(item)
        producer.take()
    return found


def test_everything_comes_in_order() -> None:
    items = [SM(10, i, 0) for i in range(200)]
    producer = Producer(items, lambda: None, capacity=16)
    assert drain(producer) == items
    producer.close()


def test_it_runs_ahead_only_so_far() -> None:
    made = []

    def endless() -> Iterator[Item]:
        while True:
            made.append(1)
            yield SM(10, 1, 1)

    producer = Producer(endless(), lambda: None, capacity=50)
    wait_for(lambda: len(made) >= 51)
    time.sleep(0.05)
    assert len(made) == 51, "fifty wait and one is in the hand"
    for _ in range(26):
        producer.take()
    wait_for(lambda: len(made) > 60)
    producer.close()
    producer.wait()
    assert "errand" not in [thread.name for thread in threading.enumerate()]


def test_an_error_comes_after_what_was_made_before_it() -> None:
    def broken() -> Iterator[Item]:
        yield SM(10, 1, 1)
        raise RuntimeError("planner")

    producer = Producer(broken(), lambda: None)
    wait_for(lambda: producer.peek() is not None)
    producer.take()
    with pytest.raises(RuntimeError, match="planner"):
        wait_for(lambda: producer.peek() is not None)
    assert not producer.exhausted
    producer.close()


def test_news_are_told_when_there_was_nothing() -> None:
    gate, told = threading.Event(), []

    def slow() -> Iterator[Item]:
        gate.wait(3)
        yield SM(10, 1, 1)

    producer = Producer(slow(), lambda: told.append(1))
    assert producer.peek() is None
    assert not told
    gate.set()
    wait_for(lambda: told)
    producer.close()


def test_a_planner_that_is_busy_is_not_waited_for() -> None:
    done, planned = threading.Event(), []

    def busy() -> Iterator[Item]:
        planned.append(done.wait(30))
        yield SM(10, 1, 1)

    producer = Producer(busy(), lambda: None)
    producer.close()
    assert planned == [], "closing comes back while the planner is busy"
    done.set()


def test_what_comes_before_a_mark_is_shown_once_it_is_there() -> None:
    go = threading.Event()

    def program() -> Iterator[Item]:
        yield SM(10, 1, 1)
        yield SM(20, 1, 1)
        go.wait(10)
        yield StrokeMark(0)

    producer = Producer(program(), lambda: None)
    wait_for(lambda: producer.peek() is not None)
    assert producer.until(StrokeMark) is None
    go.set()
    wait_for(lambda: producer.until(StrokeMark) == [SM(10, 1, 1), SM(20, 1, 1)])
    for _ in range(3):
        producer.take()
    wait_for(lambda: producer.until(StrokeMark) == [])
    producer.close()


def test_how_much_is_ready_is_counted_in_board_time() -> None:
    go = threading.Event()

    def program() -> Iterator[Item]:
        yield StrokeMark(0)
        yield SM(300, 1, 1)
        go.wait(5)
        yield SM(300, 1, 1)
        go.clear()
        go.wait(5)

    producer = Producer(program(), lambda: None)
    wait_for(lambda: producer.has_s(0.25))
    assert not producer.has_s(0.5)
    go.set()
    wait_for(lambda: producer.has_s(0.5))
    assert not producer.has_s(5.0)
    go.set()
    wait_for(lambda: producer.has_s(5.0))
    producer.close()
    full = Producer((SM(1, 1, 1) for _ in iter(int, 1)), lambda: None, capacity=20)
    wait_for(lambda: full.has_s(1000.0))
    full.close()


def test_a_stop_does_not_wait_for_a_planner_that_is_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pen is down while it plans."""
    monkeypatch.setattr("output.ebb.producer._JOIN_S", 60.0)
    fake, stop, stopped, in_time = FakeEbb(), StopFlag(), threading.Event(), []
    board, send = connect(fake, clock=fake.clock), fake.send

    def watched(data: bytes) -> None:
        send(data)
        if b"ES" in data:
            stopped.set()

    def program() -> Iterator[Item]:
        yield from (SC(4, 20000), SC(5, 15000), SP(1, 100), SP(0, 100), SM(30, 10, 10))
        stop.stop("now")
        in_time.append(stopped.wait(10.0))

    monkeypatch.setattr(fake, "send", watched)
    assert board.stream(program(), on_progress=lambda _: None, stop=stop).outcome == "stopped"
    assert in_time == [True]


@pytest.mark.parametrize("version", [(2, 8, 1), (3, 0, 3)])
def test_the_board_is_fed_while_a_hold_is_reckoned(version: tuple[int, int, int]) -> None:
    """With one place in its queue the motors would stand still at speed; with many it has enough meanwhile."""
    fake, stop, drawn, in_time = FakeEbb(version=version), StopFlag(), threading.Event(), []
    executed, asked_at = [0], []

    def hold(taken: int) -> list[Item]:
        asked_at.append((taken, executed[0]))
        in_time.append(drawn.wait(10.0))
        return [SM(31, 1, 1), SP(1, 100)]

    def watch(progress: Progress) -> None:
        executed[0] = progress.commands_executed
        if executed[0] >= 30 and not asked_at:
            stop.pause("p")
        if asked_at and executed[0] >= asked_at[0][1] + 8:
            drawn.set()

    program = [SC(4, 20000), SC(5, 15000), SP(1, 100), SP(0, 100), *[SM(30, 10, 10)] * 400, SP(1, 100)]
    result = connect(fake, clock=fake.clock).stream(program, on_progress=watch, stop=stop, hold=hold)
    assert result.outcome == "held"
    assert in_time == [True]
    moves = [entry.wire for entry in fake.executed if entry.wire.startswith("SM")]
    assert moves == [*["SM,30,10,10"] * (asked_at[0][0] - 4), "SM,31,1,1"]
    assert fake.pen_up


def test_a_pen_is_lowered_for_a_stroke_that_is_there_to_its_end_or_for_so_much_of_it() -> None:
    go = threading.Event()

    def program() -> Iterator[Item]:
        yield SP(0, 100)
        yield SM(300, 1, 1)
        go.wait(5)
        yield StrokeEnd(0, (1, 1))

    producer = Producer(program(), lambda: None)
    wait_for(lambda: producer.has_stroke(0.4))
    assert not producer.has_stroke(1.0)
    go.set()
    wait_for(lambda: producer.has_stroke(1.0))
    producer.close()


def test_a_stroke_that_cannot_be_planned_to_its_end_is_told_before_the_pen_is_down() -> None:
    def broken() -> Iterator[Item]:
        yield SP(0, 100)
        yield SM(3000, 1, 1)
        raise ArithmeticError("no plan")

    producer = Producer(broken(), lambda: None)
    wait_for(lambda: producer.has_s(10.0))
    assert producer.peek() == SP(0, 100), "what came before it can still be had"
    with pytest.raises(ArithmeticError, match="no plan"):
        producer.has_stroke(1.0)
    producer.close()
