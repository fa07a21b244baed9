"""The fault script: what goes wrong, and when.

A script is a list of objects: {"fault": NAME, "at": {"command": i} | {"byte": i} | {"time_s": t} | {"stroke": s}, ...}.
Commands, bytes and strokes are counted from 0 since the board was started; times are board seconds. Durations may be given
in board time (`..._s`) or in real time (`..._real_s`). `times` repeats a reply fault on that many replies (default 1).

    drop_ack                          the reply is lost
    delay_ack   delay_s               the reply, and all after it, come late
    dup_ack                           the reply comes twice
    split       after (bytes), delay_s    the reply comes in two parts
    garbage     data, place           bytes in the reply: before (default), inside, or after it
    notice      text, place           an unsolicited line; `text` without its line end
    nak         text                  the command is refused with this error and not executed
    freeze      for_s                 the board neither reads nor answers; what is queued goes on
    slow        factor, for_s         parsing takes that many times longer (for_s absent: from then on)
    hangup                            the port goes away for good
    hangup_and_return  after_s, pty   it comes back, perhaps under another name; the board ran on
    reboot      after_s, hangup       the board restarts; with hangup false the port stays open
    power       on, for_s             the motors' supply (default off; for_s: back again after that)
    button                            PRG is pressed

A reply fault that is tied to a time, byte or stroke acts on the first reply after it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from output.ebb.virtual.registers import TICKS_PER_S
from output.errors import BadCommand

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board, Sent

REPLY_FAULTS = frozenset({"drop_ack", "delay_ack", "dup_ack", "split"})
WORLD_FAULTS = frozenset(
    {"garbage", "notice", "nak", "freeze", "slow", "hangup", "hangup_and_return", "reboot", "power", "button"}
)
# More than any plot has of seconds, commands or bytes.
_MOST = 1_000_000_000
_PLACES = ("before", "inside", "after")
_PARAMETERS = {
    "drop_ack": set[str](),
    "delay_ack": {"delay_s", "delay_real_s"},
    "dup_ack": set[str](),
    "split": {"after", "delay_s", "delay_real_s"},
    "garbage": {"data", "place"},
    "notice": {"text", "place"},
    "nak": {"text"},
    "freeze": {"for_s", "for_real_s"},
    "slow": {"factor", "for_s", "for_real_s"},
    "hangup": set[str](),
    "hangup_and_return": {"after_s", "after_real_s", "pty"},
    "reboot": {"after_s", "after_real_s", "hangup"},
    "power": {"on", "for_s", "for_real_s"},
    "button": set[str](),
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the server has to do: send `data` after `delay_ticks`, stop listening, or drop the port."""

    data: bytes = b""
    delay_ticks: int = 0
    freeze_ticks: int = 0
    hang_up: bool = False
    back_after_ticks: int | None = None
    link: str | None = None
    note: str = ""


@dataclass(slots=True)
class Fault:
    """One line of the script. `armed` once its moment has come, `left` times it still acts."""

    name: str
    command: int | None
    byte: int | None
    tick: int | None
    stroke: int | None
    parameters: dict[str, Any]
    left: int = 1
    armed: bool = False


@dataclass(slots=True)
class FaultScript:
    """The faults that are still to come; `speed` converts real to board time."""

    faults: list[Fault] = field(default_factory=list)
    speed: float = 1.0
    bytes_seen: int = 0
    later: list[tuple[int, str, Any]] = field(default_factory=list)

    @classmethod
    def parse(cls, script: object, speed: float) -> FaultScript:
        """A script as described above, as JSON gave it. Raises BadCommand naming what is wrong with it."""
        if not isinstance(script, list):
            raise BadCommand(f"a fault script is a list of objects, not {_shown(script)}: see docs/virtual-board.md")
        return cls([_fault(entry) for entry in script], speed)

    def add(self, entry: object, board: Board) -> None:
        """One more fault; without "at" it happens now."""
        now = {"time_s": board.now / TICKS_PER_S}
        self.faults.append(_fault({"at": now, **entry} if isinstance(entry, dict) else entry))

    # ---- when

    def next_tick(self) -> int | None:
        """The next tick at which something of the script is due by time alone."""
        ticks = [fault.tick for fault in self.faults if fault.tick is not None and not fault.armed and fault.left]
        ticks += [tick for tick, _, _ in self.later]
        return min(ticks, default=None)

    def incoming(self, data: bytes) -> int:
        """How many of these bytes reach the board before something happens; at least one. Counts them and arms what waits."""
        count = len(data)
        for fault in self.faults:
            if fault.byte is not None and not fault.armed:
                count = min(count, max(1, fault.byte + 1 - self.bytes_seen))
        self.bytes_seen += count
        for fault in self.faults:
            if fault.byte is not None and fault.byte < self.bytes_seen:
                fault.armed = True
        return count

    def due(self, board: Board) -> list[Outcome]:
        """What happens at this tick by time, byte or stroke."""
        outcomes: list[Outcome] = []
        now = board.now
        for moment in [item for item in self.later if item[0] <= now]:
            self.later.remove(moment)
            self._later(moment[1], moment[2], board)
        if not self.faults:
            return outcomes
        strokes = (
            sum(1 for e in board.recorder.pen_events if e.lowered) if any(f.stroke is not None for f in self.faults) else 0
        )
        for fault in list(self.faults):
            if (fault.tick is not None and fault.tick <= now) or (fault.stroke is not None and strokes > fault.stroke):
                fault.armed = True
            if fault.armed and fault.command is None and fault.name in WORLD_FAULTS - {"nak"}:
                outcomes += self._world(fault, board, b"")
                self._spend(fault)
        return outcomes

    def intercept(self, index: int, _line: bytes) -> bytes | None:
        """The error text that command `index` is refused with, or None to let it through."""
        for fault in self.faults:
            if fault.name == "nak" and fault.left and (fault.armed or fault.command == index):
                fault.armed = fault.left > 1
                self._spend(fault)
                return str(fault.parameters.get("text", "!6 Err: Invalid parameter value")).encode("latin-1")
        return None

    def outgoing(self, sent: Sent, board: Board) -> list[Outcome]:
        """What becomes of a reply."""
        if not self.faults:
            return [Outcome(sent.data)]
        outcomes = [Outcome(sent.data)]
        index = board.recorder.commands - 1
        for fault in list(self.faults):
            if fault.command is not None and fault.command <= index:
                fault.armed = True
            if not fault.armed or not fault.left or fault.name == "nak":
                continue
            if fault.name in REPLY_FAULTS:
                outcomes = self._reply(fault, outcomes)
            else:
                before = self._world(fault, board, sent.data)
                gone = fault.name == "reboot" or any(outcome.hang_up for outcome in before)
                gone = gone or fault.parameters.get("place") == "inside"
                after = fault.parameters.get("place") == "after"
                outcomes = before if gone else outcomes + before if after else before + outcomes
            self._spend(fault)
        return outcomes

    def _spend(self, fault: Fault) -> None:
        fault.left -= 1
        if fault.left <= 0 and fault in self.faults:
            self.faults.remove(fault)

    # ---- what

    def _ticks(self, fault: Fault, name: str, default_s: float | None) -> int | None:
        """A duration of the fault in ticks, given in board or real seconds."""
        if f"{name}_real_s" in fault.parameters:
            return round(float(fault.parameters[f"{name}_real_s"]) * self.speed * TICKS_PER_S)
        seconds = fault.parameters.get(f"{name}_s", default_s)
        return None if seconds is None else round(float(seconds) * TICKS_PER_S)

    def _reply(self, fault: Fault, outcomes: list[Outcome]) -> list[Outcome]:
        note = Outcome(note=fault.name)
        if fault.name == "drop_ack":
            return [note, *(outcome for outcome in outcomes if not outcome.data)]
        if fault.name == "delay_ack":
            delay = self._ticks(fault, "delay", 1.0) or 0
            return [note, *(Outcome(outcome.data, delay) if outcome.data else outcome for outcome in outcomes)]
        if fault.name == "dup_ack":
            return [note, *outcomes, *(outcome for outcome in outcomes if outcome.data)]
        parts: list[Outcome] = [note]
        delay = self._ticks(fault, "delay", 0.05) or 0
        for outcome in outcomes:
            at = int(fault.parameters.get("after", max(1, len(outcome.data) // 2)))
            parts += [Outcome(outcome.data[:at]), Outcome(outcome.data[at:], delay)] if outcome.data else [outcome]
        return parts

    def _world(self, fault: Fault, board: Board, reply: bytes) -> list[Outcome]:
        """The faults that are not about one reply; `reply` is the one they come with, if any."""
        name, given = fault.name, fault.parameters
        note = Outcome(note=name)
        if name in ("garbage", "notice"):
            if name == "garbage":
                data = str(given.get("data", "\x00\xff\x80#?")).encode("latin-1")
            else:
                end = "\n" if board.syntax.future else "\r\n"
                data = (str(given.get("text", "Limit switch triggered. PortB=E5")) + end).encode("latin-1")
            if given.get("place") == "inside" and reply:
                middle = len(reply) // 2
                data = reply[:middle] + data + reply[middle:]
            return [note, Outcome(data)]
        if name == "freeze":
            return [Outcome(note=name, freeze_ticks=self._ticks(fault, "for", 1.0) or 0)]
        if name in ("hangup", "hangup_and_return"):
            back = self._ticks(fault, "after", 2.0) if name == "hangup_and_return" else None
            return [Outcome(note=name, hang_up=True, back_after_ticks=back, link=given.get("pty"))]
        if name == "reboot":
            board.reboot()
            board.usb_dropped = False
            if given.get("hangup", True):
                return [Outcome(note=name, hang_up=True, back_after_ticks=self._ticks(fault, "after", 1.0))]
            return [note]
        if name == "slow":
            board.parser.factor = float(given.get("factor", 10.0))
            self._undo(fault, board, "slow", 1.0)
        elif name == "power":
            on = bool(given.get("on", False))
            board.switch_supply(on)
            self._undo(fault, board, "power", not on)
        elif name == "button":
            board.press_button()
        return [note]

    def _undo(self, fault: Fault, board: Board, name: str, value: Any) -> None:
        ticks = self._ticks(fault, "for", None)
        if ticks is not None:
            self.later.append((board.now + ticks, name, value))

    @staticmethod
    def _later(name: str, value: Any, board: Board) -> None:
        if name == "slow":
            board.parser.factor = value
        else:
            board.switch_supply(value)


def _shown(value: object) -> str:
    """As it stands in the script, cut short."""
    text = json.dumps(value, default=repr)
    return text if len(text) <= 40 else text[:37] + "..."


def _whole(value: object, least: int) -> str | None:
    """What a whole number must be that `value` is not; None when it is one."""
    fits = isinstance(value, int) and not isinstance(value, bool) and least <= value <= _MOST
    return None if fits else f"a whole number from {least} to {_MOST}"


def _number(value: object, above: bool = False) -> str | None:
    """What a number must be that `value` is not; with `above` it is not 0 either."""
    fits = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= _MOST and (value > 0 or not above)
    return None if fits else f"a number {'above' if above else 'from'} 0{' and' if above else ''} up to {_MOST}"


def _amiss(name: str, value: object) -> str | None:
    """What parameter or moment `name` must be that `value` is not; None when it may be so."""
    if name in ("command", "byte", "stroke", "after"):
        return _whole(value, 0)
    if name == "times":
        return _whole(value, 1)
    if name == "factor":
        return _number(value, above=True)
    if name in ("on", "hangup"):
        return None if isinstance(value, bool) else "true or false"
    if name == "place":
        return None if value in _PLACES else "before, inside or after"
    if name in ("data", "text", "pty"):
        fits = isinstance(value, str) and (name == "pty" or all(letter <= "\xff" for letter in value))
        return None if fits else "a string" if name == "pty" else "a string of characters up to \\u00ff"
    return _number(value)  # a duration or a time


def _fault(entry: object) -> Fault:
    """One entry of a script, checked."""
    if not isinstance(entry, dict):
        raise BadCommand(f'a fault is an object such as {{"fault": "button", "at": {{"time_s": 2}}}}, not {_shown(entry)}')
    name = entry.get("fault")
    if not isinstance(name, str) or name not in _PARAMETERS:
        raise BadCommand(f"fault {name!r} is not known; choose one of {', '.join(_PARAMETERS)}")
    at = entry.get("at", {})
    if not isinstance(at, dict) or len(at) != 1 or not set(at) <= {"command", "byte", "time_s", "stroke"}:
        raise BadCommand(f"fault {name}: `at` is {at!r}; give one of command, byte, time_s or stroke")
    parameters = {key: value for key, value in entry.items() if key not in ("fault", "at", "times")}
    unknown = set(parameters) - _PARAMETERS[name]
    if unknown:
        known = ", ".join(sorted(_PARAMETERS[name])) or "nothing"
        raise BadCommand(f"fault {name}: {sorted(unknown)[0]!r} is not known; it takes {known}")
    for key, value in {**at, **parameters, "times": entry.get("times", 1)}.items():
        if (wanted := _amiss(key, value)) is not None:
            raise BadCommand(f"fault {name}: {key} is {_shown(value)}; give {wanted}")
    time_s = at.get("time_s")
    return Fault(
        name=name,
        command=at.get("command"),
        byte=at.get("byte"),
        tick=None if time_s is None else round(float(time_s) * TICKS_PER_S),
        stroke=at.get("stroke"),
        parameters=parameters,
        left=int(entry.get("times", 1)),
    )
