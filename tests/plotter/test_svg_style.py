"""What is drawn, and in which colour: attributes, style sheets, inheritance, display and visibility."""

from __future__ import annotations

import pytest

from plotter.svg.colors import parse_paint
from tests.plotter.svg_help import page, rounded


def colors(body: str, **options: object) -> list[str | None]:
    return [stroke.color for layer in page(body, **options).layers for stroke in layer.strokes]


@pytest.mark.parametrize(
    ("attributes", "sheet", "color"),
    [
        ('stroke="red"', "", "#ff0000"),
        ('stroke="red"', "path{stroke:lime}", "#00ff00"),
        ('stroke="red" style="stroke:blue"', "path{stroke:lime}", "#0000ff"),
        ('style="stroke:blue"', "path{stroke:lime!important}", "#00ff00"),
        ('style="stroke:blue!important"', "path{stroke:lime!important}", "#0000ff"),
        ('class="a b"', ".a{stroke:red}.b{stroke:lime}", "#00ff00"),
        ('class="a" id="i"', "#i{stroke:red}.a{stroke:lime}", "#ff0000"),
        ('class="a b"', ".a.b{stroke:red}.b{stroke:lime}", "#ff0000"),
        ('class="a"', "path.a{stroke:red}.a{stroke:lime}", "#ff0000"),
        ('class="a"', "rect.a{stroke:red}*{stroke:lime}", "#00ff00"),
        ("", "g path{stroke:red}path{stroke:lime}", "#ff0000"),
        ("", "svg>path{stroke:red}", "#000000"),
        ("", "svg > g > path{stroke:red}", "#ff0000"),
        ('data-k="v"', '[data-k="v"]{stroke:red}', "#ff0000"),
        ("", "rect + path, path:first-child{stroke:red}", "#ff0000"),
        ("", "@media print{path{stroke:red}} @media (min-width:1px){path{stroke:lime}}", "#ff0000"),
        ("", "/* c */ path{stroke:/* x */red;}", "#ff0000"),
        ('stroke="currentColor" color="red"', "", "#ff0000"),
        ('stroke="rgb(10, 20,30)"', "", "#0a141e"),
        ('stroke="rgb(100%,0%,0%)"', "", "#ff0000"),
        ('stroke="#f0f"', "", "#ff00ff"),
        ('stroke="hsl(120,100%,50%)"', "", "#00ff00"),
        ('stroke="inherit"', "", "#000000"),
        ('stroke="none" fill="blue"', "", "#0000ff"),
        ('stroke="nonsense"', "", "#000000"),
        ('stroke="red!important"', "", "#000000"),
        ('stroke="red" style="stroke:12px"', "", "#ff0000"),
    ],
)
def test_the_cascade(attributes: str, sheet: str, color: str) -> None:
    body = f"<style><![CDATA[{sheet}]]></style><g><path {attributes} d='M0 0h5'/></g>"
    assert colors(body) == [color]


def test_styles_are_inherited_and_use_gives_its_own() -> None:
    body = '<defs><path id="p" d="M0 0h5"/><path id="q" stroke="lime" d="M0 0h5"/></defs><g stroke="red">'
    assert colors(body + '<use href="#p"/><use href="#q"/><use href="#p" stroke="blue"/></g>') == [
        "#ff0000",
        "#00ff00",
        "#0000ff",
    ]


@pytest.mark.parametrize(
    ("attributes", "drawn", "unpainted", "every"),
    [
        ('stroke="none"', 0, 1, 1),
        ('stroke="none" fill="none"', 0, 1, 1),
        ('stroke-width="0"', 0, 1, 1),
        ('stroke-opacity="0"', 0, 1, 1),
        ('stroke="transparent"', 0, 1, 1),
        ('stroke="url(#missing)"', 0, 1, 1),
        ('stroke="url(#missing) red"', 1, 1, 1),
        ('display="none"', 0, 0, 1),
        ('style="display:none"', 0, 0, 1),
        ('visibility="hidden"', 0, 0, 1),
        ('visibility="collapse"', 0, 0, 1),
        ('fill="white" stroke="none"', 1, 1, 1),
        ("", 1, 1, 1),
    ],
)
def test_what_is_painted(attributes: str, drawn: int, unpainted: int, every: int) -> None:
    body = f'<path {attributes} d="M0 0h5"/>'
    for hidden, count in (("skip", drawn), ("unpainted", unpainted), ("all", every)):
        drawing = page(body, hidden=hidden)
        assert drawing.stroke_count == count, hidden
        assert count or any("--hidden" in warning for warning in drawing.warnings)


def test_visible_children_of_hidden_groups_are_drawn_but_not_those_of_undisplayed_ones() -> None:
    assert len(colors('<g visibility="hidden"><path visibility="visible" d="M0 0h5"/><path d="M0 0h5"/></g>')) == 1
    assert colors('<g display="none"><path display="inline" d="M0 0h5"/></g>') == []


def test_fills_outlined_closed_or_left_out() -> None:
    body = '<path stroke="none" fill="red" d="M0 0h5v5"/><path d="M9 0h5v5"/>'
    assert rounded(page(body)) == [[[0, 0], [5, 0], [5, 5]], [[9, 0], [14, 0], [14, 5]]]
    assert rounded(page(body, fills="close")) == [[[0, 0], [5, 0], [5, 5], [0, 0]], [[9, 0], [14, 0], [14, 5]]]
    assert rounded(page(body, fills="skip")) == [[[9, 0], [14, 0], [14, 5]]]


def test_what_cannot_be_drawn_is_named_once_with_its_count() -> None:
    body = (
        '<image href="x.png" width="5" height="5"/><image href="http://example.com/x.png"/>'
        '<linearGradient id="l"/><path fill="url(#l)" d="M0 0h5"/><mask id="m"/><g mask="url(#m)"><path d="M0 0h5"/></g>'
        '<filter id="f"/><path filter="url(#f)" d="M0 0h5"/><foreignObject/><blink/>'
    )
    warnings = page(body).warnings
    for words in (
        "2 images",
        "gradients or patterns",
        "1 mask was",
        "1 filter was",
        "1 foreignObject",
        "1 unknown element was",
    ):
        assert sum(words in warning for warning in warnings) == 1, words


def test_nothing_is_said_of_a_plain_drawing() -> None:
    assert page('<title>t</title><desc>d</desc><defs><rect/></defs><metadata/><path d="M0 0h5"/>').warnings == ()


def test_gradients_have_no_colour_but_their_fallback_has() -> None:
    assert parse_paint("url(#a)", "black") is not None
    body = '<linearGradient id="l"/><path stroke="url(#l)" d="M0 0h5"/><path stroke="url(#l) lime" d="M0 0h5"/>'
    assert colors(body) == [None, "#00ff00"]


def test_geometry_may_come_from_css() -> None:
    body = '<style>circle{cx:10px;r:2mm} path{d:path("M1 1L2 2")}</style><circle r="9"/><path/>'
    circle, path = rounded(page(body))
    assert circle[0] == pytest.approx([10 + 2 / 25.4 * 96, 0]) and path == [[1, 1], [2, 2]]
