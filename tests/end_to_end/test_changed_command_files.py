"""Command files that were cut short or changed by hand: verify and send refuse them, and say why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from plotter.cli.main import run

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


def test_what_was_not_changed_is_sent_and_its_pause_passed_over(
    exported: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "drawing.ebb"
    assert any(line.startswith("# pause") for line in exported)
    assert run(["verify", str(file)]) == 0
    assert run(["send", str(file), "--port", "sim", "--speed", "50"]) == 0
    assert "is passed over: nobody is at a keyboard" in capsys.readouterr().err
