"""With checksums on, a command that was damaged on its way is refused by the board, and nothing of it is done."""

from __future__ import annotations

import pytest

from output.ebb.commands import SM
from output.ebb.control import StopFlag
from output.ebb.session import connect
from output.errors import BoardRefused
from tests.output.board_in_memory import MemoryBoard
from tests.output.inline_producer import inline_producer  # noqa: F401 - a fixture
from tests.output.test_stream_loops import check_at_rest, check_plan_is_inked, plot

pytestmark = pytest.mark.usefixtures("inline_producer")


class NoisyBoard(MemoryBoard):
    """Turns the steps of one move into others, as noise on a cable would."""

    noise = b""

    def send(self, data: bytes) -> None:
        super().send(data.replace(self.noise, self.noise[:-1] + b"9") if self.noise else data)


def test_a_whole_plot_with_checksums_and_the_board_left_without() -> None:
    memory = MemoryBoard()
    board = connect(memory, clock=memory.clock, checksums=True)
    assert memory.board.checksums
    assert board.stream(list(plot()), on_progress=lambda _: None, stop=StopFlag()).outcome == "done"
    check_plan_is_inked(memory.record()["ink"], list(plot()))
    board.close()
    memory.host_stalls(0.1)
    assert not memory.board.checksums


@pytest.mark.parametrize("checksums", [False, True])
def test_a_damaged_command(checksums: bool) -> None:
    memory = NoisyBoard()
    board = connect(memory, clock=memory.clock, checksums=checksums)
    memory.noise = b"SM,35,67,-4"
    items = list(plot())
    assert SM(35, 67, -40) in items
    if checksums:
        with pytest.raises(BoardRefused, match="hecksum"):
            board.stream(items, on_progress=lambda _: None, stop=StopFlag())
        check_at_rest(memory)
    else:
        assert board.stream(items, on_progress=lambda _: None, stop=StopFlag()).outcome == "done"
        with pytest.raises(AssertionError):
            check_plan_is_inked(memory.record()["ink"], items)


def test_a_board_left_with_checksums_on_is_still_greeted() -> None:
    memory = MemoryBoard()
    connect(memory, clock=memory.clock, checksums=True)
    memory.replugged()
    assert connect(memory, clock=memory.clock).query("QP") == "1"


def test_firmware_without_checksums_says_so() -> None:
    memory = MemoryBoard("2.8.1")
    with pytest.raises(BoardRefused, match=r"it needs 3\.0\.0"):
        connect(memory, clock=memory.clock, checksums=True)
