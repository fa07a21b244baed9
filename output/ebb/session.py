"""The public door to a board: connect, ask, stream, stop.

    with connect("/dev/ttyACM0") as board:
        result = board.stream(program, on_progress=show, stop=flag)

A Board is owned by one thread; only the StopFlag given to `stream` may be touched from elsewhere.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType

from output.ebb.abilities import Abilities
from output.ebb.commands import SP, Command
from output.ebb.control import StopFlag, signals_stop
from output.ebb.conversation import REPLY_TIMEOUT_S, Clock, Conversation
from output.ebb.handshake import greet
from output.ebb.holding import Hold
from output.ebb.link import ChecksummedPort, Port, SerialPort
from output.ebb.nickname import wrong_nickname
from output.ebb.poll import EXECUTING_BIT, FIFO_BIT, LEAST_SUPPLY_COUNTS, POWER_LOST_BIT, supply_lost
from output.ebb.program import SUPPLY_SLOT, TOKEN_SLOT, Program
from output.ebb.progress import Progress, Recorder, State
from output.ebb.protocol import Syntax
from output.ebb.safe_stop import StopReport, safe_stop
from output.ebb.stream import StopRequested, Streamer
from output.errors import BadCommand, BoardRefused, LinkLost, PositionLost
from output.wording import counted

# CU,4 answers only when nothing moves any more: at once after a stop, later after another program's move.
_IDLE_TIMEOUT_S = 30.0
_ASK_EVERY_S = 0.02
# Longer than what a queue holds: a board whose program was killed goes on with that.
_STILL_TIMEOUT_S = 10.0
_LONGEST_QUEUE = 255
# The supply's divider and the 10-bit converter (the unit of CU,60).
_SUPPLY_V_PER_COUNT = 0.0295


def _token_question(slot: int | None) -> str:
    return "QL" if slot is None else f"QL,{slot}"


def _sleeping(on_progress: Callable[[Progress], None], stop: StopFlag) -> Callable[[Progress], None]:
    """`on_progress`, and in a pause the sleep that Ctrl-Z has asked for: the board stands, and this program owes it nothing."""

    def seen(progress: Progress) -> None:
        try:
            on_progress(progress)
        finally:
            if progress.state is State.PAUSED and stop.suspend_asked and not stop.leave_asked:
                stop.suspend()

    return seen


@dataclass(frozen=True, slots=True)
class StreamResult:
    """How a stream ended. `outcome` is "done" (everything executed), "held" (`hold` has brought the pen to rest on the path and
    up; the motors hold), "left" (a pause between strokes was left) or "stopped" (the stop flag). `reason` says who asked.

    `steps` are both motors' positions as the board counted them at the end, None when it could not be asked; after a stop in
    mid-move they are counted but physically suspect. `stop` is what became of the safe stop, None when the plot was done.
    """

    outcome: str
    reason: str
    progress: Progress
    steps: tuple[int, int] | None
    stop: StopReport | None = None
    signal_number: int | None = None


def connect(
    port: str | Port,
    *,
    clock: Clock = time.monotonic,
    clear: bool = True,
    board_speed: float = 1.0,
    checksums: bool = False,
    pen_pin: int | None = None,
) -> Board:
    """Opens the port for ourselves and finds an EiBotBoard there, whatever state it was left in.

    `clear` also stops what is still moving from before and raises the pen: a new connection starts empty. `board_speed` is a
    virtual board's time scale. `checksums` has the board check every command (firmware 3). `pen_pin` is the RB pin of the pen's
    servo (None: RB1), which a stop must raise; a program's own SP commands are heeded as well.
    Raises LinkLost for a port that is missing or goes away; BoardRefused for one that is denied, in use, or no EiBotBoard.
    """
    link: Port = SerialPort(port) if isinstance(port, str) else port
    try:
        talk = Conversation(link, clock)
        abilities = greet(talk)
        if checksums:
            if not abilities.checksums:
                raise BoardRefused(
                    f"firmware {abilities.name} knows no checksums, it needs 3.0.0: leave --checksums out, or update the board"
                )
            talk.ask("CU,54,1")
            talk.port = link = ChecksummedPort(link)
        board = Board(talk, abilities, board_speed, pen_pin)
        if clear:
            board.clear()
        return board
    except BaseException:
        link.close()
        raise


class Board:
    """A connected EiBotBoard. `firmware` is its version, as "3.0.3"."""

    def __init__(self, talk: Conversation, abilities: Abilities, board_speed: float = 1.0, pen_pin: int | None = None) -> None:
        self._talk = talk
        self.abilities = abilities
        self._board_speed = board_speed
        self._pen_down_wire: str | None = None
        self._pen_down_lost = False
        self._pen_pin = pen_pin
        self._depth: int | None = None
        self._job_token: int | None = None
        self._goes_on = False  # the next stream begins where the last one has left the pen
        self.last_stop: StopReport | None = None

    @property
    def firmware(self) -> str:
        return self.abilities.name

    @property
    def port_name(self) -> str:
        return self._talk.port.name

    def __enter__(self) -> Board:
        return self

    def __exit__(self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Gives the port back. The board keeps what it has queued; after a stream or a stop that is nothing."""
        self._talk.port.close()

    # single commands

    def query(self, question: str | Command, timeout_s: float = REPLY_TIMEOUT_S) -> str:
        """Asks one thing and returns the reply's data, without the command's name: `query("QC")` -> "0394,0300".

        Raises BoardRefused when the board answers with an error, LinkLost when it does not answer.
        """
        return self._talk.ask(question if isinstance(question, str) else question.wire(), timeout_s)

    def send(self, command: Command, timeout_s: float = REPLY_TIMEOUT_S) -> None:
        """One command by itself, acknowledged. For motion use `stream`, which watches the queue."""
        for extra in self._before_send(command):
            self._talk.ask(extra)
        self._talk.ask(command.wire(), timeout_s)

    def steps(self) -> tuple[int, int]:
        """Both motors' positions as the board counts them now: executed motion only."""
        one, two = self.query("QS").split(",")
        return int(one), int(two)

    def wait_until_still(self, timeout_s: float = _STILL_TIMEOUT_S) -> None:
        """Returns when nothing executes or waits any more. Raises BoardRefused after `timeout_s`."""
        end_s = self._talk.waited_s + timeout_s
        while self.is_moving():
            if self._talk.waited_s >= end_s:
                raise BoardRefused(f"the board is still busy after {timeout_s:g} s: stop it with `plotter disable`")
            self._talk.receive(_ASK_EVERY_S)

    def is_moving(self) -> bool:
        """Whether anything executes or waits on the board."""
        if self.abilities.status_query == "QG":
            return bool(self._status() & (FIFO_BIT | EXECUTING_BIT))
        return "1" in self.query("QM").split(",")

    def clear(self) -> None:
        """Ends what moves and raises the pen to the height that is set, without taking the pen-down height away."""
        self._talk.ask("ES")
        self._talk.ask(self._raising(2))

    def queue_depth(self) -> int:
        """How many commands wait on the board: all it can hold on firmware 3 (set here, once), 1 before."""
        if self._depth is None:
            self._depth = 1
            if self.abilities.deep_queue:
                longest = self._queue_length("QU,2", _LONGEST_QUEUE)
                self._talk.ask(f"CU,4,{longest}", _IDLE_TIMEOUT_S if self.is_moving() else REPLY_TIMEOUT_S)
                self._depth = self._queue_length("QU,3", longest)
        return self._depth

    def _queue_length(self, question: str, most: int) -> int:
        """A length that may be set and counted by: with CU,4,0 the board would take no motion any more."""
        length = int(self.query(question).split(",")[-1])
        if not 1 <= length <= most:
            raise LinkLost(
                f"{self.port_name}: {length} is no length of the motion queue (1 to {most}), so that the board's answers are "
                "damaged on their way: check the USB cable"
            )
        return length

    # the job token: is this still the board, and the power session, that the plot was begun with?

    def begin_job(self, token: int | None = None) -> int:
        """Writes a job's token into the board's RAM, where only a restart clears it; returns it.

        32 bits on firmware 3, the lowest 8 of them before. No byte of it is 0, which is what a restarted board holds. From here
        on the board's counters are taken for the pen's place: what the motors' supply did before does not matter.
        """
        self._job_token = token or int.from_bytes(bytes(secrets.randbelow(255) + 1 for _ in range(4)), "little")
        if self.abilities.power_flag:
            self._talk.ask(f"SL,0,{SUPPLY_SLOT}")
        for slot, byte in self._token_slots(self._job_token):
            self._talk.ask(f"SL,{byte}" if slot is None else f"SL,{byte},{slot}")
        return self._job_token

    def has_token(self, token: int) -> bool:
        """Whether the board has been under power, and not given to another job, since `begin_job` wrote this token."""
        return all(int(self.query(_token_question(slot))) == byte for slot, byte in self._token_slots(token))

    def motors_off(self) -> bool:
        """Whether the board says that both motors are off. Firmware before 2.8.0 cannot say: False."""
        return self.abilities.version >= (2, 8, 0) and self.query("QE") == "0,0"

    def _token_slots(self, token: int) -> list[tuple[int | None, int]]:
        if self.abilities.variables == 1:
            return [(None, token & 0xFF)]
        return [(TOKEN_SLOT + i, byte) for i, byte in enumerate(token.to_bytes(4, "little"))]

    # the nickname

    def nickname(self) -> str | None:
        """What the board is called; "" when it has no name, None when its firmware has none."""
        return self.query("QT") if self.abilities.nickname else None

    def set_nickname(self, name: str) -> None:
        """Writes the name into the board's flash memory, which wears: never do this unasked. It shows after replugging.

        Raises BadCommand for a name that a board cannot keep, BoardRefused when it did not keep it.
        """
        if not self.abilities.nickname:
            raise BadCommand(f"firmware {self.firmware} has no nicknames: it needs 2.5.5 or later")
        if (wrong := wrong_nickname(name)) is not None:
            raise BadCommand(wrong)
        self._talk.ask(f"ST,{name}")
        if self.nickname() != name:
            raise BoardRefused(f"the board calls itself {self.nickname()!r} after being named {name!r}: try again")

    # motor power

    def supply_v(self) -> float:
        """The voltage at the motors' power input, to within half a volt."""
        return int(self.query("QC").split(",")[1]) * _SUPPLY_V_PER_COUNT

    def watch_supply(self) -> None:
        """Refuses to start without motor power, and has the board take note of any dip from here on (firmware 3).

        USB alone keeps the logic alive: moves would be acknowledged, counted, and not made.
        """
        if self._goes_on and self.supply_failed():
            raise supply_lost()
        counts = int(self.query("QC").split(",")[1])
        if counts < LEAST_SUPPLY_COUNTS:
            raise BoardRefused(
                f"the motors have no power ({counts * _SUPPLY_V_PER_COUNT:.1f} V, at least "
                f"{LEAST_SUPPLY_COUNTS * _SUPPLY_V_PER_COUNT:.1f} V is needed): plug in and switch on the power supply"
            )
        if self.abilities.power_flag:
            self._talk.ask(f"CU,60,{max(LEAST_SUPPLY_COUNTS, counts * 6 // 10)}")
            self.query("QG")  # clears the flag that the new threshold may have set
            self._talk.status_bits &= ~POWER_LOST_BIT

    def supply_failed(self) -> bool:
        """Whether the motors' supply has dipped since `begin_job`, as far as `watch_supply` had it watched (firmware 3)."""
        if not self.abilities.power_flag:
            return False
        self._status()
        return int(self.query(_token_question(SUPPLY_SLOT))) != 0

    def _status(self) -> int:
        """QG's byte."""
        bits = int(self.query("QG"), 16)
        self._note_supply()
        return bits

    def _note_supply(self) -> None:
        """Has the board remember that its flag of lost power was up: read, it is down, and the next program must know of it."""
        if self.abilities.power_flag and self._talk.status_bits & POWER_LOST_BIT:
            self._talk.ask(f"SL,1,{SUPPLY_SLOT}")
            self._talk.status_bits &= ~POWER_LOST_BIT

    # whole programs

    def stream(
        self,
        program: Program,
        *,
        on_progress: Callable[[Progress], None],
        stop: StopFlag,
        journal: Recorder | None = None,
        hold: Hold | None = None,
        free_motors: bool = True,
        drawn_before: int = 0,
    ) -> StreamResult:
        """Sends `program` and returns when the board has executed it, or when `stop` ended it.

        On every other way out than "done" the motion is stopped and the pen raised first; a stop by the operator also lets go
        of the motors unless `free_motors` is False. In the main thread, SIGINT, SIGTERM and SIGHUP set `stop` meanwhile; with
        `hold` the first SIGINT only pauses, and SIGTSTP puts this program to sleep in a pause. `drawn_before` strokes were
        drawn by earlier programs of the same plot: an error counts them.
        Raises what the program raised, BoardRefused, BadCommand or LinkLost, with the safe stop's report in `last_stop`.
        """
        with signals_stop(stop, pauses=hold is not None), stop.waking(self._talk.port.wake):
            streamer: Streamer | None = None
            try:
                if stop.requested:
                    raise StopRequested
                depth = self.queue_depth()
                self.watch_supply()
                token = self._token_slots(self.begin_job() if self._job_token is None else self._job_token)[0]
                streamer = Streamer(
                    self._talk,
                    self.abilities,
                    depth,
                    program,
                    on_progress=_sleeping(on_progress, stop),
                    stop=stop,
                    journal=journal,
                    hold=hold,
                    before_send=self._before_send,
                    token=(_token_question(token[0]), token[1]),
                    board_speed=self._board_speed,
                )
                progress = streamer.run()
                outcome = "left" if streamer.left else "held" if streamer.held else "done"
                self._goes_on = self._goes_on or outcome != "done"
                return StreamResult(outcome, progress.message, progress, self.steps())
            except StopRequested:
                self._goes_on = False
                report = self.safe_stop(free_motors=free_motors)
                progress = streamer.progress if streamer is not None else Progress()
                steps = self.steps() if report.pen_up else None
                return StreamResult("stopped", stop.reason or "", progress, steps, report, stop.signal_number)
            except BaseException as error:
                self._goes_on = False
                report = self.safe_stop()
                with suppress(LinkLost, BoardRefused):
                    self._note_supply()
                progress = streamer.progress if streamer is not None else Progress()
                if isinstance(error, LinkLost):
                    raise self._told_better(error, report, progress, drawn_before) from error
                raise
            finally:
                self._job_token = None
                if streamer is not None:
                    streamer.wait_for_planner()

    def _told_better(
        self, error: LinkLost, report: StopReport, progress: Progress, drawn_before: int
    ) -> BoardRefused | LinkLost:
        """What a lost reply or link really was, once the safe stop has looked."""
        strokes = drawn_before + progress.strokes_done
        done = f"{counted(strokes, 'stroke')} {'was' if strokes == 1 else 'were'} drawn for certain"
        if not report.pen_up and progress.state is State.PAUSED and progress.pen_up:
            return LinkLost(f"{error}; {done}; the plot was paused with the pen up")
        if not report.pen_up:
            return LinkLost(f"{error}; {done}; the pen could not be raised and may be down: lift it by hand")
        if self.abilities.future_syntax and self._talk.syntax is Syntax.LEGACY:
            self._depth = None
            return PositionLost(
                f"the board restarted during the plot ({done}), so that its position is lost", "check its power supply"
            )
        return LinkLost(f"{error}; {done}; the pen is up")

    def safe_stop(self, *, free_motors: bool = False) -> StopReport:
        """Stops all motion and raises the pen, from any state; the report says what could be done. Never raises for the link.

        The pen-down height is gone afterwards on firmware 3.0.1 and later; it is sent again before the next pen-down.
        """
        self._pen_down_lost = self.abilities.pen_now
        self.last_stop = safe_stop(self._talk, self.abilities, self._raising(3), free_motors=free_motors)
        return self.last_stop

    def _raising(self, value: int) -> str:
        """SP,2 or SP,3, or SP,1 where the firmware has neither, on the pen's own pin."""
        return SP(value if self.abilities.pen_now else 1, None if self._pen_pin is None else 0, self._pen_pin).wire()

    def _before_send(self, command: Command) -> list[str]:
        """What a command needs said before it: the pen-down height, when a safe stop has taken it away."""
        wire = command.wire()
        if isinstance(command, SP):
            self._pen_pin = command.pin
        if wire.startswith("SC,5,"):
            self._pen_down_wire, self._pen_down_lost = wire, False
        elif self._pen_down_lost and (wire == "SP,0" or wire.startswith(("TP", "SP,0,"))):
            if self._pen_down_wire is None:
                raise BadCommand(f"{wire} would not lower the pen: a stop has cleared the pen-down height, so send SC,5 first")
            self._pen_down_lost = False
            return [self._pen_down_wire]
        return []
