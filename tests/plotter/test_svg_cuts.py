"""Clips, dashes, hidden lines and the page's edge, to the micrometre."""

from __future__ import annotations

import numpy as np
import pytest

from plotter.errors import BadInput
from plotter.svg.options import Budgets
from tests.plotter.svg_help import marks, page, polylines, rounded

SQUARE = '<clipPath id="c"><rect x="10" y="10" width="20" height="20"/></clipPath>'


def test_a_clip_cuts_and_adds_no_edge() -> None:
    assert rounded(page(SQUARE + '<path clip-path="url(#c)" d="M0 20H40"/>')) == [[[10, 20], [30, 20]]]
    assert rounded(page(SQUARE + '<path clip-path="url(#c)" d="M20 20H40V25H20"/>')) == [
        [[20, 20], [30, 20]],
        [[30, 25], [20, 25]],
    ]
    assert rounded(page(SQUARE + '<path clip-path="url(#c)" d="M0 0H5"/>')) == []


def test_what_runs_along_the_clip_is_kept_whole_and_in_its_direction() -> None:
    body = SQUARE + '<rect clip-path="url(#c)" x="10" y="10" width="20" height="20"/>'
    assert rounded(page(body)) == [[[10, 10], [30, 10], [30, 30], [10, 30], [10, 10]]]


def test_a_closed_shape_is_not_cut_at_its_seam() -> None:
    body = SQUARE + '<rect clip-path="url(#c)" x="20" y="20" width="20" height="20"/>'
    assert rounded(page(body)) == [[[20, 30], [20, 20], [30, 20]]]
    assert marks(page(body)) == [[True, True, True]]


def test_a_cut_curve_stays_smooth() -> None:
    (mask,) = marks(page(SQUARE + '<circle clip-path="url(#c)" cx="10" cy="20" r="8"/>'))
    assert mask[0] and mask[-1] and sum(mask) <= 3


@pytest.mark.parametrize(("rule", "pieces"), [("nonzero", [[0, 60]]), ("evenodd", [[0, 20], [40, 60]])])
def test_clip_rules(rule: str, pieces: list[list[float]]) -> None:
    clip = f'<clipPath id="c"><path clip-rule="{rule}" d="M0 0H60V60H0zM20 20H40V40H20z"/></clipPath>'
    found = rounded(page(clip + '<path clip-path="url(#c)" d="M-5 30H90"/>'))
    assert [[one[0][0], one[-1][0]] for one in found] == pieces


def test_clip_units_nesting_use_and_transforms() -> None:
    box = '<clipPath id="c" clipPathUnits="objectBoundingBox"><rect x=".25" width=".5" height="1"/></clipPath>'
    assert rounded(page(box + '<g clip-path="url(#c)"><path d="M0 0H40"/><path d="M0 9H40"/></g>')) == [
        [[10, 0], [30, 0]],
        [[10, 9], [30, 9]],
    ]
    used = '<rect id="r" width="10" height="10"/><clipPath id="c"><use href="#r" x="5"/></clipPath>'
    assert rounded(page(f'<defs>{used}</defs><path clip-path="url(#c)" d="M0 5H40"/>')) == [[[5, 5], [15, 5]]]
    nested = SQUARE + '<clipPath id="d" clip-path="url(#c)"><rect x="20" y="0" width="50" height="50"/></clipPath>'
    assert rounded(page(nested + '<path clip-path="url(#d)" d="M0 20H90"/>')) == [[[20, 20], [30, 20]]]
    part = '<rect clip-path="url(#c)" x="20" y="0" width="50" height="50"/>'
    inner = SQUARE + f'<clipPath id="d">{part}<rect width="5" height="50"/></clipPath>'
    assert rounded(page(inner + '<path clip-path="url(#d)" d="M0 20H90"/>')) == [[[0, 20], [5, 20]], [[20, 20], [30, 20]]]
    moved = SQUARE + '<g transform="translate(100) scale(-1 1)"><path clip-path="url(#c)" d="M0 20H90"/></g>'
    assert rounded(page(moved)) == [[[90, 20], [70, 20]]]


def test_an_empty_clip_hides_all_and_a_missing_one_nothing() -> None:
    assert page('<clipPath id="c"/><path clip-path="url(#c)" d="M0 0h5"/>').stroke_count == 0
    missing = page('<path clip-path="url(#c)" d="M0 0h5"/>')
    assert missing.stroke_count == 1 and any("1 clip path is not there" in warning for warning in missing.warnings)


def test_inner_svg_clips_unless_it_overflows() -> None:
    for overflow, end in (("hidden", 20), ("visible", 50)):
        body = f'<svg x="10" y="10" width="10" height="10" overflow="{overflow}"><path d="M0 5H40"/></svg>'
        assert rounded(page(body)) == [[[10, 15], [end, 15]]]


def test_dashes_phase_offset_and_units() -> None:
    assert rounded(page('<path stroke-dasharray="10 5" d="M0 0H40"/>')) == [
        [[0, 0], [10, 0]],
        [[15, 0], [25, 0]],
        [[30, 0], [40, 0]],
    ]
    assert rounded(page('<path stroke-dasharray="10" stroke-dashoffset="4" d="M0 0H30"/>')) == [
        [[0, 0], [6, 0]],
        [[16, 0], [26, 0]],
    ]
    assert rounded(page('<path stroke-dasharray="10" stroke-dashoffset="-4" d="M0 0H30"/>')) == [
        [[4, 0], [14, 0]],
        [[24, 0], [30, 0]],
    ]
    odd = rounded(page('<path stroke-dasharray="4,2,6" d="M0 0H24"/>'))
    assert [[one[0][0], one[1][0]] for one in odd] == [[0, 4], [6, 12], [16, 18]]
    percent = rounded(page('<path stroke-dasharray="10%,90%" d="M0 0H50"/>'))
    assert percent == [[[0, 0], [10, 0]]]


def test_dashes_begin_afresh_with_every_subpath_and_turn_corners() -> None:
    assert rounded(page('<path stroke-dasharray="10" d="M0 0H15M0 9H15"/>')) == [[[0, 0], [10, 0]], [[0, 9], [10, 9]]]
    assert rounded(page('<path stroke-dasharray="10 100" d="M0 0H6V20"/>')) == [[[0, 0], [6, 0], [6, 4]]]
    assert marks(page('<path stroke-dasharray="10 100" d="M0 0H6V20"/>')) == [[True, True, True]]


def test_dashes_are_measured_in_user_units_along_true_lengths() -> None:
    stretched = rounded(page('<path transform="scale(1 2)" stroke-dasharray="5" d="M0 0V20"/>'))
    assert stretched == [[[0, 0], [0, 10]], [[0, 20], [0, 30]]]
    arc = polylines(page('<circle cx="50" cy="50" r="40" stroke-dasharray="10 10"/>'))
    for i, one in enumerate(arc):
        begin, end = (np.arctan2(*(point - 50)[::-1]) % (2 * np.pi) * 40 for point in (one[0], one[-1]))
        assert begin == pytest.approx(20 * i, abs=0.005)
        if i + 1 < len(arc):
            assert end == pytest.approx(20 * i + 10, abs=0.005)


def test_path_length_scales_dashes() -> None:
    circle = '<circle r="10" cx="50" cy="50" pathLength="4" stroke-dasharray="1"/>'
    body = '<path pathLength="4" stroke-dasharray="1" d="M0 0H40"/>' + circle
    first, second, quarter, half = polylines(page(body))
    assert (first[-1][0], second[0][0]) == pytest.approx((10, 20))
    assert quarter[-1] == pytest.approx([50, 60], abs=0.002) and half[0] == pytest.approx([40, 50], abs=0.002)


def test_dashes_without_length_are_dots_under_round_caps() -> None:
    assert rounded(page('<path stroke-linecap="round" stroke-dasharray="0 10" d="M0 0H25"/>')) == [
        [[0, 0]],
        [[10, 0]],
        [[20, 0]],
    ]
    assert page('<path stroke-dasharray="0 10" d="M0 0H25"/>').stroke_count == 0


@pytest.mark.parametrize("pattern", ["none", "0", "0,0", "5,-1", "x", ""])
def test_patterns_that_are_none(pattern: str) -> None:
    assert page(f'<path stroke-dasharray="{pattern}" d="M0 0H25"/>').stroke_count == 1


def test_fills_have_no_dashes() -> None:
    assert page('<path stroke="none" fill="red" stroke-dasharray="1" d="M0 0H25"/>').stroke_count == 1


def test_a_flood_of_dashes_is_refused() -> None:
    with pytest.raises(BadInput, match="--max-dashes"):
        page('<path stroke-dasharray="0.1" d="M0 0H25"/>', budgets=Budgets(dashes=100))


def test_crop_cuts_at_the_page() -> None:
    body = '<path d="M-10 50H200"/><path d="M0 0H100"/><path d="M150 0v9"/>'
    assert rounded(page(body, crop=True)) == [[[0, 50], [100, 50]], [[0, 0], [100, 0]]]
    assert page(body).stroke_count == 3


def test_opaque_fills_hide_what_lies_under_them_only() -> None:
    under, over = '<path d="M0 20H40"/>', '<rect x="10" y="10" width="20" height="20" fill="white"/>'
    assert rounded(page(under + over, occlude=True))[:2] == [[[0, 20], [10, 20]], [[30, 20], [40, 20]]]
    assert len(rounded(page(over + under, occlude=True))) == 2
    assert len(rounded(page(under + over))) == 2
    for see_through in ('fill="none"', 'fill-opacity=".5"', 'opacity=".5"', 'fill="rgba(0,0,0,.5)"'):
        assert rounded(page(under + over.replace('fill="white"', see_through + ' stroke="red"'), occlude=True))[0] == [
            [0, 20],
            [40, 20],
        ]


def test_a_translucent_group_hides_nothing() -> None:
    for effect in ('opacity=".5"', 'mask="url(#m)"'):
        body = f'<path d="M0 20H40"/><g {effect}><g><rect x="10" y="10" width="20" height="20" fill="red"/></g></g>'
        assert rounded(page(body, occlude=True))[0] == [[0, 20], [40, 20]]


def test_occlusion_follows_fill_rules_clips_and_shared_edges() -> None:
    ring = '<path fill="white" fill-rule="evenodd" d="M10 10H40V40H10zM20 20H30V30H20z"/>'
    found = rounded(page('<path d="M0 25H50"/>' + ring, occlude=True))
    assert [[one[0][0], one[-1][0]] for one in found[:3]] == [[0, 10], [20, 30], [40, 50]]
    clipped = SQUARE + '<path d="M0 20H90"/><rect clip-path="url(#c)" fill="white" width="90" height="90"/>'
    assert [[one[0][0], one[-1][0]] for one in rounded(page(clipped, occlude=True))] == [[0, 10], [30, 90]]
    twice = '<rect x="10" y="10" width="20" height="20" fill="white"/>' * 2
    assert len(rounded(page(twice, occlude=True))) == 1, "a line under a drawn outline is not drawn twice"


def test_occlusion_by_strips() -> None:
    """Horizontal lines under a row of squares: what is left is what lies between the squares."""
    lines = "".join(f'<path d="M0 {y + 0.5}H100"/>' for y in range(0, 50, 5))
    squares = "".join(f'<rect x="{x}" y="0" width="5" height="60" fill="white" stroke="none"/>' for x in range(0, 100, 10))
    drawing = page(lines + squares, occlude=True)
    left = [one for one in polylines(drawing) if len(one) == 2]
    assert sum(np.ptp(one[:, 0]) for one in left) == pytest.approx(10 * 50)
