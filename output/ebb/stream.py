"""Sending a program so that the pen never waits and the board never goes deaf.

The loop owns the port. It sends while there is credit (flow.QueueModel) and less than LEAD_S of motion on the board, asks
the board how far it is, and never sleeps to pace itself. Planning happens in another thread (producer). A command counts as
executed only when the board's own count says so: sent >= acknowledged >= executed; marks take effect when executed.

    feed -> send          room for its entries, few unacknowledged, lead short of LEAD_S
    poll -> QU,6 QG       how many wait, whether one executes; button and power: read by this one poller only, QG clears them
    receive               replies owned by position; anything unexpected ends the plot with the error that names it
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from output.ebb.abilities import Abilities
from output.ebb.board_time import board_time_s, way_s
from output.ebb.commands import HM, S2, SP, TP, Command, MotionCommand
from output.ebb.control import StopFlag
from output.ebb.conversation import Conversation, complaint, suspended_s
from output.ebb.flow import QueueModel
from output.ebb.low_lift import LowLift
from output.ebb.poll import Poll, Seen, supply_lost
from output.ebb.producer import Producer
from output.ebb.program import (
    ApproachMark,
    DipMark,
    LayerMark,
    Mark,
    PauseMark,
    Program,
    Slowed,
    StrokeEnd,
    StrokeMark,
    refused_in_a_stream,
)
from output.ebb.progress import Progress, Recorder, State
from output.ebb.protocol import Event, Reply
from output.errand import Errand
from output.errors import BadCommand, BoardRefused, PositionLost

# Motion kept on the board: ordinary host stalls are 50 to 800 ms; more would only delay a pause and overrun after a crash.
LEAD_S = 1.2
# Below this lead, one unacknowledged command at a time: should it be refused, nothing after it has been started.
_CAREFUL_LEAD_S = 0.1
_PIPELINE = 4
_POLL_FASTEST_S, _POLL_SLOWEST_S, _POLL_IDLE_S = 0.002, 0.05, 0.1
_PROGRESS_EVERY_S = 0.1
# So much board time is left when a hold is asked for, on the board or still to be sent.
_HOLD_TAKES_S = 0.4
# How often the position and the job token are asked for.
_PLACE_EVERY_S = 0.5
_BUTTON_PRESSES, _BUTTON_STUCK_S = 3, 1.0
# A difference between the clocks that stop in sleep and those that do not: more than their own jitter.
_SLEPT_S = 0.5
# How much longer than predicted the oldest command may be waited for before the board is said to be stuck.
_STUCK_MARGIN_S = 5.0


class StopRequested(Exception):
    """The stop flag was set: leaves the loop by the same way as an error."""


Hold = Callable[[int], Program | None]


@dataclass(slots=True)
class _Sent:
    """A command of the program on its way: its number among the queued ones (0 when immediate) and its place in the program."""

    queued: int
    index: int
    seconds: float
    command: Command


def _may_lower(command: Command) -> bool:
    """Whether the pen may go down by it; which way a servo on another pin goes is not known here."""
    return isinstance(command, TP | S2) or (isinstance(command, SP) and command.value == 0)


class Streamer:
    """One run of one program. `run` returns when everything has been executed; it raises StopRequested, what the program
    raised, BoardRefused or LinkLost. It never raises the pen itself: its caller does, on every way out.

    A pause takes effect at a PauseMark or before the next stroke. `hold(taken)` may do better: return what to send in place of
    the rest of the program, `taken` items having been sent, to slow down along the path and lift. `held` is then True, and
    `run` returns when that has been executed. It is asked again as the program goes on for as long as it returns None.
    `left` is True when `run` returned from a pause because that was asked for.
    """

    def __init__(
        self,
        talk: Conversation,
        abilities: Abilities,
        depth: int,
        program: Program,
        *,
        on_progress: Callable[[Progress], None],
        stop: StopFlag,
        journal: Recorder | None = None,
        hold: Hold | None = None,
        before_send: Callable[[Command], list[str]] | None = None,
        token: tuple[str, int] | None = None,
        board_speed: float = 1.0,
    ) -> None:
        self._talk = talk
        self._abilities = abilities
        self._on_progress: Callable[[Progress], None] | None = on_progress
        self._stop = stop
        self._journal = journal
        self._hold = hold
        self._before_send = before_send or (lambda _command: [])
        self._token = token
        self._speed = board_speed
        self.model = QueueModel(depth, counts=abilities.counts_queue, board_speed=board_speed)
        self.progress = Progress()
        self._producer = Producer(program, talk.port.wake)
        self._taken = 0
        self._in_flight: dict[int, _Sent] = {}  # program commands by conversation number, until acknowledged
        self._unexecuted: deque[_Sent] = deque()
        self._marks: deque[tuple[int, Mark]] = deque()  # (number of the queued command before it, mark)
        self._poll = Poll(talk, abilities, None if token is None else token[0])
        self._next_poll_at = 0.0
        self._next_progress_at = 0.0
        self._next_place_at = 0.0
        self._token_asked = self._token_seen = -1  # commands sent when the token was asked for, and seen
        self._button_at: deque[float] = deque(maxlen=_BUTTON_PRESSES)
        self._idle = True
        self.held = self.left = False
        self._hold_at = -1  # the item from which on the last hold was asked for
        self._holding: Errand[Program | None] | None = None
        self._errand: Errand[Program | None] | None = None  # the same, also when it is not wanted any more
        self._slept_s = suspended_s()
        self._approached = False
        self._over_stroke = False  # which comes next, and for which the pen has not been lowered on the way
        self._lowering = False  # on the way: the rest of the travel follows at once
        self._low_lift = LowLift()
        self._last_motion = 0  # number of the last queued command that moves the motors
        self._oldest_since_s = 0.0
        self._oldest = 0
        self._oldest_lasts_s = 0.0

    # the loop

    def run(self) -> Progress:
        """Sends, watches and waits until the last command has been executed."""
        try:
            while not self._finished():
                if self._stop.requested:
                    raise StopRequested
                self._notice_sleep()
                self._follow_pause()
                self._feed()
                self._ask_if_due()
                for event in self._talk.receive(self._until_next_poll_s()):
                    self._handle(event)
                self._report()
            self._report(always=True)
            return self.progress
        finally:
            self._producer.close()

    def _finished(self) -> bool:
        if self.left:
            return not self._poll.pending
        done = self._producer.exhausted and not self._in_flight and not self._poll.pending and self.model.is_empty
        # A board that has restarted is idle as well: only its token tells that what it was sent last has been done.
        return done and self._idle and self.progress.state is State.RUNNING and not self._marks and self._knows_board()

    def wait_for_planner(self) -> None:
        """After `run`, and after what stops the board."""
        self._producer.wait()

    # sending

    def _feed(self) -> None:
        while self.progress.state is State.RUNNING and (item := self._producer.peek()) is not None:
            if self._stop.requested:
                return
            if self._holding is not None and self._taken == self._hold_at:
                break
            if isinstance(item, Command):
                if self._over_stroke and not self._producer.has_stroke(LEAD_S):
                    # A pen that is down waits for nobody; as long as it is up, it may as well pause.
                    if self._stop.pause_reason is not None:
                        self._set(state=State.HOLDING, message=self._stop.pause_reason)
                    return
                if not self._may_send(item):
                    return
                self._send(item)
                self._over_stroke = False
            else:
                self._over_stroke = isinstance(item, StrokeMark) and not self._approached
                self._lowering = self._lowering and not isinstance(item, StrokeMark)
                self._marks.append((self.model.sent, item))
                if isinstance(item, PauseMark) or (self._may_hold(item) and self._stop.pause_reason is not None):
                    message = item.message if isinstance(item, PauseMark) else self._stop.pause_reason or ""
                    self._stop.pause_reason = message
                    self._set(state=State.HOLDING, message=message)
            self._producer.take()
            self._taken += 1
        self._apply_marks()

    def _may_hold(self, mark: Mark) -> bool:
        """Before a stroke, with the pen up: at its approach where the pen is lowered on the way, else at its own mark."""
        if isinstance(mark, Slowed):  # in the midst of anything
            return False
        approached, self._approached = self._approached, isinstance(mark, ApproachMark)
        return self._approached or isinstance(mark, DipMark) or (isinstance(mark, StrokeMark) and not approached)

    def _may_send(self, command: Command) -> bool:
        lead_s = self.model.lead_s(self._talk.clock())
        if len(self._in_flight) >= (_PIPELINE if lead_s > _CAREFUL_LEAD_S else 1):
            return False
        if command.waits_for_idle or (not self._abilities.stop_clears and _may_lower(command)):
            # Firmware 2 keeps a pen-down in its queue through ES: were it queued behind a travel, a stop would leave a dot
            # wherever the travel was cut off. The pen is at rest before it is lowered, so that waiting costs milliseconds.
            if not (self.model.is_empty and self._idle and not self._in_flight):
                return False
            if _may_lower(command) and not self._knows_board():
                return False
            self.model.expect_idle()
            return True
        if _may_lower(command) and self._talk.pending:
            # Were the travel before it lost (a restart, a refusal), a pen-down already on the wire would leave a dot there.
            return False
        if _may_lower(command) and self._approached and not self._rest_of_travel_fits():
            return False
        if not command.queued:
            return True
        if isinstance(command, MotionCommand) and self._stands and not self._comes_to_rest():
            return False
        if command.fifo_entries > self.model.depth:
            raise BadCommand(
                f"{command.wire()} takes {command.fifo_entries} places, but the motion queue has {self.model.depth}: it needs "
                "firmware 3.0.1"
            )
        if self.model.room() < command.fifo_entries:
            return False
        return self._lowering or lead_s * self._speed < LEAD_S or self.model.sent - self.model.completed < 3

    def _comes_to_rest(self) -> bool:
        """Whether a motion from rest can be begun: it must not run out in its middle, at speed, with planning only just begun.

        A travel may wait at its end, unless the pen is lowered before that.
        """
        if self._producer.has_s(LEAD_S):
            return True
        return not self._approached and self._producer.until(StrokeMark) is not None

    def _rest_of_travel_fits(self) -> bool:
        """Whether a lowering on the way can be followed at once by the rest of its travel, without which it would leave a dot

        beside its stroke: were this program killed then, or planning late.
        """
        rest = self._producer.until(StrokeMark)
        if rest is None:
            return False
        entries = sum(item.fifo_entries for item in rest if isinstance(item, Command))
        return self.model.room() >= min(entries, self.model.depth)

    @property
    def _stands(self) -> bool:
        """Whether all that moves the motors has been executed, for all that the board has said."""
        return self.model.completed >= self._last_motion

    def _knows_board(self) -> bool:
        """Whether the token has been seen since the last command went out; asks for it when not.

        Firmware 2 shows a restart in nothing else, and lowered there, the pen would draw beside its place.
        """
        if self._token is None or self._token_seen == self.progress.commands_sent:
            return True
        self._next_place_at = self._next_poll_at = self._talk.clock()
        return False

    def _send(self, command: Command) -> None:
        wire = command.wire()
        if (refusal := refused_in_a_stream(command, self._abilities.variables)) is not None:
            raise BadCommand(refusal)
        for extra in self._before_send(command):
            self._talk.send(extra)
        if self._journal is not None:
            self._journal.sent(self.progress.commands_sent + 1)
        number = self._talk.send(wire)
        sent = _Sent(0, self.progress.commands_sent, board_time_s(command), command)
        self._low_lift.note(command)
        self._lowering = self._lowering or (self._approached and _may_lower(command))
        if command.queued:
            self._enqueued(command, sent)
        self._in_flight[number] = sent
        self._set(commands_sent=self.progress.commands_sent + 1)

    def _enqueued(self, command: Command, sent: _Sent) -> None:
        sent.queued = self.model.on_sent(command.fifo_entries, sent.seconds)
        self._last_motion = sent.queued if isinstance(command, MotionCommand) else self._last_motion
        self._unexecuted.append(sent)
        self._idle = False
        now = self._talk.clock()
        self._next_poll_at = min(self._next_poll_at, now + self._poll_interval_s(now))

    def _send_beside(self, command: Command) -> None:
        """A queued command that is none of the program's: the queue is told of it, the count of the program's is not."""
        sent = _Sent(0, self.progress.commands_sent - 1, board_time_s(command), command)
        self._in_flight[self._talk.send(command.wire())] = sent
        self._enqueued(command, sent)

    # asking how far the board is

    def _until_next_poll_s(self) -> float:
        """For how long to wait for news: while the poll is unanswered the news is its answer, and the next is not due."""
        return _POLL_SLOWEST_S if self._poll.pending else self._next_poll_at - self._talk.clock()

    def _ask_if_due(self) -> None:
        now = self._talk.clock()
        if self._poll.pending or now < self._next_poll_at:
            return
        self.model.on_poll_sent(now)
        place = now >= self._next_place_at
        if place:
            self._next_place_at = now + _PLACE_EVERY_S
            self._token_asked = self.progress.commands_sent
        self._poll.ask(place=place)

    def _polled(self, seen: Seen) -> None:
        now = self._talk.clock()
        if seen.pen_up is not None:
            self._set(pen_up=seen.pen_up)
        if seen.power_lost:
            raise supply_lost()
        if seen.button:
            self._button_pressed()
        if seen.steps is not None:
            self._set(steps=seen.steps)
        if seen.token is not None:
            self._check_token(seen.token)
        self.model.on_polled(waiting=seen.waiting, fifo_empty=not seen.fifo, executing=seen.executing, now=now)
        self._idle = self.model.is_empty
        self._count_executed()
        self._next_poll_at = now + self._poll_interval_s(now)
        self._watch_for_stuck()

    def _poll_interval_s(self, now: float) -> float:
        """Often enough that a freed place is found long before the motion queued behind it runs out."""
        if self._idle:
            return _POLL_IDLE_S
        return min(max(self.model.lead_s(now) / 8, _POLL_FASTEST_S), _POLL_SLOWEST_S)

    def _check_token(self, token: int) -> None:
        """Whether the board is still the one that was told this job's token."""
        if self._token is not None and token != self._token[1]:
            raise PositionLost(
                f"the board restarted during {self._where()}, so that its position is lost", "check its power supply"
            )
        self._token_seen = self._token_asked

    def _button_pressed(self) -> None:
        now = self._talk.clock()
        self._button_at.append(now)
        if len(self._button_at) == _BUTTON_PRESSES and now - self._button_at[0] < _BUTTON_STUCK_S:
            # A finger cannot do that: a floating or shorted input can, and it must not make the plot go on by itself.
            self._stop.pause("the button input is stuck: check its wiring, then go on")
        elif self.progress.state is State.PAUSED:
            self._stop.go()
        else:
            self._stop.pause("the board's button was pressed")

    def _watch_for_stuck(self) -> None:
        oldest, waited_s = self.model.completed + 1, self._talk.waited_s
        if self.model.is_empty or oldest != self._oldest or not self._unexecuted:
            self._oldest, self._oldest_since_s, self._oldest_lasts_s = oldest, waited_s, 0.0
            return
        entry = self._unexecuted[0]
        if isinstance(entry.command, HM) and self.progress.steps is not None:  # the farthest it has been seen from its end
            self._oldest_lasts_s = max(self._oldest_lasts_s, way_s(entry.command, self.progress.steps))
        seconds = max(entry.seconds, self._oldest_lasts_s) / self._speed
        busy_s = waited_s - self._oldest_since_s
        if busy_s > seconds * 1.5 + _STUCK_MARGIN_S:
            raise BoardRefused(
                f"the board is busy with command {entry.index + 1} for {busy_s:.1f} s, which should take {seconds:.1f} s: "
                "it is stuck; power it off and on"
            )

    def _count_executed(self) -> None:
        done, board_time_s_sum, index = False, self.progress.board_time_s, self.progress.commands_executed
        while self._unexecuted and self._unexecuted[0].queued <= self.model.completed:
            entry = self._unexecuted.popleft()
            board_time_s_sum += entry.seconds
            index, done = entry.index + 1, True
        if done:
            self._set(board_time_s=board_time_s_sum, commands_executed=index)
            self._apply_marks()
            if self._journal is not None:
                self._journal.executed(self.progress)

    def _apply_marks(self) -> None:
        """Marks whose commands before them have all been executed."""
        while self._marks and self._marks[0][0] <= self.model.completed:
            _, mark = self._marks.popleft()
            if isinstance(mark, LayerMark):
                self._set(layer=mark)
            elif isinstance(mark, StrokeMark):
                self._set(stroke=mark.index)
            elif isinstance(mark, StrokeEnd):
                self._set(stroke=None, strokes_done=self.progress.strokes_done + 1)
                if self._journal is not None:
                    self._journal.stroke_done(mark, self.progress)

    # events

    def _handle(self, event: Event) -> None:
        if not isinstance(event, Reply):
            raise complaint(event, self._where())
        if self._poll.owns(event.number):
            if (seen := self._poll.answered(event.number, event.data)) is not None:
                self._polled(seen)
            return
        sent = self._in_flight.pop(event.number, None)
        if sent is not None and sent.queued:
            self.model.on_acknowledged(self._talk.clock())
            self._set(stalls=self.model.stalls, stalled_s=self.model.stalled_s)
        elif sent is not None and not self._unexecuted:
            self._set(commands_executed=max(self.progress.commands_executed, sent.index + 1))

    def _where(self) -> str:
        stroke = "" if self.progress.stroke is None else f" (stroke {self.progress.stroke + 1})"
        return f"the plot, command {self.progress.commands_executed + 1} of {self.progress.commands_sent} sent{stroke}"

    # pause

    def _notice_sleep(self) -> None:
        """After a sleep nobody knows what became of the board: it pauses, and the poll asks for its token at once."""
        slept_s = suspended_s()
        if slept_s > self._slept_s + _SLEPT_S:
            self._stop.pause(f"the computer was asleep for {slept_s - self._slept_s:.0f} s")
            self._next_place_at = self._next_poll_at = self._talk.clock()
        self._slept_s = slept_s

    def _follow_pause(self) -> None:
        state = self.progress.state
        if state is State.RUNNING and self._stop.pause_reason is not None:
            self._hold_on_path()
            return
        self._holding = None
        if state is State.HOLDING and self.model.is_empty and self._idle and not self._in_flight:
            self.model.expect_idle()
            if (rise := self._low_lift.rise()) is not None:
                self._send_beside(rise)  # the queue is empty, so that this is at once
                return
            self._apply_marks()
            self._set(state=State.PAUSED)
            self._report(always=True)
        elif state is State.PAUSED and self._stop.leave_asked:
            self._stop.leave_asked, self.left = False, True
        elif state is State.PAUSED and self._stop.pause_reason is None:
            self._set(state=State.RUNNING, message="")
            if (back := self._low_lift.back()) is not None:
                self._send_beside(back)
            self._report(always=True)

    def _hold_on_path(self) -> None:
        """Asks for a hold, which takes a tenth of a second to reckon, and turns to it when it is there. Where the queue is
        short it begins a little later, and what comes before it goes on being sent meanwhile."""
        if self._hold is None or self.held:
            return
        if self._holding is None:
            if self._errand is not None and not self._errand.done:
                return
            at = self._taken + self._producer.ahead(_HOLD_TAKES_S - self.model.lead_s(self._talk.clock()) * self._speed)
            if at == self._hold_at:
                return
            self._hold_at = at
            self._holding = self._errand = Errand(partial(self._hold, at), self._talk.port.wake)
        if not self._holding.done or self._taken < self._hold_at:
            return
        rest, self._holding = self._holding.result(), None
        if rest is None:
            return
        rest = list(rest)
        if self._journal is not None:
            self._journal.held([item.wire() for item in rest if isinstance(item, Command)])
        self.held = True
        self._producer.close()
        self._producer = Producer(rest, self._talk.port.wake)
        self._set(message=self._stop.pause_reason or "")

    # reporting

    def _set(self, **changes: object) -> None:
        self.progress = replace(self.progress, **changes)  # type: ignore[arg-type]

    def _report(self, *, always: bool = False) -> None:
        now = self._talk.clock()
        if self._on_progress is None or (now < self._next_progress_at and not always):
            return
        self._next_progress_at = now + _PROGRESS_EVERY_S
        self._set(lead_s=self.model.lead_s(now) * self._speed)
        try:
            self._on_progress(self.progress)
        except (OSError, ValueError):
            # Whoever looked at the progress is gone (a closed pipe, a closed terminal): the plot is not their hostage.
            self._on_progress = None
