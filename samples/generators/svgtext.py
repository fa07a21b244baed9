"""Writing SVG by hand: numbers, path data, and the heads that Inkscape, Illustrator, vpype and p5.js put on their files."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

INKSCAPE_NAMESPACES = """xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
   xmlns:sodipodi="http://sodipodi.sourceforge.net/DTD/sodipodi-0.dtd"
   xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
   xmlns:cc="http://creativecommons.org/ns#"
   xmlns:dc="http://purl.org/dc/elements/1.1/"
   xmlns="http://www.w3.org/2000/svg"
   xmlns:svg="http://www.w3.org/2000/svg\""""


def num(value: float, decimals: int = 3) -> str:
    """The number with at most `decimals` places and no trailing zeros; never `-0`."""
    text = f"{value:.{decimals}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def pair(point: Iterable[float], decimals: int = 3) -> str:
    return ",".join(num(float(value), decimals) for value in point)


def polyline_path(points: Points, *, closed: bool = False, decimals: int = 3) -> str:
    """Path data `M x,y L x,y ...` through the points (n, 2); `closed` ends with Z and leaves a repeated last point out."""
    kept = points[:-1] if closed and np.array_equal(points[0], points[-1]) else points
    body = " ".join(pair(point, decimals) for point in kept[1:])
    return f"M {pair(kept[0], decimals)} L {body}" + (" Z" if closed else "")


def hermite_path(points: Points, derivatives: Points, step: float, *, closed: bool = False, decimals: int = 3) -> str:
    """Cubic Bezier path data through `points` (n, 2) of a curve p(t) sampled every `step` of t, `derivatives` being dp/dt.

    The inner control points are p0 + p'0 h/3 and p1 - p'1 h/3, so that the path has the curve's own tangents.
    """
    ahead = points[:-1] + derivatives[:-1] * (step / 3)
    behind = points[1:] - derivatives[1:] * (step / 3)
    curves = (
        f"C {pair(c1, decimals)} {pair(c2, decimals)} {pair(end, decimals)}"
        for c1, c2, end in zip(ahead, behind, points[1:], strict=True)
    )
    return f"M {pair(points[0], decimals)} " + " ".join(curves) + (" Z" if closed else "")


def smooth_path(points: Points, *, decimals: int = 3, tension: float = 1.0) -> str:
    """A Catmull-Rom spline through `points` (n, 2), written as cubic Beziers."""
    before = np.vstack((points[:1], points[:-1]))
    after = np.vstack((points[1:], points[-1:]))
    return hermite_path(points, (after - before) / 2 * tension, 1.0, decimals=decimals)


def inkscape_document(width_mm: float, height_mm: float, body: str, *, title: str, viewbox: str | None = None) -> str:
    """A file as Inkscape saves it: attributes one a line, a named view, metadata with the licence, then `body`."""
    box = viewbox or f"0 0 {num(width_mm)} {num(height_mm)}"
    return f"""<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<!-- Created with Inkscape (http://www.inkscape.org/) -->

<svg
   width="{num(width_mm)}mm"
   height="{num(height_mm)}mm"
   viewBox="{box}"
   version="1.1"
   id="svg1"
   {INKSCAPE_NAMESPACES}>
  <title
     id="title1">{title}</title>
  <sodipodi:namedview
     id="namedview1"
     pagecolor="#ffffff"
     bordercolor="#666666"
     borderopacity="1.0"
     inkscape:pageopacity="0.0"
     inkscape:document-units="mm"
     showgrid="false"
     inkscape:current-layer="layer1" />
  <defs
     id="defs1" />
  <metadata
     id="metadata1">
    <rdf:RDF>
      <cc:Work
         rdf:about="">
        <dc:format>image/svg+xml</dc:format>
        <dc:type
           rdf:resource="http://purl.org/dc/dcmitype/StillImage" />
        <dc:title>{title}</dc:title>
        <cc:license
           rdf:resource="http://creativecommons.org/publicdomain/zero/1.0/" />
      </cc:Work>
    </rdf:RDF>
  </metadata>
{body}</svg>
"""


def inkscape_layer(number: int, label: str, body: str, *, style: str = "", transform: str = "") -> str:
    """A `<g>` that Inkscape (and a plotter) takes for a layer."""
    more = f'\n     transform="{transform}"' if transform else ""
    return f"""  <g
     inkscape:label="{label}"
     inkscape:groupmode="layer"
     id="layer{number}"
     style="{style or "display:inline"}"{more}>
{body}  </g>
"""
