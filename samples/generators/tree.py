"""A tree of nested groups: each branch is a group inside its parent's, moved, turned and made smaller by its own transform."""

from __future__ import annotations

import numpy as np

from generators.svgtext import num

WIDTH_MM, HEIGHT_MM = 215.9, 215.9
DEPTH = 8
SEED = 41

BARK = '<path d="M-7 0C-3.5-10-3-30 0-50M7 0C4-12 2.5-30 0-50M-2.4-3C-1-14-1-28 0-42M3-2C1.6-12 1-22 .6-30"/>'
TWIG = '<path d="M0 0C1-16-2-34 0-50"/>'
LEAF = '<path d="M0 0C-9-8-9-22 0-32C9-22 9-8 0 0zM0 0V-22"/>'


def _branch(depth: int, rng: np.random.Generator, indent: str) -> list[str]:
    """The groups of one branch, drawn from its foot upwards in a frame of its own, 50 units long."""
    if depth == DEPTH:
        skew = rng.integers(-18, 19)
        return [f'{indent}<g transform="skewX({skew}) scale(.9,1.1)" class="leaf">{LEAF}</g>']
    out = [f"{indent}{BARK if depth < 1 else TWIG}"]
    forks = 2 if rng.random() < 0.82 else 3
    for fork in range(forks):
        side = -1 if fork == 0 else 1 if fork == 1 else 0
        turn = side * rng.uniform(13, 30) + rng.uniform(-5, 5)
        shrink = rng.uniform(0.72, 0.84)
        if depth % 3 == 2:
            cos, sin = shrink * np.cos(np.radians(turn)), shrink * np.sin(np.radians(turn))
            transform = f"matrix({num(cos, 5)} {num(sin, 5)} {num(-sin, 5)} {num(cos, 5)} 0 -50)"
        elif depth % 3 == 1:
            transform = f"rotate({num(turn, 2)}, 0, -50) translate(0 -50) scale({num(shrink, 4)})"
        else:
            transform = f"translate(0,-50) rotate({num(turn, 2)}) scale({num(shrink, 4)})"
        out.append(f'{indent}<g transform="{transform}">')
        out += _branch(depth + 1, rng, indent + " ")
        out.append(f"{indent}</g>")
    return out


def tree() -> str:
    branches = "\n".join(_branch(0, np.random.default_rng(SEED), "  "))
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_MM}mm" height="{HEIGHT_MM}mm" viewBox="-108 -216 216 216">
<title>A tree of nested groups</title>
<desc>Public domain, CC0 1.0</desc>
<g id="tree" transform="translate(6,-15) scale(.8)" fill="none" stroke="#2f5d34" stroke-width=".4"
  vector-effect="non-scaling-stroke">
{branches}
</g>
<path d="M-80-14C-50-17-30-15-8-16M8-16C30-15 55-18 82-14M-60-9q30-3 55 0t60-1" fill="none" stroke="#6b4a2b" stroke-width=".4"/>
</svg>
"""
