"""How much a document's `<use>` elements will expand to, counted before anything is expanded."""

from __future__ import annotations

from typing import Any

from plotter.svg.document import XLINK

_HREF = f"{{{XLINK}}}href"


def count_uses(root: Any, limit: int) -> int:
    """Expansions of `<use>` elements below `root`, cycles counted once; stops at about `limit`. Takes linear time."""
    uses = [element for element in root.iter("{*}use", "use")]
    if not uses:
        return 0
    by_id: dict[str, Any] = {}
    for element in root.iter():
        name = element.get("id")
        if name is not None:
            by_id.setdefault(name, element)
    inside: dict[Any, list[Any]] = {}
    for use in uses:
        for ancestor in (use, *use.iterancestors()):
            inside.setdefault(ancestor, []).append(use)
    done: dict[Any, int] = {}
    total = 0
    for use in uses:
        # What lies in <defs> or <symbol> is only expanded where it is referred to.
        if any(ancestor.tag.rpartition("}")[2] in _REFERRED for ancestor in use.iterancestors()):
            continue
        total += _expansions(use, by_id, inside, done, limit)
        if total > limit:
            break
    return total


_REFERRED = frozenset(("defs", "symbol", "clipPath", "mask", "marker", "pattern"))


def _expansions(use: Any, by_id: dict[str, Any], inside: dict[Any, list[Any]], done: dict[Any, int], limit: int) -> int:
    """1 for `use`, and all expansions below what it refers to; without recursion, as chains may be long."""
    stack = [use]
    while stack:
        one = stack[-1]
        if done.get(one, -1) >= 0:
            stack.pop()
            continue
        href = (one.get("href") or one.get(_HREF) or "").strip()
        below = inside.get(by_id.get(href[1:]), []) if href.startswith("#") else []
        if one not in done:
            done[one] = -1
            fresh = [child for child in below if child not in done]
            if fresh:
                stack += fresh
                continue
        done[one] = min(limit + 1, 1 + sum(max(0, done.get(child, 0)) for child in below))
        stack.pop()
    return done[use]
