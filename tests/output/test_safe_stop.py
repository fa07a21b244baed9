"""Pen up and everything stopped, on every way out, at every command, with every fault."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator

import pytest

from output.ebb.commands import EM, SC, SM, SP, Command
from output.ebb.control import StopFlag
from output.ebb.program import Mark, StrokeEnd, StrokeMark
from output.ebb.session import connect
from output.errors import BadCommand, BoardRefused, LinkLost
from tests.output.fake_ebb import FakeEbb
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture

pytestmark = pytest.mark.usefixtures("inline_producer")

VERSIONS = [(3, 0, 3), (3, 0, 0), (2, 8, 1), (2, 5, 5)]


def short() -> Iterator[Command | Mark]:
    yield from (SC(4, 20000), SC(5, 15000), EM(1, 1), SP(1, 50))
    for k in range(2):
        yield from (SM(30, 10, 10), StrokeMark(k), SP(0, 50))
        for _ in range(8):
            yield SM(25, 20, -10)
        yield from (StrokeEnd(k, (0, 0)), SP(1, 50))


def after(fake: FakeEbb, seconds: float) -> None:
    """Lets the board live on by itself."""
    fake.on_time, end = None, fake.now + seconds
    while not fake.dead and fake.now < end:
        fake.receive(0.05)


def assert_safe(fake: FakeEbb, *, may_block: bool = False) -> None:
    assert fake.pen_up
    assert fake.executing is None
    assert not fake.fifo
    assert may_block or fake.blocked_s == 0.0


def motion_after(fake: FakeEbb, at: float) -> list[str]:
    sent = b"".join(data for t, data in fake.written if t > at).decode()
    return [wire for wire in sent.split("\r") if re.match(r"(SM|T3|LM|SP,0|EM,1)", wire)]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("free", [True, False])
def test_a_stop_at_random_instants_is_prompt(version: tuple[int, int, int], free: bool) -> None:
    took, rng = [], random.Random(1)
    for _ in range(40):
        fake, stop = FakeEbb(version=version, parse_s=0.0015), StopFlag()
        board = connect(fake, clock=fake.clock)
        at = fake.now + rng.uniform(0.0, 1.5)

        def press(board: FakeEbb, at: float = at, stop: StopFlag = stop) -> None:
            if board.now >= at and not stop.requested:
                stop.stop("test")

        fake.on_time = press
        result = board.stream(short(), on_progress=lambda _: None, stop=stop, free_motors=free)
        if result.outcome == "done":
            continue
        assert result.stop is not None
        assert result.stop.pen_up, result.stop
        assert_safe(fake)
        assert fake.motors_on is not free or not any(w.startswith("EM") for _, w in fake.transcript)
        assert result.steps is not None
        took.append(result.stop.took_s)
        assert board.query("QG") is not None, "the conversation is in step after a stop"
    assert len(took) > 20
    assert max(took) < 0.1


def dropped(_fake: FakeEbb, _wire: str) -> bytes:
    return b""


def refused(fake: FakeEbb, wire: str) -> bytes:
    text = "!6 Err: Invalid parameter value"
    return f"{wire.split(',')[0]},{text}\n".encode() if fake.future else f"{text}\r\n".encode()


def doubled(fake: FakeEbb, wire: str) -> None:
    fake.say(f"{wire.split(',')[0]}\n".encode() if fake.future else b"OK\r\n")


def garbage(fake: FakeEbb, _wire: str) -> None:
    fake.say(b"\x00\xfe#?\r\n")


def notice(fake: FakeEbb, _wire: str) -> None:
    fake.say(b"Limit switch triggered. PortB=12\n")


def rebooted(fake: FakeEbb, _wire: str) -> bytes:
    fake.reboot()
    return b"EBBv13_and_above EB Firmware Version 3.0.3\r\n"


def hung(fake: FakeEbb, _wire: str) -> None:
    fake._free_at += 1.2


def late(fake: FakeEbb, _wire: str) -> None:
    fake._free_at += 0.3


def pulled(fake: FakeEbb, _wire: str) -> bytes:
    fake.dead = True
    return b""


FAULTS: dict[str, tuple[Callable[[FakeEbb, str], bytes | None], tuple[type[Exception], ...]]] = {
    "dropped": (dropped, (LinkLost,)),
    "refused": (refused, (BoardRefused,)),
    "doubled": (doubled, (LinkLost,)),
    "garbage": (garbage, (LinkLost,)),
    "notice": (notice, (BoardRefused,)),
    "rebooted": (rebooted, (BoardRefused, LinkLost)),
    "hung": (hung, (LinkLost,)),
    "late": (late, ()),
    "pulled": (pulled, (LinkLost,)),
}


@pytest.mark.parametrize("version", [(3, 0, 3), (2, 8, 1)])
@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_at_every_command(name: str, version: tuple[int, int, int]) -> None:
    """For each command of the whole conversation after the handshake: the right error, in time, the pen up, nothing sent on."""
    fault, expected = FAULTS[name]
    probe = FakeEbb(version=version)
    board = connect(probe, clock=probe.clock)
    board.queue_depth()
    first = probe._count
    board.stream(short(), on_progress=lambda _: None, stop=StopFlag())
    raised = 0
    for i in range(first, probe._count - 1, 1 if version[0] == 3 and name not in ("hung", "late") else 5):
        fake = FakeEbb(version=version)
        struck: list[float] = []

        def strike(f: FakeEbb, n: int, wire: str, i: int = i, struck: list[float] = struck) -> bytes | None:
            if n != i:
                return None
            struck.append(f._free_at)
            return fault(f, wire)

        board = connect(fake, clock=fake.clock)
        board.queue_depth()
        fake.fault = strike
        try:
            board.stream(short(), on_progress=lambda _: None, stop=StopFlag())
        except (LinkLost, BoardRefused) as error:
            raised += 1
            assert expected, f"{name} at {i} should have been survived: {error}"
            assert isinstance(error, expected), (i, error)
            assert fake.now - struck[0] <= 1.0 + 1.2, "named within the deadline and the stop's own time"
            if not fake.dead:
                after(fake, 3.0)
                # A restarted board has a queue of one again; what was on the wire then may have to wait in it.
                assert_safe(fake, may_block=name == "rebooted")
                assert motion_after(fake, struck[0] + 1.1) == []
        else:
            assert not expected or name in ("doubled", "garbage", "notice", "dropped"), f"{name} at {i} went unnoticed"
            assert_safe(fake)
    if expected:
        assert raised > 10


def test_pen_down_height_is_sent_again_after_a_stop() -> None:
    """SP,3 takes the pen-down height away: without SC,5 the next plot would draw in the air."""
    fake = FakeEbb()
    board = connect(fake, clock=fake.clock)
    board.stream(short(), on_progress=lambda _: None, stop=StopFlag())
    board.safe_stop()
    assert not fake.pen_can_lower
    board.send(SP(0, 10))
    after(fake, 0.1)
    assert fake.pen_can_lower
    assert not fake.pen_up


def test_lowering_without_a_known_height_after_a_stop_is_refused() -> None:
    fake = FakeEbb()
    board = connect(fake, clock=fake.clock)
    board.safe_stop()
    with pytest.raises(BadCommand, match="SC,5"):
        board.send(SP(0, 10))


def test_a_stop_on_a_dead_link_reports_and_does_not_raise() -> None:
    fake = FakeEbb()
    board = connect(fake, clock=fake.clock)
    fake.dead = True
    report = board.safe_stop()
    assert not report.pen_up
    assert "could not be sent" in report.detail


def test_a_stop_in_the_middle_of_a_written_line() -> None:
    """A write that failed half way leaves half a command in the board's buffer; the stop must not be glued to it."""
    fake = FakeEbb()
    board = connect(fake, clock=fake.clock)
    fake.send(b"SM,1000,5")
    report = board.safe_stop()
    assert report.pen_up
    assert "ES" in [wire for _, wire in fake.transcript]


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, MemoryError])
def test_whatever_is_raised_inside_the_pen_comes_up(error: type[BaseException]) -> None:
    fake = FakeEbb()
    board = connect(fake, clock=fake.clock)

    def bomb(f: FakeEbb) -> None:
        if len(f.executed) > 8:
            f.on_time = None
            raise error

    fake.on_time = bomb
    with pytest.raises(error):
        board.stream(short(), on_progress=lambda _: None, stop=StopFlag())
    assert_safe(fake)
