"""Bombs, damage and what is no SVG: refused or bounded, quickly, in little memory, with one sentence, never a traceback."""

from __future__ import annotations

import gzip
import subprocess
import sys
from pathlib import Path

import pytest

from plotter.errors import BadInput
from plotter.svg.options import Budgets, ReadOptions
from plotter.svg.read import read_drawing
from tests.plotter.svg_help import HEAD, page

ENTITIES = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True))
USES = "".join(f'<g id="a{i}">{f"""<use href="#a{i - 1}"/>""" * 10}</g>' for i in range(1, 10))
MARKERS = "".join(f'<marker id="m{i}"><path d="M0 0{"l1 1" * 30}" marker-mid="url(#m{i + 1})"/></marker>' for i in range(8))


def doc(body: str, prolog: str = "") -> bytes:
    return f"{prolog}{HEAD}{body}</svg>".encode()


# What must be refused, and a word of the sentence.
REFUSED: dict[str, tuple[bytes, str]] = {
    "entities": (doc("<text>&j;</text>", f'<!DOCTYPE svg [<!ENTITY a "aaaaaaaaaa">{ENTITIES}]>'), "entities"),
    "entities of elements": (doc("&j;", f'<!DOCTYPE svg [<!ENTITY a "<g/><g/>">{ENTITIES}]>'), "entities"),
    "one big entity": (doc("&a;" * 50_000, f'<!DOCTYPE svg [<!ENTITY a "{"a" * 50_000}">]>'), "entities"),
    "an entity loop": (doc("&a;", '<!DOCTYPE svg [<!ENTITY a "&b;"><!ENTITY b "&a;">]>'), "entities"),
    "a file entity": (doc("&a;", '<!DOCTYPE svg [<!ENTITY a SYSTEM "file:///etc/hostname">]>'), "external entity"),
    "a parameter entity": (doc("", '<!DOCTYPE svg [<!ENTITY % a SYSTEM "http://127.0.0.1:9/x"> %a;]>'), "parameter entity"),
    "nested uses": (doc(f'<defs><g id="a0"><path d="M0 0h1"/></g>{USES}</defs><use href="#a9"/>'), "--max-uses"),
    "nested markers": (doc(f'{MARKERS}<path d="M0 0{"l1 1" * 30}" marker-mid="url(#m0)"/>'), "--max-markers"),
    "deep groups": (doc("<g>" * 1000 + "</g>" * 1000), "--max-nesting"),
    "very deep groups": (doc("<g>" * 100_000 + "</g>" * 100_000), "--max-nesting"),
    "deep svgs": (doc("<svg>" * 300 + "</svg>" * 300), "--max-nesting"),
    "a use chain": (doc("".join(f'<use id="u{i}" href="#u{i + 1}"/>' for i in range(300))), "--max-nesting"),
    "dashes": (doc('<path d="M0 0H1e6" stroke-dasharray="1e-6"/>'), "--max-dashes"),
    "dashes of nothing": (doc('<path d="M0 0H100" stroke-dasharray="1e-300"/>'), "--max-dashes"),
    "many dashed lines": (doc('<g stroke-dasharray="0.001">' + '<path d="M0 0H100"/>' * 1000 + "</g>"), "--max-dashes"),
    "gzip": (gzip.compress(HEAD.encode() + b" " * 400_000_000), "--max-bytes"),
    "elements": (doc("<g/>" * 3_000_000), "--max-elements"),
    "points": (doc('<circle r="9e8"/>' * 50), "--max-points"),
    "text": (doc(f"<text>{'a b ' * 100_000}</text>"), "--max-characters"),
    "selectors": (doc("<style>" + ".a b c d e > f {fill:red}" * 20_000 + "</style>"), "--max-selector-tests"),
    "attributes": (doc("<g " + " ".join(f'a{i}="1"' for i in range(100_000)) + "/>"), "attributes"),
    "clip chain": (
        doc(
            "".join(
                f'<clipPath id="c{i}" clip-path="url(#c{i + 1})"><rect width="5" height="5"/></clipPath>' for i in range(2000)
            )
            + '<rect width="9" height="9" clip-path="url(#c0)"/>'
        ),
        "each other",
    ),
    "NaN": (doc('<rect id="r" x="NaN" width="5" height="5"/>'), "id='r'"),
    "infinity": (doc('<circle id="r" r="Infinity"/>'), "id='r'"),
    "a huge number": (doc('<path id="r" d="M0 0L1e999 5"/>'), "id='r'"),
    "a huge arc": (doc('<path id="r" d="M0 0A1e300 1e300 0 0 1 1e300 1e300"/>'), "id='r'"),
    "a huge circle": (doc('<circle id="r" r="1e12"/>'), "id='r'"),
    "a huge page": (b'<svg xmlns="http://www.w3.org/2000/svg" width="1e308mm" height="5"/>', "width"),
    "a page of nothing": (b'<svg xmlns="http://www.w3.org/2000/svg" width="0" height="5"/>', "positive"),
    "truncated": (HEAD.encode() + b'<g><path d="M0 0L5', "well-formed"),
    "truncated gzip": (gzip.compress(doc(""))[:-12], "truncated"),
    "garbage after a gzip head": (b"\x1f\x8b\x08\x00garbage garbage", "gzip"),
    "nothing": (b"", "empty"),
    "white space": (b" \n\t ", "empty"),
    "PNG": (b"\x89PNG\r\n\x1a\n" + bytes(100), "PNG"),
    "PDF": (b"%PDF-1.7\n", "PDF"),
    "HTML": (b"<html><body/></html>", "<html>"),
    "bytes": (bytes(range(256)) * 100, "well-formed"),
    "not UTF-16": (b"\xff\xfe<\0s\0v\0g\0 ", "utf-16"),
    "not UTF-8": (b'<?xml version="1.0" encoding="utf-8"?>' + HEAD.encode() + b"\xe9\xff</svg>", "well-formed"),
    "no such encoding": (b'<?xml version="1.0" encoding="klingon"?>' + doc(""), "encoding"),
}

# What is read, but must stay bounded.
BOUNDED: dict[str, bytes] = {
    "an outside DTD": doc('<path d="M0 0h5"/>', '<!DOCTYPE svg SYSTEM "http://127.0.0.1:9/x.dtd">'),
    "clips in clips": doc(
        "".join(
            f'<clipPath id="c{i}">{f"""<rect width="5" height="5" clip-path="url(#c{i + 1})"/>""" * 10}</clipPath>'
            for i in range(9)
        )
        + '<rect width="9" height="9" clip-path="url(#c0)"/>'
    ),
    "clips of themselves": doc(
        '<clipPath id="c" clip-path="url(#c)"><rect width="5" height="5" clip-path="url(#c)"/></clipPath>'
        '<rect width="9" height="9" clip-path="url(#c)"/>'
    ),
    "a long selector": doc(f"<style>{'a' * 1_000_000}{{fill:red}}</style>"),
    "nested media": doc(f"<style>{'@media all{' * 3000}{'}' * 3000}</style>"),
    "parentheses": doc(f'<rect style="fill:{"(" * 50_000}" width="5" height="5"/>'),
    "transforms": doc(f'<g transform="{"scale(1) " * 100_000}"><rect width="5" height="5"/></g>'),
    "no transform": doc(f'<g transform="{"(" * 100_000}"><rect width="5" height="5"/></g>'),
    "an odd polygon": doc(f'<polygon points="{"1 " * 300_001}"/>'),
    "a long number": doc(f'<path d="M{"1" * 3_000_000}"/>'),
    "packed arcs": doc(f'<path d="M0 0{"a5,5 0 115,5" * 100_000}"/>'),
    "damage everywhere": doc('<path d="M0 0L1 1 e"/>' * 5000),
}


# These are run in a process of their own, with an eye on their time and memory.
MEASURED = (
    "entities",
    "nested uses",
    "nested markers",
    "many dashed lines",
    "gzip",
    "elements",
    "selectors",
    "points",
    "clip chain",
)


@pytest.mark.parametrize("kind", sorted(set(REFUSED) - set(MEASURED)))
def test_refused_with_one_sentence(kind: str) -> None:
    data, word = REFUSED[kind]
    with pytest.raises(BadInput) as caught:
        read_drawing(data)
    message = str(caught.value)
    assert word in message
    assert "\n" not in message and len(message) < 400


@pytest.mark.parametrize("kind", BOUNDED)
def test_bounded(kind: str) -> None:
    read_drawing(BOUNDED[kind])


CHILD = """
import resource, sys, time
from pathlib import Path
from plotter.errors import BadInput
from plotter.svg.read import read_drawing
begin = time.process_time()
try:
    read_drawing(Path(sys.argv[1]))
except BadInput as error:
    print(error, file=sys.stderr)
peak_kb = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
print(time.process_time() - begin, peak_kb / 1024)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads its memory from /proc")
@pytest.mark.parametrize("kind", MEASURED)
def test_bombs_stay_within_5_s_and_300_mb(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "bomb.svg"
    file.write_bytes(REFUSED[kind][0])
    child = subprocess.run([sys.executable, "-c", CHILD, str(file)], capture_output=True, text=True, timeout=60, check=False)
    assert child.returncode == 0 and "Traceback" not in child.stderr
    assert REFUSED[kind][1] in child.stderr and child.stderr.count("\n") == 1
    cpu_s, peak_mb = map(float, child.stdout.split())
    assert cpu_s < 5 and peak_mb < 300


def test_budgets_can_be_raised_and_refuse_nonsense() -> None:
    body = "<g>" * 300 + '<path d="M0 0h5"/>' + "</g>" * 300
    with pytest.raises(BadInput, match="256 levels"):
        page(body)
    assert page(body, budgets=Budgets(nesting=400)).stroke_count == 1
    with pytest.raises(ValueError, match="at most 400"):
        Budgets(nesting=1000)
    with pytest.raises(ValueError, match="at least 1"):
        Budgets(points=0)
    with pytest.raises(ValueError, match="tolerance"):
        ReadOptions(tolerance_mm=0)


def test_reading_leaves_the_recursion_limit_alone() -> None:
    before = sys.getrecursionlimit()
    page("<g>" * 200 + "</g>" * 200)
    with pytest.raises(BadInput):
        page("<g>" * 400 + "</g>" * 400)
    assert sys.getrecursionlimit() == before


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ('<rect x="NaN" width="5" height="5"/>', "<rect> on line 2 has x='NaN'"),
        ('<rect\n\nid="r" x="1e999" width="5" height="5"/>', "<rect id='r'> on line 4 has x='1e999'"),
        ('<use id="u" href="#q" x="1e999"/><path id="q" d="M0 0h5"/>', "<use id='u'> on line 2 has x='1e999'"),
        (
            '<svg><symbol id="s" viewBox="0 0 NaN 5"/><use href="#s"/></svg>',
            "<symbol id='s'> on line 2 has viewBox='0 0 NaN",
        ),
        ('<path style="stroke-dasharray:inf" class="info" d="M0 0h5"/>', "<path> on line 2 has style='stroke-dasharray:inf'"),
        ('<text id="t" x="3">A<tspan dx="inf" class="info">B</tspan></text>', "<tspan> on line 2 has dx='inf'"),
        ('<text id="t" letter-spacing="1e999">AB</text>', "<text id='t'> on line 2 has letter-spacing='1e999'"),
        (
            '<clipPath id="c"><rect x="1e999" width="5" height="5"/></clipPath><path clip-path="url(#c)" d="M0 0h5"/>',
            "<rect> on line 2 has x='1e999'",
        ),
        ("<style>circle{r:1e999}</style><circle id='c'/>", "<circle id='c'> on line 2 has the value '1e999'"),
        ("<style>text{letter-spacing:1e999}</style><text>AB</text>", "style sheet, has the value '1e999'"),
        ('<path id="p" d="M0 0L1e999 5"/>', "<path id='p'> has a number too large to be finite"),
        ('<polyline points="0,0 1e999,3"/>', "<polyline> on line 2 has a number too large to be finite"),
    ],
)
def test_a_number_that_is_not_finite_is_named_with_its_element_and_attribute(body: str, said: str) -> None:
    with pytest.raises(BadInput) as refused:
        page(f"\n{body}", text="single")
    assert said in str(refused.value)


def test_the_root_is_an_element_too() -> None:
    with pytest.raises(BadInput, match="<svg id='top'> on line 1 has style='font-size:1e999', which is not finite"):
        read_drawing(HEAD.replace("<svg ", '<svg id="top" style="font-size:1e999" ').encode() + b"</svg>")
