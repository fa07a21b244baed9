"""Makes the drawings of this folder again, byte for byte: `python samples/make_samples.py [NAME ...] [--out DIR]`.

Needs numpy. `poster` also needs fontTools and the font it names; without them it is left out, and said so, when no name is given.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from generators.arcs import arcs
from generators.contours import contours
from generators.hilbert import hilbert
from generators.rosette import rosette

SAMPLES: dict[str, Callable[[], str]] = {
    "rosette": rosette,
    "contours": contours,
    "hilbert": hilbert,
    "arcs": arcs,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which to make, of: {', '.join(SAMPLES)} (default: all)")
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parent, metavar="DIR", help="where to (default: beside this file)"
    )
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in SAMPLES]
    if unknown:
        parser.error(f"there is no sample called {unknown[0]!r}; there are {', '.join(SAMPLES)}")
    for name in options.names or SAMPLES:
        path = options.out / f"{name}.svg"
        path.write_text(SAMPLES[name](), encoding="utf-8", newline="\n")
        print(f"{path} {path.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
