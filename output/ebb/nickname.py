"""What a board can be called: its own limit, and what its list of answers and the USB's names leave of that."""

from __future__ import annotations

LONGEST = 16


def wrong_nickname(name: str) -> str | None:
    """Why a board cannot keep `name`, with the next step; None when it can. "" takes a name away."""
    legible = all(" " <= letter <= "~" and letter not in ",'\"" for letter in name)
    if len(name) <= LONGEST and legible and name != "OK":
        return None
    return (
        f"a nickname has at most {LONGEST} letters, digits, spaces or signs, no comma or quotes, not {name!r}: choose another"
    )
