"""The virtual board in memory: parser, queue, pen, switches, records, and what differs between firmware versions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from output.ebb.virtual.board import Board
from output.ebb.virtual.firmware import FIRMWARES
from output.ebb.virtual.servo import DOWN_AT_BOOT, UP_AT_BOOT
from output.errors import BadCommand

MS = 25
T3 = b"T3,375,400000000,0,0,-200000000,1000,0"


class Bench:
    """A board on the bench: each command is given time to be answered, not to be executed."""

    def __init__(self, firmware: str = "3.0.3", **options: Any) -> None:
        self.board = Board(firmware, **options)
        self.board.advance(10 * MS)

    def ask(self, *commands: bytes, ticks: int = 20 * MS) -> bytes:
        for command in commands:
            self.board.feed(command + b"\r")
            self.board.advance(ticks)
        return b"".join(sent.data for sent in self.board.output())

    def future(self, depth: int = 1) -> Bench:
        self.ask(b"CU,10,1", b"CU,4,%d" % depth)
        return self

    def run_dry(self) -> None:
        while (event := self.board.motion.next_event()) is not None:
            self.board.advance_to(event)


def test_one_runs_one_waits_one_is_stuck_in_the_parser() -> None:
    bench = Bench().future()
    assert bench.ask(b"SM,1000,10,10", b"SM,1000,10,10", b"SM,1000,10,10") == b"SM\nSM\n"
    assert bench.board.blocked_on_motion
    assert bench.ask(b"QG", b"ES", b"SP,3") == b""
    bench.board.advance(1000 * MS)
    sent = bench.board.output()
    assert b"".join(item.data for item in sent) == b"SM\nQG,1F\nES,1\nSP\n"
    # The stuck command is queued in the tick in which the queue takes up the next one.
    assert sent[0].tick == bench.board.recorder.blocked[0][1]


def test_what_waits_is_counted_without_the_running_command() -> None:
    bench = Bench().future(8)
    bench.ask(*[b"SM,1000,10,10"] * 4)
    assert bench.ask(b"QU,6") == b"QU,3\n\n"
    assert bench.ask(b"QG") == b"QG,1F\n"
    assert bench.ask(b"ES", b"QU,6", b"QG") == b"ES,1\nQU,0\n\nQG,10\n"


def test_a_stop_keeps_the_position_it_was_at() -> None:
    bench = Bench().future()
    bench.ask(b"SM,1000,1000,-500")
    before = bench.board.motion.state(bench.board.now)
    assert bench.ask(b"ES") == b"ES,1\n"
    after = bench.board.motion.state(bench.board.now)[0]
    assert 0 < before[0][0] < after[0] < 100
    bench.board.advance(2000 * MS)
    assert bench.board.motion.state(bench.board.now)[0] == after
    assert bench.board.recorder.paper == after


def test_timed_moves_cost_a_dead_tick_only_in_3_x() -> None:
    assert _duration("3.0.3", b"LT,250,85899346,0,0,0") == 251
    assert _duration("2.8.1", b"LT,250,85899346,0,0,0") == 250
    assert _duration("3.0.3", b"TD,100,0,85899346,100,858993,0,0,0,0") == 202


def _duration(firmware: str, command: bytes) -> int:
    board = Board(firmware, timed=False)
    board.advance(10)
    board.feed(command + b"\r")
    loaded = board.now + 1
    while not board.motion.idle:
        board.advance_to(board.motion.next_event() or 0)
    return board.now - loaded


def test_the_pen_travels_at_its_rate_and_the_state_is_that_of_the_start() -> None:
    bench = Bench().future()
    bench.ask(b"SP,0,0", ticks=2 * MS)
    servo = bench.board.servo
    assert not servo.up
    started = bench.board.recorder.pen_events[-1].tick
    frames = (UP_AT_BOOT - DOWN_AT_BOOT) / 400
    assert servo.travel_end() - started == round(frames * 24 * MS)
    bench.board.advance_to(started + 24 * MS)
    assert servo.position(bench.board.now) == pytest.approx(UP_AT_BOOT - 400, abs=1)
    bench.board.advance_to(servo.travel_end())
    assert servo.position(bench.board.now) == DOWN_AT_BOOT
    assert bench.ask(b"QP") == b"QP,0\n"


def test_the_pen_up_at_once_also_lifts_what_is_queued() -> None:
    bench = Bench().future(8)
    bench.ask(b"SM,1000,10,10", b"SP,0,100", b"SP,3")
    bench.run_dry()
    assert bench.ask(b"QP") == b"QP,1\n"
    assert bench.board.servo.position(bench.board.now) == UP_AT_BOOT
    # Heights are equal now: lowering does nothing until SC,5 is sent again.
    assert bench.ask(b"SP,0", b"QP") == b"SP\nQP,1\n"
    assert bench.ask(b"SC,5,15302", b"SP,0", b"QP") == b"SC\nSP\nQP,0\n"


def test_the_servo_loses_power_after_its_timeout_and_stays_where_it_is() -> None:
    bench = Bench().future()
    assert bench.ask(b"QR") == b"QR,0\n"
    assert bench.ask(b"SR,500", b"SP,0", b"QR") == b"SR\nSP\nQR,1\n"
    bench.board.advance(500 * MS)
    assert bench.ask(b"QR") == b"QR,0\n"
    assert bench.board.servo.position(bench.board.now) == DOWN_AT_BOOT


def test_motors_are_switched_off_after_the_last_motion() -> None:
    bench = Bench().future()
    bench.ask(b"CU,61,2", b"SM,100,10,10")
    bench.run_dry()
    bench.board.advance(1900 * MS)
    assert bench.ask(b"QE") == b"QE,16,16\n"
    bench.board.advance(200 * MS)
    assert bench.ask(b"QE") == b"QE,0,0\n"


def test_clearing_the_counters_inside_a_move_does_not_bend_the_line() -> None:
    bench = Bench().future()
    bench.ask(b"SM,1000,1000,-500", ticks=300 * MS)
    bench.ask(b"CS")
    bench.run_dry()
    position = bench.board.motion.state(bench.board.now)[0]
    assert 0 < position[0] < 1000
    assert bench.board.recorder.paper == pytest.approx([1000, -500], abs=1)


def test_em_clears_counters_and_the_paper_goes_on() -> None:
    bench = Bench().future(8)
    bench.ask(b"SM,100,10,20", b"EM,1,1", b"SM,100,1,2")
    bench.run_dry()
    assert bench.ask(b"QS") == b"QS,1,2\n"
    assert bench.board.recorder.paper == [11, 22]


def test_without_supply_moves_are_counted_and_the_paper_stays() -> None:
    bench = Bench().future()
    bench.ask(b"SM,1000,1000,1000", ticks=500 * MS)
    bench.board.switch_supply(False)
    halfway = list(bench.board.recorder.paper)
    bench.run_dry()
    assert bench.ask(b"QS") == b"QS,1000,1000\n"
    assert bench.board.recorder.paper == halfway
    assert 400 < halfway[0] < 600


def test_a_limit_switch_stops_drops_and_is_told_after_the_next_command() -> None:
    bench = Bench().future(8)
    bench.ask(b"CU,52,0", b"CU,53,1", b"CU,51,4", b"SM,1000,100,100", b"SM,1000,100,100")
    bench.board.wire_pin("B", 2, False)
    assert bench.board.motion.idle
    assert bench.ask(b"QG") == b"QG,90\nLimit switch triggered. PortB=E1\n"
    assert bench.ask(b"SM,100,5,5", b"SP,0") == b"SM\nSP\n"
    position = bench.board.motion.state(bench.board.now)[0]
    bench.run_dry()
    assert bench.board.motion.state(bench.board.now)[0] == position
    assert not bench.board.servo.up
    assert bench.ask(b"QU,1", b"CU,51,0", b"QG") == b"QU,E1\n\nCU\nQG,00\n"


def test_the_button_is_a_latch_that_reading_clears() -> None:
    bench = Bench().future()
    bench.board.press_button()
    assert bench.ask(b"QG", b"QG") == b"QG,30\nQG,10\n"
    bench.board.wire_pin("B", 0, False)
    assert bench.ask(b"QB", b"QB") == b"QB,1\nQB,0\n"
    bench.ask(b"SC,13,0")
    bench.board.wire_pin("B", 0, False)
    assert bench.ask(b"QB") == b"QB,0\n"


def test_homing_waits_and_goes_straight() -> None:
    bench = Bench().future(8)
    bench.ask(b"SM,100,300,-100")
    assert bench.ask(b"HM,3000", ticks=MS) == b""
    bench.run_dry()
    assert bench.ask(b"QS") == b"HM\nQS,0,0\n"


def test_a_first_line_end_is_an_unknown_command_and_later_ones_are_nothing() -> None:
    board = Board()
    board.feed(b"\r\r\n\rV\n\r\n")
    board.advance(20 * MS)
    assert [sent.data for sent in board.output()] == [
        b"!8 Err: Unknown command '\r:0D'\r\n",
        b"EBBv13_and_above EB Firmware Version 3.0.3\r\n",
    ]


def test_a_line_that_is_too_long_overwrites_its_own_beginning() -> None:
    bench = Bench().future()
    assert bench.ask(b"X" * 256 + b"QS") == b"QS,0,0\n"


def test_bytes_may_come_one_by_one() -> None:
    whole, single = Bench().future(8), Bench().future(8)
    text = b"SP,0,100\rSM,100,10,20\rQS\rES\rQG\r"
    whole.board.feed(text)
    for byte in text:
        single.board.feed(bytes([byte]))
    for bench in (whole, single):
        bench.board.advance(40 * MS)
    assert whole.board.output() == single.board.output()


def test_the_leading_y_of_3_0_2_swallows_what_follows() -> None:
    bench = Bench("3.0.2").future()
    bench.board.feed(b"Y" + b"\r" * 27)
    assert bench.ask(b"QP") == b"QP,1\n"
    assert Bench("3.0.2").future().ask(b"Y", b"QP", b"QP") == b""


def test_longer_lines_and_faster_motors_take_longer_to_parse() -> None:
    def reply_ticks(setup: bytes, line: bytes) -> int:
        bench = Bench().future(8)
        bench.ask(setup)
        start = bench.board.now
        bench.ask(line)
        bench.board.advance(10 * MS)
        (entry,) = (item for item in bench.board.recorder.wire[-1:] if item[1] == ">")
        return entry[0] - start

    idle = reply_ticks(b"QP", b"T3,375,1,0,0,1,0,0")
    assert idle == pytest.approx(2.2 * MS, abs=1)
    assert reply_ticks(b"SM,60000,1500000,1500000", b"T3,375,1,0,0,1,0,0") == pytest.approx(2.9 * MS, abs=1)
    assert reply_ticks(b"QP", T3) > idle


# ---- the record


def test_a_queue_that_runs_dry_under_the_pen_is_recorded() -> None:
    bench = Bench().future(8)
    bench.ask(b"SP,0")
    bench.ask(T3, T3, ticks=5 * MS)
    bench.board.advance(50 * MS)
    bench.ask(T3)
    bench.run_dry()
    summary = bench.board.recorder.summary(bench.board.now)
    (gap,) = summary["gaps"]
    assert (summary["underruns"], gap[2]) == (1, True)
    assert summary["underrun_ticks"] == gap[1] > 20 * MS
    assert summary["motion_ticks"] == 3 * 376 + gap[1]


def test_ink_is_where_the_pen_was_and_nowhere_else() -> None:
    bench = Bench().future(32)
    bench.ask(b"SM,100,100,0", b"SP,0,500", b"SM,200,0,300", b"SP,1,500", b"SM,100,-50,0", b"SP,0,500", b"SP,1,500")
    bench.run_dry()
    recorder, now = bench.board.recorder, bench.board.now
    line, dot = recorder.strokes(touching=False, now=now)
    assert (line["points"][0], line["points"][-1], dot["points"]) == ([100, 0], [100, 300], [[50, 300]])
    touching = recorder.strokes(touching=True, now=now)
    assert [stroke["points"] for stroke in touching] == [line["points"], dot["points"]]
    assert touching[0]["down_tick"] > line["down_tick"]
    assert len(line["points"]) == pytest.approx(200, abs=3)


def test_ink_of_a_lowering_that_was_not_waited_for_differs_in_the_two_traces() -> None:
    bench = Bench().future(32)
    bench.ask(b"SP,0,0", b"SM,1000,1000,0", b"SP,1,500")
    bench.run_dry()
    recorder, now = bench.board.recorder, bench.board.now
    (commanded,) = recorder.strokes(touching=False, now=now)
    (touching,) = recorder.strokes(touching=True, now=now)
    assert commanded["points"][0] == [0, 0]
    assert 100 < touching["points"][0][0] < 400


def test_sampled_ink_is_the_boards_own_position() -> None:
    bench = Bench().future(32)
    bench.ask(b"SP,0,0")
    positions = {}
    for command in (T3, b"SM,50,40,-30", b"L3,400000000,60,300,2,-300000000,50,10,-3", b"LM,0,20,90000,900000000,20,-70000"):
        bench.ask(command, ticks=1)
    for _ in range(300):
        bench.board.advance(11)
        positions[bench.board.now] = bench.board.motion.state(bench.board.now)[0]
    bench.run_dry()
    bench.board.advance(1)
    ticks = np.array(sorted(positions), dtype=np.int64)
    sampled = bench.board.recorder.positions(ticks)
    assert sampled.tolist() == [positions[tick] for tick in ticks.tolist()]
    assert len({tuple(p) for p in positions.values()}) > 50


# ---- other firmware


def test_firmware_that_nobody_wrote_down_is_refused() -> None:
    with pytest.raises(BadCommand, match=r"1\.9\.0"):
        Board("1.9.0")


@pytest.mark.parametrize("version", FIRMWARES)
def test_every_version_says_which_it_is(version: str) -> None:
    assert Bench(version).ask(b"V") == f"EBBv13_and_above EB Firmware Version {version}\r\n".encode()


def test_it_can_claim_to_be_anything() -> None:
    assert Bench(version_line="Grbl 1.1f ['$' for help]").ask(b"V") == b"Grbl 1.1f ['$' for help]\r\n"


def test_2_8_1_is_without_the_commands_of_3_0() -> None:
    bench = Bench("2.8.1")
    for command in (b"T3", b"TD", b"L3", b"QU", b"TR"):
        assert bench.ask(command).startswith(b"!8 Err: Unknown command '" + command)
    assert bench.ask(b"QL", b"QC") == b"000\r\nOK\r\n0394,0300\r\nOK\r\n"
    assert Bench("2.7.0").ask(b"QE").startswith(b"!8 Err")


def test_2_8_1_stops_only_moves_by_steps_and_tells_what_is_left() -> None:
    bench = Bench("2.8.1")
    assert bench.ask(b"SM,1000,500,-250", b"SM,1000,7,8", b"ES") == b"OK\r\nOK\r\n1,7,8,481,241\n\rOK\r\n"
    bench.ask(b"LT,25000,85899346,0,0,0")
    assert bench.ask(b"ES") == b"OK\r\n0,0,0,0,0\n\rOK\r\n"[4:]
    assert bench.ask(b"QM").startswith(b"QM,1,1,")


def test_2_8_1_has_rates_without_a_sign() -> None:
    bench = Bench("2.8.1")
    assert bench.ask(b"LM,-85899346,10,0,0,0,0").endswith(b"!6 Err: Invalid parameter value\r\n")
    assert bench.board.motion.idle
    bench.ask(b"LM,85899346,-10,0,85899346,10,0", b"QS")
    bench.run_dry()
    assert bench.ask(b"QS") == b"-10,10\n\rOK\r\n"
    # Slower than nothing rolls over to nearly full speed instead of turning back.
    bench.ask(b"CS", b"LT,200,1000000,-100000,0,0")
    bench.run_dry()
    forward = bench.board.motion.state(bench.board.now)[0][0]
    assert forward > 100


def test_2_7_0_executes_em_at_once() -> None:
    old, new = Bench("2.7.0"), Bench("2.8.1")
    for bench in (old, new):
        bench.ask(b"SM,1000,1000,1000", b"EM,2,1")
    assert (old.board.microstep, new.board.microstep) == (8, 16)
    new.run_dry()
    assert new.board.microstep == 8


def test_2_8_1_homes_in_two_parts_when_one_axis_would_be_too_slow() -> None:
    bench = Bench("2.8.1")
    bench.ask(b"SM,100,1,0", b"SM,2000,0,20000")
    bench.run_dry()
    moves_before = bench.board.recorder.stepper_moves
    bench.ask(b"HM,2000")
    bench.run_dry()
    bench.board.advance(MS)
    bench.run_dry()
    assert bench.ask(b"QS") == b"0,0\n\rOK\r\n"
    assert bench.board.recorder.stepper_moves - moves_before == 2


def test_2_8_1_reports_by_itself_when_asked_to() -> None:
    bench = Bench("2.8.1")
    bench.ask(b"T,100,1")
    bench.board.advance(250 * MS)
    assert [sent.data for sent in bench.board.output()] == [b"A,00:0394,11:0300\n\r"] * 2
    bench.ask(b"T,0,1")
    bench.board.advance(250 * MS)
    assert bench.board.output() == []


def test_3_0_0_answers_moves_dropped_by_a_limit_switch_with_nothing() -> None:
    for version, reply in (("3.0.0", b""), ("3.0.1", b"OK\r\n")):
        bench = Bench(version)
        bench.ask(b"CU,52,0", b"CU,51,8")
        assert bench.ask(b"LT,100,1000,0,0,0") == reply
        assert bench.ask(b"SM,100,1,1") == b"OK\r\n"


def test_errors_come_alone_in_3_0_3_and_after_ok_before_it() -> None:
    assert Bench("3.0.3").ask(b"SM,0,1,1") == b"!6 Err: Invalid parameter value\r\n"
    assert Bench("3.0.2").ask(b"SM,0,1,1") == b"OK\r\n!6 Err: Invalid parameter value\r\n"


def test_checksums_are_asked_for_and_checked() -> None:
    bench = Bench()
    bench.ask(b"CU,54,1")
    assert bench.ask(b"QP") == b"!10 Err: No checksum found but required\r\n"
    assert bench.ask(b"QP,1") == b"!9 Err: Checksum incorrect, expected 95\r\n"
    assert bench.ask(b"QP,95", b"CU,54,0,119", b"QP") == b"1\n\rOK\r\nOK\r\n1\n\rOK\r\n"


def test_reset_forgets_everything_but_the_name() -> None:
    bench = Bench().future(8)
    bench.ask(b"ST,East", b"SL,9,4", b"SM,1000,100,100", b"SP,0")
    assert bench.ask(b"R", b"QT", b"QL,4") == b"R\nEast\r\nOK\r\n0\r\nOK\r\n"
    assert bench.ask(b"QS", b"QG", b"QU,3") == b"0,0\n\rOK\r\n10\r\nQU,1\r\nOK\r\n"
