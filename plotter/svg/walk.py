"""The walk through a document: every rendered shape, with its style, transform, layer and clips, in painting order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from output.wording import counted
from plotter.errors import BadInput
from plotter.svg.alike import Alike
from plotter.svg.blame import not_finite
from plotter.svg.clip import Clip
from plotter.svg.clip_paths import ClipPaths
from plotter.svg.collector import Collector, Shape, Spent
from plotter.svg.colors import Paint
from plotter.svg.context import Context, PendingText
from plotter.svg.dashes import dashes_of
from plotter.svg.document import SVG
from plotter.svg.expansion import count_uses
from plotter.svg.flatten import Polylines
from plotter.svg.layers import Layering
from plotter.svg.lengths import MM_PER_IN, Frame, NotFinite, parse_length
from plotter.svg.marker_walk import Markers
from plotter.svg.matrix import IDENTITY, Matrix, is_singular, multiply
from plotter.svg.notes import Notes
from plotter.svg.options import ReadOptions
from plotter.svg.references import References
from plotter.svg.shapes import is_shape, outline, path_text
from plotter.svg.style import GEOMETRY, Cascade, Style, root_style
from plotter.svg.transforms import Transforms
from plotter.svg.viewport import fit_view_box, parse_view_box

_CONTAINERS = frozenset(("g", "a"))
_NEVER = frozenset(
    (
        "defs",
        "symbol",
        "clipPath",
        "mask",
        "marker",
        "pattern",
        "linearGradient",
        "radialGradient",
        "filter",
        "title",
        "desc",
        "metadata",
        "style",
        "script",
        "font",
        "font-face",
        "cursor",
        "view",
        "animate",
        "animateTransform",
        "animateMotion",
        "set",
        "solidColor",
        "hatch",
    )
)
# Page of a drawing that says neither a size nor a viewBox, in px.
_NO_SIZE_PX = 100.0


class Walk:
    """Walks one document. After `run`, the outlines are with the collector and the layers with `layering`."""

    def __init__(self, root: Any, cascade: Cascade, layering: Layering, options: ReadOptions, notes: Notes) -> None:
        self.root = root
        self.cascade = cascade
        self.layering = layering
        self.options = options
        self.notes = notes
        self.spent = Spent()
        self.collector = Collector(options, notes, self.name, self.spent)
        self.width_mm = self.height_mm = 0.0
        self.texts: list[PendingText] = []
        self.clip_paths = ClipPaths(self)
        self.markers = Markers(self)
        self.references = References(self)
        self.transforms = Transforms(notes, self.name)
        self.gathering = False
        self._root_style: Style | None = None
        self._styles_in_place: dict[Any, Style] = {}
        self._kinds: dict[Any, str] = {}
        self._element_count = 0

    # ---- page

    def run(self) -> None:
        """Raises BadInput."""
        limit = self.options.budgets.uses
        if count_uses(self.root, limit) > limit:
            raise BadInput(f"the drawing expands more than {limit} <use> elements; raise --max-uses if it is meant")
        px_per_in = self.options.px_per_in
        mm = MM_PER_IN / px_per_in
        box = self.view_box(self.root)
        sized = box is not None and box[2] > 0 and box[3] > 0
        outer = Frame(box[2] if sized else _NO_SIZE_PX, box[3] if sized else _NO_SIZE_PX, 16.0, px_per_in)
        width, height = self._page_size(box, outer)
        self.width_mm, self.height_mm = width * mm, height * mm
        inner = Frame(width, height, 16.0, px_per_in)
        style = self.cascade.style(self.root, "svg", self.root.items(), root_style(inner), inner)
        matrix: Matrix = (mm, 0.0, 0.0, mm, 0.0, 0.0)
        own = self.transforms.own(self.root, style, inner)
        if own is not None:
            matrix = multiply(matrix, own)
        if box is not None and box[2] > 0 and box[3] > 0:
            matrix = multiply(matrix, fit_view_box(box, width, height, self.root.get("preserveAspectRatio")))
            inner = Frame(box[2], box[3], style.font_px, px_per_in)
        elif box is not None:
            self.notes.add("the viewBox has no area, so nothing is drawn")
            return
        if not style.displayed and self.options.hidden != "all":
            self.notes.add("the whole drawing is hidden (display:none); --hidden all draws it")
            return
        self.children(self.root, Context(matrix, style, replace(inner, font_px=style.font_px)))

    def _page_size(self, box: Any, outer: Frame) -> tuple[float, float]:
        texts = [self.specified(self.root, name) for name in ("width", "height")]
        sizes = [
            self.number(self.root, name, text, outer, share)
            for name, text, share in zip(("width", "height"), texts, (outer.width, outer.height), strict=True)
        ]
        missing = [size is None or (text or "").strip().endswith("%") for size, text in zip(sizes, texts, strict=True)]
        width, height = sizes
        if box and box[2] > 0 and box[3] > 0:
            # CSS sizing of a replaced element: one size and the viewBox's proportions give the other.
            if missing[0] and not missing[1] and texts[0] is None and height:
                width = height * box[2] / box[3]
            if missing[1] and not missing[0] and texts[1] is None and width:
                height = width * box[3] / box[2]
        elif all(missing):
            self.notes.add("the drawing has no size and no viewBox; its page was taken as 100 px square")
        width = outer.width if width is None else width
        height = outer.height if height is None else height
        if width <= 0 or height <= 0:
            raise BadInput(f"the page is {width:g} px wide and {height:g} px high; give the <svg> a positive width and height")
        return width, height

    def view_box(self, element: Any) -> Any:
        try:
            return parse_view_box(element.get("viewBox"))
        except NotFinite as error:
            raise not_finite(self, str(error), element) from None

    # ---- elements

    def children(self, element: Any, context: Context) -> None:
        alike = Alike(self, context)
        left = iter(element)
        while (child := next(left, None)) is not None:
            try:
                if not alike.take(child):
                    self.element(child, context)
                elif alike.may_run:
                    left = alike.take_run(child)
            except NotFinite as error:
                raise not_finite(self, str(error), child) from None

    def element(self, element: Any, context: Context) -> None:
        tag = element.tag
        kind = self._kinds.get(tag)
        if kind is None:
            kind = self._kinds[tag] = self.kind(tag)
        if not kind or kind in _NEVER:
            return
        self.count_elements()
        items = element.items()
        style = self.cascade.style(element, kind, items, context.style, context.frame)
        if not style.displayed and self.options.hidden != "all":
            if kind in _CONTAINERS:
                self.layering.enter(element, context.level + 1, context.layer, hidden=True)
            self.notes.add("{count} [element is|elements are] hidden (display:none) and left out; --hidden all draws [it|them]")
            return
        attributes = dict(items)
        matrix = context.matrix
        if "transform" in attributes or "transform" in style.own:
            own = self.transforms.own(element, style, context.frame)
            if own is None:
                own = IDENTITY
            matrix = multiply(matrix, own)
            if is_singular(matrix):
                self.notes.add("{count} [element has|elements have] a transform that leaves no area and [was|were] left out")
                return
        clips = context.clips
        if style.own and not self.gathering:
            if not self._notes_on_effects(element, kind, style):
                return
            if "clip-path" in style.own:
                clips = self.clip_paths.add(clips, element, kind, attributes, style, matrix, context)
        if is_shape(kind):
            self.shape(element, kind, attributes, style, matrix, clips, context)
            return
        if context.level >= self.options.budgets.nesting:
            raise BadInput(
                f"{self.name(element)} is nested deeper than {counted(self.options.budgets.nesting, 'level')}, counting "
                "each <use>; raise --max-nesting (at most 400) or flatten its groups"
            )
        frame = context.frame if style.font_px == context.frame.font_px else replace(context.frame, font_px=style.font_px)
        inner = Context(matrix, style, frame, context.layer, clips, context.level + 1, context.uses)
        self.container(element, kind, inner)

    def count_elements(self, count: int = 1) -> None:
        """Counts elements that may be drawn. Raises BadInput beyond the budget."""
        self._element_count += count
        if self._element_count > self.options.budgets.elements:
            raise BadInput(
                f"the drawing has more than {counted(self.options.budgets.elements, 'element')}, counting each <use>; "
                "raise --max-elements if it is meant"
            )

    def kind(self, tag: Any) -> str:
        """The local name of an SVG element; empty for what is none."""
        if not isinstance(tag, str):
            return ""
        space, _, local = tag.rpartition("}")
        return local if space in ("", "{" + SVG) else ""

    def container(self, element: Any, kind: str, inner: Context) -> None:
        if kind in _CONTAINERS:
            if inner.layer is None and not inner.uses:
                inner = replace(inner, layer=self.layering.enter(element, inner.level, None, hidden=False))
                if inner.layer is not None and self.layering.layers[inner.layer].is_documentation:
                    self.notes.add(
                        "{count} [layer is|layers are] documentation (named with a % in front) and left out: {names}",
                        self.layering.layers[inner.layer].name,
                    )
                    return
            self.children(element, inner)
        elif kind == "svg":
            self.references.viewport(element, inner, element.get("width"), element.get("height"))
        elif kind == "use":
            self.references.use(element, inner)
        elif kind == "switch":
            self._switch(element, inner)
        elif kind == "image":
            self.notes.add("{count} [image was|images were] left out: a pen draws no pixels")
        elif kind == "foreignObject":
            self.notes.add("{count} foreignObject [element|elements] (HTML inside the drawing) [was|were] left out")
        elif kind == "text":
            self._text(element, inner)
        else:
            self.notes.add("{count} unknown [element was|elements were] left out ({names})", f"<{kind}>")

    def _switch(self, element: Any, inner: Context) -> None:
        """The first child whose conditions hold (SVG 2, 5.9)."""
        for child in element:
            kind = self.kind(child.tag)
            if not kind or kind in _NEVER:
                continue
            languages = child.get("systemLanguage")
            if languages is not None and not any(word.strip().lower().split("-")[0] == "en" for word in languages.split(",")):
                continue
            if child.get("requiredExtensions") is not None or (kind == "foreignObject"):
                continue
            self.element(child, inner)
            return

    def _notes_on_effects(self, element: Any, kind: str, style: Style) -> bool:
        """Says what of an element's effects cannot be drawn; False where it is wholly transparent and so not drawn at all."""
        own = style.own
        if own.get("opacity") in ("0", "0%", "0.0") and kind in _CONTAINERS and self.options.hidden != "all":
            self.notes.add("{count} [group is|groups are] wholly transparent and left out; --hidden all draws [it|them]")
            return False
        for effect, what in (
            ("mask", "[mask was|masks were] ignored: what [it hides|they hide] is drawn"),
            ("filter", "[filter was|filters were] ignored"),
        ):
            if own.get(effect, "none") != "none":
                self.notes.add(f"{{count}} {what} ({{names}})", self.name(element))
        return True

    # ---- shapes

    def shape(
        self,
        element: Any,
        kind: str,
        attributes: dict[str, str],
        style: Style,
        matrix: Matrix,
        clips: tuple[Clip, ...],
        context: Context,
    ) -> None:
        """Hands one shape and its markers to the collector."""
        frame = context.frame if style.font_px == context.frame.font_px else replace(context.frame, font_px=style.font_px)
        if style.own:
            attributes.update((name, value) for name, value in style.own.items() if name in GEOMETRY)
        found = outline(kind, attributes, frame)
        if found is None:
            return
        drawn = self._is_drawn(style)
        layer = self.layer_of(context)
        if drawn:
            dashes = None
            if "stroke-dasharray" in style.inherited and not self.gathering:
                dashes = dashes_of(style, frame, attributes.get("pathLength"))
            self.collector.add(element, Shape(style, layer, matrix, clips, dashes), found)
        if not self.gathering and style.visible and self.markers.wanted(kind, style):
            here = Context(matrix, style, frame, layer, clips, context.level + 1, context.uses)
            self.markers.draw(element, path_text(found), here)

    def layer_of(self, context: Context) -> int:
        if context.layer is not None:
            return context.layer
        return 0 if self.gathering else self.layering.outside()

    def _is_drawn(self, style: Style) -> bool:
        hidden = self.options.hidden
        if not style.visible and (hidden != "all" or self.gathering):
            self.note("{count} [shape is|shapes are] invisible (visibility) and left out; --hidden all draws [it|them]")
            return False
        if self.gathering or hidden != "skip":
            return True
        stroke, fill = self._painted(style.stroke), self._painted(style.fill)
        if not stroke and not fill:
            self.notes.add(
                "{count} [shape has|shapes have] neither fill nor stroke: left out; --hidden unpainted draws [it|them]"
            )
            return False
        if not stroke and self.options.fills == "skip":
            self.notes.add(
                "{count} [shape is|shapes are] only filled and left out; --fills outline draws [its outline|their outlines]"
            )
            return False
        return True

    def _painted(self, paint: Paint | None) -> bool:
        """Whether a paint shows. A gradient or pattern that is not there paints nothing, unless it has a fallback."""
        if paint is None or paint.server is None:
            return paint is not None
        if self.references.by_id(paint.server) is None:
            return paint.has_fallback
        self.notes.add(
            "{count} [shape is|shapes are] painted with gradients or patterns, of which a pen draws the outline only"
        )
        return True

    def note(self, template: str, name: str | None = None) -> None:
        """A note, unless shapes are only gathered for their area."""
        if not self.gathering:
            self.notes.add(template, name)

    def gather(self, run: Callable[[], None]) -> tuple[list[Polylines], list[Shape]]:
        """The outlines that `run` hands over, painted or not, without markers and dashes; the drawing gets none of them."""
        outer = self.collector, self.gathering
        self.collector, self.gathering = Collector(self.options, self.notes, self.name, self.spent), True
        try:
            run()
            return self.collector.finish(), self.collector.shapes
        finally:
            self.collector, self.gathering = outer

    def _text(self, element: Any, inner: Context) -> None:
        if self.gathering:
            self.notes.add("{count} [text|texts] inside clip paths or used for [its|their] size [was|were] left out")
            return
        if not any(text.strip() for text in element.itertext()):
            return
        if self.options.text == "skip":
            self.notes.add("{count} [text was|texts were] left out; --text outline or --text single draws [it|them]")
            return
        layer = self.layer_of(inner)
        shape = Shape(inner.style, layer, inner.matrix, inner.clips)
        self.texts.append(PendingText(element, inner, self.collector.reserve(element, shape), layer))

    def style_in_place(self, element: Any) -> Style:
        """The style of an element as its own ancestors make it, whoever refers to it."""
        known = self._styles_in_place.get(element)
        if known is not None:
            return known
        chain = [element, *element.iterancestors()]
        frame = Frame(self.width_mm, self.height_mm, 16.0, self.options.px_per_in)
        if self._root_style is None:
            self._root_style = root_style(frame)
        style = self._root_style
        for one in reversed(chain):
            style = self.cascade.style(one, self.kind(one.tag), one.items(), style, frame)
        self._styles_in_place[element] = style
        return style

    # ---- help

    def number(self, element: Any, attribute: str, text: str | None, frame: Frame, percent_of: float) -> float | None:
        try:
            return parse_length(text, frame, percent_of)
        except NotFinite as error:
            raise not_finite(self, str(error), element, attribute) from None

    def specified(self, element: Any, name: str, style: Style | None = None) -> str | None:
        """A geometry attribute, or the property that overrides it."""
        value = style.own.get(name) if style is not None else None
        found = element.get(name) if value is None else value
        return None if found is None or found.strip() == "auto" else found

    def name(self, element: Any) -> str:
        kind = self.kind(element.tag) or "?"
        name = element.get("id")
        return f"<{kind} id={name!r}>" if name else f"<{kind}> on line {element.sourceline}"
