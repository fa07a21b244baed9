"""What is drawn by reference (`use`), and what stands in coordinates of its own: inner svg elements and symbols."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from output.wording import counted
from plotter.errors import BadInput
from plotter.svg.clip import Clip
from plotter.svg.context import Context
from plotter.svg.document import XLINK
from plotter.svg.matrix import is_singular, multiply, translation
from plotter.svg.viewport import fit_view_box

if TYPE_CHECKING:
    from plotter.svg.walk import Walk

_HREF = f"{{{XLINK}}}href"


class References:
    """Draws referenced elements through the walk, so that what they hold is read like everything else."""

    def __init__(self, walk: Walk) -> None:
        self._walk = walk
        self._by_id: dict[str, Any] | None = None
        self._use_count = 0

    def use(self, element: Any, inner: Context) -> None:
        """A `use` with what it refers to. Raises BadInput beyond the budgets."""
        walk = self._walk
        href = element.get("href")
        if href is None:
            href = element.get(_HREF) or element.get("xlink:href") or ""
        target = self._find(href, "<use>")
        if target is None:
            return
        # A cycle closes where the target is being drawn already: through a use, or because a use on the way lies inside it.
        drawn = (*inner.uses, element)
        if any(target is one for one in drawn) or any(target is above for one in drawn for above in one.iterancestors()):
            walk.notes.add("{count} <use> [element refers to itself and was|elements refer to themselves and were] left out")
            return
        self._count_use()
        frame = inner.frame
        x = walk.number(element, "x", walk.specified(element, "x", inner.style), frame, frame.width) or 0.0
        y = walk.number(element, "y", walk.specified(element, "y", inner.style), frame, frame.height) or 0.0
        matrix = multiply(inner.matrix, translation(x, y)) if x or y else inner.matrix
        moved = replace(inner, matrix=matrix, uses=(*inner.uses, element, target))
        kind = walk.kind(target.tag)
        if kind not in ("symbol", "svg"):
            walk.element(target, moved)
            return
        style = walk.cascade.style(target, kind, target.items(), moved.style, moved.frame)
        if not style.displayed and kind == "svg":
            return
        own = walk.transforms.own(target, style, moved.frame)
        moved = replace(moved, style=style, matrix=multiply(matrix, own) if own else matrix, level=moved.level + 1)
        if moved.level > walk.options.budgets.nesting:
            raise BadInput(
                f"{walk.name(element)} is nested deeper than {counted(walk.options.budgets.nesting, 'level')}; "
                "raise --max-nesting (at most 400)"
            )
        self.viewport(target, moved, *(element.get(name) or target.get(name) for name in ("width", "height")))

    def _count_use(self) -> None:
        """Counts one expansion of a referenced element. Raises BadInput beyond the budget."""
        self._use_count += 1
        if self._use_count > self._walk.options.budgets.uses:
            limit = self._walk.options.budgets.uses
            raise BadInput(f"the drawing expands more than {limit} <use> elements; raise --max-uses if it is meant")

    def viewport(self, element: Any, context: Context, width_text: str | None, height_text: str | None) -> None:
        """The content of an inner svg or a used symbol: new coordinates, clipped unless overflow is visible."""
        walk, frame = self._walk, context.frame
        kind = walk.kind(element.tag)
        x = y = 0.0
        if kind == "svg":
            x = walk.number(element, "x", element.get("x"), frame, frame.width) or 0.0
            y = walk.number(element, "y", element.get("y"), frame, frame.height) or 0.0
        width = walk.number(element, "width", width_text, frame, frame.width)
        height = walk.number(element, "height", height_text, frame, frame.height)
        width = frame.width if width is None else width
        height = frame.height if height is None else height
        if width <= 0 or height <= 0:
            return
        matrix = multiply(context.matrix, translation(x, y)) if x or y else context.matrix
        clips = context.clips
        if context.style.own.get("overflow", "hidden") not in ("visible", "auto"):
            clips = (*clips, Clip.of_box(matrix, 0.0, 0.0, width, height))
        box = walk.view_box(element)
        if box is not None:
            if box[2] <= 0 or box[3] <= 0:
                return
            matrix = multiply(matrix, fit_view_box(box, width, height, element.get("preserveAspectRatio")))
            width, height = box[2], box[3]
        if is_singular(matrix):
            return
        walk.children(element, replace(context, matrix=matrix, clips=clips, frame=replace(frame, width=width, height=height)))

    def _find(self, href: str, who: str) -> Any:
        """The element that `#id` names, or None with a note."""
        href = href.strip()
        if not href.startswith("#"):
            self._walk.notes.add(
                f"{{count}} {who} [element refers|elements refer] to something outside the file ({{names}}): it is never read",
                href[:60],
            )
            return None
        target = self.by_id(href[1:])
        if target is None:
            self._walk.notes.add(
                f"{{count}} {who} [element refers|elements refer] to something that is not there ({{names}})", href[:60]
            )
        return target

    def by_id(self, name: str) -> Any:
        """The first element with this id, or None."""
        if self._by_id is None:
            self._by_id = {}
            for one in self._walk.root.iter():
                own = one.get("id")
                if own is not None:
                    self._by_id.setdefault(own, one)
        return self._by_id.get(name)
