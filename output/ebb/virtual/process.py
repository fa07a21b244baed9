"""A virtual board in a process of its own, for the program, its tests and other programs.

with start_virtual_board(speed=20) as board:
    plot_to(board.port)
    record = board.record()
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from output.errors import BadCommand, LinkLost

Record = dict[str, Any]

START_DEADLINE_S = 20.0
STOP_DEADLINE_S = 60.0


class VirtualBoard:
    """A running virtual board. `port` is the path to open; see docs/virtual-board.md for the record and the controls."""

    def __init__(self, process: subprocess.Popen[bytes], record_path: Path) -> None:
        self._process = process
        self._record_path = record_path
        self._selector = selectors.DefaultSelector()
        assert process.stdout is not None
        self._selector.register(process.stdout, selectors.EVENT_READ)
        self._text = b""
        self._kept: bytes | None = None
        started = self._answer(START_DEADLINE_S)
        if "error" in started:
            raise BadCommand(str(started["error"]))
        self.port: str = str(started["port"])

    @property
    def pid(self) -> int:
        """The board's process, to be stopped and continued by tests."""
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def control(self, command: str) -> dict[str, Any]:
        """Do something to the board from outside, and get its state: position, pen, queue, tick.

        `state` · `button` · `power on|off` · `wire PORT PIN 0|1` · `reboot` · `hangup [SECONDS [PTY]]` · `return` ·
        `fault JSON` · `stop`. Raises BadCommand for one it does not know, LinkLost when the process is gone.
        """
        stdin = self._process.stdin
        assert stdin is not None
        try:
            stdin.write(command.encode() + b"\n")
            stdin.flush()
        except (BrokenPipeError, ValueError) as problem:
            raise LinkLost(f"the virtual board is not running any more, so {command!r} cannot reach it") from problem
        answer = self._answer(STOP_DEADLINE_S)
        if "error" in answer:
            raise BadCommand(str(answer["error"]))
        return answer

    def state(self) -> dict[str, Any]:
        """The board's state just now."""
        return self.control("state")

    def record(self) -> Record:
        """What the board has done so far, or did until it stopped."""
        if self.running:
            self.control(f"record {self._record_path}")
            self._kept = None
        if self._kept is None:
            if not self._record_path.exists():
                raise LinkLost(f"the virtual board left no record at {self._record_path}; was it killed?")
            self._kept = self._record_path.read_bytes()
        loaded: Record = json.loads(self._kept)
        return loaded

    def stop(self) -> None:
        """End the process; its record stays readable through `record`."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            # A broken pipe says that it is gone already, which is what was wanted.
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.close()
        try:
            self._process.wait(STOP_DEADLINE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._record_path.exists():
            self._kept = self._record_path.read_bytes()

    def _answer(self, deadline_s: float) -> dict[str, Any]:
        stdout = self._process.stdout
        assert stdout is not None
        while b"\n" not in self._text:
            if not self._selector.select(deadline_s):
                raise LinkLost(f"the virtual board did not answer within {deadline_s:g} s; stop it and start another one")
            data = stdout.read1(65536)  # type: ignore[attr-defined]
            if not data:
                code = self._process.wait()
                raise LinkLost(f"the virtual board ended with exit code {code}; its message is on stderr")
            self._text += data
        line, self._text = self._text.split(b"\n", 1)
        answer: dict[str, Any] = json.loads(line)
        return answer


def need_pseudo_terminals() -> None:
    """Raises BadCommand on a system without them."""
    if os.name != "posix":
        raise BadCommand(
            "the virtual board needs pseudo-terminals, which this system has not: use Linux or macOS, or a real board"
        )


@contextmanager
def start_virtual_board(
    *,
    firmware: str = "3.0.3",
    speed: float = 1.0,
    record: Path | None = None,
    faults: Sequence[dict[str, Any]] | None = None,
    pty: Path | None = None,
    nickname: str = "",
    pen_down: bool = False,
    keep_wire: bool = True,
    patience_s: float = 0.0,
    version_line: str | None = None,
) -> Iterator[VirtualBoard]:
    """A virtual board in its own process, ready when the context is entered and gone when it is left.

    `speed` is board time over real time; `record` is where its record is kept (None: only `VirtualBoard.record` has it);
    `faults` a script as in `output.ebb.virtual.faults`; `pty` a symbolic link to make for the port; `pen_down` starts with the
    pen on the paper; `version_line` is what V answers instead of its own line. `patience_s` is how long, in real time, a board
    that is about to run dry waits for the host, for fast runs whose underruns are to be the stream's own.
    Raises BadCommand for what the board cannot be and on a system without pseudo-terminals, LinkLost when the process does not
    start.
    """
    need_pseudo_terminals()
    with tempfile.TemporaryDirectory(prefix="virtual-board-") as scratch:
        record_path = Path(scratch) / "record.json" if record is None else record
        command = [sys.executable, "-m", "output.ebb.virtual", "--control", "--firmware", firmware, "--speed", str(speed)]
        command += ["--record", str(record_path)]
        if pty is not None:
            command += ["--pty", str(pty)]
        if faults:
            script = Path(scratch) / "faults.json"
            script.write_text(json.dumps(list(faults)))
            command += ["--faults", str(script)]
        if nickname:
            command += ["--nickname", nickname]
        if pen_down:
            command.append("--pen-down")
        if version_line is not None:
            command += ["--version-line", version_line]
        if patience_s:
            command += ["--patience", str(patience_s)]
        if not keep_wire:
            command.append("--no-wire")
        # Its own session: a Ctrl-C for the program under test is not one for the board.
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        board: VirtualBoard | None = None
        try:
            board = VirtualBoard(process, record_path)
            yield board
        finally:
            if board is not None:
                board.stop()
            elif process.poll() is None:
                process.kill()
                process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None and not stream.closed:
                    stream.close()
