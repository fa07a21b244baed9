"""A drawing without strokes is refused with the reasons why it has none."""

from __future__ import annotations

from pathlib import Path

import pytest

from plotter.cli.main import run
from plotter.svg import font_engine
from tests.plotter.svg_help import HEAD

EMPTY = (
    ('<image href="x.png" width="10" height="10"/>', "1 image was left out: a pen draws no pixels"),
    ('<g inkscape:groupmode="layer" inkscape:label="%doc"><path d="M0 0h9"/></g>', "1 layer is documentation"),
    ('<path d="oh" stroke="black"/>', "1 path"),
    ("<text>a</text>", "1 text was left out: the font engine failed (too old)"),
)


@pytest.mark.parametrize(("body", "reason"), EMPTY)
@pytest.mark.parametrize(
    "command", [["preview"], ["export", "-o", "out.ebb"], ["plot", "--port", "sim"], ["strokes", "-o", "out.json"]]
)
def test_why_there_is_nothing_is_said(
    command: list[str],
    body: str,
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fails() -> tuple[str, ...]:
        raise font_engine.FontEngineFailed("too old")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(font_engine, "available", lambda: True)
    monkeypatch.setattr(font_engine, "families", fails)
    Path("drawing.svg").write_text(f"{HEAD}{body}</svg>")
    code = run([command[0], "drawing.svg", *command[1:]])
    said = capsys.readouterr()
    assert said.out == ""
    if command[0] == "strokes":  # an empty list is an answer
        assert code == 0 and reason in said.err
        return
    assert code == 2 and not list(tmp_path.glob("out*"))
    first, error = said.err.splitlines()
    assert first.startswith(f"note: {reason}")
    assert error == "plotter: the drawing has no strokes to draw: give it visible lines, or see --hidden, --fills and --text"
