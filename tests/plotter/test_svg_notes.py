"""What the reader says of a drawing, in sentences that are right for one thing and for several."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import plotter.svg
from output.wording import agreeing
from plotter.svg.notes import Notes
from tests.plotter.svg_help import page

ROOM = Path(plotter.svg.__file__).parent


def templates() -> Iterator[str]:
    """Every text in the reader's source that a count is put into, what f-strings put in shown as `*`."""
    for path in sorted(ROOM.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.JoinedStr():
                    parts = [part.value if isinstance(part, ast.Constant) else "*" for part in node.values]
                    text = "".join(map(str, parts))
                case ast.Constant(value=str() as text):
                    text = "" if text == "{count} " else text  # a piece of an f-string, which is looked at as a whole
                case _:
                    continue
            if text.startswith("{count}") and " " in text:
                yield text


def test_templates_are_found() -> None:
    assert len(set(templates())) >= 25


@pytest.mark.parametrize("template", sorted(set(templates())))
def test_a_note_on_one_thing_is_in_the_singular(template: str) -> None:
    if template.startswith("{count} *"):  # what comes next is inserted, and has its own words
        assert re.search(r"\[\w+ \w+\|\w+ \w+\]|^\{count\} \* \(", template)
        return
    one, several = agreeing(template, 1), agreeing(template, 2)
    assert one != several
    assert not re.search(r"\b(are|were|have|refer|they|them|their|themselves)\b", one.split(": ")[0]), one


def test_notes_count() -> None:
    notes = Notes()
    notes.add("{count} [shape is|shapes are] damaged ({names})", "a [b|c]")
    assert notes.sentences() == ("1 shape is damaged (a [b|c])",)
    notes.add("{count} [shape is|shapes are] damaged ({names})", "d")
    assert notes.sentences() == ("2 shapes are damaged (a [b|c], d)",)


def test_a_drawing_with_one_of_each() -> None:
    body = '<path id="a" d="M0 0H9"/><path display="none" d="M0 0H9"/><image/><path mask="url(#m)" d="M0 9H9"/>'
    assert page(body).warnings == (
        "1 element is hidden (display:none) and left out; --hidden all draws it",
        "1 image was left out: a pen draws no pixels",
        "1 mask was ignored: what it hides is drawn (<path> on line 1)",
    )
