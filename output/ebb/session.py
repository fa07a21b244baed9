"""The public door to a board: connect, ask, stream, stop.

    with connect("/dev/ttyACM0") as board:
        result = board.stream(program, on_progress=show, stop=flag)

A Board is owned by one thread; only the StopFlag given to `stream` may be touched from elsewhere.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

from output.ebb.abilities import Abilities
from output.ebb.commands import Command
from output.ebb.control import StopFlag, signals_stop
from output.ebb.conversation import REPLY_TIMEOUT_S, Clock, Conversation
from output.ebb.handshake import greet
from output.ebb.link import Port, SerialPort
from output.ebb.program import Program
from output.ebb.safe_stop import StopReport, safe_stop
from output.ebb.stream import Hold, Progress, Recorder, StopRequested, Streamer
from output.errors import BadCommand

# CU,4 answers only when nothing moves any more: at once after a stop, later after another program's move.
_IDLE_TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True)
class StreamResult:
    """How a stream ended. `outcome` is "done" (everything executed) or "stopped" (the stop flag; `reason` says by whom).

    `steps` are both motors' positions as the board counted them at the end, None when it could not be asked; after a stop in
    mid-move they are counted but physically suspect. `stop` is what became of the safe stop, None when the plot was done.
    """

    outcome: str
    reason: str
    progress: Progress
    steps: tuple[int, int] | None
    stop: StopReport | None = None
    signal_number: int | None = None


def connect(port: str | Port, *, clock: Clock = time.monotonic, clear: bool = True, board_speed: float = 1.0) -> Board:
    """Opens the port for ourselves and finds an EiBotBoard there, whatever state it was left in.

    `clear` also stops what is still moving from before and raises the pen: a new connection starts empty. `board_speed` is a
    virtual board's time scale.
    Raises LinkLost for a port that is missing or goes away; BoardRefused for one that is denied, in use, or no EiBotBoard.
    """
    link = SerialPort(port) if isinstance(port, str) else port
    try:
        talk = Conversation(link, clock)
        abilities = greet(talk)
        board = Board(talk, abilities, board_speed)
        if clear:
            board.clear()
        return board
    except BaseException:
        link.close()
        raise


class Board:
    """A connected EiBotBoard. `firmware` is its version, as "3.0.3"."""

    def __init__(self, talk: Conversation, abilities: Abilities, board_speed: float = 1.0) -> None:
        self._talk = talk
        self.abilities = abilities
        self._board_speed = board_speed
        self._pen_down_wire: str | None = None
        self._pen_down_lost = False
        self._depth: int | None = None
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

    def clear(self) -> None:
        """Ends what moves and raises the pen to the height that is set, without taking the pen-down height away."""
        self._talk.ask("ES")
        self._talk.ask("SP,2" if self.abilities.pen_now else "SP,1")

    def queue_depth(self) -> int:
        """How many commands wait on the board: all it can hold on firmware 3 (set here, once), 1 before."""
        if self._depth is None:
            self._depth = 1
            if self.abilities.deep_queue:
                longest = int(self.query("QU,2").split(",")[-1])
                moving = int(self.query("QG"), 16) & 0x0F
                self._talk.ask(f"CU,4,{longest}", _IDLE_TIMEOUT_S if moving else REPLY_TIMEOUT_S)
                self._depth = int(self.query("QU,3").split(",")[-1])
        return self._depth

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
    ) -> StreamResult:
        """Sends `program` and returns when the board has executed it, or when `stop` ended it.

        On every other way out than "done" the motion is stopped and the pen raised first; a stop by the operator also lets go
        of the motors unless `free_motors` is False. In the main thread, SIGINT, SIGTERM and SIGHUP set `stop` meanwhile.
        Raises what the program raised, BoardRefused, BadCommand or LinkLost, with the safe stop's report in `last_stop`.
        """
        with signals_stop(stop), stop.waking(self._talk.port.wake):
            streamer: Streamer | None = None
            try:
                streamer = Streamer(
                    self._talk,
                    self.abilities,
                    self.queue_depth(),
                    program,
                    on_progress=on_progress,
                    stop=stop,
                    journal=journal,
                    hold=hold,
                    before_send=self._before_send,
                    board_speed=self._board_speed,
                )
                progress = streamer.run()
                return StreamResult("done", "", progress, self.steps())
            except StopRequested:
                report = self.safe_stop(free_motors=free_motors)
                progress = streamer.progress if streamer is not None else Progress()
                steps = self.steps() if report.pen_up else None
                return StreamResult("stopped", stop.reason or "", progress, steps, report, stop.signal_number)
            except BaseException:
                self.safe_stop()
                raise

    def safe_stop(self, *, free_motors: bool = False) -> StopReport:
        """Stops all motion and raises the pen, from any state; the report says what could be done. Never raises for the link.

        The pen-down height is gone afterwards on firmware 3.0.1 and later; it is sent again before the next pen-down.
        """
        self._pen_down_lost = self.abilities.pen_now
        self.last_stop = safe_stop(self._talk, self.abilities, free_motors=free_motors)
        return self.last_stop

    def _before_send(self, command: Command) -> list[str]:
        """What a command needs said before it: the pen-down height, when a safe stop has taken it away."""
        wire = command.wire()
        if wire.startswith("SC,5,"):
            self._pen_down_wire, self._pen_down_lost = wire, False
        elif self._pen_down_lost and (wire == "SP,0" or wire.startswith(("TP", "SP,0,"))):
            if self._pen_down_wire is None:
                raise BadCommand(f"{wire} would not lower the pen: a stop has cleared the pen-down height, so send SC,5 first")
            self._pen_down_lost = False
            return [self._pen_down_wire]
        return []
