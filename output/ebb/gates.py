"""What of a program may be sent now: the rules that keep the pen off the paper while it waits, and the board busy but not deaf.

room        never more entries than the board's queue has places for (flow.QueueModel), nor more motion than LEAD_S
careful     while the board has little motion, nothing follows a command that may yet be refused
lowering    only with nothing unanswered, and not before what is drawn, or travelled, with the pen on its way down is there
from rest   no motion that could run out in its middle, at speed, because planning has only just begun
"""

from __future__ import annotations

from output.ebb.abilities import Abilities
from output.ebb.commands import S2, SP, TP, Command, MotionCommand
from output.ebb.conversation import Conversation
from output.ebb.flow import QueueModel
from output.ebb.poll import Poll
from output.ebb.producer import Producer
from output.ebb.program import ApproachMark, DipMark, Mark, PauseMark, Slowed, StrokeMark
from output.errors import BadCommand

# Motion kept on the board: ordinary host stalls are 50 to 800 ms; more would only delay a pause and overrun after a crash.
LEAD_S = 1.2
# Below this lead, one unacknowledged command at a time: should it be refused, nothing after it has been started.
_CAREFUL_LEAD_S = 0.1
_PIPELINE = 4


class Gates:
    """Follows a program as it is sent, and says whether its next command may be."""

    def __init__(
        self, abilities: Abilities, model: QueueModel, poll: Poll, talk: Conversation, board_speed: float = 1.0
    ) -> None:
        self._abilities = abilities
        self._model = model
        self._poll = poll
        self._talk = talk
        self._speed = board_speed
        self._approached = False
        self._over_stroke = False  # which comes next, and for which the pen has not been lowered on the way
        self._lowering = False  # on the way: the rest of the travel follows at once
        self._last_motion = 0  # number of the last queued command that moves the motors

    def pass_mark(self, mark: Mark) -> bool:
        """Whether a pause may begin at this mark: a pause of the program's own, or before a stroke with the pen up, at its
        approach where the pen is lowered on the way, else at its own mark."""
        if isinstance(mark, PauseMark | Slowed):
            return isinstance(mark, PauseMark)
        approached, self._approached = self._approached, isinstance(mark, ApproachMark)
        self._over_stroke = isinstance(mark, StrokeMark) and not approached
        self._lowering = self._lowering and not isinstance(mark, StrokeMark)
        return self._approached or isinstance(mark, DipMark) or self._over_stroke

    def pass_command(self, command: Command, number: int) -> None:
        """A command has been sent; `number` is the queue's, 0 for one that is not queued."""
        self._over_stroke = False
        self._lowering = self._lowering or (self._approached and _may_lower(command))
        if number and isinstance(command, MotionCommand):
            self._last_motion = number

    def must_wait_for_stroke(self, producer: Producer) -> bool:
        """Whether the pen is over a stroke that is not there yet: a pen that is down waits for nobody."""
        return self._over_stroke and not producer.has_stroke(LEAD_S)

    def may_send(self, command: Command, producer: Producer, *, unacknowledged: int, sent: int) -> bool:
        """Whether the program's next command, which `producer` shows, may be sent; `sent` is how many were.

        Raises BadCommand for one that the board's queue is too short for.
        """
        lead_s = self._model.lead_s(self._talk.clock())
        if unacknowledged >= (_PIPELINE if lead_s > _CAREFUL_LEAD_S else 1):
            return False
        lowers = _may_lower(command)
        if command.waits_for_idle or (lowers and not self._abilities.stop_clears):
            # Firmware 2 keeps a pen-down in its queue through ES: were it queued behind a travel, a stop would leave a dot
            # wherever the travel was cut off. The pen is at rest before it is lowered, so that waiting costs milliseconds.
            if not self._model.is_empty or unacknowledged or (lowers and not self._poll.knows_board(sent)):
                return False
            self._model.expect_idle()
            return True
        if lowers and (self._talk.pending or (self._approached and not self._rest_of_travel_fits(producer))):
            # Were the travel before it lost (a restart, a refusal), a pen-down already on the wire would leave a dot there.
            return False
        if not command.queued:
            return True
        if isinstance(command, MotionCommand) and self._stands and not self._comes_to_rest(producer):
            return False
        if command.fifo_entries > self._model.depth:
            raise BadCommand(
                f"{command.wire()} takes {command.fifo_entries} places, but the motion queue has {self._model.depth}: it needs "
                "firmware 3.0.1"
            )
        if self._model.room() < command.fifo_entries:
            return False
        return self._lowering or lead_s * self._speed < LEAD_S or self._model.sent - self._model.completed < 3

    @property
    def _stands(self) -> bool:
        """Whether all that moves the motors has been executed, for all that the board has said."""
        return self._model.completed >= self._last_motion

    def _comes_to_rest(self, producer: Producer) -> bool:
        """Whether a motion that begins from rest is there as far as it must be. A travel may wait at its end, unless the pen
        is lowered before that."""
        return producer.has_s(LEAD_S) or (not self._approached and producer.until(StrokeMark) is not None)

    def _rest_of_travel_fits(self, producer: Producer) -> bool:
        """Whether a lowering on the way can be followed at once by the rest of its travel, without which it would leave a dot
        beside its stroke: were this program killed then, or planning late."""
        rest = producer.until(StrokeMark)
        if rest is None:
            return False
        entries = sum(item.fifo_entries for item in rest if isinstance(item, Command))
        return self._model.room() >= min(entries, self._model.depth)


def _may_lower(command: Command) -> bool:
    """Whether the pen may go down by it; which way a servo on another pin goes is not known here."""
    return isinstance(command, TP | S2) or (isinstance(command, SP) and command.value == 0)
