"""Travel that overlaps with lifting and lowering: the virtual board's servo is asked where the pen really touches.

The virtual board knows nothing of the clearance model: it moves the servo at the rate it was told, and puts the paper where the
test says. Its ink must be the drawing, and nothing else, wherever the paper may be.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import pytest

from output.ebb.command_file import read_command_file, write_command_file
from output.ebb.commands import S2, SC, SP, Command
from output.ebb.control import StopFlag
from output.ebb.encode import BoardSetup
from output.ebb.program import ApproachMark, Mark
from output.ebb.session import connect
from output.ebb.verify import verify
from output.ebb.verify_compare import compare
from output.ebb.virtual.board import Board
from output.errors import BadCommand
from planning.geometry.stroke import Layer, Stroke
from planning.motion.plan import Action, Lift, Lower, Travel
from planning.motion.planner import plan
from plotter.board_setup import board_setup
from plotter.cli.keys import press
from plotter.machines.profile import PenLift
from plotter.pipeline import motion_settings, program
from plotter.settings import resolve
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture

HOME = np.zeros(2)
OFF_MM = 0.03  # what the ink may be off the drawing: tolerance of the motion, and steps


def drawing() -> tuple[Layer, ...]:
    """Short and long travels, dots, lines and corners."""
    rng = np.random.default_rng(5)
    at, strokes = np.array([40.0, 40.0]), []
    for k in range(24):
        at = np.clip(at + rng.uniform(-1, 1, 2) * (0.6, 3.0, 9.0, 40.0)[k % 4], 5, 140)
        reach = rng.uniform(-4, 4, (k % 3 + 1, 2))
        points = np.clip(np.vstack((at, at + np.cumsum(reach, axis=0))), 1, 149)
        strokes.append(Stroke(points[:1] if k % 5 == 4 else points))
        at = strokes[-1].points_mm[-1]
    return (Layer(1, "all", tuple(strokes)),)


def plotted(**flags: Any) -> tuple[list[Action], list[Command | Mark], BoardSetup]:
    settings = resolve(flags).values
    machine = settings.machine_profile()
    actions = list(plan(drawing(), motion_settings(settings, machine), HOME, HOME))
    setup = board_setup(settings, machine)
    return actions, list(program(iter(actions), setup)), setup


def on_board(items: list[Command | Mark], setup: BoardSetup, touch_share: float) -> dict[str, Any]:
    """The record of a board that is sent everything as fast as it takes it."""
    board = Board(setup.firmware.name, timed=False)
    board.servo.touch_share = touch_share
    wires = iter(["CU,4,32"] if setup.firmware.queue_max > 1 else [])
    for wire in (*wires, *(item.wire() for item in items if isinstance(item, Command))):
        while not board.wants_bytes:
            board.advance_to(max(board.next_event() or 0, board.now + 1))
        board.feed(f"{wire}\r".encode())
    while not board.motion.idle or not board.wants_bytes:
        board.advance_to(max(board.next_event() or 0, board.now + 1))
    assert b"!" not in b"".join(sent.data for sent in board.output())
    return board.recorder.summary(board.now)


def off_mm(record: dict[str, Any], setup: BoardSetup) -> tuple[float, float]:
    """How far the ink is off the drawing, and the drawing off the ink."""
    ink = [setup.kinematics.millimetres(np.array(s["points"], dtype=float)) for s in record["ink_touching"]]
    found = compare(ink, [stroke.points_mm for layer in drawing() for stroke in layer.strokes])
    return found.drawn.max_mm, found.wanted.max_mm


@pytest.fixture(autouse=True)
def _own_settings(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))


@pytest.mark.parametrize("touch_share", [0.31, 0.5, 0.69])
@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
@pytest.mark.parametrize("lift", ["standard-servo", "brushless"])
def test_no_ink_outside_the_strokes_and_none_missing(firmware: str, touch_share: float, lift: str) -> None:
    _, items, setup = plotted(overlap=1.0, firmware=firmware, lift=lift)
    record = on_board(items, setup, touch_share)
    stray, missing = off_mm(record, setup)
    assert stray <= OFF_MM
    assert missing <= OFF_MM
    assert len(record["ink_touching"]) == 24
    assert record["underruns"] == 0


def test_the_check_sees_paper_that_is_higher_than_the_model_allows() -> None:
    _, items, setup = plotted(overlap=1.0)
    stray, missing = off_mm(on_board(items, setup, 0.9), setup)
    assert stray > 2 * OFF_MM
    assert missing <= OFF_MM


def test_the_check_sees_a_servo_that_falls_more_slowly_than_the_model_says() -> None:
    _, items, setup = plotted(overlap=1.0)
    assert off_mm(on_board(list(_with_rate(items, 500)), setup, 0.3), setup)[1] > 2 * OFF_MM


def test_overlap_saves_time_and_0_waits_for_every_lift() -> None:
    times = {}
    for overlap in (0.0, 0.4, 0.8, 1.0):
        actions, items, setup = plotted(overlap=overlap, low_lift=0.0, lead=0.15)
        times[overlap] = verify(items, setup.firmware, setup.kinematics).duration_s
        if overlap == 0:
            assert not any(isinstance(a, Travel) and a.lower_at_s is not None for a in actions)
            settings = resolve({}).values
            assert {a.wait_s for a in actions if isinstance(a, Lift)} == {settings.lift_time}
            assert {a.wait_s for a in actions if isinstance(a, Lower)} == {settings.lower_time}
            assert not any(isinstance(item, ApproachMark) for item in items)
    assert times[0.0] > times[0.4] > times[0.8] > times[1.0]
    assert times[0.0] - times[1.0] > 24 * 0.08


def test_motion_goes_on_while_the_pen_is_being_lowered() -> None:
    _, items, setup = plotted(overlap=1.0)
    record = on_board(items, setup, 0.5)
    assert record["underruns"] == 0
    report = verify(items, setup.firmware, setup.kinematics)
    assert report.max_velocity_jump_mm_s < 0.3
    assert report.problems == []
    assert report.final_steps == (0, 0)
    assert len(report.strokes) == 24


def test_verify_shows_the_ink_of_too_early_a_lowering() -> None:
    _, items, setup = plotted(overlap=1.0)
    slow = verify(items, setup.firmware, setup.kinematics)
    quick = verify(_with_rate(items, 60000), setup.firmware, setup.kinematics)
    wanted = [stroke.points_mm for layer in drawing() for stroke in layer.strokes]
    assert compare(slow.strokes, wanted).drawn.max_mm <= OFF_MM
    assert compare(quick.strokes, wanted).drawn.max_mm > 2 * OFF_MM


def _with_rate(items: list[Command | Mark], rate: int) -> Iterator[Command | Mark]:
    for item in items:
        yield SC(12, rate) if isinstance(item, SC) and item.number == 12 else item


def test_short_travels_lift_to_the_low_height_through_the_queue() -> None:
    actions, items, _ = plotted(low_lift="5mm", pen_low="55%")
    low = [a for a in actions if isinstance(a, Lift) and a.height == "low"]
    assert low
    lifts = [item for item in items if isinstance(item, S2)]
    assert len(lifts) == len(low)
    assert {(s.position, s.pin, s.rate) for s in lifts} == {(round(9855 + 17976 * 0.55), 4, 1618)}
    ways = [np.hypot(*(a.motion.end_mm - a.motion.start_mm)) for a in actions if isinstance(a, Travel)]
    assert len(low) == sum(way < 5.0 for way in ways[1:-1])
    assert not any(isinstance(item, S2) for item in plotted(low_lift="0mm")[1])
    assert not any(isinstance(item, S2) for item in plotted(low_lift="5mm", firmware="1.9.5")[1])


def test_where_one_command_can_wait_the_pen_is_lowered_at_rest() -> None:
    _, items, _ = plotted(overlap=1.0, firmware="2.8.1")
    assert not any(isinstance(item, ApproachMark) for item in items)
    assert not any(isinstance(item, SP) and item.value == 0 and not item.duration_ms for item in items)


def test_a_command_file_keeps_the_approach() -> None:
    _, items, _ = plotted(overlap=1.0)
    assert any(isinstance(item, ApproachMark) for item in items)
    text = io.StringIO()
    write_command_file(text, {}, items)
    text.seek(0)
    assert [line.item for line in read_command_file(text)[1]] == items


def test_a_slower_lift_by_hand_is_slower_all_the_way() -> None:
    own, slow = resolve({}).values, resolve({"lift_time": "0.5s", "lower_time": "0.5s"}).values
    one, other = own.pen_timing(), slow.pen_timing()
    assert other.lift_wait_s("up") > 0.35
    assert other.lower_wait_s("up") > 0.35
    assert other.lead_s(9.0, "up") == pytest.approx(one.lead_s(9.0, "up"))


@pytest.mark.parametrize("heights", [(60, 30), (100, 0), (52, 50), (31, 30)])
@pytest.mark.parametrize("lift", ["standard-servo", "brushless", "solenoid"])
def test_no_wait_is_shorter_than_the_model_allows(lift: str, heights: tuple[int, int]) -> None:
    """At any overlap and any height; without overlap the whole time is waited for, which is never less than that."""
    for overlap in (0.0, 0.8, 1.0):
        pen = resolve({"lift": lift, "pen_up": heights[0], "pen_down": heights[1], "overlap": overlap}).values.pen_timing()
        model = pen.clearance
        assert model is not None
        for height in ("up", "low"):
            assert pen.lift_wait_s(height) >= model.lifted_s(height) - 1e-9
            assert pen.lower_wait_s(height) >= model.down_s(height) - 1e-9
            assert pen.lead_s(9.0, height) <= max(model.top(height) - model.touch_high, 0.0) * model.drop_s + 1e-9
            assert overlap or pen.lead_s(9.0, height) == 0.0


class SteppedServo:
    """A servo as it really moves: its pulse a step of `rate` once a period, the tip after it at the servo's full speed.

    Nothing here is the model's: `phase` is when the first period begins after a command, `lag` how late the tip is.
    """

    def __init__(self, lift: PenLift, phase: float, lag: float) -> None:
        self.lift, self.phase, self.lag_ms = lift, phase * lift.period_ms, lag * lift.lag_ms
        self.per_ms = abs(lift.pulse_at_100 - lift.pulse_at_0) / 100 / lift.percent_ms

    def heights(self, commands: list[tuple[float, float]], until_ms: float) -> np.ndarray:
        """Share of the way from down to up at each 0.1 ms, after commands (ms, share), from the paper."""
        way = float(abs(self.lift.up_pulse - self.lift.down_pulse))
        pulse = tip = target = 0.0
        rate, next_step, found, pulses = 0.0, np.inf, [], []
        waiting = list(commands)
        for k in range(round(until_ms * 10)):
            now = k / 10
            if waiting and now >= waiting[0][0]:
                target = waiting.pop(0)[1] * way
                rate = float(self.lift.rate_up if target > pulse else self.lift.rate_down)
                next_step = now + self.phase
            if now >= next_step:
                pulse += float(np.clip(target - pulse, -rate, rate))
                next_step += self.lift.period_ms
            pulses.append(pulse)
            seen = pulses[max(0, k - round(self.lag_ms * 10))]
            tip += float(np.clip(seen - tip, -self.per_ms / 10, self.per_ms / 10))
            found.append(tip / way)
        return np.array(found)


@pytest.mark.parametrize("travel_ms", [8.0, 20.0, 45.0, 400.0])
@pytest.mark.parametrize("height", ["up", "low"])
@pytest.mark.parametrize("lift", ["standard-servo", "brushless"])
def test_a_servo_that_moves_in_steps_is_off_the_paper_while_the_pen_travels(
    lift: str, height: Literal["up", "low"], travel_ms: float
) -> None:
    """At full overlap, for every phase of the pulse and lag of the tip: clear during travel, down when the stroke begins."""
    settings = resolve({"lift": lift, "overlap": 1.0}).values
    pen, profile = settings.pen_timing(), settings.pen_lift()
    assert pen.clearance is not None
    begins = 1000 * pen.lift_wait_s(height)
    ends = begins + travel_ms
    lead = 1000 * pen.lead_s(ends / 1000, height)
    draws = ends - lead + 1000 * pen.lower_wait_s(height)
    for phase, lag in itertools.product((0.02, 0.35, 0.7, 1.0), (0.0, 0.5, 1.0)):
        commands = [(0.0, pen.clearance.top(height)), (ends - lead, 0.0)]
        tip = SteppedServo(profile, phase, lag).heights(commands, draws + 1)
        assert tip[round(begins * 10) + 1 : round(ends * 10) - 1].min() >= profile.touch_high - 0.005
        assert tip[round(draws * 10)] <= profile.touch_low + 0.005


# pauses and stops


def low_lifts(**flags: Any) -> tuple[list[Command | Mark], BoardSetup]:
    """A row of short strokes 2 mm apart, so that the pen is on a low lift between each two."""
    settings = resolve({"overlap": 1.0, "low_lift": "5mm", **flags}).values
    machine = settings.machine_profile()
    row = tuple(Stroke(np.array([[10.0 + 2 * k, 10.0], [10.0 + 2 * k, 12.0]])) for k in range(20))
    actions = plan((Layer(1, "all", row),), motion_settings(settings, machine), HOME, HOME)
    setup = board_setup(settings, machine)
    return list(program(actions, setup)), setup


@pytest.mark.usefixtures("inline_producer")
@pytest.mark.parametrize("lift", ["standard-servo", "brushless"])
@pytest.mark.parametrize("firmware", ["3.0.3", "3.0.0", "2.8.1"])
def test_a_pause_on_a_low_lift_raises_the_pen_and_goes_on_from_the_low_height(firmware: str, lift: str) -> None:
    items, setup = low_lifts(firmware=firmware, lift=lift)
    memory, stop = MemoryBoard(firmware), StopFlag()
    memory.board.servo.touch_share = 0.69
    paused_at: list[float] = []
    heights: list[float] = []

    def operator(m: MemoryBoard) -> None:
        if stop.pause_reason is None and len(paused_at) < 3 and m.clock() > 2.5 + 1.5 * len(paused_at):
            paused_at.append(m.clock())
            stop.pause("paused by key")
        elif stop.pause_reason is not None and m.clock() > paused_at[-1] + 3.0 and m.board.motion.idle:
            heights.append(m.board.servo.position(m.board.now))
            stop.go()

    board = connect(memory, clock=memory.clock)
    memory.on_receive = operator
    result = board.stream(items, on_progress=lambda _: None, stop=stop)
    assert result.outcome == "done"
    assert heights == [setup.pen.up] * 3
    record = memory.record()
    ink = [setup.kinematics.millimetres(np.array(s["points"], dtype=float)) for s in record["ink_touching"]]
    assert len(ink) == 20
    for k, line in enumerate(ink):
        assert np.abs(line[:, 0] - (10 + 2 * k)).max() <= OFF_MM
        assert sorted(line[[0, -1], 1]) == pytest.approx([10, 12], abs=OFF_MM)
    assert result.progress.commands_executed == sum(isinstance(item, Command) for item in items)
    lows = [event for event in record["pen_events"] if event[3] == setup.pen.low]
    # Each pause on a low lift comes back to it, and there is one for each pair of strokes but the first and the last.
    assert len(lows) >= 19 + 1
    assert record["parser_blocked"] == []


@pytest.mark.usefixtures("inline_producer")
@pytest.mark.parametrize("firmware", ["3.0.3", "2.8.1"])
@pytest.mark.parametrize("after_s", np.linspace(1.4, 2.6, 7))
def test_a_stop_raises_a_pen_on_another_pin(firmware: str, after_s: float) -> None:
    """Half-way down, on a low lift, or on the paper: SP,3 without its pin would move some other servo."""
    items, setup = low_lifts(firmware=firmware, lift="brushless")
    memory, stop = MemoryBoard(firmware), StopFlag()
    board = connect(memory, clock=memory.clock, pen_pin=2)
    began = memory.clock()

    def operator(m: MemoryBoard) -> None:
        if m.clock() - began > after_s and not stop.requested:
            press("q", stop)

    memory.on_receive = operator
    assert board.stream(items, on_progress=lambda _: None, stop=stop).outcome == "stopped"
    memory.host_stalls(0.5)
    servo = memory.board.servo
    assert servo.rp_pin == 5
    assert servo.position(memory.board.now) == setup.pen.up
    strays = [
        line
        for s in memory.record()["ink_touching"]
        for line in [setup.kinematics.millimetres(np.array(s["points"], dtype=float))]
        if (np.abs((line[:, 0] - 10) / 2 - np.round((line[:, 0] - 10) / 2)) > OFF_MM).any() or not (line[:, 1] > 9.97).all()
    ]
    assert strays == []


def test_a_pen_lift_is_told_to_the_board_whatever_it_drove_before() -> None:
    items = plotted(lift="brushless")[1]
    assert [item.wire() for item in items[:2] if isinstance(item, Command)] == ["SC,1,2", "SC,8,1"]
    items = plotted()[1]
    board = Board("3.0.3", timed=False)
    board.feed(b"SC,8,1\r")
    for item in items[:8]:
        if isinstance(item, Command):
            board.feed(f"{item.wire()}\r".encode())
    assert board.servo.channels == 8
    assert [item.wire() for item in plotted(lift="solenoid")[1][:1] if isinstance(item, Command)] == ["SC,1,0"]
    with pytest.raises(BadCommand, match=r"2\.2\.0"):
        plotted(lift="brushless", firmware="1.9.5")
