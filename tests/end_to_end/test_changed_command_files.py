"""Command files that were cut short or changed by hand: verify and send refuse them, and say why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from output.ebb.commands import SL
from output.ebb.control import StopFlag
from output.ebb.program import refused_in_a_stream
from output.ebb.session import connect
from output.errors import BadCommand
from plotter.cli.main import run
from tests.output.board_in_memory import MemoryBoard

DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" width="60mm"
 height="40mm" viewBox="0 0 60 40" stroke="black" fill="none"><g inkscape:groupmode="layer" inkscape:label="1 a"><path
 d="M5 5h20v20"/></g><g inkscape:groupmode="layer" inkscape:label="!2 b"><path d="M30 5l10 20 10 -20"/></g></svg>"""

Change = Callable[[list[str]], list[str]]


@pytest.fixture
def exported(tmp_path: Path) -> list[str]:
    (tmp_path / "drawing.svg").write_text(DRAWING)
    assert run(["export", str(tmp_path / "drawing.svg"), "-o", str(tmp_path / "drawing.ebb")]) == 0
    return (tmp_path / "drawing.ebb").read_text().splitlines()


def in_a_stroke(lines: list[str]) -> int:
    return next(i for i, line in enumerate(lines) if line.startswith("SP,0")) + 6


def with_line(text: str) -> Change:
    return lambda lines: [*lines[: in_a_stroke(lines)], text, *lines[in_a_stroke(lines) :]]


def recounted(lines: list[str]) -> list[str]:
    """With a head that is true again, so that only the change itself is left to find."""
    count = sum(not line.startswith("#") for line in lines)
    return [f"# commands: {count}" if line.startswith("# commands:") else line for line in lines]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda lines: lines[: in_a_stroke(lines)], "its head says"),
        (lambda lines: recounted(lines[: in_a_stroke(lines)]), "still down at the end"),
        (lambda lines: recounted([line for i, line in enumerate(lines) if i != in_a_stroke(lines)]), "stroke 0 ends at"),
        (lambda lines: recounted(with_line("EM,0,0")(lines)), "lets go of the motors while the pen is down"),
        (lambda lines: recounted(with_line("RB")(lines)), "RB cannot be part of a stream"),
        (lambda lines: recounted(with_line("BL")(lines)), "BL cannot be part of a stream"),
    ],
)
def test_verify_and_send_refuse_what_was_changed(
    change: Change, reason: str, exported: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "changed.ebb"
    file.write_text("\n".join(change(exported)) + "\n")
    assert run(["verify", str(file)]) == 2
    out, err = capsys.readouterr()
    assert reason in out + err
    assert run(["send", str(file), "--port", "sim", "--speed", "50"]) == 2
    assert "was not sent" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["ES", "R"])
def test_what_another_program_might_send_is_warned_of_and_never_streamed(
    command: str, exported: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "changed.ebb"
    file.write_text("\n".join(recounted([*exported, command])) + "\n")
    assert run(["verify", str(file)]) == 0
    assert f"{command} ends whatever moves" in capsys.readouterr().out
    assert run(["send", str(file), "--port", "sim", "--speed", "50"]) == 2
    assert f"{command} cannot be part of a stream" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("CU,4,1", "changes the depth of the motion queue"),
        ("CU,60,0", "changes from which voltage"),
        ("QG", "reads the button away"),
        ("QB", "reads the button away"),
        ("SL,0,24", "writes where a stream keeps the mark"),
        ("SL,0,28", "writes where a stream keeps the mark"),
    ],
)
def test_what_would_break_the_streams_own_books_is_refused(
    command: str, reason: str, exported: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "changed.ebb"
    file.write_text("\n".join(recounted([*exported[:-1], command, command, exported[-1]])) + "\n")
    assert run(["verify", str(file)]) == 0
    out = capsys.readouterr().out
    assert out.count(f"warning: {command} {reason}") == 1
    assert "`plotter send` refuses it" in out
    assert run(["send", str(file), "--port", "sim", "--speed", "50"]) == 2
    err = capsys.readouterr().err
    assert f"{command} cannot be part of a stream, because it {reason}" in err


def test_the_variables_and_options_that_a_stream_does_not_use_are_the_files(
    exported: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "changed.ebb"
    added = ["SL,7,3", "SL,5", "QL,3", "CU,2,1", "CU,3,1", "CU,53,0", "QC", "QS"]
    file.write_text("\n".join(recounted([*exported[:-1], *added, exported[-1]])) + "\n")
    assert run(["send", str(file), "--port", "sim", "--speed", "50"]) == 0
    assert "sent" in capsys.readouterr().out


def test_firmware_2_has_one_variable_and_a_stream_needs_it() -> None:
    assert refused_in_a_stream(SL(5)) is None
    assert "knows a board that has restarted" in str(refused_in_a_stream(SL(5), 1))
    memory = MemoryBoard("2.8.1")
    board = connect(memory, clock=memory.clock)
    with pytest.raises(BadCommand, match="SL,5 cannot be part"):
        board.stream([SL(5)], on_progress=lambda _: None, stop=StopFlag())


def test_what_was_not_changed_is_sent_and_its_pause_passed_over(
    exported: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "drawing.ebb"
    assert any(line.startswith("# pause") for line in exported)
    assert run(["verify", str(file)]) == 0
    assert run(["send", str(file), "--port", "sim", "--speed", "50"]) == 0
    assert "is passed over: nobody is at a keyboard" in capsys.readouterr().err
