"""A handwritten page: joined-up writing, one stroke a word, then the dots and crosses, from an alphabet of our own."""

from __future__ import annotations

import numpy as np

from generators.svgtext import Points, num, smooth_path

WIDTH_MM, HEIGHT_MM = 210.0, 148.0  # A5, landscape
X_HEIGHT_MM = 3.35
LINE_MM = 12.6
LEFT_MM, TOP_MM = 15.0, 20.0
SLANT = 0.28
SEED = 7

TEXT = """\
Dear reader,
this page was written by a machine that holds a
pen and never tires of it. Every word is one line;
the pen goes down at the first letter, and comes up
after the last, to dot an i, or to cross a t.
The loops are smooth bends, to be taken without
a stop. Only where a stroke turns back upon itself
must the pen slow down, just as a hand does.
Yours, the plotter"""

# Letters as points for a spline, in heights of an x, y up from the baseline. A letter goes on from where the one before
# it ended, (0, 0) at a word's start, and ends where the next begins; only x is carried over.
LETTERS = {
    "a": ".8,.88 .45,1 .1,.5 .36,0 .76,.42 .94,1 .88,.35 1.03,0 1.3,.2",
    "b": ".42,1.0 .64,1.8 .46,2.1 .3,1.6 .26,.4 .5,0 .84,.35 .76,.86 .68,.72 1.1,.85",
    "c": ".24,.42 .52,.9 .74,.95 .76,.78 .52,.96 .25,.62 .3,.14 .56,0 .8,.08 1.05,.3",
    "d": ".8,.88 .45,1 .1,.5 .36,0 .76,.42 1.02,1.3 1.06,2.05 .98,1.3 .92,.4 1.05,0 1.32,.2",
    "e": ".42,.4 .62,.78 .42,1 .18,.55 .34,.03 .6,.05 .95,.3",
    "f": ".42,1.0 .62,1.8 .44,2.1 .3,1.5 .24,0 .2,-.8 .34,-1 .48,-.55 .36,-.02 .8,.2",
    "g": ".8,.88 .45,1 .1,.5 .36,.05 .76,.42 .94,1 .84,0 .7,-.8 .45,-1 .4,-.65 .85,-.1 1.25,.25",
    "h": ".42,1.0 .62,1.8 .44,2.1 .29,1.5 .22,0 .38,.65 .66,1 .84,.8 .8,.3 .95,0 1.22,.2",
    "i": ".36,1 .3,.35 .45,0 .72,.2",
    "j": ".42,1 .36,0 .25,-.8 .0,-1 -.02,-.65 .4,-.1 .78,.25",
    "k": ".42,1.0 .62,1.8 .44,2.1 .29,1.5 .22,0 .32,.55 .62,1 .78,.8 .42,.5 .74,.1 .95,.02 1.22,.2",
    "l": ".42,1 .62,1.8 .44,2.1 .28,1.5 .25,.4 .45,0 .78,.2",
    "m": ".2,.72 .34,1 .42,.8 .36,0 .52,.62 .77,1 .87,.8 .82,0 .98,.62 1.23,1 1.33,.8 1.3,.3 1.42,0 1.68,.2",
    "n": ".2,.72 .34,1 .42,.8 .36,0 .52,.62 .78,1 .9,.8 .87,.3 1.0,0 1.27,.2",
    "o": ".72,.85 .42,1 .1,.5 .36,0 .74,.4 .7,.86 .52,.98 .6,.8 1.12,.9",
    "p": ".3,.8 .42,1.05 .32,0 .2,-1 .28,-.3 .47,.7 .77,1 .97,.6 .78,.06 .48,.1 .8,0 1.22,.2",
    "q": ".8,.88 .45,1 .1,.5 .36,.05 .76,.42 .94,1 .86,0 .8,-.9 .95,-1 1.02,-.6 .95,-.1 1.32,.2",
    "r": ".22,.75 .34,1.14 .46,.95 .7,.94 .68,.3 .82,0 1.08,.2",
    "s": ".38,.75 .5,1.12 .56,.75 .68,.3 .45,0 .2,.12 .5,.0 .95,.2",
    "t": ".42,.9 .56,1.7 .46,.9 .42,.3 .6,0 .92,.2",
    "u": ".32,1 .28,.35 .45,0 .75,.4 .92,1 .87,.35 1.0,0 1.27,.2",
    "v": ".22,.8 .36,.98 .5,.02 .76,.6 .82,1 .84,.86 1.17,.92",
    "w": ".3,1 .28,.3 .45,0 .7,.5 .8,.98 .76,.3 .94,0 1.17,.5 1.24,1 1.26,.86 1.56,.92",
    "x": ".2,.8 .36,1 .55,.5 .75,.05 .9,0 1.22,.2",
    "y": ".32,1 .28,.35 .45,.02 .75,.4 .92,1 .84,0 .7,-.8 .45,-1 .4,-.65 .85,-.1 1.22,.25",
    "z": ".2,.8 .5,1 .62,.7 .25,.05 .5,.1 .55,-.5 .3,-1 .2,-.7 .6,-.1 1.0,.25",
    "E": "1.05,1.8 .75,2.1 .4,1.75 .52,1.28 .78,1.15 .4,1.0 .18,.5 .45,0 .9,.1 1.2,.3",
    "O": ".9,1.9 .5,2.0 .1,1.1 .35,.1 .9,.1 1.25,1.0 1.0,1.85 .7,1.75 1.5,1.7",
    "Y": ".15,1.7 .32,2.0 .4,1.4 .65,1.02 1.0,1.4 1.2,2.0 1.08,.6 .85,-.6 .55,-.95 .45,-.6 1.0,-.05 1.45,.25",
    "D": ".62,1.9 .5,1 .36,.15 .12,.05 .3,.22 .9,0 1.4,.6 1.25,1.6 .6,2.05 .15,1.7",
    "T": ".95,1.9 .88,1 .7,.2 .38,0 .15,.3",
}
EXTRA = {  # drawn after the word, from the letter's own origin
    "i": [".42,1.45 .45,1.48"],
    "j": [".48,1.45 .51,1.48"],
    "t": [".15,1.2 .5,1.24 .9,1.3"],
    "x": [".95,1.0 .55,.5 .15,0"],
    "T": [".1,1.72 .4,2.02 .95,1.9 1.5,2.05"],
}
ALONE = {"D": 1.75, "T": 1.4}  # capitals that the next letter does not join, and how far they reach
MARKS = {
    ".": ([".1,.02 .13,.05"], 0.5),
    ",": [".18,.08 .18,-.1 .05,-.3"],
    ";": [".18,.08 .18,-.1 .05,-.3", ".22,.6 .25,.63"],
}


def _points(text: str) -> Points:
    return np.array([[float(v) for v in pair.split(",")] for pair in text.split()])


def _write_word(word: str, rng: np.random.Generator) -> tuple[list[Points], float]:
    """The word's strokes, in heights of an x, and how far it reaches."""
    strokes: list[Points] = []
    extras: list[Points] = []
    joined: list[Points] = []
    x = 0.0

    def finish() -> None:
        if joined:
            strokes.append(np.vstack(joined))
            joined.clear()

    for letter in word:
        if letter in MARKS:
            finish()
            marks = MARKS[letter]
            extras += [_points(mark) + np.array([x + 0.1, 0]) for mark in (marks[0] if isinstance(marks, tuple) else marks)]
            x += 0.5
            continue
        tall, wide = rng.uniform(0.94, 1.08), rng.uniform(0.94, 1.06)
        shape = _points(LETTERS[letter]) * [wide, tall]
        if not joined and letter.islower():
            joined.append(np.array([[x, 0.02]]))
        joined.append(shape + np.array([x, 0]))
        extras += [_points(extra) * [wide, tall] + [x, 0] for extra in EXTRA.get(letter, [])]
        if letter in ALONE:
            finish()
            x += ALONE[letter] * wide
        else:
            x += float(shape[-1, 0])
    finish()
    return strokes + extras, x


def letter() -> str:
    rng = np.random.default_rng(SEED)
    paths = []
    for row, line in enumerate(TEXT.split("\n")):
        indent = 6.0 if row == 1 else 100.0 if row == 8 else 0.0
        x_mm, y_mm = LEFT_MM + indent + rng.uniform(-1, 1), TOP_MM + row * LINE_MM + (6.0 if row == 8 else 0.0)
        drift = rng.uniform(-0.006, 0.006)
        for word in line.split():
            strokes, reach = _write_word(word, rng)
            y_word = y_mm + drift * x_mm + rng.normal() * 0.18
            for points in strokes:
                wobbled = points + rng.normal(size=points.shape) * 0.012
                slanted = np.column_stack((wobbled[:, 0] + SLANT * wobbled[:, 1], -wobbled[:, 1]))
                paths.append(smooth_path(slanted * X_HEIGHT_MM + [x_mm, y_word]))
            x_mm += (reach + 0.95) * X_HEIGHT_MM
    body = "\n".join(f'  <path d="{data}"/>' for data in paths)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" version="1.1" width="{num(WIDTH_MM)}mm" height="{num(HEIGHT_MM)}mm" '
        f'viewBox="0 0 {num(WIDTH_MM)} {num(HEIGHT_MM)}">\n'
        "<title>A handwritten letter</title>\n<desc>Public domain, CC0 1.0</desc>\n"
        '<g fill="none" stroke="#1b2a6b" stroke-width="0.4" stroke-linecap="round" stroke-linejoin="round">\n'
        f"{body}\n</g>\n</svg>\n"
    )
