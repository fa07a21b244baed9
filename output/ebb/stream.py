"""Sending a program so that the pen never waits and the board never goes deaf.

The loop owns the port. It sends what the gates let pass, asks the board how far it is, and never sleeps to pace itself.
Planning happens in another thread (producer). A command counts as executed only when the board's own count says so:
sent >= acknowledged >= executed; marks take effect when executed.

    feed -> send          while the gates are open (gates): room, little unacknowledged, lead short of LEAD_S
    poll -> QU,6 QG       how many wait, whether one executes; button and power: read by this one poller only, QG clears them
    receive               replies owned by position; anything unexpected ends the plot with the error that names it
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from output.ebb.abilities import Abilities
from output.ebb.board_time import board_time_s
from output.ebb.commands import Command
from output.ebb.control import StopFlag
from output.ebb.conversation import Conversation, complaint
from output.ebb.flow import QueueModel
from output.ebb.gates import Gates
from output.ebb.holding import Hold, Holding
from output.ebb.low_lift import LowLift
from output.ebb.poll import Poll, Seen, supply_lost
from output.ebb.producer import Producer
from output.ebb.program import LayerMark, Mark, PauseMark, Program, StrokeEnd, StrokeMark, refused_in_a_stream
from output.ebb.progress import Progress, Recorder, Sent, State
from output.ebb.protocol import Event, Reply
from output.ebb.watch import Button, Sleep, StuckBoard
from output.errors import BadCommand, PositionLost

_PROGRESS_EVERY_S = 0.1
# So much board time is left when a hold is asked for, on the board or still to be sent.
_HOLD_TAKES_S = 0.4


class StopRequested(Exception):
    """The stop flag was set: leaves the loop by the same way as an error."""


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
        self._variables = abilities.variables
        self._on_progress: Callable[[Progress], None] | None = on_progress
        self._stop = stop
        self._journal = journal
        self._before_send = before_send or (lambda _command: [])
        self._speed = board_speed
        self.model = QueueModel(depth, counts=abilities.counts_queue, board_speed=board_speed)
        self.progress = Progress()
        self._producer = Producer(program, talk.port.wake)
        self._taken = 0
        self._in_flight: dict[int, Sent] = {}  # program commands by conversation number, until acknowledged
        self._unexecuted: deque[Sent] = deque()
        self._marks: deque[tuple[int, Mark]] = deque()  # (number of the queued command before it, mark)
        self._poll = Poll(talk, abilities, self.model, token)
        self._gates = Gates(abilities, self.model, self._poll, talk, board_speed)
        self._holding = Holding(hold, talk.port.wake)
        self._low_lift = LowLift()
        self._stuck_board = StuckBoard(board_speed)
        self._button = Button()
        self._sleep = Sleep()
        self._next_progress_at = 0.0
        self.held = self.left = False

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
                self._poll.ask_if_due(self.progress.commands_sent)
                for event in self._talk.receive(self._poll.due_in_s()):
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
        done = done and self.progress.state is State.RUNNING and not self._marks
        return done and self._poll.knows_board(self.progress.commands_sent)

    def wait_for_planner(self) -> None:
        """After `run`, and after what stops the board."""
        self._producer.wait()

    # sending

    def _feed(self) -> None:
        while self.progress.state is State.RUNNING and (item := self._producer.peek()) is not None:
            if self._stop.requested:
                return
            if self._holding.waits_at(self._taken):
                break
            if isinstance(item, Command):
                if self._gates.must_wait_for_stroke(self._producer):
                    if self._stop.pause_reason is not None:  # the pen being up, it may as well pause
                        self._set(state=State.HOLDING, message=self._stop.pause_reason)
                    return
                unacknowledged, sent = len(self._in_flight), self.progress.commands_sent
                if not self._gates.may_send(item, self._producer, unacknowledged=unacknowledged, sent=sent):
                    return
                self._send(item)
            else:
                may_pause = self._gates.pass_mark(item)
                self._marks.append((self.model.sent, item))
                if isinstance(item, PauseMark):
                    self._stop.pause_reason = item.message
                if may_pause and self._stop.pause_reason is not None:
                    self._set(state=State.HOLDING, message=self._stop.pause_reason)
            self._producer.take()
            self._taken += 1
        self._apply_marks()

    def _send(self, command: Command) -> None:
        wire = command.wire()
        if (refusal := refused_in_a_stream(command, self._variables)) is not None:
            raise BadCommand(refusal)
        for extra in self._before_send(command):
            self._talk.send(extra)
        if self._journal is not None:
            self._journal.sent(self.progress.commands_sent + 1)
        number = self._talk.send(wire)
        sent = Sent(0, self.progress.commands_sent, board_time_s(command), command)
        self._low_lift.note(command)
        if command.queued:
            self._enqueued(sent)
        self._gates.pass_command(command, sent.queued)
        self._in_flight[number] = sent
        self._set(commands_sent=self.progress.commands_sent + 1)

    def _enqueued(self, sent: Sent) -> None:
        sent.queued = self.model.on_sent(sent.command.fifo_entries, sent.seconds)
        self._unexecuted.append(sent)
        self._poll.not_later_than_by_lead()

    def _send_beside(self, command: Command) -> None:
        """A queued command that is none of the program's: the queue is told of it, the count of the program's is not."""
        sent = Sent(0, self.progress.commands_sent - 1, board_time_s(command), command)
        self._in_flight[self._talk.send(command.wire())] = sent
        self._enqueued(sent)

    # how far the board is

    def _polled(self, seen: Seen) -> None:
        if seen.pen_up is not None:
            self._set(pen_up=seen.pen_up)
        if seen.power_lost:
            raise supply_lost()
        if seen.button:
            self._button_pressed()
        if seen.steps is not None:
            self._set(steps=seen.steps)
        if seen.restarted:
            raise PositionLost(
                f"the board restarted during {self._where()}, so that its position is lost", "check its power supply"
            )
        now = self._talk.clock()
        self.model.on_polled(waiting=seen.waiting, fifo_empty=not seen.fifo, executing=seen.executing, now=now)
        self._count_executed()
        self._poll.by_lead()
        oldest = self._unexecuted[0] if self._unexecuted else None
        self._stuck_board.look(oldest, self.progress.steps, self._talk.waited_s)

    def _button_pressed(self) -> None:
        if self._button.stuck(self._talk.clock()):  # it must not make the plot go on by itself
            self._stop.pause("the button input is stuck: check its wiring, then go on")
        elif self.progress.state is State.PAUSED:
            self._stop.go()
        else:
            self._stop.pause("the board's button was pressed")

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
        if slept_s := self._sleep.since_last():
            self._stop.pause(f"the computer was asleep for {slept_s:.0f} s")
            self._poll.place_at_once()

    def _follow_pause(self) -> None:
        state = self.progress.state
        if state is State.RUNNING and self._stop.pause_reason is not None:
            self._hold_on_path()
            return
        self._holding.forget()
        if state is State.HOLDING and self.model.is_empty and not self._in_flight:
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
        """Turns to what `hold` says, when it is there. To reckon that takes a tenth of a second: where the queue is short it
        begins a little later, and what comes before it goes on being sent meanwhile."""
        if self.held or (rest := self._holding.rest(self._taken, self._ahead)) is None:
            return
        if self._journal is not None:
            self._journal.held([item.wire() for item in rest if isinstance(item, Command)])
        self.held = True
        self._producer.close()
        self._producer = Producer(rest, self._talk.port.wake)
        self._set(message=self._stop.pause_reason or "")

    def _ahead(self) -> int:
        lead_s = self.model.lead_s(self._talk.clock()) * self._speed
        return self._producer.ahead(_HOLD_TAKES_S - lead_s)

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
