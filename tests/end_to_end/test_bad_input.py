"""Whatever a person gives by mistake: one sentence on stderr with what to do next, its exit code, no traceback, no motion."""

import os
import pty
from pathlib import Path

import pytest

from plotter.cli.main import run

SAMPLE = "samples/rosette.svg"
SMALL = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="50mm" height="50mm" viewBox="0 0 50 50"><path d="{}" stroke="black"/></svg>'
)
PNG = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00"


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of wrong files; settings of the machine's user are kept out."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "picture.svg").write_bytes(PNG)
    (tmp_path / "text.svg").write_text("just some words")
    (tmp_path / "other.svg").write_text("<html><body>no</body></html>")
    (tmp_path / "empty.svg").write_text("")
    (tmp_path / "nothing.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="10mm" height="10mm"/>')
    (tmp_path / "big.svg").write_text(SMALL.format("M0 0L400 0"))
    (tmp_path / "left.svg").write_text(SMALL.format("M-5 0L10 10"))
    (tmp_path / "good.svg").write_text(SMALL.format("M10 10L20 20"))
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], code: int, arguments: list[str], *parts: str) -> str:
    """Run, expect `code`, and one sentence on stderr that has every part; nothing on stdout."""
    assert run(arguments) == code
    out, err = capsys.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if line]
    assert len(lines) == 1, err
    assert "Traceback" not in err
    for part in parts:
        assert part in err
    return err


@pytest.mark.parametrize("command", [["preview"], ["plot", "--port", "sim"], ["export", "-o", "out.ebb"]])
@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("missing.svg", "missing.svg"),
        ("picture.svg", "SVG"),
        ("text.svg", "SVG"),
        ("other.svg", "root is <html>"),
        ("empty.svg", "empty"),
        ("nothing.svg", "no strokes"),
        ("big.svg", "100 mm beyond"),
        ("left.svg", "5 mm beyond"),
    ],
)
def test_wrong_drawings(
    name: str, part: str, command: list[str], files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    before = set(files.iterdir())
    refused(capsys, 2, [command[0], str(files / name), *command[1:]], part)
    assert set(files.iterdir()) == before


@pytest.mark.parametrize(
    ("flags", "part"),
    [
        (["--machine", "axidraw-v9"], "axidraw-v9"),
        (["--draw-speed", "5000mm/s"], "at most 1000"),
        (["--draw-speed", "fast"], "fast"),
        (["--tolerance", "5mm"], "tolerance"),
        (["--quality", "best"], "quality"),
        (["--no-such-flag"], "--no-such-flag"),
        (["--firmware", "banana"], "banana"),
    ],
)
def test_wrong_flags(flags: list[str], part: str, files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, 2, ["preview", str(files / "good.svg"), *flags], part)


def test_a_port_that_does_not_exist(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, 4, ["plot", str(files / "good.svg"), "--port", "/dev/ttyNONE7"], "/dev/ttyNONE7")


def test_a_port_that_is_no_board(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A terminal that never answers: refused in seconds, and no motion command was sent to it."""
    ours, theirs = pty.openpty()
    try:
        refused(capsys, 3, ["plot", str(files / "good.svg"), "--port", os.ttyname(theirs)], "EiBotBoard")
        os.set_blocking(ours, False)
        sent = os.read(ours, 4096)
        assert not any(word in sent for word in (b"SM,", b"T3,", b"SP,0", b"LM,"))
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize("name", ["good.svg", "missing.ebb"])
def test_verify_refuses_what_is_no_command_file(name: str, files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused(capsys, 2, ["verify", str(files / name)], name)


def test_what_the_virtual_board_cannot_be_is_one_sentence(files: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Also what its own process writes."""
    commands = files / "other.ebb"
    commands.write_text("# firmware: 9.9.9\nSP,1,100\n")
    refused(capfd, 2, ["send", str(commands), "--port", "sim"], "no virtual board has firmware 9.9.9; choose one of 2.7.0")
    good = str(files / "good.svg")
    refused(capfd, 2, ["plot", good, "--port", "sim", "--firmware", "2.5.0"], "no virtual board has firmware 2.5.0")
    refused(capfd, 2, ["plot", good, "--port", "sim", "--record", "/nodir/x"], "there is no folder /nodir; make it first")


def test_a_command_file_by_standard_input(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It can be verified; to send it, the keys of a plot are in its way."""
    commands = files / "good.ebb"
    assert run(["export", str(files / "good.svg"), "-o", str(commands)]) == 0
    capsys.readouterr()
    with commands.open(encoding="utf-8") as file:
        monkeypatch.setattr("sys.stdin", file)
        assert run(["verify", "-"]) == 0
        assert capsys.readouterr().out.startswith("standard input: ")
    with (files / "picture.svg").open(encoding="utf-8") as file:
        monkeypatch.setattr("sys.stdin", file)
        refused(capsys, 2, ["verify", "-"], "line 1 is not text (UTF-8)")
    refused(capsys, 2, ["send", "-", "--port", "sim"], "cannot read -", "give a command file")


@pytest.mark.parametrize(
    ("arguments", "option", "bounds"),
    [
        (["plot", "good.svg", "--port", "sim", "--speed", "nan"], "--speed", "0.1 to 1000"),
        (["send", "good.ebb", "--port", "sim", "--speed", "nan"], "--speed", "0.1 to 1000"),
        (["virtual", "--speed", "nan"], "--speed", "0 to 1000"),
        (["virtual", "--patience", "NaN"], "--patience", "0 to 60"),
    ],
)
def test_what_is_no_number_lies_in_no_range(
    arguments: list[str],
    option: str,
    bounds: str,
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(files)
    monkeypatch.setattr("output.ebb.virtual.server.Server.run", lambda _: None)
    refused(capsys, 2, arguments, f"'{option}'", f"{arguments[-1].lower()} is no number", bounds)
