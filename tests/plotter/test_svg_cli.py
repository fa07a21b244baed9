"""`plotter layers` and `plotter strokes`, and the flags of reading."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from plotter.cli.main import run
from tests.plotter.svg_help import HEAD

BODY = (
    '<g inkscape:groupmode="layer" inkscape:label="!red"><path stroke="red" d="M0 0H10V10"/><text>x</text></g>'
    '<g inkscape:groupmode="layer" inkscape:label="%note"><path d="M0 0H10"/></g>'
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "drawing.svg"
    path.write_text(f"{HEAD}{BODY}</svg>")
    return path


def test_strokes_writes_polylines_in_document_order(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "poly.json"
    assert run(["strokes", str(file), "-o", str(out), "--text", "skip"]) == 0
    assert json.loads(out.read_text()) == {"width_mm": 100, "height_mm": 100, "polylines": [[[0, 0], [10, 0], [10, 10]]]}
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("note: ") == 2 and "warning" not in said.err and "%note" in said.err and "1 text was" in said.err


def test_standard_input_and_output(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(f'{HEAD}<path d="M0 0H9"/></svg>'.encode())))
    assert run(["strokes", "-", "-o", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["polylines"] == [[[0, 0], [9, 0]]]


def test_layers_for_people_and_programs(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["layers", str(file), "--text", "skip"]) == 0
    text = capsys.readouterr().out
    assert "100.00 x 100.00 mm, 1 stroke\n" in text and "!red" in text and "pause before" in text and "documentation" in text
    assert run(["layers", str(file), "--json", "--text", "skip"]) == 0
    found = json.loads(capsys.readouterr().out)
    first, second = found["layers"]
    assert (first["number"], first["name"], first["strokes"], first["points"]) == (1, "!red", 1, 3)
    assert (first["length_mm"], first["box_mm"], first["colors"]) == (20, [0, 0, 10, 10], ["#ff0000"])
    assert first["pause_before"] and second["documentation"] and second["strokes"] == 0


@pytest.mark.parametrize(
    ("flags", "word"),
    [
        (["--max-elements", "2"], "--max-elements"),
        (["--tolerance-curve", "20mm"], "tolerance"),
        (["--tolerance-curve", "soon"], "tolerance-curve"),
        (["--max-nesting", "999"], "max-nesting"),
        (["--hidden", "some"], "hidden"),
        (["--dpi", "0"], "dpi"),
    ],
)
def test_bad_flags_are_bad_input(file: Path, flags: list[str], word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["layers", str(file), *flags]) == 2
    said = capsys.readouterr().err
    assert word in said and "Traceback" not in said


def test_bad_files_are_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["layers", str(tmp_path / "missing.svg")]) == 2
    assert "cannot be read" in capsys.readouterr().err
    (tmp_path / "a.svg").write_bytes(b"\x89PNG\r\n\x1a\n")
    assert run(["strokes", str(tmp_path / "a.svg"), "-o", str(tmp_path / "x.json")]) == 2
    assert "PNG picture" in capsys.readouterr().err
    good = tmp_path / "b.svg"
    good.write_text(f"{HEAD}</svg>")
    assert run(["strokes", str(good), "-o", str(tmp_path / "no" / "x.json")]) == 2


def test_every_flag_reaches_the_reader(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import plotter.cli.reading as reading

    seen: list[Any] = []
    real = reading.read_drawing

    def spy(source: Any, options: Any) -> Any:
        seen.append(options)
        return real(source, options)

    monkeypatch.setattr(reading, "read_drawing", spy)
    flags = (
        "--tolerance-curve 0.05mm --hidden all --fills close --text skip --layers one --occlude --crop --dpi 72 "
        "--max-bytes 99999 "
        "--max-elements 98 --max-nesting 97 --max-uses 96 --max-markers 95 --max-points 94 --max-dashes 93 --max-characters 92 "
        "--max-selector-tests 91"
    )
    assert run(["layers", str(file), *flags.split()]) == 0
    (options,) = seen
    assert (options.tolerance_mm, options.hidden, options.fills, options.text) == (0.05, "all", "close", "skip")
    assert (options.layers, options.occlude, options.crop, options.px_per_in) == ("one", True, True, 72)
    budgets = options.budgets
    assert (budgets.document_bytes, budgets.elements, budgets.nesting, budgets.uses) == (99999, 98, 97, 96)
    assert (budgets.markers, budgets.points, budgets.dashes, budgets.characters, budgets.selector_tests) == (95, 94, 93, 92, 91)


@pytest.mark.parametrize("command", [["layers"], ["preview"], ["export", "-o", "-"]])
def test_no_command_reads_further_than_the_byte_budget(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard input without an end: refused after the budget's bytes, not when the memory is full."""

    class Endless(io.RawIOBase):
        taken = 0

        def readable(self) -> bool:
            return True

        def readinto(self, buffer: Any) -> int:
            assert self.taken < 5_000_000, "read on beyond the budget"
            buffer[:] = b" " * len(buffer)
            self.taken += len(buffer)
            return len(buffer)

    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BufferedReader(Endless())))
    assert run([command[0], "-", *command[1:], "--max-bytes", "1000000"]) == 2
    assert "--max-bytes" in capsys.readouterr().err
