"""Stop latency at random instants, and underruns when the host stalls, on the virtual board in memory (its own clock)."""

from __future__ import annotations

from statistics import median
from unittest.mock import patch

from output.ebb.control import StopFlag
from output.ebb.session import connect
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import InlineProducer
from tests.output.test_stream_loops import FAULTS, length_of, plot, stop_latencies

STALLS = 5


def run() -> None:
    with patch("output.ebb.stream.Producer", InlineProducer):
        for firmware in ("3.0.3", "2.8.1"):
            took_ms = [1000 * took_s for took_s in stop_latencies(100, firmware, 7)]
            print(f"stop, firmware {firmware}: median {median(took_ms):.1f} ms, worst of 100 {max(took_ms):.1f} ms")
        print(f"a plot of {length_of('3.0.3')} commands is run once for each of them and of {len(FAULTS)} faults\n")
        print("| host stalls | times | underruns, queue 32 | counted | dry s | underruns, queue 1 | counted | dry s |")
        print("|---|---|---|---|---|---|---|---|")
        for stall_s in (0.05, 0.2, 0.8):
            deep, shallow = (underruns(stall_s, firmware) for firmware in ("3.0.3", "2.8.1"))
            print(f"| {1000 * stall_s:.0f} ms | {STALLS} | {deep} | {shallow} |", flush=True)


def underruns(stall_s: float, firmware: str) -> str:
    """Underruns as the board saw them, as the stream counted them, and for how long the board was dry."""
    memory = MemoryBoard(firmware)
    stalls, next_at = [0], [memory.clock() + 1.5]

    def stall(m: MemoryBoard) -> None:
        if m.clock() >= next_at[0] and stalls[0] < STALLS:
            stalls[0] += 1
            m.host_stalls(stall_s)
            next_at[0] = m.clock() + 1.6

    memory.on_receive = stall
    board = connect(memory, clock=memory.clock)
    result = board.stream(list(plot(strokes=4, moves=60)), on_progress=lambda _: None, stop=StopFlag())
    record = memory.record()
    return f"{record['underruns']} | {result.progress.stalls} | {record['underrun_ticks'] / 25_000:.2f}"
