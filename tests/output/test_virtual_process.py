"""The virtual board as another program meets it: a port to open, a clock of its own, and faults on request."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import serial

from output.ebb.virtual import VirtualBoard, start_virtual_board
from output.ebb.virtual.registers import TICKS_PER_S
from output.errors import BadCommand

T3 = b"T3,375,400000000,0,0,-200000000,1000,0"
DEADLINE_S = 5.0


class Host:
    """The simplest host: one command, one line of reply."""

    def __init__(self, path: str) -> None:
        self.port = serial.Serial(path, timeout=DEADLINE_S)
        self.buffer = b""

    def line(self, timeout_s: float = DEADLINE_S) -> bytes:
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self.buffer:
            self.port.timeout = max(0.0, deadline - time.monotonic())
            data = self.port.read(1)
            if not data:
                return b""
            self.buffer += data + self.port.read(self.port.in_waiting)
        line, _, self.buffer = self.buffer.partition(b"\n")
        return line + b"\n"

    def ask(self, command: bytes, timeout_s: float = DEADLINE_S) -> bytes:
        self.port.write(command + b"\r")
        return self.line(timeout_s)

    def handshake(self, depth: int = 32) -> None:
        self.ask(b"V")
        assert self.ask(b"CU,10,1") == b"\n"
        assert self.ask(b"CU,4,%d" % depth) == b"CU\n"

    def until_idle(self) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while int(self.ask(b"QG")[3:5], 16) & 0x0F:
            assert time.monotonic() < deadline


@contextmanager
def plugged(speed: float = 20.0, **options: Any) -> Iterator[tuple[VirtualBoard, Host]]:
    with start_virtual_board(speed=speed, **options) as board:
        host = Host(board.port)
        try:
            yield board, host
        finally:
            host.port.close()


def test_a_stroke_is_drawn_and_recorded() -> None:
    with plugged(speed=2.0) as (board, host):
        host.handshake()
        for command in (b"SP,0,400", *[T3] * 20, b"SP,1,400"):
            assert host.ask(command) == command[:2] + b"\n"
        host.until_idle()
        position = host.ask(b"QS")
        record = board.record()
    first, second = (int(value) for value in position[3:].split(b","))
    (ink,) = record["ink"]
    (touching,) = record["ink_touching"]
    assert ink["points"][0] == [0, 0]
    assert ink["points"][-1] == touching["points"][-1] == [first, second]
    assert record["motion_ticks"] == 20 * 376
    assert (record["underruns"], record["pen_up"], record["firmware"]) == (0, True, "3.0.3")
    # Down from 22565 to half way between the heights, at 400 a frame of 24 ms, takes 9.08 frames.
    assert touching["down_tick"] - ink["down_tick"] == pytest.approx(9.08 * 600, abs=600)


def test_a_full_queue_makes_the_board_deaf_even_for_a_stop() -> None:
    with plugged(speed=1.0) as (board, host):
        host.handshake(depth=2)
        for _ in range(4):
            host.port.write(b"SM,300,100,100\r")
        asked = time.monotonic()
        host.port.write(b"ES\r")
        assert [host.line() for _ in range(4)] == [b"SM\n"] * 4
        assert host.line() == b"ES,1\n"
        assert time.monotonic() - asked > 0.25
        blocked = board.record()["parser_blocked"]
    assert len(blocked) == 1
    assert blocked[0][1] - blocked[0][0] > 0.25 * TICKS_PER_S


def test_with_room_in_the_queue_a_stop_is_immediate() -> None:
    with plugged(speed=1.0) as (board, host):
        host.handshake(depth=8)
        for _ in range(4):
            host.ask(b"SM,2000,100,100")
        assert host.ask(b"ES") == b"ES,1\n"
        assert board.state()["idle"]
        # By the board's own clock: eight seconds of motion were queued, and next to none of it was made.
        record = board.record()
        assert record["parser_blocked"] == []
        assert record["position"][0] < 200


def test_a_late_host_is_an_underrun_and_not_a_longer_move() -> None:
    with plugged(speed=1.0) as (board, host):
        host.handshake()
        host.ask(b"SP,0,0")
        host.ask(T3)
        time.sleep(0.2)
        host.ask(T3)
        host.until_idle()
        record = board.record()
    assert record["underruns"] == 1
    gap = record["gaps"][0]
    assert gap[1] > 0.1 * TICKS_PER_S
    assert gap[2] is True


def test_a_patient_board_at_high_speed_waits_for_a_host_that_is_only_slow_in_board_time() -> None:
    with plugged(speed=50.0, patience_s=1.0) as (board, host):
        host.handshake()
        host.ask(b"SP,0,0")
        for _ in range(40):
            # 20 ms are a second of the board's time.
            time.sleep(0.02)
            assert host.ask(T3) == b"T3\n"
        host.until_idle()
        record = board.record()
    assert record["underruns"] == 0
    assert record["motion_ticks"] == 40 * 376
    assert record["patience_used_s"] > 0.3


def test_the_board_ends_with_its_parent_and_keeps_its_record(tmp_path: Path) -> None:
    record_path, link = tmp_path / "record.json", tmp_path / "ebb"
    with plugged(record=record_path, pty=link, nickname="East EBB", pen_down=True) as (board, host):
        assert board.port == str(link)
        assert host.ask(b"QT") == b"East EBB\r\n"
        assert board.state()["pen_touches"]
        board.stop()
        assert not board.running
        assert board.record()["nickname"] == "East EBB"
    assert record_path.exists()
    assert not link.exists()
    record_path.unlink()
    assert board.record()["commands"] == 1


def test_an_unknown_firmware_or_control_is_refused() -> None:
    with pytest.raises(BadCommand, match=r"no virtual board has firmware 1\.2\.3"), start_virtual_board(firmware="1.2.3"):
        pass
    with start_virtual_board() as board, pytest.raises(BadCommand, match="unknown control"):
        board.control("fly")


def test_the_world_outside_reaches_the_board() -> None:
    with plugged() as (board, host):
        host.handshake()
        board.control("button")
        assert int(host.ask(b"QG")[3:5], 16) & 0x20
        host.ask(b"CU,60,250")
        board.control("power off")
        time.sleep(0.01)
        assert int(host.ask(b"QG")[3:5], 16) & 0x40
        host.ask(b"SP,0,0")
        host.ask(T3)
        host.until_idle()
        assert host.ask(b"QS") != b"QS,0,0\n"
        assert board.record()["paper_position"] == [0, 0]


def faulty(**fault: Any) -> Any:
    return plugged(faults=[fault])


# Commands are counted from 0: V, CU,10,1 and CU,4,32 are the handshake, so the fourth is number 3.
AT = {"command": 3}


def test_a_dropped_reply_is_the_only_one_missing() -> None:
    with faulty(fault="drop_ack", at=AT) as (_, host):
        host.handshake()
        assert host.ask(b"QP", 0.2) == b""
        assert host.ask(b"QR") == b"QR,0\n"


def test_a_delayed_reply_comes_late_and_in_order() -> None:
    with faulty(fault="delay_ack", at=AT, delay_real_s=0.3) as (_, host):
        host.handshake()
        asked = time.monotonic()
        host.port.write(b"QP\rQR\r")
        assert [host.line(), host.line()] == [b"QP,1\n", b"QR,0\n"]
        assert time.monotonic() - asked > 0.25


def test_a_doubled_reply() -> None:
    with faulty(fault="dup_ack", at=AT) as (_, host):
        host.handshake()
        assert [host.ask(b"QP"), host.line(), host.line(0.1)] == [b"QP,1\n", b"QP,1\n", b""]


def test_a_split_reply_comes_whole_in_the_end() -> None:
    with faulty(fault="split", at=AT, after=2, delay_real_s=1.0) as (_, host):
        host.handshake()
        host.port.write(b"QP\r")
        # All that was asked for comes at once, or both parts are there: a host that is held up for that second sees no split.
        assert host.port.read(2) == b"QP"
        assert host.port.in_waiting == 0
        assert host.line() == b",1\n"


@pytest.mark.parametrize(
    ("place", "expected"), [("before", b"*#QP,1\n"), ("inside", b"QP*#,1\n"), ("after", b"QP,1\n*#")], ids=str
)
def test_garbage_in_a_reply(place: str, expected: bytes) -> None:
    with faulty(fault="garbage", at=AT, data="*#", place=place) as (_, host):
        host.handshake()
        host.port.write(b"QP\r")
        host.port.timeout = 1.0
        assert host.port.read(len(expected)) == expected


def test_an_unsolicited_line() -> None:
    with faulty(fault="notice", at=AT, text="Limit switch triggered. PortB=E5") as (_, host):
        host.handshake()
        assert host.ask(b"QP") == b"Limit switch triggered. PortB=E5\n"
        assert host.line() == b"QP,1\n"


def test_a_refused_command_is_not_executed() -> None:
    with faulty(fault="nak", at=AT, text="!6 Err: Invalid parameter value") as (board, host):
        host.handshake()
        assert host.ask(b"SM,10,5,5") == b"SM,!6 Err: Invalid parameter value\n"
        assert host.ask(b"SM,10,5,5") == b"SM\n"
        host.until_idle()
        assert board.state()["position"] == [5, 5]


def test_a_frozen_board_is_silent_and_then_goes_on() -> None:
    with faulty(fault="freeze", at=AT, for_real_s=0.3) as (_, host):
        host.handshake()
        asked = time.monotonic()
        assert host.ask(b"QP") == b"QP,1\n"
        assert time.monotonic() - asked > 0.25


def test_a_slow_board_takes_its_time() -> None:
    with faulty(fault="slow", at={"command": 2}, factor=2000) as (_, host):
        host.handshake()
        asked = time.monotonic()
        assert host.ask(b"QP") == b"QP,1\n"
        # 0.4 ms for 2000 times as long, at 20 times the speed.
        assert time.monotonic() - asked > 0.03


@pytest.mark.parametrize("at", [AT, {"byte": 18}, {"time_s": 0.5}], ids=str)
def test_the_plug_is_pulled(at: dict[str, Any]) -> None:
    with faulty(fault="hangup", at=at) as (board, host):
        with pytest.raises((serial.SerialException, OSError)):
            for _ in range(100):
                host.ask(b"QP", 0.2)
                time.sleep(0.01)
        assert board.state()["port"] is None


def test_it_comes_back_under_another_name(tmp_path: Path) -> None:
    link, other = tmp_path / "ACM0", tmp_path / "ACM1"
    fault = {"fault": "hangup_and_return", "at": AT, "after_real_s": 0.2, "pty": str(other)}
    with start_virtual_board(speed=20, pty=link, faults=[fault]) as board:
        host = Host(board.port)
        host.handshake()
        with pytest.raises((serial.SerialException, OSError)):
            while True:
                host.ask(b"SL,7,3", 0.2)
        deadline = time.monotonic() + DEADLINE_S
        while not other.exists():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert not link.exists()
        again = Host(str(other))
        # The board ran on: syntax and variables are as they were left.
        assert again.ask(b"QL,3") == b"QL,7\n"
        again.port.close()


def test_a_reboot_forgets_everything_and_keeps_the_port_if_asked() -> None:
    with faulty(fault="reboot", at={"command": 5}, hangup=False) as (board, host):
        host.handshake()
        host.ask(b"SL,7,3")
        host.ask(b"SM,10,5,5")
        host.port.write(b"QP\r")
        assert host.line(0.2) == b""
        assert host.ask(b"QL,3") == b"0\r\n"
        assert board.state()["position"] == [0, 0]


def test_rb_drops_the_port_and_comes_back_as_after_power_on(tmp_path: Path) -> None:
    link = tmp_path / "ebb"
    with start_virtual_board(speed=20, pty=link, nickname="East") as board:
        host = Host(board.port)
        host.handshake()
        host.port.write(b"RB\r")
        with pytest.raises((serial.SerialException, OSError)):
            while True:
                host.line(0.05)
        deadline = time.monotonic() + DEADLINE_S
        while board.state()["port"] is None or board.state()["now_tick"] < TICKS_PER_S:
            assert time.monotonic() < deadline
        again = Host(str(link))
        assert again.ask(b"QT") == b"East\r\n"
        again.port.close()
        host.port.close()


def test_the_supply_dips_and_the_flag_stays() -> None:
    with faulty(fault="power", at={"command": 4}, for_s=0.03) as (board, host):
        host.handshake()
        host.ask(b"CU,60,250")
        host.ask(b"QP")
        time.sleep(0.05)
        assert board.state()["supply_on"]
        assert [int(host.ask(b"QG")[3:5], 16) & 0x40 for _ in range(2)] == [0x40, 0]


def test_the_button_at_a_stroke() -> None:
    with faulty(fault="button", at={"stroke": 1}) as (_, host):
        host.handshake()
        flags = []
        for command in (b"SP,0,10", b"SP,1,10", b"SP,0,10", b"SP,1,10"):
            host.ask(command)
            time.sleep(0.01)
            flags.append(int(host.ask(b"QG")[3:5], 16) >> 5 & 1)
        assert flags == [0, 0, 1, 0]


def test_a_wrong_script_is_refused() -> None:
    with pytest.raises(BadCommand, match="explode"), start_virtual_board(faults=[{"fault": "explode", "at": AT}]):
        pass
