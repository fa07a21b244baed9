"""A robot of basic shapes only: rect with and without rounding, circle, ellipse, line, polyline, polygon.

Written as Illustrator writes: classes in a style sheet, points for units in the viewBox, short numbers.
"""

from __future__ import annotations

import math

from generators.svgtext import num

WIDTH_MM, HEIGHT_MM = 210.0, 210.0


def _gear(cx: float, cy: float, inner: float, outer: float, teeth: int) -> str:
    """The points of a gear's rim, for a polygon."""
    points = []
    for tooth in range(teeth):
        for at, radius in ((0.0, inner), (0.22, outer), (0.5, outer), (0.72, inner)):
            angle = 2 * math.pi * (tooth + at) / teeth
            points.append(f"{num(cx + radius * math.cos(angle), 2)},{num(cy + radius * math.sin(angle), 2)}")
    return " ".join(points)


def _spring(x: float, top: float, bottom: float, half: float, turns: int) -> str:
    """The points of a zigzag spring, for a polyline."""
    step = (bottom - top) / (2 * turns)
    zigzag = [f"{num(x + (half if k % 2 else -half), 2)} {num(top + k * step, 2)}" for k in range(1, 2 * turns)]
    return " ".join([f"{num(x, 2)} {num(top, 2)}", *zigzag, f"{num(x, 2)} {num(bottom, 2)}"])


def shapes() -> str:
    rivets = "\n".join(
        f'\t<circle class="st1" cx="{num(x, 1)}" cy="{num(y, 1)}" r="2.5"/>'
        for y in (262, 398)
        for x in (208, 240, 272, 304, 336, 368, 400)
    )
    grille = "\n".join(f'\t<line class="st0" x1="{x}" y1="196" x2="{x}" y2="212"/>' for x in range(268, 340, 8))
    grass = " ".join(f"{num(40 + 7.5 * k, 1)},{num(566 - (11 + 6 * math.sin(k * 1.7)) * (k % 2), 1)}" for k in range(70))
    background = 'style="enable-background:new 0 0 595.28 595.28;" xml:space="preserve"'
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- Generator: Adobe Illustrator 27.0.0, SVG Export Plug-In . SVG Version: 6.00 Build 0)  -->
<svg version="1.1" id="Layer_1" xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" x="0px" y="0px"
\t width="{num(WIDTH_MM)}mm" height="{num(HEIGHT_MM)}mm" viewBox="0 0 595.28 595.28" {background}>
<style type="text/css">
\t.st0{{fill:none;stroke:#231F20;stroke-miterlimit:10;}}
\t.st1{{fill:none;stroke:#C1272D;stroke-miterlimit:10;}}
\t.st2{{fill:none;stroke:#006837;stroke-width:0.75;stroke-linecap:round;stroke-linejoin:round;}}
</style>
<title>Robot</title>
<desc>Public domain, CC0 1.0</desc>
<g id="head">
\t<rect x="238" y="112" class="st0" width="132" height="112" rx="18"/>
\t<rect x="252" y="190" class="st0" width="104" height="28" rx="14" ry="9"/>
{grille}
\t<circle class="st0" cx="276" cy="156" r="19"/>
\t<circle class="st0" cx="332" cy="156" r="19"/>
\t<circle class="st1" cx="279" cy="158" r="8"/>
\t<circle class="st1" cx="335" cy="158" r="8"/>
\t<ellipse class="st0" cx="276" cy="156" rx="25" ry="28"/>
\t<ellipse class="st0" cx="332" cy="156" rx="25" ry="28"/>
\t<rect x="222" y="146" class="st0" width="16" height="34"/>
\t<rect x="370" y="146" class="st0" width="16" height="34"/>
\t<polyline class="st0" points="{_spring(304, 74, 112, 9, 5)}"/>
\t<circle class="st1" cx="304" cy="64" r="10"/>
\t<line class="st1" x1="304" y1="46" x2="304" y2="34"/>
\t<line class="st1" x1="319" y1="53" x2="329" y2="45"/>
\t<line class="st1" x1="289" y1="53" x2="279" y2="45"/>
</g>
<g id="body">
\t<polyline class="st0" points="288,224 288,246 320,246 320,224 "/>
\t<rect x="190" y="246" class="st0" width="228" height="168" rx="26" ry="20"/>
\t<polygon class="st1" points="{_gear(260, 332, 27, 36, 12)} "/>
\t<circle class="st1" cx="260" cy="332" r="11"/>
\t<polygon class="st0" points="{_gear(316.5, 355, 16.5, 25, 8)} "/>
\t<circle class="st0" cx="316.5" cy="355" r="6"/>
\t<rect x="346" y="292" class="st0" width="50" height="34" rx="4"/>
\t<polyline class="st1" points="350,314 358,314 363,300 370,322 376,306 380,314 392,314"/>
\t<ellipse class="st0" cx="371" cy="358" rx="24" ry="12"/>
\t<ellipse class="st0" cx="371" cy="358" rx="12" ry="12"/>
{rivets}
</g>
<g id="limbs">
\t<polygon class="st0" points="190,276 150,300 126,352 146,362 166,316 190,304 "/>
\t<polygon class="st0" points="418,276 462,262 492,208 474,196 448,242 418,252 "/>
\t<circle class="st0" cx="136" cy="372" r="17"/>
\t<circle class="st0" cx="486" cy="188" r="17"/>
\t<polygon class="st0" points="479,172 462,134 474,130 486,158 492,126 504,128 500,162 522,140 530,149 502,181 "/>
\t<polyline class="st0" points="{_spring(246, 414, 500, 13, 7)}"/>
\t<polyline class="st0" points="{_spring(362, 414, 500, 13, 7)}"/>
\t<rect x="206" y="500" class="st0" width="78" height="34" rx="60" ry="17"/>
\t<rect x="324" y="500" class="st0" width="78" height="34" rx="17"/>
</g>
<g id="ground">
\t<polyline class="st2" points="{grass}"/>
\t<line class="st2" x1="40" y1="574" x2="557.5" y2="574"/>
\t<ellipse class="st2" cx="92" cy="474" rx="30" ry="44"/>
\t<line class="st2" x1="92" y1="452" x2="92" y2="548"/>
\t<ellipse class="st2" cx="498" cy="452" rx="24" ry="62" transform="rotate(8 498 452)"/>
\t<line class="st2" x1="498" y1="428" x2="490" y2="549"/>
</g>
</svg>
"""
