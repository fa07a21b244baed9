"""Finding boards, choosing one, and keeping others off it."""

from __future__ import annotations

import io
import os
import pty
import select
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
import serial

from output.ebb import link
from output.ebb.link import CLOSE_TIMEOUT_S, WRITE_TIMEOUT_S, SerialPort
from output.ebb.port_lock import PortLock
from output.ebb.ports import FoundPort, choose_port, find_ports, wait_for_board
from output.ebb.session import connect
from output.errors import BoardRefused, LinkLost
from tests.output.fake_ebb import FakeEbb


def listed(
    device: str, vid: int | None, pid: int | None, product: str | None = None, serial_number: str | None = None
) -> object:
    return SimpleNamespace(
        device=device, vid=vid, pid=pid, product=product, serial_number=serial_number, description=product or device
    )


# What pyserial lists on each system, with and without a nickname, and the neighbours that must not be taken for a board.
SYSTEMS = {
    "linux": [
        listed("/dev/ttyS0", None, None),
        listed("/dev/ttyACM1", 0x04D8, 0xFD92, "EiBotBoard", None),
        listed("/dev/ttyACM0", 0x04D8, 0xFD92, "EiBotBoard,East EBB", "East EBB"),
        listed("/dev/ttyACM2", 0x04D8, 0x000A, "CDC RS-232 Emulation Demo"),
    ],
    "macos": [
        listed("/dev/cu.Bluetooth-Incoming-Port", None, None),
        listed("/dev/cu.usbmodem14101", 0x04D8, 0xFD92, "EiBotBoard,West", "West"),
        listed("/dev/cu.usbserial-1420", 0x0403, 0x6001, "FT232R"),
    ],
    "windows": [
        listed("COM1", None, None),
        SimpleNamespace(
            device="COM4", vid=0x04D8, pid=0xFD92, product=None, serial_number="", description="EiBotBoard,Old One (COM4)"
        ),
    ],
    "raspberry pi": [listed("/dev/ttyAMA0", None, None), listed("/dev/ttyACM0", 0x04D8, 0xFD92, None, "Pi plotter")],
}


@pytest.mark.parametrize(
    ("system", "expected"),
    [
        ("linux", [("/dev/ttyACM0", "East EBB"), ("/dev/ttyACM1", "")]),
        ("macos", [("/dev/cu.usbmodem14101", "West")]),
        ("windows", [("COM4", "Old One")]),
        ("raspberry pi", [("/dev/ttyACM0", "Pi plotter")]),
    ],
)
def test_boards_are_found_by_what_the_usb_says(system: str, expected: list[tuple[str, str]]) -> None:
    assert [(port.device, port.nickname) for port in find_ports(SYSTEMS[system])] == expected


EAST, EASTER, WEST = FoundPort("/dev/a", "East"), FoundPort("/dev/b", "Easter"), FoundPort("/dev/c", "West")


def test_one_board_needs_no_name() -> None:
    assert choose_port(None, [EAST]) == "/dev/a"


def test_none_is_an_error_and_never_a_simulation() -> None:
    with pytest.raises(LinkLost, match=r"no EiBotBoard is plugged in.*--port sim"):
        choose_port(None, [])


def test_two_boards_and_no_choice_are_refused_by_name() -> None:
    with pytest.raises(BoardRefused, match=r"/dev/a \(East\).*/dev/c \(West\)"):
        choose_port(None, [EAST, WEST])


def test_nicknames_are_taken_exactly_first_and_then_by_a_unique_beginning() -> None:
    assert choose_port("east", [EAST, EASTER, WEST]) == "/dev/a"
    assert choose_port("w", [EAST, EASTER, WEST]) == "/dev/c"
    with pytest.raises(BoardRefused, match="fits 2 boards"):
        choose_port("Eas", [EAST, EASTER, WEST])
    with pytest.raises(LinkLost, match="no board is named 'North'"):
        choose_port("North", [EAST])


@pytest.mark.parametrize("name", ["/dev/ttyACM7", "COM12", "com3", "./ebb"])
def test_a_port_is_taken_as_it_is(name: str) -> None:
    assert choose_port(name, [EAST, WEST]) == name


def test_a_board_that_comes_back_under_another_name_is_known_by_its_nickname() -> None:
    now = [0.0]
    lists = iter([[], [WEST], [WEST, FoundPort("/dev/z", "East")]])
    assert (
        wait_for_board(
            "East", 5.0, find=lambda: next(lists), sleep=lambda s: now.__setitem__(0, now[0] + s), clock=lambda: now[0]
        )
        == "/dev/z"
    )
    with pytest.raises(LinkLost, match="did not come back within 1 s"):
        wait_for_board("East", 1.0, find=lambda: [WEST], sleep=lambda s: now.__setitem__(0, now[0] + s), clock=lambda: now[0])


def test_a_board_that_comes_back_while_the_program_is_stopped_is_found() -> None:
    now, east = [0.0], FoundPort("/dev/z", "East")
    lists = iter([[], [east]])

    def find() -> list[FoundPort]:
        now[0] += 10.0
        return next(lists)

    assert wait_for_board("East", 5.0, find=find, sleep=lambda _: None, clock=lambda: now[0]) == "/dev/z"


# opening


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    master, slave = pty.openpty()
    name = os.ttyname(slave)
    os.close(slave)
    yield master, name
    os.close(master)


def test_a_missing_port_is_a_lost_link() -> None:
    with pytest.raises(LinkLost, match=r"no port /dev/not-there.*plotter ports"):
        connect("/dev/not-there")


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(BoardRefused, match="not a serial port"):
        connect(str(tmp_path / "file"))


def test_a_second_opening_names_the_holder(terminal: tuple[int, str]) -> None:
    _, name = terminal
    port = SerialPort(name)
    other = subprocess.run(
        [sys.executable, "-c", f"from output.ebb.link import SerialPort; SerialPort({name!r})"],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )
    assert f"in use by process {os.getpid()}" in other.stderr
    port.send(b"V\r")
    port.close()
    SerialPort(name).close()


def test_another_users_lock_on_the_port_itself_is_respected(terminal: tuple[int, str]) -> None:
    _, name = terminal
    with serial.Serial(name, exclusive=True), pytest.raises(BoardRefused, match="in use by another program"):
        SerialPort(name)


def test_a_lock_ends_with_its_process(terminal: tuple[int, str]) -> None:
    _, name = terminal
    holder = subprocess.Popen(
        [
            sys.executable,
            "-c",
            f"import time\nfrom output.ebb.link import SerialPort\np = SerialPort({name!r}); print(1, flush=True)\n"
            "time.sleep(60)",
        ],
        stdout=subprocess.PIPE,
    )
    assert holder.stdout is not None
    holder.stdout.readline()
    with pytest.raises(BoardRefused, match=f"process {holder.pid}"):
        SerialPort(name)
    holder.kill()
    holder.wait()
    holder.stdout.close()
    SerialPort(name).close()


def test_no_permission_tells_the_group(terminal: tuple[int, str]) -> None:
    """As an ordinary user; for root no mode forbids anything, so a child gives its rights up first."""
    _, name = terminal
    Path(name).chmod(0)
    code = "import os\nfrom output.ebb.link import SerialPort\nos.setuid(65534) if os.getuid() == 0 else None\n"
    code += f"SerialPort({name!r})"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False)
    Path(name).chmod(stat.S_IRUSR | stat.S_IWUSR)
    assert "dialout" in out.stderr


def test_lock_files_do_not_stay(tmp_path: Path) -> None:
    lock = PortLock("/dev/x", tmp_path)
    assert lock.path.exists()
    with pytest.raises(BoardRefused, match="in use by process"):
        PortLock("/dev/x", tmp_path)
    PortLock("/dev/y", tmp_path).release()
    lock.release()
    lock.release()
    assert list(tmp_path.iterdir()) == []
    PortLock("/dev/x", tmp_path).release()


def test_a_lock_that_finds_no_room_for_its_holders_name_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> NoReturn:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("output.ebb.port_lock.os.pwrite", full)
    lock = PortLock("/dev/x", tmp_path)
    with pytest.raises(BoardRefused, match="in use by another program"):
        PortLock("/dev/x", tmp_path)
    lock.release()
    assert list(tmp_path.iterdir()) == []


def test_a_pulled_cable_is_a_lost_link_for_every_verb() -> None:
    master, slave = pty.openpty()
    port = SerialPort(os.ttyname(slave))
    os.close(slave)
    os.close(master)
    with pytest.raises(LinkLost):
        port.receive(1.0)
    with pytest.raises(LinkLost):
        port.send(b"V\r")
        port.send(b"V\r")
    port.close()
    port.close()
    port.wake()


def test_a_board_that_reads_nothing_cannot_hold_us(terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """It is waited for once, and looked at once more; how long a busy computer takes over that is its own affair."""
    _, name = terminal
    port = SerialPort(name)
    in_vain: list[float] = []

    def wait(fd: int, timeout_s: float, writable: Callable[[int, float], bool] = link._writable) -> bool:
        if not (there := writable(fd, timeout_s)):
            in_vain.append(timeout_s)
        return there

    monkeypatch.setattr(link, "_writable", wait)
    with pytest.raises(LinkLost, match="took no bytes"):
        for _ in range(100):
            port.send(b"x" * 1000)
    assert in_vain == [WRITE_TIMEOUT_S, 0.0]
    assert WRITE_TIMEOUT_S <= 0.5
    port.close()


def test_a_stop_in_the_middle_of_a_write_is_not_the_boards_fault(
    terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGSTOP for longer than a write may take, just after the bytes were taken."""
    board, name = terminal
    port = SerialPort(name)

    def write_and_stop(fd: int, data: bytes, write: Callable[[int, bytes], int] = os.write) -> int:
        count = write(fd, data)
        time.sleep(WRITE_TIMEOUT_S + 0.1)
        return count

    monkeypatch.setattr(os, "write", write_and_stop)
    port.send(b"V\r")
    monkeypatch.undo()
    assert os.read(board, 10) == b"V\r"
    port.close()


def test_a_wait_to_write_that_outlasted_its_time_looks_again(
    terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """SIGSTOP while the port was full, and the board took bytes meanwhile."""
    board, name = terminal
    port = SerialPort(name)
    received = bytearray()

    def wait(reading: list[int], writing: list[int], other: list[int], timeout_s: float) -> object:
        if timeout_s > 0:
            received.extend(os.read(board, 4096))
            return [], [], []
        return reading, writing, other

    monkeypatch.setattr(select, "select", wait)
    port.send(b"x" * 20_000)
    monkeypatch.undo()
    port.send(b"y")
    while not received.endswith(b"y"):
        received.extend(os.read(board, 4096))
    assert received == b"x" * 20_000 + b"y"
    port.close()


def test_closing_has_a_deadline(terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
    _, name = terminal
    port = SerialPort(name)
    release, closed = threading.Event(), []
    monkeypatch.setattr(port._serial, "close", lambda: closed.append(release.wait(30)))
    port.close()
    assert closed == [], "it comes back while the close is hanging"
    assert CLOSE_TIMEOUT_S <= 1.0
    release.set()


def test_waiting_ends_when_woken(terminal: tuple[int, str]) -> None:
    _, name = terminal
    port = SerialPort(name)
    port.wake()
    began = time.monotonic()
    assert port.receive(60.0) == b""
    assert time.monotonic() - began < 30.0
    port.close()


# who answers


# Windows, as far as it can be had here


class WindowsSerial(io.RawIOBase):
    """As pyserial's there: `fileno` is what its base class has, which raises. The port answers what was written to it."""

    timeout: float | None = None

    def __init__(self) -> None:
        self.written = b""

    def write(self, data: Any) -> int:
        self.written += data
        return len(data)

    @property
    def in_waiting(self) -> int:
        return len(self.written)

    def read(self, size: int = -1) -> bytes:
        data, self.written = self.written[:size], self.written[size:]
        return data


def test_a_port_without_a_descriptor_is_asked_again_and_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link, "_open", lambda _name: WindowsSerial())
    port = SerialPort("COM4")
    port.send(b"QG\r")
    assert port.receive(0.1) == b"QG\r"
    assert port.receive(0.0) == b""
    port.wake()
    port.close()


ON_WINDOWS = """
import os, signal, sys
import serial.tools.list_ports, subprocess  # these have their own ways there
for name in ("fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"):
    sys.modules[name] = None
for name in [name for name in vars(signal) if name.startswith("SIG") and name not in ("SIGINT", "SIGTERM")]:
    if not name.startswith("SIG_"):
        delattr(signal, name)
for name in ("set_blocking", "pread", "pwrite", "tcgetpgrp", "getpgrp", "fork", "killpg", "openpty", "O_NOFOLLOW"):
    delattr(os, name)
from plotter.cli.main import LazyGroup, cli, run
import click
for name in LazyGroup.homes:
    LazyGroup(name="x").get_command(click.Context(cli), name)
from output.ebb.control import StopFlag, ignore_signals, signals_stop
from plotter.cli.keys import keys
with signals_stop(StopFlag(), pauses=True), keys(StopFlag()) as listening:
    assert not listening
ignore_signals()
assert run(["--help"]) == 0
"""


def test_every_command_is_there_without_what_only_unix_has() -> None:
    done = subprocess.run(
        [sys.executable, "-c", ON_WINDOWS], capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "plotter plot drawing.svg" in done.stdout


class Talker(FakeEbb):
    """Something else on the port: answers every line with the same text."""

    answer = b""

    def _execute(self, wire: str) -> bytes:  # noqa: ARG002 - it answers everything alike
        return self.answer


@pytest.mark.parametrize(
    ("answer", "match"),
    [(b"", "answers nothing"), (b"error:20\r\nGrbl 1.1f ['$' for help]\r\n", "Grbl"), (b"\xff\x00\n", "not an EiBotBoard")],
)
def test_something_else_on_the_port_is_refused(answer: bytes, match: str) -> None:
    fake = Talker()
    fake.answer = answer
    with pytest.raises(BoardRefused, match=match):
        connect(fake, clock=fake.clock)
    assert fake.dead, "the port is given back"
    assert not any(b"SP" in data or b"SM" in data for _, data in fake.written)


@pytest.mark.parametrize("version", [(2, 2, 6), (1, 9, 5)])
def test_firmware_whose_queue_cannot_be_watched_is_refused(version: tuple[int, int, int]) -> None:
    fake = FakeEbb(version=version)
    with pytest.raises(BoardRefused, match="update it"):
        connect(fake, clock=fake.clock)


@pytest.mark.parametrize("version", [(2, 4, 4), (2, 5, 3), (2, 8, 1), (3, 0, 0), (3, 0, 3), (9, 9, 0)])
@pytest.mark.parametrize("future", [False, True])
@pytest.mark.parametrize("half_line", [b"", b"SM,10", b"AT"])
def test_the_handshake_works_from_any_state(version: tuple[int, int, int], future: bool, half_line: bytes) -> None:
    fake = FakeEbb(version=version, future=future and version[0] >= 3, half_line=half_line)
    fake.say(b"T3\nT3\nOK\r\nQU,4\n\n")  # what the program before did not read any more
    board = connect(fake, clock=fake.clock)
    assert board.firmware == ".".join(map(str, version))
    assert board.query("QS") == "0,0"
    again = connect(fake, clock=fake.clock)
    assert again.query("QS") == "0,0"
    assert fake.pen_up


def test_a_modem_manager_in_the_line_is_survived() -> None:
    fake = FakeEbb()
    count = [0]

    def meddle(f: FakeEbb) -> None:
        count[0] += 1
        if count[0] < 6:
            f._in.append((f.now, b"AT\r"))

    fake.on_time = meddle
    board = connect(fake, clock=fake.clock, clear=False)
    fake.on_time = None
    assert board.firmware == "3.0.3"


def test_a_new_connection_stops_what_moves_and_a_quiet_one_does_not() -> None:
    for clear in (True, False):
        fake = FakeEbb()
        fake.send(b"SM,5000,100,100\r")
        fake.receive(0.1)
        board = connect(fake, clock=fake.clock, clear=clear)
        assert (fake.executing is None) is clear
        board.close()
