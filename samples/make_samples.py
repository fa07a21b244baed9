"""Makes the drawings of this folder again, byte for byte: `python samples/make_samples.py [NAME ...] [--out DIR]`.

Needs numpy. `poster` also needs fontTools and its font; without them it is left out, and said so.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from generators.arcs import arcs
from generators.city import city
from generators.contours import contours
from generators.harbour import harbour
from generators.hilbert import hilbert
from generators.letter import letter
from generators.poster import FontMissing, poster
from generators.rosette import rosette
from generators.shapes import shapes
from generators.stipple import stipple
from generators.streamlines import streamlines
from generators.tree import tree

DRAWINGS: tuple[Callable[[], str], ...] = (
    rosette, poster, contours, stipple, hilbert, city, letter, harbour, shapes, arcs, tree, streamlines,
)  # fmt: skip
SAMPLES = {drawing.__name__: drawing for drawing in DRAWINGS}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which to make, of: {', '.join(SAMPLES)} (default: all)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, metavar="DIR", help="where to (default: here)")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in SAMPLES]
    if unknown:
        parser.error(f"there is no sample called {unknown[0]!r}; there are {', '.join(SAMPLES)}")
    left_out = 0
    for name in options.names or SAMPLES:
        path = options.out / f"{name}.svg"
        try:
            text = SAMPLES[name]()
        except FontMissing as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            left_out += 1
            continue
        path.write_text(text, encoding="utf-8", newline="\n")
        print(f"{path} {path.stat().st_size / 1000:.0f} kB")
    return 1 if left_out else 0


if __name__ == "__main__":
    sys.exit(main())
