"""A guilloche rosette, the engine-turned line of banknotes: few strokes, all of them long smooth curves, on two layers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from generators.svgtext import Points, hermite_path, inkscape_document, inkscape_layer

WIDTH_MM, HEIGHT_MM = 148.0, 148.0
BLUE, RED = "#1f4e8c", "#b3392f"


def _closed_curve(radius: Callable[[Points], Points], slope: Callable[[Points], Points], turns: int, pieces: int) -> str:
    """Path data of r(theta) over whole turns about the page's centre, from r and dr/dtheta."""
    theta = np.linspace(0.0, 2 * np.pi * turns, pieces + 1)
    r, dr = radius(theta), slope(theta)
    cos, sin = np.cos(theta), np.sin(theta)
    points = np.column_stack((WIDTH_MM / 2 + r * cos, HEIGHT_MM / 2 + r * sin))
    derivatives = np.column_stack((dr * cos - r * sin, dr * sin + r * cos))
    points[-1], derivatives[-1] = points[0], derivatives[0]
    return hermite_path(points, derivatives, 2 * np.pi * turns / pieces, closed=True)


def _wave(base_mm: float, swing_mm: float, lobes: int, turns: int, phase: float = 0.0) -> str:
    """r = base + swing cos(lobes/turns theta + phase): it closes after `turns` turns when the two have no common factor."""
    k = lobes / turns
    return _closed_curve(
        lambda theta: base_mm + swing_mm * np.cos(k * theta + phase),
        lambda theta: -swing_mm * k * np.sin(k * theta + phase),
        turns,
        pieces=lobes * 12 if lobes > turns else turns * 16,
    )


def _path(name: str, data: str, color: str) -> str:
    style = f"fill:none;stroke:{color};stroke-width:0.3;stroke-linecap:round;stroke-linejoin:round"
    return f'    <path\n       style="{style}"\n       d="{data}"\n       id="{name}" />\n'


def rosette() -> str:
    woven = [_path("band", _wave(53.0, 11.0, 40, 7), BLUE), _path("rim", _wave(67.5, 0.9, 72, 1), BLUE)]
    rose = [
        _path("rose", _wave(25.0, 14.0, 19, 6), RED),
        _path("eye", _wave(7.0, 1.2, 6, 1), RED),
    ]
    layers = inkscape_layer(1, "1 blue", "".join(woven)) + inkscape_layer(2, "2 red", "".join(rose))
    return inkscape_document(WIDTH_MM, HEIGHT_MM, layers, title="Guilloche rosette")
