"""Basic shapes as path commands (SVG 2, 10): the directions and starting points that the standard gives."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

import numpy as np

from plotter.svg.lengths import Frame, parse_length
from plotter.svg.path_segments import Floats

Get = Callable[[str], str | None]
# Letters of absolute commands, and their arguments one after the other.
Outline = tuple[bytes, list[float]]
# Centre, x and y, and radii, along x and y, both positive.
Ellipse = tuple[float, float, float, float]


def rect(get: Get, frame: Frame) -> Outline | None:
    x = parse_length(get("x"), frame, frame.width) or 0.0
    y = parse_length(get("y"), frame, frame.height) or 0.0
    w = parse_length(get("width"), frame, frame.width) or 0.0
    h = parse_length(get("height"), frame, frame.height) or 0.0
    if w <= 0 or h <= 0:
        return None
    rx, ry = _radii(get, frame)
    rx, ry = min(rx, w / 2), min(ry, h / 2)
    if rx <= 0 or ry <= 0:
        return b"MHVHZ", [x, y, x + w, y + h, x]
    r = [rx, ry, 0.0, 0.0, 1.0]
    return b"MHAVAHAVAZ", [
        *(x + rx, y, x + w - rx, *r, x + w, y + ry, y + h - ry, *r, x + w - rx, y + h),
        *(x + rx, *r, x, y + h - ry, y + ry, *r, x + rx, y),
    ]


def _radii(get: Get, frame: Frame) -> tuple[float, float]:
    """rx and ry; one that is missing, auto or negative is the other."""
    rx = parse_length(get("rx"), frame, frame.width)
    ry = parse_length(get("ry"), frame, frame.height)
    rx = None if rx is not None and rx < 0 else rx
    ry = None if ry is not None and ry < 0 else ry
    if rx is None:
        rx = ry
    if ry is None:
        ry = rx
    return rx or 0.0, ry or 0.0


def circle(get: Get, frame: Frame) -> Ellipse | None:
    r = parse_length(get("r"), frame, frame.diagonal) or 0.0
    return _ellipse(get, frame, r, r)


def ellipse(get: Get, frame: Frame) -> Ellipse | None:
    return _ellipse(get, frame, *_radii(get, frame))


def _ellipse(get: Get, frame: Frame, rx: float, ry: float) -> Ellipse | None:
    x = parse_length(get("cx"), frame, frame.width) or 0.0
    y = parse_length(get("cy"), frame, frame.height) or 0.0
    return None if rx <= 0 or ry <= 0 else (x, y, rx, ry)


def ellipses_as_path(ellipses: Floats) -> tuple[bytes, Floats]:
    """Outlines of very many ellipses, rows of centre and radii (n, 4): the letters of each, and the arguments (n, 30)."""
    x, y, rx, ry = ellipses.T
    r = (rx, ry, np.zeros_like(x), np.zeros_like(x), np.ones_like(x))
    right, low, left, high = (x + rx, y), (x, y + ry), (x - rx, y), (x, y - ry)
    return b"MAAAAZ", np.stack((*right, *r, *low, *r, *left, *r, *high, *r, *right), axis=1)


def _one_as_path(ellipse: Ellipse) -> Outline:
    codes, numbers = ellipses_as_path(np.array([ellipse]))
    return codes, numbers[0].tolist()


def line(get: Get, frame: Frame) -> Outline:
    return b"ML", [
        parse_length(get("x1"), frame, frame.width) or 0.0,
        parse_length(get("y1"), frame, frame.height) or 0.0,
        parse_length(get("x2"), frame, frame.width) or 0.0,
        parse_length(get("y2"), frame, frame.height) or 0.0,
    ]


_NO_NUMBER = re.compile(r"[a-df-zA-DF-Z]")


def points_as_path(text: str, *, closed: bool) -> str:
    """A `points` list as path data; a letter in it ends it, as any error does."""
    stray = _NO_NUMBER.search(text)
    if stray is not None:
        return f"M{text[: stray.start()]}#"
    if not text.strip():
        return ""
    return f"M{text}Z" if closed else f"M{text}"


ELLIPSES: dict[str, Callable[[Get, Frame], Ellipse | None]] = {"circle": circle, "ellipse": ellipse}
SHAPES: dict[str, Callable[[Get, Frame], Outline | None]] = {"rect": rect, "line": line}


def _path_data(text: str) -> str:
    data = text.strip()
    if data.startswith("path("):
        data = data[5:].rstrip(") \t\r\n").strip("\"'")
    return "" if data == "none" else data


# Shapes whose outline is a text: the attribute that has it, and what path data it makes.
OUTLINES: dict[str, tuple[str, Callable[[str], str]]] = {
    "path": ("d", _path_data),
    "polyline": ("points", partial(points_as_path, closed=False)),
    "polygon": ("points", partial(points_as_path, closed=True)),
}


def is_shape(kind: str) -> bool:
    return kind in OUTLINES or kind in SHAPES or kind in ELLIPSES


def outline(kind: str, attributes: dict[str, str], frame: Frame) -> str | Outline | Ellipse | None:
    """A shape's outline as the element gives it: path data, numbers, or an ellipse; None where there is none."""
    if kind in OUTLINES:
        name, as_path = OUTLINES[kind]
        return as_path(attributes.get(name, "")) or None
    return ELLIPSES[kind](attributes.get, frame) if kind in ELLIPSES else SHAPES[kind](attributes.get, frame)


_ARGUMENTS = {"M": 2, "L": 2, "H": 1, "V": 1, "A": 7, "Z": 0}


def path_text(outline: str | Outline | Ellipse) -> str:
    """An outline as path data."""
    if isinstance(outline, str):
        return outline
    codes, numbers = outline if len(outline) == 2 else _one_as_path(outline)
    words: list[str] = []
    at = 0
    for letter in codes.decode():
        count = _ARGUMENTS[letter]
        words += [
            letter,
            *(
                f"{value:g}" if letter == "A" and i in (3, 4) else repr(value)
                for i, value in enumerate(numbers[at : at + count])
            ),
        ]
        at += count
    return " ".join(words)
