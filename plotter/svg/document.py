"""Bytes to an element tree, safely: nothing from outside, no network, and bounded before the tree is built."""

from __future__ import annotations

import codecs
import re
import zlib
from typing import Any

from lxml import etree

from output.wording import counted
from plotter.errors import BadInput
from plotter.svg.notes import Notes
from plotter.svg.options import Budgets

SVG = "http://www.w3.org/2000/svg"
XLINK = "http://www.w3.org/1999/xlink"
INKSCAPE = "http://www.inkscape.org/namespaces/inkscape"
SODIPODI = "http://sodipodi.sourceforge.net/DTD/sodipodi-0.dtd"

_GZIP = b"\x1f\x8b"
_NAMESPACE_ERRORS = frozenset(("NS_ERR_UNDEFINED_NAMESPACE",))
_CHUNK_BYTES = 1 << 20
# Attributes form a chain that takes the square of its length to list.
_MOST_ATTRIBUTES = 1000
_SHORTEST_ATTRIBUTE = len(' a=""')
_CROWDED = etree.XPath(f"boolean(//*[@*[{_MOST_ATTRIBUTES + 1}]])")
_QUOTED = rb"(?:\"[^\"]*\"|'[^']*')"
_DOCTYPE = re.compile(
    rb"<!DOCTYPE\s+([^\s\[>]+)\s*(?:PUBLIC\s*" + _QUOTED + rb"\s*" + _QUOTED + rb"?|SYSTEM\s*" + _QUOTED + rb")"
)
_ENTITY = re.compile(rb"<!ENTITY\s+(%\s+)?([^\s\"']+)\s+(SYSTEM|PUBLIC|\"|')")
_SMALL_GROWTH_BYTES = 5_000_000
_NOT_SVG = {
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
    b"GIF8": "a GIF picture",
    b"%PDF": "a PDF document",
    b"PK\x03\x04": "a zip archive",
    b"BM": "a bitmap picture",
}


def parse_document(data: bytes, name: str, budgets: Budgets, notes: Notes) -> Any:
    """The root `<svg>` element of `data` (plain or gzipped). `name` is what messages call the document.

    Raises BadInput with one sentence for everything that is no readable SVG.
    """
    data = _unpack(data, name, budgets)
    for magic, what in _NOT_SVG.items():
        if data.startswith(magic):
            raise BadInput(f"{name} is {what}, not an SVG drawing; give an .svg or .svgz file")
    data = _as_utf8(data.lstrip(b" \t\r\n") if not data.startswith((b"\xff\xfe", b"\xfe\xff")) else data, name)
    if not data:
        raise BadInput(f"{name} is empty; give an .svg or .svgz file")
    has_entities = _check_prolog(data, name)
    data = _DOCTYPE.sub(rb"<!DOCTYPE \1 ", data, count=1) if b"<!DOCTYPE" in data[:65536] else data
    tags = data.count(b"<") - data.count(b"</")
    if tags > budgets.elements * 1.05 + 100:
        raise BadInput(
            f"{name} has about {tags} elements and the limit is {budgets.elements}; raise --max-elements if it is meant"
        )
    # Asking the tree takes as long as parsing it, and where no tag is long enough there is nothing to ask.
    crowdable = b"<!ENTITY" in data or max(map(len, data.split(b"<"))) > _SHORTEST_ATTRIBUTE * _MOST_ATTRIBUTES
    root = _parse(data, name, budgets, notes, has_entities)
    if crowdable and _CROWDED(root):
        raise BadInput(f"{name} has an element with more than {_MOST_ATTRIBUTES} attributes; remove them")
    return _svg_root(root, name, notes)


def _unpack(data: bytes, name: str, budgets: Budgets) -> bytes:
    limit = budgets.document_bytes
    if len(data) > limit:
        raise BadInput(f"{name} has {counted(len(data), 'byte')} and the limit is {limit}; raise --max-bytes if it is meant")
    if not data.startswith(_GZIP):
        return data
    parts: list[bytes] = []
    total = 0
    while data.startswith(_GZIP):
        unpacker = zlib.decompressobj(wbits=31)
        try:
            while not unpacker.eof:
                part = unpacker.decompress(data, _CHUNK_BYTES)
                data = unpacker.unconsumed_tail
                if not part and not data and not unpacker.eof:
                    raise BadInput(f"{name} is a truncated gzip file; pack or copy it again")
                parts.append(part)
                total += len(part)
                if total > limit:
                    raise BadInput(f"{name} unpacks to more than {counted(limit, 'byte')}; raise --max-bytes if it is meant")
        except zlib.error as error:
            raise BadInput(f"{name} is a damaged gzip file ({error}); pack or copy it again") from None
        data = unpacker.unused_data
    return b"".join(parts)


def _as_utf8(data: bytes, name: str) -> bytes:
    """The document in a form libxml2 reads by itself: UTF-16 and UTF-32 become UTF-8, other encodings stay as declared."""
    for mark, encoding in (
        (codecs.BOM_UTF32_LE, "utf-32"),
        (codecs.BOM_UTF32_BE, "utf-32"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
        (b"<\x00?\x00", "utf-16-le"),
        (b"\x00<\x00?", "utf-16-be"),
    ):
        if data.startswith(mark):
            try:
                text = data.decode(encoding)
            except UnicodeDecodeError:
                raise BadInput(f"{name} begins like {encoding} text but is not; save it as UTF-8") from None
            return re.sub(r"^\s*<\?xml[^>]*\?>", "", text, count=1).encode("utf-8", "replace")
    return data.removeprefix(codecs.BOM_UTF8)


def _check_prolog(data: bytes, name: str) -> bool:
    """Whether the document declares entities that may grow. External and parameter entities are refused here, before any parser
    sees them; entities that hold no others and stay small when all are put in, as Illustrator writes, do not grow."""
    if b"<!ENTITY" not in data:
        return False
    grown = 0
    for match in _ENTITY.finditer(data):
        if match[1] or match[3] in (b"SYSTEM", b"PUBLIC"):
            kind = "a parameter entity" if match[1] else "an external entity"
            raise BadInput(f"{name} declares {kind}, which is never read; remove the <!ENTITY ...> declaration")
        value = data[match.end() : data.find(match[3], match.end())]
        if b"&" in value:
            return True
        grown += len(value) * data.count(b"&" + match[2] + b";")
    return grown > _SMALL_GROWTH_BYTES


def _parse(data: bytes, name: str, budgets: Budgets, notes: Notes, has_entities: bool) -> Any:
    # huge_tree lifts libxml2's 10 MB limit on one attribute, which a long path needs, but also its guard against entity
    # bombs: so it is only lifted where the document declares no entity.
    parser = etree.XMLParser(
        resolve_entities="internal",
        no_network=True,
        load_dtd=False,
        huge_tree=not has_entities,
        remove_comments=True,
        remove_pis=True,
        collect_ids=False,
    )
    try:
        return etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        if all(entry.type_name in _NAMESPACE_ERRORS for entry in parser.error_log):
            notes.add("the document uses namespace prefixes that it does not declare; they were taken as they are written")
            parser = etree.XMLParser(
                resolve_entities="internal",
                no_network=True,
                load_dtd=False,
                remove_comments=True,
                remove_pis=True,
                recover=True,
            )
            return etree.fromstring(data, parser)
        text = " ".join(str(error.msg or error).split()).replace(" ,", ",")
        if "depth" in text.lower() and "excessive" in text.lower():
            raise BadInput(
                f"{name} nests elements deeper than the limit of {budgets.nesting}; "
                "flatten its groups (--max-nesting allows at most 400)"
            ) from None
        if "amplification" in text or ("entity" in text.lower() and "loop" in text.lower()):
            raise BadInput(f"{name} has entities that grow without bound ({text}); remove them") from None
        raise BadInput(f"{name} is not well-formed XML: {text}; repair it or save it again as plain SVG") from None
    except (ValueError, LookupError) as error:
        raise BadInput(f"{name} cannot be read as XML: {error}; save it as UTF-8") from None


def _svg_root(root: Any, name: str, notes: Notes) -> Any:
    if root is None:
        raise BadInput(f"{name} holds no element; give an .svg file")
    qualified = etree.QName(root)
    if qualified.localname != "svg":
        raise BadInput(f"{name} is XML but its root is <{qualified.localname}>, not <svg>; give an .svg file")
    if qualified.namespace != SVG:
        notes.add("the document lacks the SVG namespace; its elements were read as SVG all the same")
    return root
