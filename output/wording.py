"""Numbers in sentences: one stroke, two strokes."""

from __future__ import annotations

import re

_EITHER = re.compile(r"\[([^\[\]|]*)\|([^\[\]|]*)\]")


def counted(count: int, one: str, many: str | None = None) -> str:
    """`1 stroke`, `0 strokes`; `many` is the plural where it is more than an added s."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def agreeing(text: str, count: int) -> str:
    """`text` with the first word of each `[is|are]` when it is about one thing, else with the second."""
    return _EITHER.sub(lambda words: words[1 if count == 1 else 2], text)
