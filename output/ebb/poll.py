"""Asking the board how far it is: the questions of a poll, and what their answers say.

QU,6 says how many commands wait, QG or QM whether one executes; QS and the job's token, where the board is and whether it is
still the same board, are asked for less often, and QC where no flag tells that the motors' supply has failed. QG clears the
button's and the power's bits when it is read, so that nobody else may ask it during a plot.

Clocks: the conversation's, in host seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

from output.ebb.abilities import Abilities
from output.ebb.conversation import Conversation
from output.ebb.flow import QueueModel
from output.errors import PositionLost

FIFO_BIT, EXECUTING_BIT, PEN_UP_BIT, BUTTON_BIT, POWER_LOST_BIT = 0x01, 0x08, 0x10, 0x20, 0x40
# What no motor supply is below: counts of QC's converter, of 0.0295 V each.
LEAST_SUPPLY_COUNTS = 150

_FASTEST_S, _SLOWEST_S, _IDLE_S = 0.002, 0.05, 0.1
# How often the position and the job token are asked for.
_PLACE_EVERY_S = 0.5


@dataclass(frozen=True, slots=True)
class Seen:
    """What the board answered. None where it was not asked: `waiting` and `steps`; `pen_up` where only QM is known. `restarted`
    says that it does not hold the job's token any more."""

    fifo: bool
    executing: bool
    waiting: int | None = None
    pen_up: bool | None = None
    button: bool = False
    power_lost: bool = False
    steps: tuple[int, int] | None = None
    restarted: bool = False


def supply_lost() -> PositionLost:
    """What a plot ends with whose motors have been without power: they do not follow what the board counts."""
    return PositionLost(
        "the motors' power was lost during the plot, so that the machine is not where the board counts it",
        "check the power supply",
    )


class Poll:
    """One poll at a time. `token` is the question for the job's token and its answer, None when the board has not been told
    one."""

    def __init__(self, talk: Conversation, abilities: Abilities, model: QueueModel, token: tuple[str, int] | None) -> None:
        self._talk = talk
        self._abilities = abilities
        self._model = model
        self._token = token
        self._asked: dict[int, str] = {}  # questions in flight, by conversation number
        self._answers: dict[str, str] = {}
        self._next_at = self._next_place_at = 0.0
        self._token_asked = self._token_seen = -1  # commands sent when the token was asked for, and seen

    @property
    def pending(self) -> bool:
        return bool(self._asked)

    def due_in_s(self) -> float:
        """For how long to wait for news: while a poll is unanswered the news is its answer, and the next is not due."""
        return _SLOWEST_S if self.pending else self._next_at - self._talk.clock()

    def ask_if_due(self, sent: int) -> None:
        """Sends the questions when it is time; `sent` is how many commands of the program went out."""
        now = self._talk.clock()
        if self.pending or now < self._next_at:
            return
        self._model.on_poll_sent(now)
        self._answers.clear()
        questions = ["QU,6"] if self._abilities.counts_queue else []
        questions.append(self._abilities.status_query)
        if now >= self._next_place_at:
            self._next_place_at = now + _PLACE_EVERY_S
            self._token_asked = sent
            questions += ["QS"] if self._token is None else ["QS", self._token[0]]
            questions += [] if self._abilities.power_flag else ["QC"]
        for question in questions:
            self._asked[self._talk.send(question)] = question

    def place_at_once(self) -> None:
        """The next questions are due now, those for the position and the token among them."""
        self._next_place_at = self._next_at = self._talk.clock()

    def by_lead(self) -> None:
        """The next questions are due as the model has it: often enough that a freed place is found long before the motion
        queued behind it runs out."""
        self._next_at = self._talk.clock() + self._interval_s()

    def not_later_than_by_lead(self) -> None:
        """The same, unless they are due sooner."""
        self._next_at = min(self._next_at, self._talk.clock() + self._interval_s())

    def _interval_s(self) -> float:
        if self._model.is_empty:
            return _IDLE_S
        return min(max(self._model.lead_s(self._talk.clock()) / 8, _FASTEST_S), _SLOWEST_S)

    def knows_board(self, sent: int) -> bool:
        """Whether the token has been seen since the last of `sent` commands went out; has it asked for when not.

        Firmware 2 shows a restart in nothing else, and lowered there, the pen would draw beside its place.
        """
        if self._token is None or self._token_seen == sent:
            return True
        self.place_at_once()
        return False

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
        restarted = False
        if self._token is not None and self._token[0] in self._answers:
            restarted = int(self._answers[self._token[0]]) != self._token[1]
            self._token_seen = self._token_asked
        dead = "QC" in self._answers and int(self._answers["QC"].split(",")[1]) < LEAST_SUPPLY_COUNTS
        if "QM" in self._answers:
            words = self._answers["QM"].split(",")
            fifo = words[-1] == "1" if len(words) > 3 else words[0] == "1"
            return Seen(fifo, words[0] == "1", waiting, power_lost=dead, steps=steps, restarted=restarted)
        bits = int(self._answers["QG"], 16)
        return Seen(
            bool(bits & FIFO_BIT),
            bool(bits & EXECUTING_BIT),
            waiting,
            bool(bits & PEN_UP_BIT),
            bool(bits & BUTTON_BIT),
            dead or (bool(bits & POWER_LOST_BIT) and self._abilities.power_flag),
            steps,
            restarted,
        )
