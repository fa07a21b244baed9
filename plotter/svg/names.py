"""Names and characters of a drawing, as they may be shown on a terminal and written in one line of a file."""

from __future__ import annotations

import unicodedata

# Controls, line breaks, and what turns the direction of all that follows.
_UNSHOWN = frozenset(("Cc", "Cf", "Cs", "Zl", "Zp"))
# These are of that kind and parts of words: joiners of scripts and pictures.
_JOINERS = "\u200c\u200d"


def in_one_line(name: str) -> str:
    """`name` with a space for each run of what a terminal would obey instead of show."""
    if name.isprintable():
        return name
    kept = [character if character in _JOINERS or not _is_unshown(character) else "\n" for character in name]
    return " ".join(part.strip() for part in "".join(kept).split("\n") if part.strip())


def named(character: str) -> str:
    """A character itself, or its number where it cannot be shown by itself."""
    alone = character.isprintable() and not character.isspace() and not unicodedata.category(character).startswith("M")
    return character if alone else f"U+{ord(character):04X}"


def _is_unshown(character: str) -> bool:
    return unicodedata.category(character) in _UNSHOWN
