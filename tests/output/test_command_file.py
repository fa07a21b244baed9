"""The command file: what is written is read, what is not a command is named with its line."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from output.ebb.command_file import read_command_file, write_command_file
from output.ebb.commands import EM, SM, SP, T3, Command
from output.ebb.program import LayerMark, Mark, PauseMark, Slowed, StrokeEnd, StrokeMark
from output.errors import BadCommand

PROGRAM: list[Command | Mark] = [
    EM(1, 1), LayerMark(1, "out lines: 1"), StrokeMark(0), SP(0, 120), T3(250, 1, -2, 3, 4, 5, -6), StrokeEnd(0, (800, -40)),
    Slowed(0.125, 1.5), PauseMark("change to red"), PauseMark(""), LayerMark(2, ""), SM(10, 0, 0), SP(1),
]  # fmt: skip


def test_what_is_written_is_read_with_its_line_numbers(tmp_path: Path) -> None:
    path = tmp_path / "x.ebb"
    header = {"machine": "axidraw-v3", "firmware": "3.0.3", "setting speed": "100 mm/s", "duration_s": 12.5}
    assert write_command_file(path, header, PROGRAM) == 5
    text = path.read_bytes()
    assert b"\r" not in text and text.endswith(b"SP,1\n")
    found, lines = read_command_file(path)
    read = list(lines)
    assert found == {key: str(value) for key, value in header.items()}
    assert [line.item for line in read] == PROGRAM
    shown = text.decode().splitlines()
    assert all(line.item.wire() == shown[line.number - 1] for line in read if isinstance(line.item, Command))


def test_the_same_program_gives_the_same_bytes() -> None:
    files = [io.StringIO(), io.StringIO()]
    for file in files:
        write_command_file(file, {"b": 1, "a": 2}, PROGRAM)
    assert files[0].getvalue() == files[1].getvalue()


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r", "\n\n"])
def test_a_file_of_another_program_is_read(ending: str, tmp_path: Path) -> None:
    path = tmp_path / "other.txt"
    path.write_bytes(ending.join(["SC,4,16000", "# from somewhere", "sp,1,100", "", "SM,10,5,-5"]).encode())
    header, lines = read_command_file(path)
    assert header == {} and [line.item.wire() for line in lines] == ["SC,4,16000", "SP,1,100", "SM,10,5,-5"]  # type: ignore[union-attr]


def test_an_error_names_its_line_value_and_bound() -> None:
    _, lines = read_command_file(io.StringIO("SM,10,5,5\nSM,10,251,0\n"))
    with pytest.raises(BadCommand, match=r"line 2: SM: axis 1 is 251 steps in 10 ms, allowed is 25 steps per ms"):
        list(lines)
    problems: list[str] = []
    _, lines = read_command_file(io.StringIO("SM,1,51,0\n"), problems)
    assert [line.item.wire() for line in lines] == ["SM,1,51,0"] and "25 steps per ms" in problems[0]  # type: ignore[union-attr]
    problems = []
    _, lines = read_command_file(io.StringIO("hello\nSM,10,5,5\nT3,1\nSP,9\n"), problems)
    assert len(list(lines)) == 1 and [text.split(":")[0] for text in problems] == ["line 1", "line 3", "line 4"]


@pytest.mark.parametrize("junk", [b"\x89PNG\r\n\x1a\n\x00\x00", b"\xff\xfe\x00S", b"A" * 10000, b"SM,1,1,1\n\xe9\n"])
def test_what_is_no_text_is_refused(junk: bytes, tmp_path: Path) -> None:
    path = tmp_path / "junk"
    path.write_bytes(junk)
    with pytest.raises(BadCommand):
        list(read_command_file(path)[1])


def test_a_byte_order_mark_and_a_missing_file(tmp_path: Path) -> None:
    path = tmp_path / "bom"
    path.write_bytes(b"\xef\xbb\xbfEM,1,1\n")
    assert [line.item for line in read_command_file(path)[1]] == [EM(1, 1)]
    with pytest.raises(OSError):
        read_command_file(tmp_path / "none")


@pytest.mark.parametrize("line", [1, 4, 3000])
def test_the_line_that_is_no_text_is_named(line: int, tmp_path: Path) -> None:
    """Files are read many lines at a time; what comes before it is read."""
    file = tmp_path / "bad.ebb"
    file.write_bytes(b"SM,10,5,5\r\n" * (line - 1) + b"SM,10,\xff,5\r\nSM,10,5,5\r\n")
    seen: list[int] = []
    with pytest.raises(BadCommand, match=rf"^line {line} is not text"):
        seen.extend(item.number for item in read_command_file(file)[1])
    assert seen == list(range(1, line))
