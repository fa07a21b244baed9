"""A harbour in Inkscape layers: page in mm, a viewBox of quarter millimetres, transforms on layers, groups and paths.

The third layer's name begins with `!`, by AxiDraw's convention a pause for another pen; the
fourth is hidden, and not to be drawn.
"""

from __future__ import annotations

import math

import numpy as np

from generators.svgtext import inkscape_document, inkscape_layer, num, smooth_path

WIDTH_MM, HEIGHT_MM = 297.0, 210.0
UNITS_PER_MM = 4
INK, SEA, RED = "#26323f", "#2f6f9f", "#c0442e"


def _path(name: str, data: str, color: str, more: str = "") -> str:
    style = f"fill:none;stroke:{color};stroke-width:1.4;stroke-linecap:round;stroke-linejoin:round;stroke-opacity:1"
    return f'    <path\n       style="{style}"\n       d="{data}"\n       id="{name}"{more} />\n'


def _waves() -> str:
    """Rows of swell, closer and smaller with distance, broken where the rows' noise says so."""
    rng = np.random.default_rng(3)
    out = []
    for row in range(15):
        depth = row / 14
        y = 452 + 310 * depth**1.5
        swing, length = 2.5 + 11 * depth, 34 + 90 * depth
        x = 60 + rng.uniform(0, 40)
        part = 0
        while x < 1090:
            run = rng.uniform(120, 420)
            xs = np.arange(x, min(x + run, 1130), length / 8)
            if len(xs) > 4:
                crest = np.abs(np.sin(np.pi * xs / length + row * 1.3)) * swing
                out.append(_path(f"wave{row}-{part}", smooth_path(np.column_stack((xs, y - crest)), decimals=2), SEA))
            x += run + rng.uniform(20, 110)
            part += 1
    return "".join(out)


def _boat(name: str, transform: str) -> str:
    """A sloop, drawn about its waterline's middle, about 200 units wide; relative commands throughout."""
    parts = [
        "m -96,-14 c 30,4 150,6 196,-8 c -10,24 -24,40 -40,46 l -118,0 c -18,-6 -32,-20 -38,-38 z",
        "m -84,2 c 46,6 118,6 166,-4",
        "m 4,-18 v -212",
        "m 10,-224 c 46,60 68,130 74,190 l -74,6 z",
        "m -4,-212 c -20,60 -46,120 -82,176 c 30,8 56,10 82,10 z",
        "m 18,-176 c 24,12 38,14 46,12 m -44,46 c 28,14 44,14 52,10 m -50,46 c 30,10 44,10 52,6",
        "m 4,-230 q 16,-10 30,-2 q -14,8 -30,12",
    ]
    body = "".join(_path(f"{name}-{i}", data, INK).replace("    <", "      <") for i, data in enumerate(parts))
    return f'    <g\n       id="{name}"\n       transform="{transform}">\n{body}    </g>\n'


def _lighthouse() -> str:
    """Coordinates of its own, scaled and moved by the group; the stripes lean with a path's own skew."""
    stripes = "".join(
        _path(
            f"stripe{k}",
            f"M {num(-13.5 - 2.2 * k)},{18 + 22 * k} H {num(13.5 + 2.2 * k)}",
            INK,
            '\n       transform="skewY(-6)"',
        )
        for k in range(6)
    )
    tower = "M -12,0 L -28,150 L 28,150 L 12,0 Z M -18,0 H 18 M -14,-6 H 14 V 0 H -14 Z M -10,-6 V -30 H 10 V -6 M 0,-6 V -30"
    roof = "M -14,-30 A 14,12 0 0 1 14,-30 Z M 0,-42 V -54"
    body = _path("tower", tower, INK) + _path("roof", roof, INK) + stripes
    return f'    <g\n       id="lighthouse"\n       transform="matrix(1.45,0,0,1.45,930,202)">\n{body}    </g>\n'


def _rock() -> str:
    rng = np.random.default_rng(11)
    x = np.linspace(790, 1130, 18)
    y = 455 - 42 * np.sin(np.pi * np.clip((x - 780) / 330, 0, 1)) ** 0.6 + rng.uniform(-7, 7, len(x))
    out = [_path("rock", smooth_path(np.column_stack((x, y)), decimals=2), INK)]
    for k in range(9):
        sx = 815 + 32 * k
        out.append(_path(f"crack{k}", f"m {num(sx)},446 l {num(rng.uniform(4, 12))},-10 l -5,-7 l 9,-8", INK))
    return "".join(out)


def _sun() -> str:
    """A sun of a circle and rays, the rays one path turned about the sun again and again."""
    rays = "".join(
        _path(f"ray{k}", "M 74,0 C 84,-7 92,7 102,0 S 118,-6 126,0", RED, f'\n       transform="rotate({num(k * 22.5)})"')
        for k in range(16)
    )
    style = f"fill:none;stroke:{RED};stroke-width:1.4"
    circles = "".join(
        f'    <circle\n       style="{style}"\n       id="sun{r}"\n       cx="0"\n       cy="0"\n       r="{r}" />\n'
        for r in (60, 50, 40)
    )
    return f'    <g\n       id="sun"\n       transform="translate(250,190)">\n{circles}{rays}    </g>\n'


def _gulls() -> str:
    return "".join(
        _path(
            f"gull{k}",
            "m -30,-8 q 18,-16 30,6 q 14,-22 32,-4",
            INK,
            f'\n       transform="translate({x},{y}) rotate({turn}) scale({size})"',
        )
        for k, (x, y, turn, size) in enumerate(
            ((520, 130, -8, 1), (600, 176, 6, 0.7), (470, 210, 4, 0.6), (690, 110, -14, 0.8))
        )
    )


def harbour() -> str:
    boats = _boat("sloop", "translate(420,560) rotate(-4)") + _boat("far", "matrix(-0.42,0,0.03,0.42,690,470)")
    boats += _boat("near", f"translate(760,690) scale(0.8) skewX({num(math.degrees(math.atan(0.06)))})")
    guides = _path("frame", "M 40,40 H 1148 V 800 H 40 Z M 40,452 H 1148", "#ff00ff")
    layers = (
        inkscape_layer(1, "1 sea", _waves(), transform="translate(0,8)")
        + inkscape_layer(2, "2 boats and coast", boats + _lighthouse() + _rock() + _gulls())
        + inkscape_layer(3, "!3 change to red", _sun(), transform="translate(10,-4) scale(1.02)")
        + inkscape_layer(4, "guides", guides, style="display:none")
    )
    box = f"0 0 {num(WIDTH_MM * UNITS_PER_MM)} {num(HEIGHT_MM * UNITS_PER_MM)}"
    return inkscape_document(WIDTH_MM, HEIGHT_MM, layers, title="Harbour", viewbox=box)
