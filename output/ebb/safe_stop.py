"""Pen up and everything stopped, from any state of the conversation: the one thing that must always be sendable.

Nothing here looks at an error flag, and nothing waits for the answers of commands sent before. Both commands go in one write;
their answers are searched for in what comes, whatever else is still in the line.

    firmware    stop and pen        why
    >= 3.0.1    ES  SP,3            SP,3 raises past the queue and takes the pen-down height away until the next SC,5
    older       ES  SP,1            ES has emptied the queue, so that the queued SP,1 runs at once

A pen lift on another output (brushless) is raised on its own pin.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from output.ebb.abilities import Abilities
from output.ebb.conversation import NOTHING_S, Conversation
from output.errors import BoardRefused, LinkLost

DEADLINE_S = 0.5
_PEN_TIMEOUT_S = 1.5
_ASK_EVERY_S = 0.02

_ES_ANSWER = re.compile(r"(ES,)?[01](,-?\d+,-?\d+,-?\d+,-?\d+)?")


@dataclass(frozen=True, slots=True)
class StopReport:
    """What became of a safe stop. `pen_up`: the board says that the pen is sent up; `interrupted`: motion was cut off by it
    (None when the board did not say), so that the position is counted but physically suspect; `took_s` from the writing of the
    stop to its answers, on the host's clock."""

    pen_up: bool
    interrupted: bool | None
    took_s: float
    detail: str


def safe_stop(talk: Conversation, abilities: Abilities, raise_pen: str, *, free_motors: bool = False) -> StopReport:
    """Stops the motion and raises the pen, by the wire command `raise_pen`; afterwards the conversation is in step again when
    the board answers at all.

    Never raises for what the link does: a lost link is told in the report, because the error that led here matters more.
    """
    began = talk.clock()
    commands = ["ES,1" if free_motors and abilities.stop_frees else "ES", raise_pen]
    commands += ["EM,0,0"] if free_motors and not abilities.stop_frees else []
    try:
        # The first CR ends a line that a failed write may have left half sent.
        talk.port.send(("\r" + "".join(f"{command}\r" for command in commands)).encode("ascii"))
        interrupted, answered = _await_answers(talk, commands, talk.waited_s + DEADLINE_S)
        took_s = talk.clock() - began
        in_step = talk.resync(DEADLINE_S)
        pen_up = in_step and _wait_for_pen(talk)
    except (LinkLost, BoardRefused) as error:
        return StopReport(False, None, talk.clock() - began, f"the stop could not be sent: {error}")
    if pen_up and answered:
        return StopReport(True, interrupted, took_s, "stopped, pen up")
    late = f"the board did not confirm the stop within {DEADLINE_S:g} s"
    state = "but its pen is up now" if pen_up else "and its pen is not up" if in_step else "and it answers nothing"
    return StopReport(pen_up, interrupted, took_s, f"{late}, {state}")


def _wait_for_pen(talk: Conversation) -> bool:
    """The board's own word that the pen has been sent up.

    Firmware 2 does not take servo moves and delays out of its queue at ES: the raising may have to wait for one of each.
    """
    end_s = talk.waited_s + _PEN_TIMEOUT_S
    while talk.ask("QP") != "1":
        if talk.waited_s >= end_s:
            return False
        talk.receive(_ASK_EVERY_S)
    return True


def _await_answers(talk: Conversation, commands: list[str], deadline_s: float) -> tuple[bool | None, bool]:
    """Looks for the answer to ES and then for one to each later command, in either syntax, until `deadline_s` (waited)."""
    interrupted: bool | None = None
    wanted = [command.split(",")[0] for command in commands[1:]]
    legacy_ok_due = False
    for text in _lines(talk, deadline_s):
        if interrupted is None:
            if _ES_ANSWER.fullmatch(text):
                interrupted = text.removeprefix("ES,").startswith("1")
                legacy_ok_due = not text.startswith("ES")
        elif text == "OK" and legacy_ok_due:
            legacy_ok_due = False
        elif wanted and text in (wanted[0], "OK"):
            wanted.pop(0)
            if not wanted:
                return interrupted, True
    return interrupted, False


def _lines(talk: Conversation, deadline_s: float) -> Iterator[str]:
    rest = b""
    while (left_s := deadline_s - talk.waited_s) > NOTHING_S:
        rest += talk.wait(left_s)
        *lines, rest = re.split(rb"[\r\n]+", rest[-4096:])
        yield from (line.decode("ascii", "replace") for line in lines if line)
