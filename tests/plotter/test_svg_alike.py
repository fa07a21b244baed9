"""Shapes that are alike are read without being looked at one by one: what is read is the same, and what is said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.geometry.stroke import Stroke
from plotter.svg import alike, collector
from plotter.svg.alike import Alike
from plotter.svg.ellipses import flatten_ellipses, point_counts, usual
from plotter.svg.flatten import flatten
from plotter.svg.options import Budgets, ReadOptions
from plotter.svg.path_segments import resolve
from plotter.svg.path_tokens import ARITY, Commands, _plain_decimals, parse_paths
from plotter.svg.read import read_drawing
from plotter.svg.shapes import ellipses_as_path

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="100mm" viewBox="0 0 100 100"{}>{}</svg>'

PAINTS = ("", 'stroke="red"', 'stroke="blue" fill="none"', 'fill="none"', 'style="stroke:#123456"', 'stroke="url(#g)"')
OTHERS = (
    "",
    'transform="rotate(20 5 5)"',
    'transform="nonsense"',
    'transform="scale(0)"',
    'stroke-dasharray="1 0.5" stroke="red"',
    'visibility="hidden"',
    'display="none"',
    'opacity="0"',
    'class="c"',
    'font-size="3"',
    'clip-path="url(#clip)"',
    'marker-end="url(#m)" stroke="red"',
)
SHAPES = (
    '<line x1="1" y1="2" x2="{0}" y2="{1}" {2}/>',
    '<line x1="1" y2="{1}" x2="{0}" {2}/>',
    '<line x1="10%" y1="2mm" x2="{0}" y2="{1}" {2}/>',
    '<circle cx="{0}" cy="{1}" r="2" {2}/>',
    '<circle cx="{0}" cy="{1}" r="0" {2}/>',
    '<circle cx="{0}" r="1e-12" cy="3" {2}/>',
    '<circle cx="{0}" cy="{1}" r="3%" {2}/>',
    '<ellipse cx="{0}" cy="{1}" rx="2" ry="3" {2}/>',
    '<rect x="{0}" y="{1}" width="3" height="4" {2}/>',
    '<path d="M1 2L{0} {1}" {2}/>',
    '<path d="" {2}/>',
    '<path d="M1 1 L{0} broken" {2}/>',
    '<polyline points="1,2 {0},{1} 7,8" {2}/>',
    '<polygon points="1,2 {0},{1} 7,8" {2}/>',
    '<g id="layer{0}"><path d="M0 0L{0} {1}" {2}/></g>',
    "<text>{0}</text>",
)
DEFS = (
    '<linearGradient id="g"/><clipPath id="clip"><rect width="50" height="50"/></clipPath>'
    '<marker id="m" markerWidth="3" markerHeight="3"><path d="M0 0L1 1"/></marker>'
)
SHEETS = (
    "",
    "<style>.c{stroke:green}</style>",
    "<style>path + path{stroke:green}</style>",
    "<style>circle{r:5;stroke:red}</style>",
)


@st.composite
def documents(draw: st.DrawFn) -> bytes:
    """Shapes of a few kinds, often enough one like the other: the third of a kind is the first that is not looked at."""
    kinds = draw(st.lists(st.tuples(*map(st.sampled_from, (SHAPES, PAINTS, OTHERS))), min_size=1, max_size=3))
    kinds = [(shape, paint, "" if "stroke" in paint and "stroke=" in other else other) for shape, paint, other in kinds]
    order = [*draw(st.permutations(range(len(kinds)))) * 4, *draw(st.lists(st.integers(0, len(kinds) - 1), max_size=6))]
    shapes = "".join(kinds[i][0].format(1 + at, 90 - 2 * at, f"{kinds[i][1]} {kinds[i][2]}") for at, i in enumerate(order))
    return HEAD.format(draw(st.sampled_from(("", ' stroke="black"'))), DEFS + draw(st.sampled_from(SHEETS)) + shapes).encode()


def said(content: bytes, options: ReadOptions) -> tuple[object, list[Stroke]]:
    drawing = read_drawing(content, options)
    layers = [(layer.number, layer.name, layer.color, len(layer.strokes)) for layer in drawing.layers]
    return (drawing.warnings, drawing.file_layers, layers), [stroke for layer in drawing.layers for stroke in layer.strokes]


@settings(max_examples=300)
@given(
    documents(),
    st.sampled_from(
        [{}, {"hidden": "all"}, {"hidden": "unpainted"}, {"fills": "skip"}, {"occlude": True}, {"fills": "close", "crop": True}]
    ),
    st.booleans(),
)
def test_what_is_read_is_the_same(content: bytes, changes: dict[str, object], in_runs: bool) -> None:
    options = ReadOptions(text="skip", **changes)  # type: ignore[arg-type]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Alike, "take", lambda *_: False)
        facts, strokes = said(content, options)
    with pytest.MonkeyPatch.context() as patch:
        if in_runs:
            patch.setattr(alike, "_FIRST_LOOK", 1)
            patch.setattr(alike, "_LOOK_AGAIN", 1)
        facts_alike, strokes_alike = said(content, options)
    assert facts_alike == facts
    for one, other in zip(strokes, strokes_alike, strict=True):
        assert one.color == other.color
        assert np.array_equal(one.corners, other.corners)  # type: ignore[arg-type]
        assert one.points_mm == pytest.approx(other.points_mm, abs=1e-9)


# The prefix i is declared, the prefix u is not.
SPACED = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:i="urn:i" width="100mm" height="100mm" stroke="black">{}</svg>'
RUNS = {
    "paths": ('<path i:n="{0}" u:x="a" id="p{0}" d="M{0} 1l1 2"/>', '<path i:n="7" u:x="b" id="hurt" d="M1 1l1 2 oops"/>'),
    "polylines": ('<polyline i:n="{0}" id="p{0}" points="{0},1 2,2"/>', '<polyline i:n="7" id="hurt" points="1,1 2,2 x"/>'),
    "polygons": ('<polygon i:n="{0}" id="p{0}" points="{0},1 2,2 4,9"/>', '<polygon i:n="7" id="hurt" points="1,1 2,2 9"/>'),
}


@pytest.mark.parametrize("kind", RUNS)
@pytest.mark.parametrize("stranger", ["", '<path d="M1 1L5 5" stroke="red"/>', '<g><path d="M1 1L5 5"/></g>', "<text>a</text>"])
def test_long_runs_are_read_at_once(kind: str, stranger: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches are small here, so that a run comes in parts; in the middle of it may be something else."""
    shape, damaged = RUNS[kind]
    shapes = [shape.format(i) for i in range(1, 1500)]
    shapes[1200] = damaged
    content = SPACED.format("".join([*shapes[:900], stranger, *shapes[900:]])).encode()
    taken = 0
    take = Alike.take

    def counted(own: Alike, element: object) -> bool:
        nonlocal taken
        taken += 1
        return take(own, element)

    monkeypatch.setattr(Alike, "take", counted)
    monkeypatch.setattr(collector, "_BATCH_CHARACTERS", 2000)
    facts, strokes = said(content, ReadOptions(text="skip"))
    assert taken <= 505 if not stranger else 505 < taken < 1200
    monkeypatch.setattr(alike, "_FIRST_LOOK", 10**9)
    one_by_one, alone = said(content, ReadOptions(text="skip"))
    assert facts == one_by_one
    assert "hurt" in str(facts)
    assert len(strokes) == len(alone) >= 1498
    for one, other in zip(strokes, alone, strict=True):
        assert np.array_equal(one.points_mm, other.points_mm)


def test_a_run_of_damaged_paths_is_named_in_good_time() -> None:
    """A second for 20,000 of them; to count to each anew would take a minute."""
    content = HEAD.format(' stroke="black"', '<path d="M1 1L5 5 oops"/>' * 20_000).encode()
    drawing = read_drawing(content)
    assert drawing.stroke_count == 20_000
    assert "20000 paths are damaged" in "".join(drawing.warnings)


def test_the_budget_of_elements_holds_for_shapes_that_are_alike() -> None:
    content = HEAD.format(' stroke="black"', '<line x1="1" y1="1" x2="5" y2="5"/>' * 50).encode()
    assert read_drawing(content, ReadOptions(budgets=Budgets(elements=50))).stroke_count == 50
    with pytest.raises(Exception, match="more than 49 elements"):
        read_drawing(content, ReadOptions(budgets=Budgets(elements=49)))
    many = HEAD.format(' stroke="black"', '<path d="M1 1L5 5"/>' * 2000).encode()
    with pytest.raises(Exception, match="more than 1999 elements"):
        read_drawing(many, ReadOptions(budgets=Budgets(elements=1999)))
    circles = HEAD.format(' stroke="black"', '<circle cx="1" cy="1" r="5"/>' * 50).encode()
    with pytest.raises(Exception, match=r"at least .* points and the limit is 200"):
        read_drawing(circles, ReadOptions(budgets=Budgets(points=200)))


def test_shapes_outside_of_layers_come_in_a_layer_for_each_run_of_them() -> None:
    run, group = '<path d="M1 1L2 2"/>' * 5, '<g id="a"><path d="M3 3L4 4"/></g>'
    drawing = read_drawing(HEAD.format(' stroke="black"', run + group + run).encode())
    assert [(layer.name, len(layer.strokes)) for layer in drawing.layers] == [
        ("outside layers", 5),
        ("a", 1),
        ("outside layers", 5),
    ]


@given(
    st.lists(st.tuples(*[st.floats(-100, 100)] * 2, *[st.floats(0.1, 50)] * 2), min_size=1, max_size=5),
    st.tuples(*[st.floats(-2, 2)] * 6).filter(lambda m: abs(m[0] * m[3] - m[1] * m[2]) > 1e-3),
    st.floats(1e-3, 1.0),
)
def test_ellipses_at_once_are_those_of_four_arcs(
    rows: list[tuple[float, ...]], matrix: tuple[float, ...], tolerance_mm: float
) -> None:
    ellipses = np.array(rows)
    maps, tolerance = np.tile(matrix, (len(rows), 1)), np.full(len(rows), tolerance_mm)
    assert usual(ellipses, maps).all()
    codes, numbers = ellipses_as_path(ellipses)
    code = np.tile(np.frombuffer(codes, np.uint8), len(rows))
    commands = Commands(
        code, np.cumsum(ARITY[code]) - ARITY[code], np.repeat(np.arange(len(rows)), len(codes)), numbers.ravel()
    )
    wanted = flatten(resolve(commands), maps, tolerance, 10**7)
    found = flatten_ellipses(ellipses, maps, tolerance)
    assert found.offset.tolist() == wanted.offset.tolist()
    assert point_counts(ellipses, maps, tolerance).sum() == len(wanted.points)
    assert np.abs(found.points - wanted.points).max() < 1e-9
    for name in ("corner", "path", "closed", "dot"):
        assert np.array_equal(getattr(found, name), getattr(wanted, name)), name


def test_ellipses_beyond_use_are_left_to_be_judged() -> None:
    maps = np.tile((1.0, 0, 0, 1, 0, 0), (4, 1))
    assert usual(np.array([(0, 0, 1e-10, 1), (0, 0, 1e10, 1), (1e300, 0, 1, 1), (0, 0, 1, 1.0)]), maps).tolist() == [
        False
    ] * 3 + [True]


NUMBERS = st.one_of(
    st.from_regex(r"\A[+-]?([0-9]{1,12}(\.[0-9]{1,12})?|\.[0-9]{1,18})\Z"),
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.from_regex(r"\A[+-]?[0-9]{1,20}\Z"),
    st.from_regex(r"\A-?[0-9]{1,3}\.[0-9]{1,4}[eE][+-]?[0-9]{1,2}\Z"),
)


@given(st.lists(NUMBERS, min_size=2, max_size=12).filter(lambda texts: len(texts) % 2 == 0))
def test_numbers_are_read_to_the_last_bit(texts: list[str]) -> None:
    commands, damage = parse_paths(["M" + " ".join(texts)])
    assert not damage
    assert commands.numbers[: len(texts)].tolist() == [float(text) for text in texts]


def test_plain_decimals_are_found_without_the_slow_way() -> None:
    texts = [b"12.25", b"-0.5", b"+7", b".125", b"123456789012345", b"1e3", b"1234567890123456", b"0.12345678901234567"]
    raw = np.frombuffer(b" ".join(texts), np.uint8)
    size = np.array(list(map(len, texts)))
    numbers, plain = _plain_decimals(raw, np.cumsum(size + 1) - size - 1, size)
    assert plain.tolist() == [True] * 5 + [False] * 3
    assert numbers[:5].tolist() == [12.25, -0.5, 7.0, 0.125, 123456789012345.0]
