"""Elements that follow each other and differ in nothing but what may differ, asked of the parser's own tree all at once.

Large drawings have a hundred thousand such elements under one parent. To make an object of each and list its attributes takes
longer than all else that is done with it; XPath gives one attribute of all of them in a list.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import chain, islice
from typing import Any

from lxml import etree


class Run:
    """The siblings that follow `element` directly and have the same name, attributes of the same names, and the same values of
    those whose names are in `same`. `common` are those attributes."""

    def __init__(self, element: Any, same: Collection[str]) -> None:
        self._element = element
        self._elements: list[Any] = []  # made when one is asked for
        self._prefixes: dict[str, str] = {}  # for each namespace
        items = element.items()
        self.common = [item for item in items if item[0] in same]
        self._free = [name for name, _ in items if name not in same]
        alike = [f"self::{self._qualified(element.tag)}", f"count(@*)={len(items)}"]
        alike += [f"@{self._qualified(name)}" for name in self._free]
        alike += [f"@{self._qualified(name)}=$v{i}" for i, (name, _) in enumerate(self.common)]
        values = {f"v{i}": value for i, (_, value) in enumerate(self.common)}
        other = self._asked(element, f"following-sibling::*[not({' and '.join(alike)})][1]", **values)
        self._next = other[0] if other else None
        self._count: int = round(self._asked(element, "count(following-sibling::*)"))
        if self._next is not None:
            self._count -= 1 + round(self._asked(self._next, "count(following-sibling::*)"))

    def values(self, name: str) -> list[str] | None:
        """The attribute `name` of each; None where they need not have it."""
        if name not in self._free:
            return None
        which = "" if self._next is None else f"[position() <= {self._count}]"
        found: list[str] = self._asked(self._element, f"following-sibling::*{which}/@{self._qualified(name)}")
        if len(found) != self._count:
            raise AssertionError(f"{self._count} elements like <{self._element.tag}> have {len(found)} of {name}")
        return found

    def element(self, number: int) -> Any:
        """The element with this number, from 0."""
        if not self._elements:
            self._elements = list(islice(self._element.itersiblings("*"), self._count))
        return self._elements[number]

    def rest(self) -> Iterator[Any]:
        """What follows the run."""
        return iter(()) if self._next is None else chain((self._next,), self._next.itersiblings())

    def _asked(self, element: Any, question: str, **values: str) -> Any:
        spaces = {prefix: space for space, prefix in self._prefixes.items()}
        return etree.XPath(question, namespaces=spaces or None, smart_strings=False)(element, **values)

    def _qualified(self, name: str) -> str:
        space, _, local = name.rpartition("}")
        if space:
            return f"{self._prefixes.setdefault(space[1:], f's{len(self._prefixes)}')}:{local}"
        return f"*[name()='{name}']" if ":" in name else name  # a prefix that the document does not declare
