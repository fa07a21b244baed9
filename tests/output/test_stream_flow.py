"""Credits, lead, stalls and the end of a stream, against the in-memory board and its clock."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator

import pytest

from output.ebb.board_time import board_time_s
from output.ebb.commands import CU, EM, HM, L3, LM, S2, SC, SM, SP, Command
from output.ebb.control import StopFlag
from output.ebb.flow import QueueModel
from output.ebb.gates import LEAD_S
from output.ebb.producer import Item
from output.ebb.program import LayerMark, Mark, PauseMark, StrokeEnd, StrokeMark
from output.ebb.progress import Progress, State
from output.ebb.session import StreamResult, connect
from output.errors import BadCommand, BoardRefused, LinkLost
from tests.output.board_in_memory import MemoryBoard
from tests.output.fake_ebb import FakeEbb
from tests.output.inline_producer import InlineProducer, inline_producer  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("inline_producer")

VERSIONS = [(3, 0, 3), (3, 0, 1), (3, 0, 0), (2, 8, 1), (2, 6, 2), (2, 5, 5)]


def drawing(strokes: int = 5, moves: int = 10, ms: int = 30) -> Iterator[Command | Mark]:
    yield from (SC(4, 20000), SC(5, 15000), EM(1, 1), SP(1, 200), LayerMark(1, "ink"))
    x = y = 0
    for k in range(strokes):
        yield from (SM(50, 10, 10), StrokeMark(k), SP(0, 150))
        x, y = x + 10, y + 10
        for _ in range(moves):
            yield SM(ms, 20, -10)
            x, y = x + 20, y - 10
        yield from (StrokeEnd(k, (x, y)), SP(1, 150))


def plot(fake: FakeEbb, program: object = None, **kwargs: object) -> tuple[StreamResult, list[Progress]]:
    board = connect(fake, clock=fake.clock)
    seen: list[Progress] = []
    stop = kwargs.pop("stop", StopFlag())
    on_progress = kwargs.pop("on_progress", seen.append)
    result = board.stream(program or drawing(), on_progress=on_progress, stop=stop, **kwargs)  # type: ignore[arg-type]
    return result, seen


@pytest.mark.parametrize("version", VERSIONS)
def test_everything_is_drawn_and_the_parser_never_blocks(version: tuple[int, int, int]) -> None:
    fake = FakeEbb(version=version, parse_s=0.0012)
    result, seen = plot(fake)
    assert result.outcome == "done"
    assert fake.blocked_s == 0.0
    assert [entry.wire for entry in fake.executed if entry.wire.startswith("SM")] == [
        item.wire() for item in drawing() if isinstance(item, SM)
    ]
    assert result.steps == (5 * 210, 5 * -90)
    assert fake.executing is None, "done means executed"
    assert not fake.fifo
    assert fake.pen_up
    assert (result.progress.strokes_done, result.progress.commands_executed) == (5, result.progress.commands_sent)
    assert result.progress.layer == LayerMark(1, "ink")
    executed = [progress.commands_executed for progress in seen]
    assert executed == sorted(executed)
    moving = [gap for gap, wire in fake.gaps if wire.startswith("SM")]
    assert moving == [], "the board ran dry"
    assert result.progress.stalls <= 1, "at most the start, before anything moves"


@pytest.mark.parametrize("parse_ms", [0.3, 3.0, 6.0])
def test_the_queue_is_used_in_full_but_never_overfilled(parse_ms: float) -> None:
    fake = FakeEbb(parse_s=parse_ms / 1000)
    plot(fake, drawing(strokes=2, moves=200, ms=15))
    assert fake.blocked_s == 0.0
    assert 28 <= fake.most_waiting <= 32


def test_lead_is_bounded_by_time_where_moves_are_long() -> None:
    """A pause must not have to wait for half a minute of queued motion."""
    fake = FakeEbb()
    _, seen = plot(fake, drawing(strokes=3, moves=40, ms=200))
    assert max(progress.lead_s for progress in seen) <= LEAD_S + 0.2 + 0.05
    assert fake.gaps == [] or all(not wire.startswith("SM") for _, wire in fake.gaps)


@pytest.mark.parametrize("stall_ms", [50, 200, 800])
def test_a_host_that_stalls_is_carried_by_a_deep_queue_and_counted_with_a_shallow_one(stall_ms: int) -> None:
    outcome = {}
    for version in ((3, 0, 3), (2, 8, 1)):
        next_at = [102.0]

        def stall(fake: FakeEbb, next_at: list[float] = next_at) -> None:
            if fake.now >= next_at[0]:
                fake.now += stall_ms / 1000
                next_at[0] = fake.now + 1.5

        fake = FakeEbb(version=version, parse_s=0.001)
        board = connect(fake, clock=fake.clock)
        fake.on_time = stall
        result = board.stream(drawing(strokes=4, moves=60, ms=40), on_progress=lambda _: None, stop=StopFlag())
        gaps = [gap for gap, wire in fake.gaps if wire.startswith("SM") and gap > 0.005]
        outcome[version] = (gaps, result.progress)
        assert result.outcome == "done"
        assert fake.blocked_s == 0.0
    assert outcome[(3, 0, 3)][0] == [], "a second of lead covers the stall"
    gaps, progress = outcome[(2, 8, 1)]
    if stall_ms >= 200:
        assert gaps, "the stalls were long enough to be seen with one place in the queue"
    assert len(gaps) <= progress.stalls + 1
    assert progress.stalls <= len(fake.gaps)
    assert progress.stalled_s == pytest.approx(sum(gap for gap, _ in fake.gaps[1:]), rel=0.3, abs=0.05)


def test_planning_runs_ahead_while_sending() -> None:
    """A program that takes its time between strokes starts drawing before it has ended."""
    first_motion: list[float] = []

    def slow() -> Iterator[Command | Mark]:
        yield from drawing(strokes=2)
        first_motion.append(len([e for e in fake.executed if e.wire.startswith("SM")]))
        yield from drawing(strokes=1)

    fake = FakeEbb()
    result, _ = plot(fake, slow())
    assert result.outcome == "done"
    assert result.progress.strokes_done == 3


def test_a_planner_that_is_slow_at_first_does_not_stop_the_first_travel_at_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing moves before a second of motion is there: a motion cut off in its middle would be a jerk of the machine."""

    class SlowAtFirst(InlineProducer):
        """Its fifth item comes half a second after the fourth, by the board's clock."""

        def has_s(self, seconds: float) -> bool:
            return seconds <= 0.1 or fake.now > began + 0.5

        def until(self, kind: type[Mark]) -> list[Item] | None:
            return super().until(kind) if fake.now > began + 0.5 else None

        def peek(self) -> Item | None:
            return super().peek() if self._taken < 5 or fake.now > began + 0.5 else None

        def take(self) -> None:
            self._taken += 1
            super().take()

        _taken = 0

    monkeypatch.setattr("output.ebb.stream.Producer", SlowAtFirst)
    fake = FakeEbb()
    board = connect(fake, clock=fake.clock)
    board.queue_depth()
    began = fake.now
    items = [SP(1, 10), SM(40, 10, 10), *[SM(40, 90, 90)] * 6]
    result = board.stream(items, on_progress=lambda _: None, stop=StopFlag())
    assert result.outcome == "done"
    assert [wire for _, wire in fake.gaps if wire.startswith("SM")] == ["SM,40,10,10"]


class SlowStroke(InlineProducer):
    """What follows item number `late_from` is there two seconds after the rest, by the board's clock."""

    late_from = 5
    now: Callable[[], float]

    def _planned(self) -> bool:
        return self.now() > self._began + 2.0

    def has_s(self, seconds: float) -> bool:
        return seconds <= 0.1 or self._planned()

    def has_stroke(self, seconds: float) -> bool:
        return self._taken + len(STROKE) <= self.late_from or self.has_s(seconds)

    def peek(self) -> Item | None:
        return super().peek() if self._taken < self.late_from or self._planned() else None

    def take(self) -> None:
        self._taken += 1
        super().take()

    def __init__(self, program: Iterable[Item], on_news: Callable[[], None]) -> None:
        self._taken, self._began = 0, self.now()
        super().__init__(program, on_news)


def plot_slowly(
    items: list[Item], late_from: int, monkeypatch: pytest.MonkeyPatch, on_progress: Callable[[StopFlag, float, Progress], None]
) -> tuple[FakeEbb, dict[str, float]]:
    """The board, and when each command was begun, in seconds since the stream began."""
    fake, stop = FakeEbb(), StopFlag()
    board = connect(fake, clock=fake.clock)
    board.queue_depth()
    began = fake.now
    monkeypatch.setattr(
        "output.ebb.stream.Producer", type("Slow", (SlowStroke,), {"late_from": late_from, "now": lambda _: fake.now})
    )
    result = board.stream(items, on_progress=lambda progress: on_progress(stop, fake.now - began, progress), stop=stop)
    assert result.outcome == "done"
    return fake, {entry.wire: entry.start - began for entry in reversed(fake.executed)}


APPROACH = [SP(1, 10), SM(40, 10, 10), SM(40, 10, 10)]
STROKE = [StrokeMark(0), SP(0, 20), *[SM(40, 90, 90)] * 6, StrokeEnd(0, (560, 560))]


def test_the_pen_waits_up_over_a_stroke_that_is_still_being_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    """The travel to it is made meanwhile, and nothing of it stops in its middle."""
    fake, begun = plot_slowly([*APPROACH, *STROKE, SP(1)], 5, monkeypatch, lambda *_: None)
    assert begun["SM,40,10,10"] < 0.2
    assert begun["SP,0,20"] >= 2.0
    assert [wire for _, wire in fake.gaps if wire.startswith("SM")] == []


def test_while_it_waits_over_a_stroke_a_plot_can_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    paused: list[float] = []

    def operator(stop: StopFlag, now: float, progress: Progress) -> None:
        if now > 0.5 and not paused and stop.pause_reason is None:
            stop.pause("paused by key")
        if progress.state is State.PAUSED:
            paused.append(now)
            stop.go()

    fake, begun = plot_slowly([*APPROACH, *STROKE, SP(1)], 5, monkeypatch, operator)
    assert 0.5 < paused[0] < 1.0
    assert begun["SP,0,20"] >= 2.0, "nor is the pen lowered when the pause ends"
    assert [entry.wire for entry in fake.executed].count("SP,0,20") == 1


def test_the_lift_after_a_stroke_does_not_wait_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which way the S2 of a low lift moves the pen is not known here; but a pen that is down is not to wait."""
    rest = [S2(20000, 4, 1000, 50), *APPROACH[1:], StrokeMark(1), SP(0, 30), SM(40, 50, 50), StrokeEnd(1, (0, 0)), SP(1)]
    late_from = len(APPROACH) + len(STROKE) + 1
    _, begun = plot_slowly([*APPROACH, *STROKE, *rest], late_from, monkeypatch, lambda *_: None)
    assert begun["S2,20000,4,1000,50"] < 1.0
    assert begun["SP,0,30"] >= 2.0


def test_an_error_of_the_program_ends_the_plot_with_the_pen_up() -> None:
    def broken() -> Iterator[Command | Mark]:
        yield from (SP(1, 100), SP(0, 100), SM(500, 100, 100), SM(500, 100, 100))
        raise ZeroDivisionError("planner bug")

    fake = FakeEbb()
    with pytest.raises(ZeroDivisionError, match="planner bug"):
        plot(fake, broken())
    assert fake.pen_up
    assert fake.executing is None


def test_progress_that_nobody_reads_does_not_end_the_plot() -> None:
    calls = []

    def closed(progress: Progress) -> None:
        calls.append(progress)
        raise BrokenPipeError

    result, _ = plot(FakeEbb(), on_progress=closed)
    assert result.outcome == "done"
    assert len(calls) == 1


def test_a_progress_display_with_a_bug_is_no_reason_to_leave_the_pen_down() -> None:
    def bug(progress: Progress) -> None:
        if progress.commands_executed > 8:
            raise KeyError("display")

    fake = FakeEbb()
    with pytest.raises(KeyError):
        plot(fake, on_progress=bug)
    assert fake.pen_up


@pytest.mark.parametrize("wire", [CU(10, 0), CU(54, 1), CU(1, 0)])
def test_commands_that_change_the_conversation_are_refused(wire: Command) -> None:
    fake = FakeEbb()
    with pytest.raises(BadCommand, match="remove it"):
        plot(fake, iter([SP(0, 100), wire]))
    assert fake.pen_up


def test_a_pause_mark_waits_for_go() -> None:
    def program() -> Iterator[Command | Mark]:
        yield from drawing(strokes=1)
        yield PauseMark("change to red")
        yield from drawing(strokes=1)

    stop, states = StopFlag(), []

    def watch(progress: Progress) -> None:
        states.append((progress.state, progress.message, progress.strokes_done, fake.executing is None))
        if progress.state is State.PAUSED and sum(s[0] is State.PAUSED for s in states) > 20:
            stop.go()

    fake = FakeEbb()
    result, _ = plot(fake, program(), stop=stop, on_progress=watch)
    paused = [s for s in states if s[0] is State.PAUSED]
    assert result.outcome == "done"
    assert paused[0] == (State.PAUSED, "change to red", 1, True)
    assert len(paused) >= 20
    assert result.progress.strokes_done == 2
    assert result.progress.stalls <= 1, "a pause is not a stall"


def test_the_button_pauses_between_strokes_and_goes_on() -> None:
    stop, states = StopFlag(), []

    def watch(progress: Progress) -> None:
        states.append(progress.state)
        if progress.strokes_done == 1 and progress.state is State.RUNNING and State.PAUSED not in states:
            fake.button = True
        if progress.state is State.PAUSED and states.count(State.PAUSED) == 5:
            assert fake.pen_up
            fake.button = True

    fake = FakeEbb()
    result, _ = plot(fake, stop=stop, on_progress=watch)
    assert result.outcome == "done"
    assert State.PAUSED in states
    assert result.progress.strokes_done == 5


def test_a_hold_on_the_path_replaces_what_remains() -> None:
    """What was sent stays, the replacement brakes and lifts, and the stream ends as held; while it cannot it is asked on."""
    stop, asked = StopFlag(), []
    items = list(drawing(strokes=2, moves=100))

    def hold(taken: int) -> Iterator[Command | Mark] | None:
        asked.append(taken)
        return iter((SM(31, 1, 1), SP(1, 100))) if len(asked) > 3 else None

    def watch(progress: Progress) -> None:
        if progress.commands_executed >= 30 and not asked:
            stop.pause("p")

    fake = FakeEbb()
    result, _ = plot(fake, iter(items), stop=stop, on_progress=watch, hold=hold)
    assert result.outcome == "held"
    assert result.reason == "p"
    assert len(asked) == 4
    assert asked == sorted(set(asked))
    executed = [entry.wire for entry in fake.executed if entry.wire.startswith("SM")]
    planned = [item.wire() for item in items[: asked[-1]] if isinstance(item, SM)]
    assert executed == [*planned, "SM,31,1,1"]
    assert fake.pen_up
    assert result.progress.strokes_done == 0


def test_a_sleep_of_the_computer_pauses_and_the_token_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    slept, states = [0.0], []
    monkeypatch.setattr("output.ebb.watch.suspended_s", lambda: slept[0])
    stop = StopFlag()

    def watch(progress: Progress) -> None:
        if progress.strokes_done == 1:
            slept[0] = 600.0
        if progress.state is State.PAUSED:
            states.append(progress.message)
            stop.go()

    result, _ = plot(FakeEbb(), stop=stop, on_progress=watch)
    assert result.outcome == "done"
    assert set(states) == {"the computer was asleep for 600 s"}


def test_a_board_that_never_finishes_a_move_is_told() -> None:
    def stuck(fake: FakeEbb) -> None:
        if fake.executing is not None and fake.executing.wire == "SM,30,20,-10":
            fake.executing.end = fake.now + 1.0

    fake = FakeEbb(on_time=stuck)
    with pytest.raises(BoardRefused, match="stuck"):
        plot(fake)
    assert fake.pen_up


@pytest.mark.parametrize(
    ("firmware", "long"),
    [
        ("3.0.3", [SM(2000, 20000, -9000), HM(1000)]),  # 22 s; the board is asked where it is while it goes there
        ("2.8.1", [SM(2000, 20000, -9000), HM(1000)]),
        ("3.0.3", [LM(430_000, 1000, 0, 0, 0, 0)]),  # 200 s
        ("3.0.3", [L3(430_000, 1000, 0, 0, 0, 0, 0, 0)]),
        ("2.8.1", [LM(430_000, 1000, 0, 0, 0, 0)]),
    ],
)
def test_a_sound_command_that_takes_long_is_not_stuck(firmware: str, long: list[Command]) -> None:
    memory = MemoryBoard(firmware)
    board = connect(memory, clock=memory.clock)
    program: list[Command] = [SC(4, 20000), SC(5, 14000), EM(1, 1), SP(1, 60), *long, SP(1)]
    began_s = memory.clock()
    result = board.stream(program, on_progress=lambda _: None, stop=StopFlag())
    assert result.outcome == "done"
    assert memory.clock() - began_s > 20


def test_a_jerk_and_a_turn_are_in_the_time_that_is_expected() -> None:
    """By the formula without jerk the first would take two days; the second goes back before it has taken its steps."""
    assert board_time_s(L3(1000, 20000, 0, 1, 0, 0, 0, 0)) == pytest.approx(2.545, abs=0.001)
    assert board_time_s(LM(500_000_000, 3000, -1_000_000, 0, 0, 0)) == pytest.approx(0.2656)
    assert board_time_s(LM(100, 3000, -90, 0, 0, 0)) < 100


def test_lost_power_ends_the_plot() -> None:
    def cut(fake: FakeEbb) -> None:
        fake.power_low = fake.power_low or len(fake.executed) > 20

    fake = FakeEbb(on_time=cut)
    with pytest.raises(BoardRefused, match="power"):
        plot(fake)
    assert fake.pen_up


def test_the_model_refuses_to_be_overfilled() -> None:
    model = QueueModel(2, counts=True)
    model.on_sent(1, 0.1)
    model.on_sent(1, 0.1)
    with pytest.raises(AssertionError, match="block"):
        model.on_sent(1, 0.1)


@pytest.mark.parametrize("seed", range(6))
def test_the_model_never_promises_room_that_is_not_there(seed: int) -> None:
    """Random durations, parse times and host delays: the law waiting <= depth holds at every send."""
    rng = random.Random(seed)
    fake = FakeEbb(version=rng.choice([(3, 0, 3), (3, 0, 0), (2, 8, 1)]), parse_s=rng.uniform(0.0005, 0.006))
    board = connect(fake, clock=fake.clock)
    fake.on_time = lambda f: setattr(f, "now", f.now + (rng.expovariate(20.0) if rng.random() < 0.05 else 0.0))
    program = [SM(rng.randint(1, 120), rng.randint(-20, 20), 5) for _ in range(400)]
    result = board.stream(program, on_progress=lambda _: None, stop=StopFlag())
    assert result.outcome == "done"
    assert fake.blocked_s == 0.0
    assert fake.most_waiting <= fake.depth


def test_a_lost_link_is_an_error_of_its_own() -> None:
    def pull(fake: FakeEbb) -> None:
        fake.dead = fake.dead or len(fake.executed) > 10

    with pytest.raises(LinkLost, match="lost"):
        plot(FakeEbb(on_time=pull))
