"""Text as outlines and as single lines, and markers."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from plotter.errors import BadInput
from plotter.svg import font_engine, text_single
from plotter.svg.along import track_of
from plotter.svg.options import Budgets
from tests.plotter.svg_help import page, polylines, rounded

ENGINE = font_engine.available() and "DejaVu Sans" in font_engine.families()
needs_engine = pytest.mark.skipif(not ENGINE, reason="needs the extra `text` and the font DejaVu Sans")
needs_single = pytest.mark.skipif(not text_single.available(), reason="needs the package Hershey-Fonts")

LABEL = '<text x="10" y="50" font-family="DejaVu Sans" font-size="20" stroke="none" fill="red">Ho</text>'


@needs_engine
def test_outlines_of_glyphs_keep_colour_layer_and_order() -> None:
    drawing = page(f'<g id="a"><path d="M0 0h5"/>{LABEL}<path d="M9 9h5"/></g>')
    (layer,) = drawing.layers
    assert layer.name == "a"
    assert [stroke.color for stroke in layer.strokes] == ["#000000", *["#ff0000"] * 3, "#000000"]
    letters = np.concatenate([stroke.points_mm for stroke in layer.strokes[1:4]])
    assert letters.min(axis=0)[0] > 10 and letters[:, 1].max() == pytest.approx(50, abs=0.4)
    # A capital of DejaVu Sans is 0.729 em high.
    assert np.ptp(layer.strokes[1].points_mm[:, 1]) == pytest.approx(0.729 * 20, abs=0.02)
    assert drawing.warnings == ("text was drawn as outlines in DejaVu Sans",)


@needs_engine
def test_transforms_clips_and_anchors_hold_for_text() -> None:
    plain = np.concatenate(polylines(page(LABEL)))
    moved = np.concatenate(polylines(page(f'<g transform="translate(5 7) scale(2)">{LABEL}</g>')))
    assert np.allclose(moved.min(axis=0), plain.min(axis=0) * 2 + (5, 7), atol=0.02)
    clip = '<clipPath id="c"><rect x="0" y="0" width="100" height="40"/></clipPath>'
    assert np.concatenate(polylines(page(f'{clip}<g clip-path="url(#c)">{LABEL}</g>')))[:, 1].max() <= 40 + 1e-6
    ended = np.concatenate(polylines(page(LABEL.replace("<text", '<text text-anchor="end"'))))
    assert ended[:, 0].max() <= 10


@needs_engine
def test_a_font_that_is_not_there_is_replaced_and_said() -> None:
    drawing = page(LABEL.replace("DejaVu Sans", "Nowhere, serif"))
    assert drawing.stroke_count == 3
    assert drawing.warnings == ("text was drawn as outlines in DejaVu Serif (for Nowhere, which is not installed)",)


@needs_engine
def test_much_text_set_here_stands_where_the_engine_sets_it() -> None:
    """Beyond 200 texts plain ones are set glyph by glyph; kerned, they stand where the engine alone puts them."""
    label = '<text x="{}" y="{}" font-family="DejaVu Sans" font-size="10">AVAToy</text>'
    few = polylines(page(label.format(5, 50)))
    many = polylines(page(label.format(5, 50) + "".join(label.format(5, 60 + i) for i in range(250))))
    assert len(many) == 251 * len(few)
    few_box, many_box = (np.concatenate(one) for one in (few, many[: len(few)]))
    assert np.allclose(few_box.min(axis=0), many_box.min(axis=0), atol=0.01)
    assert np.allclose(few_box.max(axis=0), many_box.max(axis=0), atol=0.01)


@needs_engine
def test_the_engine_sees_neither_files_nor_the_network() -> None:
    document = b'<svg xmlns="http://www.w3.org/2000/svg"><image width="9" height="9" href="/etc/hostname"/></svg>'
    assert b"<image" not in font_engine.outlines(document).document


@needs_engine
@pytest.mark.parametrize("around", ["{}", '<textPath href="#p">{}</textPath>'])
def test_characters_that_no_font_has_are_left_out_and_named(around: str) -> None:
    """No boxes are drawn for them; what is around them stands where it stood."""
    label = '<path id="p" stroke="none" d="M0 20H99"/><text y="20" font-family="DejaVu Sans" font-size="10">{}</text>'
    plain = polylines(page(label.format("H\u00a0\u00a0\u00e4")))
    found = page(label.format(around.format("H\u65e5\u672c\u00e4")))
    assert len(plain) == found.stroke_count == 5
    assert np.allclose(np.concatenate(polylines(found)), np.concatenate(plain), atol=0.01)
    assert "2 characters are in no installed font and left out (\u65e5, \u672c)" in found.warnings


@needs_engine
def test_one_without_a_font_takes_no_other_with_it() -> None:
    """The engine gives up on a text at the first character that no font has; the next one may have a font all the same."""
    label = '<text x="5" y="20" font-family="DejaVu Sans Mono" font-size="10">{}</text>'
    hebrew = page(label.format("\u05d0"))  # in DejaVu Sans only
    assert hebrew.stroke_count and len(hebrew.warnings) == 1
    both = page(label.format("\u65e5 \u05d0 \u65e5"))
    assert both.stroke_count == hebrew.stroke_count
    assert "2 characters are in no installed font and left out (\u65e5)" in both.warnings
    joined = page(label.format("\U0001f468\u200d\U0001f469"))  # told as one
    assert joined.stroke_count == 0
    assert any(one.startswith("2 characters are in no installed font") for one in joined.warnings)
    marked = page(label.format("a\u1ab0 a"))  # a mark that no font has: its letter is told
    assert marked.stroke_count == 2 * page(label.format("a")).stroke_count
    assert "1 character is in no installed font and left out (U+1AB0)" in marked.warnings


@needs_engine
def test_what_a_terminal_cannot_show_is_named_by_its_number() -> None:
    drawing = page('<text y="20" font-size="10">&#xe123;</text>')
    assert "1 character is in no installed font and left out (U+E123)" in drawing.warnings


def test_text_is_named_where_it_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    skipped = page(LABEL, text="skip")
    assert skipped.stroke_count == 0 and any("1 text was left out; --text" in warning for warning in skipped.warnings)
    monkeypatch.setattr(font_engine, "available", lambda: False)
    monkeypatch.setattr(text_single, "available", lambda: False)
    assert any("need a font engine" in warning for warning in page(LABEL).warnings)
    assert any("Hershey-Fonts" in warning for warning in page(LABEL, text="single").warnings)


def test_far_too_much_text_is_refused() -> None:
    with pytest.raises(BadInput, match="--max-characters"):
        page(f"<text>{'x' * 50}</text>", budgets=Budgets(characters=49))


@needs_single
def test_single_line_text() -> None:
    drawing = page('<text x="10" y="50" font-size="30">H</text>', text="single")
    # Three strokes, capitals 0.7 em high, standing on the baseline.
    assert [len(one) for one in polylines(drawing)] == [2, 2, 2]
    every = np.concatenate(polylines(drawing))
    assert every[:, 1].min() == pytest.approx(50 - 21) and every[:, 1].max() == pytest.approx(50)
    assert drawing.warnings == ("1 text was drawn as single-line strokes in Hershey futural",)


@needs_single
def test_single_line_layout_positions_anchor_spaces_and_unknown_letters() -> None:
    def spans(body: str) -> list[float]:
        return [round(float(one[:, 0].min()), 6) for one in polylines(page(body, text="single"))]

    listed = spans('<text x="10 40 70" y="50" font-size="30">III</text>')
    assert np.diff(listed).tolist() == [30, 30]
    assert spans('<text y="50" font-size="30">\n  I   I\n </text>') == spans('<text y="50" font-size="30">I I</text>')
    label = '<text x="50" y="50" text-anchor="{}" font-size="30">II</text>'
    start, middle, end = (spans(label.format(anchor))[0] for anchor in ("start", "middle", "end"))
    assert start - middle == pytest.approx(middle - end) and start > middle > end
    tspan = spans('<text y="50" font-size="30">I<tspan dx="5">I</tspan><tspan x="90">I</tspan></text>')
    assert tspan[1] - tspan[0] == pytest.approx(5 + spans('<text y="50" font-size="30">II</text>')[1] - tspan[0])
    assert tspan[2] == pytest.approx(90 + tspan[0])
    drawing = page('<text y="50">é漢</text>', text="single")
    assert drawing.stroke_count and any("1 character is not in the single-line font" in one for one in drawing.warnings)


@needs_single
def test_single_line_text_says_what_it_draws_otherwise() -> None:
    def said(text: str) -> list[str]:
        return [one for one in page(f'<text y="50">{text}</text>', text="single").warnings if "nearest" in one]

    nearest = "characters were drawn as the nearest that the font has"
    assert said("H\u00e4llo \u00d1u\u00e4") == [f"3 {nearest} (\u00e4 as a, \u00d1 as N)"]
    assert said("\u00bd \u00df") == [f"2 {nearest} (\u00bd as 1/2, \u00df as ss)"]
    assert said("\u201cplain\u201d \u2013 it\u2019s\u00a0so\u2026") == []  # looks the same


@needs_single
def test_single_line_text_names_what_a_terminal_cannot_show_by_its_number() -> None:
    drawing = page('<text y="50">a&#x301;&#x9b;&#x202e;</text>', text="single")
    assert "3 characters are not in the single-line font and left out (U+0301, U+009B, U+202E)" in drawing.warnings


@needs_single
def test_single_line_text_on_a_path() -> None:
    text = '<text font-size="30"><textPath href="#p" startOffset="10">I</textPath></text>'
    body = f'<path id="p" stroke="none" d="M50 0V100"/>{text}'
    ((begin, end),) = rounded(page(body, text="single"))
    assert begin[1] == pytest.approx(end[1]) and {round(begin[0]), round(end[0])} == {50, 71}


def test_tracks_measure_lines_exactly_and_curves_as_browsers_do() -> None:
    track = track_of("M0 0L30 40M100 0h5")
    assert track is not None and track.length == pytest.approx(55)
    assert track.at(25) == pytest.approx((15, 20, np.arctan2(4, 3)))
    assert track.at(52) == pytest.approx((102, 0, 0))
    assert track.at(56) is None and track.at(-1) is None
    curve = track_of("M0 0C0 55.2 44.8 100 100 100")
    assert curve is not None and curve.length == pytest.approx(np.pi * 50, abs=0.5)
    assert track_of("") is None


MARKER = '<marker id="m" refX="1" refY="1" markerWidth="4" markerHeight="4" {}><path d="M0 1H2" stroke="red"/></marker>'


def marked(marker: str, shape: str) -> list[list[list[float]]]:
    return rounded(page(MARKER.format(marker) + shape))[1:]


def test_markers_stand_on_vertices_after_their_shape() -> None:
    shape = '<path marker-start="url(#m)" marker-mid="url(#m)" marker-end="url(#m)" d="M10 10H20V30"/>'
    assert marked("", shape) == [[[9, 10], [11, 10]], [[19, 10], [21, 10]], [[19, 30], [21, 30]]]


def test_markers_turn_with_the_path() -> None:
    shape = '<path marker-start="url(#m)" marker-end="url(#m)" d="M10 10H20V30"/>'
    assert marked('orient="auto"', shape) == [[[9, 10], [11, 10]], [[20, 29], [20, 31]]]
    assert marked('orient="auto-start-reverse"', shape) == [[[11, 10], [9, 10]], [[20, 29], [20, 31]]]
    assert marked('orient="90"', shape)[0] == [[10, 9], [10, 11]]
    ((begin, end),) = marked('orient="auto"', '<path marker-mid="url(#m)" d="M10 10H20V30"/>')
    assert np.allclose(np.subtract(end, begin), [2**0.5, 2**0.5])


def test_markers_scale_with_the_stroke_unless_told_not_to() -> None:
    shape = '<line stroke-width="3" marker-end="url(#m)" x1="10" y1="10" x2="20" y2="10"/>'
    assert marked("", shape) == [[[17, 10], [23, 10]]]
    assert marked('markerUnits="userSpaceOnUse"', shape) == [[[19, 10], [21, 10]]]
    assert marked('viewBox="0 0 2 2"', shape) == [[[14, 10], [26, 10]]]


def test_markers_are_cut_at_their_own_box() -> None:
    body = '<marker id="n" markerWidth="3" markerHeight="3"{}><path d="M-5 1H9" stroke="red"/></marker>'
    body += '<path marker-end="url(#n)" d="M0 0H50"/>'
    assert rounded(page(body.format("")))[1] == [[50, 1], [53, 1]]
    assert rounded(page(body.format(' overflow="visible"')))[1] == [[45, 1], [59, 1]]


def test_markers_too_many_missing_or_in_themselves() -> None:
    missing = page('<path marker-end="url(#none)" d="M0 0H5"/>')
    assert missing.stroke_count == 1 and any("1 marker is not there" in warning for warning in missing.warnings)
    own = page('<marker id="m"><path d="M0 0L1 1" marker-end="url(#m)"/></marker><path marker-end="url(#m)" d="M0 0H5"/>')
    assert own.stroke_count == 2 and any("refers to itself" in warning for warning in own.warnings)
    with pytest.raises(BadInput, match="--max-markers"):
        page(MARKER.format("") + '<path marker-mid="url(#m)" d="M0 0' + "h1" * 50 + '"/>', budgets=Budgets(markers=40))


def test_reading_without_text_loads_no_font_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] in ("wasmtime", "HersheyFonts")]:
        monkeypatch.delitem(sys.modules, name)
    page('<path d="M0 0h5"/>')
    assert "wasmtime" not in sys.modules and "HersheyFonts" not in sys.modules
