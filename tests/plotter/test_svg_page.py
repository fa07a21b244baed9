"""Page sizes, units, viewBox, preserveAspectRatio, inner svg and symbols: a 100 mm square is 100 mm from every kind of file."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from plotter.errors import BadInput
from plotter.svg.drawing import Drawing
from plotter.svg.options import ReadOptions
from plotter.svg.read import read_drawing
from tests.plotter.svg_help import page, polylines, rounded

SVG = 'xmlns="http://www.w3.org/2000/svg"'


def read(text: str, **options: object) -> Drawing:
    return read_drawing(text.encode(), ReadOptions(**options))  # type: ignore[arg-type]


def box_mm(drawing: Drawing) -> list[float]:
    points = np.concatenate(polylines(drawing))
    return [*points.min(axis=0).tolist(), *points.max(axis=0).tolist()]


SQUARES = {
    "px": f'<svg {SVG} width="500" height="500"><rect width="377.952755905511811" height="377.952755905511811"/></svg>',
    "mm lengths": f'<svg {SVG} width="20cm" height="200mm"><rect width="100mm" height="10cm"/></svg>',
    "inches": f'<svg {SVG} width="10in" height="10in"><rect width="3.937007874015748in" height="283.4645669291339pt"/></svg>',
    "pc and Q": f'<svg {SVG} width="100pc" height="1600Q"><rect width="23.6220472440944882pc" height="400Q"/></svg>',
    "viewBox in mm": f'<svg {SVG} width="210mm" height="297mm" viewBox="0 0 210 297"><rect width="100" height="100"/></svg>',
    "viewBox with an origin": (
        f'<svg {SVG} width="210mm" height="210mm" viewBox="-50 -50 2100 2100">'
        '<rect x="-50" y="-50" width="1000" height="1000"/></svg>'
    ),
    "Inkscape": (
        f'<svg {SVG} xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" width="210mm" height="297mm" '
        'viewBox="0 0 744.09448819 1052.3622047"><g inkscape:groupmode="layer" inkscape:label="Layer 1" '
        'transform="translate(0,-10)"><path d="m 0,10 h 354.33070866 v 354.33070867 h -354.33070866 z"/></g></svg>'
    ),
    "Corel": (
        f'<svg {SVG} xml:space="preserve" width="210mm" height="297mm" version="1.1" style="fill-rule:evenodd" '
        'viewBox="0 0 21000 29700"><g id="Layer_x0020_1"><polygon points="0,0 10000,0 10000,10000 0,10000 "/></g></svg>'
    ),
    "percent": f'<svg {SVG} width="200mm" height="200mm"><rect width="50%" height="50%"/></svg>',
    "percent of a viewBox": (
        f'<svg {SVG} width="200mm" height="200mm" viewBox="0 0 40 40"><rect width="50%" height="50%"/></svg>'
    ),
    "nested svg": (
        f'<svg {SVG} width="200mm" height="200mm"><svg width="100%" height="100%" viewBox="0 0 2 2">'
        '<path d="M0 0H1V1H0z"/></svg></svg>'
    ),
    "CSS size": f'<svg {SVG} style="width:200mm"><style>rect{{width:100mm;height:100mm}}</style><rect/></svg>',
    "scaled use": (
        f'<svg {SVG} width="200mm" height="200mm" viewBox="0 0 200 200"><defs><path id="a" d="M0 0h1v1h-1z"/></defs>'
        '<use href="#a" transform="scale(100)"/></svg>'
    ),
    "no namespace": '<svg width="200mm" height="200mm" viewBox="0 0 200 200"><rect width="100" height="100"/></svg>',
    "prefixed": f'<s:svg xmlns:s="{SVG[7:-1]}" width="200mm" height="200mm"><s:rect width="100mm" height="100mm"/></s:svg>',
    "matrix": (
        f'<svg {SVG} width="200mm" height="200mm" viewBox="0 0 20 20">'
        '<path transform="matrix(0 1 1 0 0 0)" d="M0 0h10v10H0z"/></svg>'
    ),
}


@pytest.mark.parametrize("kind", SQUARES)
def test_a_100_mm_square_is_100_mm(kind: str) -> None:
    assert np.allclose(box_mm(read(SQUARES[kind])), [0, 0, 100, 100], atol=2e-6)


def test_illustrator_files_of_72_dpi() -> None:
    text = (
        f'<svg {SVG} width="595.28px" height="841.89px" viewBox="0 0 595.28 841.89">'
        '<rect width="283.4645" height="283.4645"/></svg>'
    )
    assert np.allclose(box_mm(read(text, px_per_in=72.0)), [0, 0, 100, 100], atol=1e-4)
    assert np.allclose(box_mm(read(text)), [0, 0, 75, 75], atol=1e-4)
    assert read(text, px_per_in=72.0).width_mm == pytest.approx(210, abs=0.01)


@pytest.mark.parametrize(
    ("size", "page_mm"),
    [
        ('width="100mm" height="50mm"', (100, 50)),
        ('width="96" height="48px"', (25.4, 12.7)),
        ('viewBox="0 0 96 48"', (25.4, 12.7)),
        ('width="100%" height="100%" viewBox="0 0 96 48"', (25.4, 12.7)),
        ('width="50.8mm" viewBox="0 0 96 48"', (50.8, 25.4)),
        ('height="50.8mm" viewBox="0 0 96 48"', (101.6, 50.8)),
        ('width="1in" height="2in" viewBox="5 5 7 7"', (25.4, 50.8)),
    ],
)
def test_page_sizes(size: str, page_mm: tuple[float, float]) -> None:
    drawing = read(f"<svg {SVG} {size}/>")
    assert (drawing.width_mm, drawing.height_mm) == pytest.approx(page_mm)


def test_a_page_without_any_size_is_said_to_be_assumed() -> None:
    drawing = read(f"<svg {SVG}><rect width='9' height='9'/></svg>")
    assert any("no size and no viewBox" in warning for warning in drawing.warnings)


# viewBox 0 0 10 20 into 40 x 40 mm: meet scales by 2, slice by 4.
@pytest.mark.parametrize(
    ("aspect", "box"),
    [
        ("xMinYMin", (0, 0, 20, 40)),
        ("xMidYMid meet", (10, 0, 30, 40)),
        ("xMaxYMax", (20, 0, 40, 40)),
        ("none", (0, 0, 40, 40)),
        ("xMinYMin slice", (0, 0, 40, 80)),
        ("xMidYMid slice", (0, -20, 40, 60)),
        ("xMidYMax slice", (0, -40, 40, 40)),
        ("", (10, 0, 30, 40)),
    ],
)
def test_preserve_aspect_ratio(aspect: str, box: tuple[float, ...]) -> None:
    text = (
        f'<svg {SVG} width="40mm" height="40mm" viewBox="0 0 10 20" preserveAspectRatio="{aspect}">'
        '<rect width="10" height="20"/></svg>'
    )
    assert box_mm(read(text)) == pytest.approx(box)


@pytest.mark.parametrize(("size", "scale"), [("", 1.0), ('width="10" height="10"', 1 / 10)])
def test_symbols_take_the_size_of_their_use(size: str, scale: float) -> None:
    body = f'<symbol id="s" viewBox="0 0 100 100"><path d="M0 0L100 100"/></symbol><use href="#s" x="5" y="6" {size}/>'
    ((start, end),) = rounded(page(body))
    assert start == [5, 6]
    # Clipped to the symbol's own box; the whole line lies in it.
    assert end == pytest.approx([5 + 100 * scale, 6 + 100 * scale])


def test_em_percent_and_diagonal_percent() -> None:
    body = '<g font-size="10"><line x2="1em" y2="2ex"/></g><circle r="10%" cx="50%" cy="50%"/>'
    line, circle = polylines(page(body))
    assert line[1].tolist() == pytest.approx([10, 10])
    assert np.ptp(circle[:, 0]) == pytest.approx(20, abs=0.02)


@pytest.mark.parametrize(
    ("transform", "point"),
    [
        ("translate(3)", (13, 20)),
        ("translate(3,4)", (13, 24)),
        ("scale(2)", (20, 40)),
        ("scale(2 -1)", (20, -20)),
        ("rotate(90)", (-20, 10)),
        ("rotate(90,10,10)", (0, 10)),
        ("skewX(45)", (30, 20)),
        ("skewY(45)", (10, 30)),
        ("matrix(1 2 3 4 5 6)", (75, 106)),
        ("translate(1 2)scale(2),rotate(180)", (-19, -38)),
        ("translate(3)bad(4)", (10, 20)),
        ("", (10, 20)),
    ],
)
def test_transforms(transform: str, point: tuple[float, float]) -> None:
    ((_, end),) = rounded(page(f'<path transform="{transform}" d="M0 0L10 20"/>'))
    assert end == pytest.approx(point, abs=1e-5)


def test_css_transform_and_origin_win_over_the_attribute() -> None:
    body = '<path transform="scale(9)" style="transform:rotate(90deg) translateX(2px);transform-origin:50% 10px" '
    body += 'd="M50 10L60 10"/>'
    assert rounded(page(body)) == [[[50, 12], [50, 22]]]


def test_singular_transforms_are_dropped_and_counted() -> None:
    drawing = page('<path transform="scale(0 1)" d="M0 0L1 1"/><g transform="matrix(1 2 2 4 0 0)"><path d="M0 0L1 1"/></g>')
    assert drawing.stroke_count == 0
    assert any(warning.startswith("2 elements have a transform") for warning in drawing.warnings)


def test_gzip_bytes_and_files(tmp_path: Path) -> None:
    text = SQUARES["mm lengths"].encode()
    file = tmp_path / "a.svgz"
    file.write_bytes(gzip.compress(text))
    for source in (text, gzip.compress(text), file):
        assert box_mm(read_drawing(source)) == pytest.approx([0, 0, 100, 100])
    with pytest.raises(BadInput, match="cannot be read"):
        read_drawing(tmp_path / "missing.svg")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1"])
def test_encodings(encoding: str) -> None:
    declared = "utf-8" if encoding == "utf-8-sig" else encoding
    text = (
        f'<?xml version="1.0" encoding="{declared}"?><svg {SVG} width="9mm" height="9mm">'
        '<g id="Größe"><path d="M0 0h9"/></g></svg>'
    )
    assert read_drawing(text.encode(encoding)).layers[0].name == "Größe"
