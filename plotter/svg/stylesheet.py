"""`<style>` sheets: which declarations hold for an element, in the order of the cascade.

Selectors that name only a type, classes and an id are looked up in a dict; the rest goes through cssselect2.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import cssselect2
import tinycss2

from output.wording import counted
from plotter.errors import BadInput
from plotter.svg.notes import Notes

# name, value, important
Declaration = tuple[str, str, bool]

_SIMPLE = re.compile(r"^(?P<type>[A-Za-z][\w-]*|\*)?(?P<rest>(?:[.#][A-Za-z_][\w-]*)*)$")
_PART = re.compile(r"[.#][A-Za-z_][\w-]*")
# Making a selector ready takes as long as this many tests of it.
_COMPILING = 400
_PLAIN = re.compile(r"[\"'\\{}\[\]@!]|/\*|data:")


@dataclass(frozen=True, slots=True)
class _Rule:
    rank: tuple[Any, int]
    declarations: tuple[Declaration, ...]
    type: str | None = None
    id: str | None = None
    classes: frozenset[str] = frozenset()
    selector: Any = None


class Stylesheet:
    """All the document's style sheets. `matched` gives the rules for an element; it is empty and quick without sheets."""

    def __init__(self, root: Any, texts: list[str], notes: Notes, test_budget: int) -> None:
        self._by_key: dict[str, list[_Rule]] = {}
        self._complex: list[_Rule] = []
        self._wrappers: dict[Any, Any] | None = None
        self._ancestors: dict[Any, Any] = {}
        # Whether no selector asks for siblings, so that elements need not be numbered.
        self._is_downward = True
        self._root = root
        self._notes = notes
        self._order = 0
        self._tests_left = self._test_budget = test_budget
        for text in texts:
            self._read(tinycss2.parse_stylesheet(text, skip_comments=True, skip_whitespace=True))
        self.uses_ids = any(key.startswith("#") for key in self._by_key) or any(
            rule.id for rules in self._by_key.values() for rule in rules
        )
        self.is_empty = not self._by_key and not self._complex
        self.is_complex = bool(self._complex)

    def _read(self, rules: list[Any]) -> None:
        for rule in rules:
            if rule.type == "qualified-rule":
                self._rule(rule)
            elif rule.type == "at-rule" and rule.lower_at_keyword == "media" and rule.content is not None:
                media = tinycss2.serialize(rule.prelude).strip().lower()
                if media in ("", "all", "screen", "print"):
                    self._read(tinycss2.parse_rule_list(rule.content, skip_comments=True, skip_whitespace=True))
            elif rule.type == "at-rule" and rule.lower_at_keyword == "import":
                self._notes.add("{count} @import [rule was|rules were] not followed: nothing outside the file is read")

    def _rule(self, rule: Any) -> None:
        declarations = tuple(_declarations(rule.content))
        if not declarations:
            return
        for text in (
            tinycss2.serialize(rule.prelude).split(",")
            if "(" not in tinycss2.serialize(rule.prelude)
            else [tinycss2.serialize(rule.prelude)]
        ):
            self._selector(text.strip(), declarations)

    def _selector(self, text: str, declarations: tuple[Declaration, ...]) -> None:
        self._order += 1
        match = _SIMPLE.match(text)
        if match is not None and text:
            parts = _PART.findall(match["rest"])
            ids = [part[1:] for part in parts if part[0] == "#"]
            classes = frozenset(part[1:] for part in parts if part[0] == ".")
            kind = None if match["type"] in (None, "*") else match["type"]
            if len(ids) <= 1:
                specificity = (len(ids), len(parts) - len(ids), int(kind is not None))
                rule = _Rule((specificity, self._order), declarations, kind, ids[0] if ids else None, classes)
                key = f"#{ids[0]}" if ids else f".{min(classes)}" if classes else kind or "*"
                self._by_key.setdefault(key, []).append(rule)
                return
        try:
            self._spend(_COMPILING)
            for selector in cssselect2.compile_selector_list(text):
                if any(sign in text for sign in "+~:"):
                    self._is_downward = False
                if not selector.never_matches and selector.pseudo_element is None:
                    self._complex.append(_Rule((selector.specificity, self._order), declarations, selector=selector))
        except cssselect2.SelectorError:
            self._notes.add(
                "{count} style [rule has|rules have] a selector that was not understood ({names}) and [was|were] left out",
                text[:40],
            )

    def matched(self, element: Any, kind: str) -> tuple[_Rule, ...]:
        """Rules that hold for `element` of local name `kind`, weakest first."""
        found = list(self._by_key.get("*", ())) + list(self._by_key.get(kind, ()))
        name = element.get("id")
        classes = set((element.get("class") or "").split())
        if name:
            found += self._by_key.get("#" + name, ())
        for one in classes:
            found += self._by_key.get("." + one, ())
        found = [
            rule
            for rule in found
            if (rule.type is None or rule.type == kind) and (rule.id is None or rule.id == name) and rule.classes <= classes
        ]
        if self._complex:
            wrapper = self._wrapper(element)
            if wrapper is not None:
                found += self._tested(wrapper, kind, name, classes)
        found.sort(key=lambda rule: rule.rank)
        return tuple(found)

    def _tested(self, wrapper: Any, kind: str, name: str | None, classes: set[str]) -> list[_Rule]:
        """Rules whose selectors cssselect2 finds to hold; only those are tried whose last part can fit the element."""
        found = []
        for rule in self._complex:
            last = rule.selector
            if last.local_name not in (None, kind) or last.id not in (None, name) or last.class_name not in (None, *classes):
                continue
            self._spend(1)
            if last.test(wrapper):
                found.append(rule)
        return found

    def _spend(self, tests: int) -> None:
        self._tests_left -= tests
        if self._tests_left < 0:
            raise BadInput(
                f"the style sheets need more than {counted(self._test_budget, 'test')} of a selector on an element; "
                "simplify them or raise --max-selector-tests"
            )

    def _wrapper(self, element: Any) -> Any:
        if self._is_downward:
            return self._chain(element)
        if self._wrappers is None:
            top = cssselect2.ElementWrapper.from_xml_root(self._root)
            self._wrappers = {wrapper.etree_element: wrapper for wrapper in top.iter_subtree()}
        return self._wrappers.get(element)

    def _chain(self, element: Any) -> Any:
        """A wrapper that knows its ancestors only; those are remembered, as they have many children."""
        parent = element.getparent()
        if parent is None or element is self._root:
            return cssselect2.ElementWrapper.from_xml_root(element)
        above = self._ancestors.get(parent)
        if above is None:
            above = self._ancestors[parent] = self._chain(parent)
        return cssselect2.ElementWrapper(element, above, 0, None, False)


def _declarations(content: Any) -> list[Declaration]:
    items = tinycss2.parse_blocks_contents(content, skip_comments=True, skip_whitespace=True)
    return [
        (item.lower_name, tinycss2.serialize(item.value).strip(), item.important)
        for item in items
        if item.type == "declaration"
    ]


def parse_style_attribute(text: str) -> list[Declaration]:
    """Declarations of a style attribute, in order."""
    if _PLAIN.search(text):
        return _declarations(text)
    found = []
    for part in text.split(";"):
        name, colon, value = part.partition(":")
        if colon:
            found.append((name.strip().lower(), value.strip(), False))
    return found
