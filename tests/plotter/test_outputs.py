"""No command writes over what it reads, under whatever name: it is refused before anything is done."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import pytest

from plotter.cli.main import run

SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="50mm" height="50mm" viewBox="0 0 50 50">'
    '<path d="M10 10L20 20" stroke="black"/></svg>'
)
NAMES = ("O.svg", "./O.svg", "link.svg", "hard.svg")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A drawing under several names, and its export."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    Path("O.svg").write_text(SVG)
    Path("link.svg").symlink_to("O.svg")
    os.link("O.svg", "hard.svg")
    Path("mine.toml").write_text("margin = '5mm'\n")
    return tmp_path


def refused(arguments: list[str], output: str, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.read_bytes() for path in Path().iterdir() if path.is_file()}
    assert run(arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"plotter: the output {output} is the {what} itself; choose another name for it\n"
    assert {path: path.read_bytes() for path in Path().iterdir() if path.is_file()} == before


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "command",
    [
        ["preview", "O.svg", "-o"],
        ["export", "O.svg", "-o"],
        ["strokes", "O.svg", "-o"],
        ["plot", "O.svg", "--port", "sim", "--picture"],
        ["plot", "O.svg", "--port", "sim", "--record"],
    ],
)
def test_the_drawing_is_never_written_over(
    command: list[str], name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    del folder
    output = name if command[0] in ("export", "strokes") else str(Path(name))
    refused([*command, name], output, "drawing", capsys)


def test_nor_are_a_command_file_and_what_it_is_compared_with(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    del folder
    assert run(["export", "O.svg", "-o", "O.ebb"]) == 0
    assert run(["verify", "O.ebb", "--strokes", "ink.json"]) == 0
    capsys.readouterr()
    refused(["verify", "O.ebb", "--strokes", "O.ebb"], "O.ebb", "command file", capsys)
    refused(["verify", "O.ebb", "--against", "O.svg", "--strokes", "link.svg"], "link.svg", "drawing", capsys)


def test_nor_the_settings_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    del folder
    for command in (["export", "O.svg", "-o"], ["preview", "O.svg", "-o"], ["plot", "O.svg", "--port", "sim", "--record"]):
        refused([*command, "mine.toml", "--settings", "mine.toml"], "mine.toml", "settings file", capsys)


def test_nor_a_fault_script(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "faults.json").write_text("[]")
    refused(["virtual", "--faults", "faults.json", "--record", "faults.json"], "faults.json", "fault script", capsys)


def test_nor_the_drawing_that_comes_by_standard_input(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with (folder / "O.svg").open() as file:
        monkeypatch.setattr(sys, "stdin", file)
        refused(["export", "-", "-o", "O.svg"], "O.svg", "drawing", capsys)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(SVG.encode())))  # one that is no file
    assert run(["export", "-", "-o", "O.ebb"]) == 0


def test_a_device_may_be_read_and_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    del folder
    assert run(["export", "O.svg", "-o", "/dev/null"]) == 0
    assert "command" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["preview", "O.svg", "-o", "none/x.png"], "there is no folder none"),
        (["export", "O.svg", "-o", "none/x.ebb"], "there is no folder none"),
        (["strokes", "O.svg", "-o", "none/x.json"], "there is no folder none"),
        (["plot", "O.svg", "--port", "sim", "--picture", "none/x.png"], "there is no folder none"),
        (["plot", "O.svg", "--port", "sim", "--record", "none/x.json"], "there is no folder none"),
        (["plot", "O.svg", "--port", "sim", "--picture", "x.bmp"], "must end in .png or .svg, not '.bmp'"),
        (["preview", "O.svg", "-o", "x"], "must end in .png or .svg, not 'nothing'"),
    ],
)
def test_a_place_where_nothing_can_be_written_is_told_before_anything_is_done(
    arguments: list[str], said: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    del folder
    for command in ("preview", "export", "plot"):
        monkeypatch.setattr(f"plotter.cli.{command}.prepare", lambda *_: pytest.fail("it was begun"))
    monkeypatch.setattr("plotter.cli.reading.read_drawing", lambda *_: pytest.fail("it was begun"))
    assert run(arguments) == 2
    assert said in capsys.readouterr().err
