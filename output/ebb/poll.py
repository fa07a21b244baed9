"""Asking the board how far it is: the questions of a poll, and what their answers say.

QU,6 says how many commands wait, QG or QM whether one executes; QS and the job's token, where the board is and whether it is
still the same board, are asked for less often. QG clears the button's and the power's bits when it is read, so that nobody
else may ask it during a plot.
"""

from __future__ import annotations

from dataclasses import dataclass

from output.ebb.abilities import Abilities
from output.ebb.conversation import Conversation
from output.errors import PositionLost

FIFO_BIT, EXECUTING_BIT, PEN_UP_BIT, BUTTON_BIT, POWER_LOST_BIT = 0x01, 0x08, 0x10, 0x20, 0x40


@dataclass(frozen=True, slots=True)
class Seen:
    """What the board answered. None where it was not asked: `waiting` and `steps`, `token`; `pen_up` where only QM is known."""

    fifo: bool
    executing: bool
    waiting: int | None = None
    pen_up: bool | None = None
    button: bool = False
    power_lost: bool = False
    steps: tuple[int, int] | None = None
    token: int | None = None


def supply_lost() -> PositionLost:
    """What a plot ends with whose motors have been without power: they do not follow what the board counts."""
    return PositionLost(
        "the motors' power was lost during the plot, so that the machine is not where the board counts it",
        "check the power supply",
    )


class Poll:
    """One poll at a time. `token` is the question for the job's token, None when the board has not been told one."""

    def __init__(self, talk: Conversation, abilities: Abilities, token: str | None) -> None:
        self._talk = talk
        self._abilities = abilities
        self._token = token
        self._asked: dict[int, str] = {}  # questions in flight, by conversation number
        self._answers: dict[str, str] = {}

    @property
    def pending(self) -> bool:
        return bool(self._asked)

    def ask(self, *, place: bool) -> None:
        """Sends the questions; with those for the position and the token when `place`."""
        self._answers.clear()
        questions = ["QU,6"] if self._abilities.counts_queue else []
        questions.append(self._abilities.status_query)
        if place:
            questions += ["QS"] if self._token is None else ["QS", self._token]
        for question in questions:
            self._asked[self._talk.send(question)] = question

    def owns(self, number: int) -> bool:
        return number in self._asked

    def answered(self, number: int, data: str) -> Seen | None:
        """Takes the answer to one of its questions; what the board has said in all with the last of them."""
        self._answers[self._asked.pop(number)] = data
        if self._asked:
            return None
        waiting = int(self._answers["QU,6"].split(",")[-1]) if "QU,6" in self._answers else None
        steps = None
        if "QS" in self._answers:
            one, two = self._answers["QS"].split(",")
            steps = int(one), int(two)
        token = int(self._answers[self._token]) if self._token in self._answers else None
        if "QM" in self._answers:
            words = self._answers["QM"].split(",")
            fifo = words[-1] == "1" if len(words) > 3 else words[0] == "1"
            return Seen(fifo, words[0] == "1", waiting, steps=steps, token=token)
        bits = int(self._answers["QG"], 16)
        return Seen(
            bool(bits & FIFO_BIT),
            bool(bits & EXECUTING_BIT),
            waiting,
            bool(bits & PEN_UP_BIT),
            bool(bits & BUTTON_BIT),
            bool(bits & POWER_LOST_BIT) and self._abilities.power_flag,
            steps,
            token,
        )
