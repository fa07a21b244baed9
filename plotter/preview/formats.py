"""What kinds of pictures there are, without the libraries that make them."""

from __future__ import annotations

from pathlib import Path

from plotter.errors import BadInput


def picture_format(path: Path) -> str:
    """`.png` or `.svg`. Raises BadInput for another name."""
    suffix = path.suffix.lower()
    if suffix not in (".png", ".svg"):
        raise BadInput(
            f"a picture's name must end in .png or .svg, not {suffix or 'nothing'!r} ({path.name}); give it one of the two"
        )
    return suffix
