"""The journal: what it says after any damage, and that it never gets in the plot's way."""

from __future__ import annotations

import os
import queue
import threading
import time
from pathlib import Path
from typing import Any, NoReturn

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from output.ebb.commands import EM, SC, SM, SP, Command
from output.ebb.control import StopFlag
from output.ebb.firmware import firmware
from output.ebb.journal import Held, Journal, PlotState, differences, discard, load
from output.ebb.program import Mark, StrokeEnd, StrokeMark
from output.ebb.progress import Progress
from output.ebb.resume import find_place, position_lost
from output.ebb.session import connect
from tests.output.fake_ebb import FakeEbb
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("inline_producer")

HEAD = {"drawing": "ab12", "settings": {"speed_mm_s": 100, "pen_down": 40}, "planner": "0.1.0"}


def program(strokes: int = 3, moves: int = 6) -> list[Command | Mark]:
    items: list[Command | Mark] = [SC(4, 20000), SC(5, 15000), EM(1, 1), SP(1, 50)]
    x = y = 0
    for k in range(strokes):
        items += [SM(50, 30, 10), StrokeMark(k), SP(0, 50)]
        x, y = x + 30, y + 10
        for i in range(moves):
            items.append(SM(30, 20 + i, -10 * k))
            x, y = x + 20 + i, y - 10 * k
        items += [StrokeEnd(k, (x, y)), SP(1, 50)]
    return items


def write(path: Path, commands: int = 59, ended: str | None = "done") -> None:
    with Journal.begin(path, HEAD) as journal:
        journal.part({"token": 0x01020304})
        for n in range(1, commands + 1):
            journal.sent(n)
            journal.executed(Progress(commands_executed=n, board_time_s=n * 0.05, stroke=n // 20, steps=(n, -n)))
            if n % 20 == 0:
                journal.stroke_done(StrokeEnd(n // 20 - 1, (n, -n)), Progress(commands_executed=n))
        if ended:
            journal.end(ended)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "plot.journal"
    write(path)
    state = load(path)
    assert state is not None
    assert dict(state.head) | HEAD == dict(state.head)
    assert (state.executed, state.strokes_done, state.ended, state.damaged) == (59, {0, 1}, "done", 0)
    assert state.part["token"] == 0x01020304
    assert state.sent >= state.executed
    assert not state.interrupted


def test_a_crash_leaves_no_end(tmp_path: Path) -> None:
    write(tmp_path / "j", ended=None)
    state = load(tmp_path / "j")
    assert state is not None
    assert state.interrupted
    assert state.ended is None


def test_cut_at_every_byte_it_still_tells_a_prefix(tmp_path: Path) -> None:
    """The last whole record stands; nothing is invented, and nothing raises."""
    path, cut = tmp_path / "j", tmp_path / "cut"
    write(path, commands=12)
    content, last = path.read_bytes(), -1
    head_bytes = content.index(b"\n") + 1
    for length in range(len(content) + 1):
        cut.write_bytes(content[:length])
        state = load(cut)
        if length < head_bytes - 1:
            assert state is None
            continue
        assert state is not None
        assert state.executed >= last
        last = state.executed
    assert last == 12


@given(place=st.integers(0, 10**6), bit=st.integers(0, 7), more=st.binary(max_size=80))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_flipped_bits_and_noise_cost_their_own_lines_only(tmp_path: Path, place: int, bit: int, more: bytes) -> None:
    path = tmp_path / "whole"
    if not path.exists():
        write(path)
    content = bytearray(path.read_bytes())
    place %= len(content)
    content[place] ^= 1 << bit
    bad = tmp_path / "bad"
    bad.write_bytes(bytes(content[:place]) + more + bytes(content[place:]))
    state = load(bad)
    if state is None:
        assert place <= content.index(b"\n") + 1, "only a damaged head makes a journal unreadable"
        return
    assert state.executed in (58, 59)
    assert state.strokes_done <= {0, 1}
    assert len(state.strokes_done) >= 1


def test_a_journal_goes_on_after_a_torn_line(tmp_path: Path) -> None:
    path = tmp_path / "j"
    write(path, ended=None)
    with path.open("ab") as file:
        file.write(b"0000005b 1c29")
    with Journal.reopen(path) as journal:
        journal.part({"token": 7})
        journal.sent(1)
        journal.end("stopped", (5, 6))
    state = load(path)
    assert state is not None
    assert (state.parts, state.executed, state.ended, state.steps, state.strokes_done) == (2, 0, "stopped", (5, 6), {0, 1})


def test_what_a_pause_sends_instead_is_read_until_the_next_part(tmp_path: Path) -> None:
    """It takes the place of what follows the commands that were really sent, not of those that were written ahead."""
    path = tmp_path / "j"
    with Journal.begin(path, HEAD) as journal:
        journal.part({"token": 7})
        for n in range(1, 8):
            journal.sent(n)
        journal.held(["SM,30,5,0", "SP,1,50"])
        journal.sent(8)
        state = load(path)
        assert state is not None
        assert state.held == Held(7, ("SM,30,5,0", "SP,1,50"))
        journal.part({"token": 8})
    state = load(path)
    assert state is not None
    assert state.held is None


def test_no_journal_and_other_files_are_none(tmp_path: Path) -> None:
    assert load(tmp_path / "missing") is None
    (tmp_path / "other").write_bytes(b"<svg/>\n" * 100)
    assert load(tmp_path / "other") is None
    assert load(tmp_path) is None


def test_a_full_disk_ends_the_journal_and_not_the_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeEbb()
    board = connect(fake, clock=fake.clock)
    journal = Journal.begin(tmp_path / "j", HEAD)
    count = [0]
    write = os.write

    def full(descriptor: int, data: bytes) -> int:
        if descriptor == journal._descriptor:
            count[0] += 1
            if count[0] > 5:
                raise OSError(28, "No space left on device")
        return write(descriptor, data)

    monkeypatch.setattr("output.ebb.journal.os.write", full)
    result = board.stream(program(), on_progress=lambda _: None, stop=StopFlag(), journal=journal)
    assert load(tmp_path / "j") is None, "it is out of date from there on, however the plot ends"
    journal.close()
    assert result.outcome == "done"
    assert journal.trouble is not None
    assert "No space left" in journal.trouble
    assert not (tmp_path / "j").exists()


def test_a_journal_that_stays_without_room_warns_of_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that has become read-only takes nothing away either."""

    def read_only(*_: object) -> NoReturn:
        raise OSError(30, "Read-only file system")

    with Journal.begin(tmp_path / "j", HEAD) as journal:
        for place in ("output.ebb.journal.os.write", "output.ebb.journal.os.ftruncate", "output.ebb.journal.os.truncate"):
            monkeypatch.setattr(place, read_only)
        monkeypatch.setattr(Path, "unlink", read_only)
        journal.part({})
    assert load(tmp_path / "j") is not None
    assert "`plotter resume` would draw lines twice" in str(journal.trouble)


def test_nothing_is_left_of_a_journal_that_cannot_be_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one before it is still there, for whoever asked for a new one to say what becomes of it."""
    write(tmp_path / "j")
    before = (tmp_path / "j").read_bytes()

    def full(*_: object) -> NoReturn:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space left"):
        patch.setattr("output.ebb.journal.os.write", full)
        Journal.begin(tmp_path / "j", HEAD)
    assert [file.name for file in tmp_path.iterdir()] == ["j"]
    assert (tmp_path / "j").read_bytes() == before
    assert discard(tmp_path / "j")
    assert not list(tmp_path.iterdir())


def test_it_reaches_the_disk_at_pen_up_and_within_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is waited for a pen-up, and for a second at most; a busy computer may let the thread run later than that."""
    fsync, wait = os.fsync, threading.Event.wait
    waits: list[tuple[float | None, bool]] = []
    synced: queue.Queue[tuple[float | None, bool] | None] = queue.Queue()

    def syncing() -> bool:
        return threading.current_thread().name == "journal-sync"

    def noted(event: threading.Event, timeout: float | None = None) -> bool:
        came = wait(event, timeout)
        if syncing():
            waits.append((timeout, came))
        return came

    monkeypatch.setattr(threading.Event, "wait", noted)
    monkeypatch.setattr("output.ebb.journal.os.fsync", lambda fd: (synced.put(waits[-1] if syncing() else None), fsync(fd)))
    with Journal.begin(tmp_path / "j", HEAD) as journal:
        assert {synced.get(timeout=20) for _ in range(2)} == {None, (1.0, False)}, "at once, and in the second after it"
        journal.stroke_done(StrokeEnd(0, (1, 1)), Progress())
        assert synced.get(timeout=20) == (1.0, True)
        journal.executed(Progress(commands_executed=3))
        assert synced.get(timeout=20) == (1.0, False)


def test_nothing_is_open_while_the_new_journal_gets_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows refuses to rename a file that is open. Killed before it has its name, the journal before it is still there."""
    path, opened = tmp_path / "j", set[int]()
    write(path)
    before, open_file, close_file, rename = path.read_bytes(), os.open, os.close, Path.replace

    def opening(*args: Any) -> int:
        opened.add(descriptor := open_file(*args))
        return descriptor

    def closing(descriptor: int) -> None:
        opened.discard(descriptor)
        close_file(descriptor)

    def renaming(fresh: Path, to: Path) -> Path:
        assert not opened
        assert path.read_bytes() == before
        assert load(fresh) is not None, "its head is whole"
        return rename(fresh, to)

    monkeypatch.setattr("output.ebb.journal.os.open", opening)
    monkeypatch.setattr("output.ebb.journal.os.close", closing)
    monkeypatch.setattr(Path, "replace", renaming)
    with Journal.begin(path, HEAD) as journal:
        journal.end("done")
    state = load(path)
    assert state is not None
    assert (state.ended, state.executed) == ("done", 0)


def test_what_is_written_while_the_disk_is_busy_reaches_it_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The journal is closed while an fsync runs that has begun before its last record."""
    fsync, begun, go_on = os.fsync, threading.Event(), threading.Event()
    synced_bytes: list[int] = []

    def slowly(descriptor: int) -> None:
        synced_bytes.append(os.fstat(descriptor).st_size)
        fsync(descriptor)
        if threading.current_thread().name == "journal-sync" and not begun.is_set():
            begun.set()
            assert go_on.wait(20)

    monkeypatch.setattr("output.ebb.journal.os.fsync", slowly)
    journal = Journal.begin(tmp_path / "j", HEAD)
    assert begun.wait(20)
    journal.end("stopped")
    closer = threading.Thread(target=journal.close)
    closer.start()
    while not journal._closing.is_set():
        time.sleep(0.001)
    go_on.set()
    closer.join(20)
    assert synced_bytes[-1] == (tmp_path / "j").stat().st_size


def test_differences_name_what_changed() -> None:
    now = {**HEAD, "settings": {"speed_mm_s": 120, "pen_down": 40}, "machine": "other"}
    assert differences({"kind": "head", "format": 1, **HEAD}, now) == [
        "machine was not set, is other",
        "settings speed mm s was 100, is 120",
    ]
    assert differences({"bounds": [1, 2]}, {"bounds": (1, 2)}) == []


# executed, never acknowledged: against the in-memory board


@pytest.mark.parametrize("seed", range(25))
def test_the_journal_never_claims_more_than_the_board_has_done(tmp_path: Path, seed: int) -> None:
    """At whatever instant the computer dies: executed <= really executed <= sent, and the place found is where the board is."""
    path, items = tmp_path / "j", program()
    fake = FakeEbb(version=(3, 0, 3) if seed % 2 else (2, 8, 1))
    board = connect(fake, clock=fake.clock)
    token = board.begin_job()
    journal = Journal.begin(path, HEAD)
    journal.part({"token": token})
    crash_at = fake.now + 0.05 + seed * 0.04

    class Crash(BaseException):
        pass

    def crash(f: FakeEbb) -> None:
        if f.now >= crash_at:
            f.on_time = None
            raise Crash

    fake.on_time = crash

    def dead(**_: object) -> NoReturn:
        raise Crash

    board.safe_stop = dead  # type: ignore[method-assign,assignment]
    with pytest.raises(Crash):
        board.stream(items, on_progress=lambda _: None, stop=StopFlag(), journal=journal)
    at_crash = [entry.wire for entry in fake.executed]
    while fake.executing is not None:
        fake.receive(0.05)
    state = load(path)
    assert state is not None
    wires = [item.wire() for item in items if isinstance(item, Command)]
    really = len([wire for wire in at_crash if wire in wires]) + 2  # the two SC are immediate
    drained = len([entry for entry in fake.executed if entry.wire in wires]) + 2
    assert state.executed <= max(really, 2)
    assert drained <= state.sent or state.sent == 0
    assert state.interrupted
    if state.sent == 0:
        return
    place = find_place(items, firmware("3.0.3"), state, (fake.steps[0], fake.steps[1]))
    assert place is not None
    assert place.steps == tuple(fake.steps)
    fits = [k for k in range(state.executed, len(wires) + 1) if _steps_after(items, k) == tuple(fake.steps)]
    assert place.command in fits
    board = connect(fake, clock=fake.clock, clear=False)
    assert position_lost(board, state) is None
    fake.reboot()
    board = connect(fake, clock=fake.clock)
    assert "switched off" in str(position_lost(board, state))
    journal.close()


def _steps_after(items: list[Command | Mark], commands: int) -> tuple[int, int]:
    x = y = 0
    for item in [item for item in items if isinstance(item, Command)][:commands]:
        if isinstance(item, SM):
            x, y = x + item.steps1, y + (item.steps2 or 0)
    return x, y


def test_a_place_inside_a_stroke_knows_how_much_is_drawn() -> None:
    items = program()
    state = PlotState(HEAD, {}, 1, 6, 40, frozenset(), 0, None, 0.0, None, 0)
    place = find_place(items, firmware("3.0.3"), state, (30 + 20 + 21 + 5, 10))
    assert place is not None
    assert (place.stroke, place.pen_down, place.command) == (0, True, 8)
    assert place.drawn_steps == pytest.approx(20 + 21 + 5, abs=1)
    assert find_place(items, firmware("3.0.3"), state, (9999, 9999)) is None
    held = PlotState(HEAD, {}, 1, 30, 40, frozenset(), 0, None, 0.0, None, 0)
    place = find_place(items, firmware("3.0.3"), held, (30 + 20 + 21 + 5, 10))
    assert place is not None, "a hold put commands in: the numbers are off, the stroke is not"
    assert (place.stroke, place.command) == (0, 8)
    unknown = find_place(items, firmware("3.0.3"), state, None)
    assert unknown is not None
    assert unknown.command == 6


def state_of(executed: int, sent: int, ended: str | None = None) -> PlotState:
    return PlotState(HEAD, {}, 1, executed, sent, frozenset(), 0, None, 0.0, ended, 0)


def test_a_place_within_a_command_is_on_its_way() -> None:
    """The first command's box holds the whole of the second: whoever stands there was not on the first's diagonal."""
    items: list[Command | Mark] = [StrokeMark(0), SP(0, 50), SM(300, 400, 400), SM(200, 0, -300), SM(200, -100, 0)]
    for steps, command, drawn in [((400, 250), 2, 565.7 + 150), ((340, 100), 3, 565.7 + 360), ((250, 250), 1, 353.6)]:
        place = find_place(items, firmware("3.0.3"), state_of(1, 33), steps)
        assert place is not None
        assert (place.command, place.drawn_steps) == (command, pytest.approx(drawn, abs=1))
    assert find_place(items, firmware("3.0.3"), state_of(1, 33), (200, 300)) is None
    assert find_place(items, firmware("3.0.3"), state_of(2, 33), (250, 250)) is None, "the first was executed for certain"


def test_a_board_that_was_left_alone_has_come_to_what_it_was_sent_last() -> None:
    """Round a square four times and out: at its corners the counters say which only with how far the board can have come."""
    sides = [SM(100, 50, 0), SM(100, 0, 50), SM(100, -50, 0), SM(100, 0, -50)]
    items: list[Command | Mark] = [StrokeMark(0), SP(0, 50), *(sides * 20), SM(100, 60, 70)]
    written_ahead = 66  # between 34 and 66 commands have been sent, at most four of the last are lost

    def place(ended: str | None) -> int:
        found = find_place(items, firmware("3.0.3"), state_of(2, written_ahead, ended), (50, 50))
        assert found is not None
        return found.command

    assert place(None) == 31
    assert place("LinkLost: the link to x is lost") == 31
    assert place("BoardRefused: the board is stuck") == 3, "it was stopped, soon after what was counted last"


def test_a_place_in_a_pause_is_looked_for_in_what_was_sent_for_it() -> None:
    """Eight commands were sent, then a brake of 6 steps and a lift in place of 20, 21, ... steps and other strokes."""
    items, fw = program(), firmware("3.0.3")
    held = Held(8, ("SM,30,4,0", "SM,30,2,0", "SP,1,50"))

    def place(executed: int, steps: tuple[int, int] | None) -> tuple[float, bool] | None:
        state = PlotState(HEAD, {}, 1, executed, 40, frozenset(), 0, None, 0.0, None, 0, held=held)
        found = find_place(items, fw, state, steps)
        return None if found is None else (found.drawn_steps, found.pen_down)

    x = 30 + 20 + 21
    assert place(7, (x, 10)) == (pytest.approx(41, abs=1), True)
    assert place(8, (x + 3, 10)) == (pytest.approx(44, abs=1), True), "in the brake"
    assert place(8, (x + 6, 10)) == (pytest.approx(47, abs=1), True), "at rest"
    assert place(8, (x + 15, 10)) is None, "where the stroke would have gone on"
    assert place(9, None) == (pytest.approx(45, abs=1), True)
    assert place(11, None) == (pytest.approx(47, abs=1), False)
