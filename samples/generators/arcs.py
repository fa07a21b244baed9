"""Elliptical arcs in every combination of flags, and the awkward ones: rotated, relative, run together, radii too small."""

from __future__ import annotations

import math

from generators.svgtext import num

WIDTH_MM, HEIGHT_MM = 279.4, 215.9  # US letter, landscape


def _flag_table(x: float, y: float) -> str:
    """The specification's own figure: two points, and the four arcs between them, for several rotations of the ellipse."""
    out = []
    for column, rotation in enumerate((0, 30, 60, -45, 90)):
        ox, oy = x + column * 50, y
        for large in (0, 1):
            for sweep in (0, 1):
                color = ("#1b6ca8", "#c0392b", "#27824a", "#8e44ad")[2 * large + sweep]
                arc = f"A 18 11 {rotation} {large} {sweep} {num(ox + 16)} {num(oy + 9)}"
                out.append(f'<path d="M {num(ox)} {num(oy)} {arc}" stroke="{color}"/>')
    return "\n".join(out)


def _rose_window(cx: float, cy: float) -> str:
    """Rings of scallops, each one path of relative arcs with numbers run together as SVGO writes them; petals between."""
    out = []
    for radius, scallops, bulge in ((49.0, 24, 0.52), (31.0, 12, 0.56), (14.0, 12, 0.6)):
        corners = [
            (radius * math.cos(2 * math.pi * k / scallops), radius * math.sin(2 * math.pi * k / scallops))
            for k in range(scallops)
        ]
        r = num(2 * radius * math.sin(math.pi / scallops) * bulge)
        steps = [(bx - ax, by - ay) for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True)]
        arcs = "".join(f"a{r} {r} 0 01{num(dx)}{'' if num(dy).startswith('-') else ' '}{num(dy)}" for dx, dy in steps)
        out.append(f'<path d="M{num(cx + radius)} {num(cy)}{arcs}z"/>')
    for inner, outer, petals, roundness in ((14.0, 31.0, 12, 0.62), (31.0, 49.0, 24, 0.66), (0.0, 14.0, 12, 0.75)):
        for k in range(petals):
            cos, sin = math.cos(2 * math.pi * k / petals), math.sin(2 * math.pi * k / petals)
            start, end = (f"{num(cx + radius * cos)} {num(cy + radius * sin)}" for radius in (inner, outer))
            r = num((outer - inner) * roundness)
            out.append(f'<path d="M{start}A{r} {r} 0 0 0 {end} {r} {r} 0 0 0 {start}z"/>')
    out.append(f'<path d="M{num(cx - 55)} {num(cy)}a55 55 0 1 0 110 0 55 55 0 1 0-110 0z"/>')
    out.append(f'<path d="M{num(cx - 57.5)} {num(cy)}a57.5 57.5 0 1 1 115 0a57.5 57.5 0 1 1-115 0z"/>')
    return "\n".join(out)


def _spiral(cx: float, cy: float) -> str:
    """A spiral of half circles, absolute arcs, each a little larger."""
    data, side, radius = [f"M {num(cx)} {num(cy)}"], 1, 2.0
    x = cx
    for _ in range(22):
        x += side * 2 * radius
        data.append(f"A {num(radius)},{num(radius)} 0 0 1 {num(x)},{num(cy)}")
        side, radius = -side, radius + 1.9
    return f'<path d="{" ".join(data)}"/>'


def _too_small(x: float, y: float) -> str:
    """Arcs whose radii cannot reach: to be enlarged until they just do. Then a zero radius: a straight line."""
    waves = " ".join("a 1 1 0 0 1 8 0 a 1 2 0 0 0 8 0" for _ in range(6))
    straight = f"a 0 5 0 0 1 32 0 A 30 0 0 1 0 {num(x + 64)} {num(y + 11)} h 32"
    return f'<path d="M {num(x)} {num(y)} {waves}"/>\n<path d="M {num(x)} {num(y + 11)} {straight}"/>'


def arcs() -> str:
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<svg xmlns="http://www.w3.org/2000/svg" width="{num(WIDTH_MM / 25.4)}in" height="{num(HEIGHT_MM / 25.4)}in"
  viewBox="0 0 {WIDTH_MM} {HEIGHT_MM}">
<title>Arcs</title>
<desc>Public domain, CC0 1.0</desc>
<g id="flags" fill="none" stroke-width=".35" stroke-linecap="round">
{_flag_table(31, 34)}
</g>
<g id="window" fill="none" stroke="#7a5c00" stroke-width=".35" stroke-linecap="round">
{_rose_window(76, 140)}
</g>
<g id="spiral" fill="none" stroke="#444" stroke-width=".35" stroke-linecap="round">
{_spiral(198, 122)}
</g>
<g id="small" fill="none" stroke="#b3392f" stroke-width=".35" stroke-linecap="round">
{_too_small(150, 188)}
</g>
</svg>
"""
