"""Which element a value that cannot be used is from."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import chain
from typing import TYPE_CHECKING, Any

from plotter.errors import BadInput

if TYPE_CHECKING:
    from plotter.svg.walk import Walk


def not_finite(walk: Walk, value: str, near: Any = None, attribute: str = "") -> BadInput:
    """For a `value` that is NaN or infinite: names the element that has it, its line, and the attribute.

    That is `near`, when its `attribute` is known to have it; else `near` or something in it, or the first in the document.
    Where no attribute has the value, as when it is from a style sheet, it is said of `near`.
    """
    where: Iterable[Any] = walk.root.iter() if near is None else chain(near.iter(), walk.root.iter())
    word = re.compile(rf"(?<![\w.+-]){re.escape(value.strip())}(?![\w.])")
    found = ((one, key, text) for one in where if isinstance(one.tag, str) for key, text in one.items() if word.search(text))
    element, key, text = (near, attribute, value) if attribute else next(found, (near, "", ""))
    said = f"{key.rpartition('}')[2]}={text[:60]!r}" if key else f"the value {value!r}"
    if element is None:
        name = "the drawing, perhaps its style sheet,"
    else:
        name = walk.name(element) + (f" on line {element.sourceline}" if element.get("id") else "")
    return BadInput(f"{name} has {said}, which is not finite; correct it")
