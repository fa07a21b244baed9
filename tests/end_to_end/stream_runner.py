"""A plot by itself, as a process: what the signal and crash tests start, interrupt and kill.

    python -m tests.end_to_end.stream_runner PORT SPEED JOURNAL [resume]

Prints "streaming" when the first command is executed, and the outcome as JSON at the end. Exit codes as the program's own.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

from output.ebb.commands import EM, SC, SM, SP, Command
from output.ebb.control import StopFlag, ignore_signals, signals_stop
from output.ebb.journal import Journal
from output.ebb.program import Mark, StrokeEnd, StrokeMark
from output.ebb.progress import Progress
from output.ebb.session import connect
from output.errors import BoardRefused, LinkLost

STROKES, MOVES, MS = 6, 10, 30


def program() -> Iterator[Command | Mark]:
    """Six strokes of ten moves each, about three seconds of board time."""
    yield from (SC(4, 20000), SC(5, 14000), SC(11, 60000), SC(12, 60000), EM(1, 1), SP(1, 60))
    x = y = 0
    for k in range(STROKES):
        yield from (SM(40, 90, 30), StrokeMark(k), SP(0, 60))
        x, y = x + 90, y + 30
        for i in range(MOVES):
            dx, dy = 60 + 7 * i, (-1) ** i * (40 + 11 * k)
            yield SM(MS, dx, dy)
            x, y = x + dx, y + dy
        yield from (StrokeEnd(k, (x, y)), SP(1, 60))


def main() -> int:
    port, speed, journal_path = sys.argv[1], float(sys.argv[2]), Path(sys.argv[3])
    said = []

    def show(progress: Progress) -> None:
        if progress.commands_executed and not said:
            said.append(True)
            print("streaming", flush=True)

    stop = StopFlag()
    try:
        with (
            signals_stop(stop),
            connect(port, board_speed=speed) as board,
            Journal.begin(journal_path, {"drawing": "test"}) as journal,
        ):
            token = board.begin_job()
            journal.part({"token": token})
            result = board.stream(program(), on_progress=show, stop=stop, journal=journal)
            journal.end(result.outcome, result.steps)
            ignore_signals()
    except BoardRefused as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 3
    except LinkLost as error:
        print(json.dumps({"error": str(error)}), flush=True)
        return 4
    safe = None if result.stop is None else {"pen_up": result.stop.pen_up, "took_s": result.stop.took_s}
    print(json.dumps({"outcome": result.outcome, "reason": result.reason, "stop": safe, "steps": result.steps}), flush=True)
    return 0 if result.outcome == "done" else 130


if __name__ == "__main__":
    sys.exit(main())
