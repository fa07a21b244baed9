"""Runs a virtual board on a pseudo-terminal by the clock, real or `speed` times faster.

The board executes by its own clock: what the host sends late is late. Where this process itself is late (it wakes up after
the time it asked for), the board's clock loses that time instead, so that a busy machine is not taken for a slow host; the
sum is recorded as `clock_slip_s`.

At a high speed an ordinary pause of the host is long in board time. With `patience_s`, the clock stands still for up to that
much real time whenever the last command in the queue is about to end, so that fast runs measure the stream and not the host;
recorded as `patience_used_s`.
"""

from __future__ import annotations

import json
import os
import selectors
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from output.ebb.virtual.board import Board, Sent
from output.ebb.virtual.control_lines import understood
from output.ebb.virtual.faults import FaultScript, Outcome
from output.ebb.virtual.pseudo_terminal import PseudoTerminal
from output.ebb.virtual.record import Recorder
from output.ebb.virtual.registers import TICKS_PER_S
from output.errors import BadCommand

USB_PACKET = 64
LONGEST_WAIT_S = 0.02
LATENESS_S = 0.002
# A board that is about to run dry is held this long before it, so that a command can still be parsed in time.
HOLD_MARGIN_TICKS = 200


@dataclass(slots=True)
class _Pending:
    """Bytes to the host that are due at a tick."""

    tick: int
    data: bytes


class Server:
    """One board, its wire, its faults and its control channel.

    `control` is a file descriptor with one command a line (see `_control_line`); its answers go to `answers`, as JSON lines.
    The end of `control` stops the server.
    """

    def __init__(
        self,
        board: Board,
        link: Path | None,
        *,
        speed: float,
        record: Path | None,
        faults: FaultScript,
        control: int | None = None,
        answers: int = 1,
        patience_s: float = 0.0,
    ) -> None:
        self.board = board
        self.wire: PseudoTerminal | None = PseudoTerminal(link)
        self._link = link
        self._speed = speed
        self._record = record
        self._faults = faults
        board.intercept = faults.intercept
        self._control = control
        self._answers = answers
        self._control_text = b""
        # Not epoll: its waits are whole milliseconds, which are long at a high speed.
        self._selector = selectors.SelectSelector()
        if control is not None:
            self._selector.register(control, selectors.EVENT_READ)
        self._watching: int | None = None
        self._pending: deque[_Pending] = deque()
        self._unwritten = b""
        self._exact_tick = 0.0
        self._stopping = False
        self._back_at: int | None = None
        self._frozen_until: int | None = None
        self.clock_slip_s = 0.0
        self._patience_s = patience_s
        self._patience_left_s = patience_s
        self._queued_before = 0
        self.patience_used_s = 0.0

    # ---- the loop

    def run(self) -> None:
        """Serve until told to stop, then write the record. Raises BadCommand when that cannot be written."""
        last_s = time.monotonic()
        try:
            while not self._stopping:
                self._watch_wire()
                wait_s = self._wait_s()
                ready = self._selector.select(wait_s)
                now_s = time.monotonic()
                elapsed_s = now_s - last_s
                last_s = now_s
                allowed_s = wait_s + LATENESS_S
                if elapsed_s > allowed_s:
                    self.clock_slip_s += elapsed_s - allowed_s
                    elapsed_s = allowed_s
                self._exact_tick += elapsed_s * TICKS_PER_S * self._speed
                reached = self._advance(int(self._exact_tick), listened=self._watching is not None)
                if reached < int(self._exact_tick):
                    held_s = (self._exact_tick - reached) / (TICKS_PER_S * self._speed)
                    self._patience_left_s -= held_s
                    self.patience_used_s += held_s
                    self._exact_tick = float(reached)
                if any(key.fd == self._control for key, _ in ready):
                    self._read_control()
        finally:
            self.close()

    def stop(self) -> None:
        """Leave the loop at its next turn."""
        self._stopping = True

    def close(self) -> None:
        """Write the record and take the wire away."""
        try:
            if self._record is not None:
                self.write_record(self._record)
        finally:
            if self.wire is not None:
                self._unwatch()
                self.wire.hang_up()
                self.wire = None

    def write_record(self, path: Path) -> None:
        """The record up to now. Raises BadCommand when it cannot be written there."""
        _need_room(path, "the record cannot be written to")
        state = {**self.board.state(), "speed": self._speed, "clock_slip_s": self.clock_slip_s}
        state["patience_used_s"] = self.patience_used_s
        try:
            self.board.recorder.write(path, self.board.now, state)
        except OSError as problem:
            raise BadCommand(f"the record cannot be written to {path}: {problem}; choose another file") from problem

    def _watch_wire(self) -> None:
        """Be woken by bytes only while the board would take them: a busy board leaves them in the host's kernel."""
        if self.wire is not None and self.board.wants_bytes and self._frozen_until is None:
            if self._watching is None:
                self._watching = self.wire.fd
                self._selector.register(self.wire.fd, selectors.EVENT_READ)
        else:
            self._unwatch()

    def _unwatch(self) -> None:
        if self._watching is not None:
            self._selector.unregister(self._watching)
            self._watching = None

    def _wait_s(self) -> float:
        events = [self.board.next_event(), self._back_at, self._frozen_until, self._faults.next_tick()]
        if self._pending:
            events.append(self._pending[0].tick)
        soonest = min((event for event in events if event is not None), default=None)
        if soonest is None:
            return LONGEST_WAIT_S
        return min(LONGEST_WAIT_S, max(0.0, (soonest - self._exact_tick) / (TICKS_PER_S * self._speed)))

    def _advance(self, target: int, *, listened: bool) -> int:
        """Let the board live until `target`, feeding it whenever it is ready to take bytes on the way.

        Returns the tick that was reached: before `target` when the board is held for a host that is not ready.

        `listened`: bytes would have ended the wait, so what is there now has come only now. A board that was busy finds
        them waiting as soon as it is ready, at whatever tick that is.
        """
        board = self.board
        hopeful = not listened
        while True:
            if hopeful:
                hopeful = self._take_bytes()
            target = self._held(target)
            ticks = (board.next_event(), self._faults.next_tick(), self._back_at, self._frozen_until)
            stops = [tick for tick in ticks if tick is not None and tick <= target]
            board.advance_to(min(stops, default=target))
            self._outside_events()
            self._collect()
            if not stops:
                break
        if listened:
            self._take_bytes()
        self._collect()
        self._flush()
        return target

    def _held(self, target: int) -> int:
        """`target`, or sooner while there is patience and the running command is the last one the board has, or was."""
        board = self.board
        recorder = board.recorder
        if recorder.queue_pushes != self._queued_before:
            self._queued_before = recorder.queue_pushes
            self._patience_left_s = self._patience_s
        if self._patience_left_s <= 0 or not board.wants_bytes or board.motion.entries:
            return target
        running = board.motion.running
        if running is None:
            return board.now if self._queued_before else target
        if running.end is None:
            return target
        return min(target, max(board.now, running.end - HOLD_MARGIN_TICKS))

    def _take_bytes(self) -> bool:
        """Feed one USB packet if the board is ready; False when the wire has nothing more."""
        if self.wire is not None and self.board.wants_bytes and self._frozen_until is None:
            data = self.wire.read(USB_PACKET)
            if not data:
                return False
            self._feed(data)
        return True

    def _feed(self, data: bytes) -> None:
        """Give the board what arrived, up to a byte at which something happens, and the rest if the wire is still there."""
        while data and self.wire is not None:
            count = self._faults.incoming(data)
            self.board.feed(data[:count])
            data = data[count:]
            self._outside_events()

    # ---- to the host

    def _collect(self) -> None:
        for sent in self.board.output():
            self._pass_on(sent)
        if self.board.usb_dropped:
            self.board.usb_dropped = False
            self._drop_usb(None if self.board.in_bootloader else self.board.now + TICKS_PER_S)

    def _pass_on(self, sent: Sent) -> None:
        for outcome in self._faults.outgoing(sent, self.board):
            self._act(outcome)

    def _flush(self) -> None:
        if self._frozen_until is not None:
            return
        while self._pending and self._pending[0].tick <= self.board.now:
            item = self._pending.popleft()
            self._unwritten += item.data
            self.board.recorder.reply(item.tick, item.data)
        if self._unwritten and self.wire is not None:
            taken = self.wire.write(self._unwritten)
            self._unwritten = self._unwritten[taken:]

    # ---- faults and the world outside

    def _outside_events(self) -> None:
        now = self.board.now
        if self._frozen_until is not None and self._frozen_until <= now:
            self._frozen_until = None
        if self._back_at is not None and self._back_at <= now:
            self._come_back()
        for outcome in self._faults.due(self.board):
            self._act(outcome)

    def _come_back(self) -> None:
        """The port is there again, unless something else is in its place: then it stays away, which is noted."""
        self._back_at = None
        if self.wire is None:
            try:
                self.wire = PseudoTerminal(self._link)
            except BadCommand as problem:
                self.board.recorder.note(self.board.now, str(problem))

    def _act(self, outcome: Outcome) -> None:
        """Do what a fault (or nothing special: a plain reply) asks for."""
        board = self.board
        if outcome.note:
            board.recorder.note(board.now, outcome.note)
        if outcome.data:
            # Replies stay in order: nothing overtakes what is already on its way.
            tick = board.now + outcome.delay_ticks
            if self._pending:
                tick = max(tick, self._pending[-1].tick)
            self._pending.append(_Pending(tick, outcome.data))
        if outcome.freeze_ticks:
            self._frozen_until = board.now + outcome.freeze_ticks
        if outcome.hang_up:
            self._drop_usb(None if outcome.back_after_ticks is None else board.now + outcome.back_after_ticks, outcome.link)

    def _drop_usb(self, back_at: int | None, link: str | None = None) -> None:
        """The port goes away; with `back_at` it returns then, perhaps under another name."""
        self._flush()
        self._pending.clear()
        self._unwritten = b""
        self._unwatch()
        if self.wire is not None:
            self.wire.hang_up()
            self.wire = None
        if link is not None:
            self._link = Path(link)
        self._back_at = back_at
        self.board.recorder.note(self.board.now, "usb dropped")

    # ---- the control channel

    def _read_control(self) -> None:
        assert self._control is not None
        data = os.read(self._control, 65536)
        if not data:
            self.stop()
            return
        self._control_text += data
        *lines, self._control_text = self._control_text.split(b"\n")
        for line in lines:
            self._answer(self._control_line(line.decode(errors="replace").split()))

    def _answer(self, answer: dict[str, Any]) -> None:
        os.write(self._answers, json.dumps(answer).encode() + b"\n")

    def _control_line(self, words: list[str]) -> dict[str, Any]:
        """One control command; the answer has "error" when it was not understood."""
        board = self.board
        try:
            verb, values = understood(words)
            self._obey(verb, values)
            if verb not in ("state", "record", "stop"):
                board.recorder.note(board.now, " ".join(words))
        except BadCommand as problem:
            return {"error": f"control command {' '.join(words)!r}: {problem}"}
        port = None if self.wire is None else self.wire.port
        return {"now_tick": board.now, "port": port, **board.state()}

    def _obey(self, verb: str, values: list[Any]) -> None:
        board = self.board
        if verb == "stop":
            self.stop()
        elif verb == "record":
            self.write_record(*values)
        elif verb == "button":
            board.press_button()
        elif verb == "power":
            board.switch_supply(*values)
        elif verb == "wire":
            board.wire_pin(*values)
        elif verb == "reboot":
            board.reboot()
            self._collect()
        elif verb == "hangup":
            away_s, link = values
            if link is not None:
                _need_room(Path(link), "the port cannot come back as")
            self._drop_usb(None if away_s is None else board.now + round(away_s * TICKS_PER_S), link)
        elif verb == "return":
            self._come_back()
        elif verb == "fault":
            self._faults.add(values[0], board)


def _need_room(path: Path, what: str) -> None:
    """Raise BadCommand, beginning with `what`, when no file can be made as `path`."""
    if not path.parent.is_dir():
        raise BadCommand(f"{what} {path}: {path.parent} is not a directory; make it first")
    if path.is_dir():
        raise BadCommand(f"{what} {path}: it is a directory; give a file in it")


def make_server(
    *,
    firmware: str = "3.0.3",
    link: Path | None = None,
    speed: float = 1.0,
    record: Path | None = None,
    faults: Path | None = None,
    nickname: str = "",
    keep_wire: bool = True,
    pen_down: bool = False,
    version_line: str | None = None,
    patience_s: float = 0.0,
    control: int | None = None,
) -> Server:
    """A server with its board, its port open. Raises BadCommand for a firmware, speed, link or fault script that cannot be."""
    if not 0 < speed <= 1000:
        raise BadCommand(f"speed is {speed:g}; choose more than 0 and at most 1000")
    if record is not None:
        _need_room(record, "the record cannot be written to")
    script: object = []
    if faults is not None:
        try:
            script = json.loads(faults.read_text())
        except (OSError, ValueError) as problem:
            raise BadCommand(f"fault script {faults} cannot be read: {problem}") from problem
    if len(nickname) > 16 or not all(" " <= letter <= "~" and letter != "," for letter in nickname):
        raise BadCommand(
            f"nickname is {nickname!r}: a board keeps at most 16 letters, digits, spaces or signs, and no comma: choose another"
        )
    recorder = Recorder(keep_wire=keep_wire)
    board = Board(firmware, nickname=nickname, pen_down=pen_down, version_line=version_line, recorder=recorder)
    try:
        return Server(
            board,
            link,
            speed=speed,
            record=record,
            faults=FaultScript.parse(script, speed),
            control=control,
            patience_s=patience_s,
        )
    except OSError as problem:
        raise BadCommand(f"there is no pseudo-terminal left ({problem.strerror}): end programs that hold some") from problem
