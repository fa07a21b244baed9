"""Groups, use, switch, layers and entities."""

from __future__ import annotations

from tests.plotter.svg_help import page, rounded


def layers(body: str, **options: object) -> list[tuple[int, str, int]]:
    return [(layer.number, layer.name, len(layer.strokes)) for layer in page(body, **options).layers]


LAYER = '<g inkscape:groupmode="layer" inkscape:label="{0}" id="{1}"{2}><path d="M0 0h5"/></g>'


def test_inkscape_layers_keep_names_order_and_numbers() -> None:
    body = (
        LAYER.format("Zweite Ebene", "a", "")
        + LAYER.format("empty", "b", "").replace("<path", "<desc")
        + LAYER.format("x", "c", "")
    )
    assert layers(body) == [(1, "Zweite Ebene", 1), (3, "x", 1)]
    assert [facts.name for facts in page(body).file_layers] == ["Zweite Ebene", "empty", "x"]


def test_inner_layers_belong_to_the_outer_one() -> None:
    inner = LAYER.format("in", "i", "")
    body = f'<g inkscape:groupmode="layer" inkscape:label="out"><path d="M0 0h5"/>{inner}</g>'
    assert layers(body) == [(1, "out", 2)]


def test_shapes_outside_layers_come_where_they_stand() -> None:
    body = '<path d="M1 1h5"/>' + LAYER.format("a", "a", "") + '<path d="M2 2h5"/><path d="M3 3h5"/>'
    assert layers(body) == [(1, "outside layers", 1), (2, "a", 1), (3, "outside layers", 2)]
    assert [one[0] for one in rounded(page(body))] == [[1, 1], [0, 0], [2, 2], [3, 3]]


def test_top_level_groups_are_layers_where_there_are_no_others() -> None:
    body = '<g id="one"><g id="in"><path d="M0 0h5"/></g></g><g><path d="M0 0h5"/></g>'
    assert layers(body) == [(1, "one", 1), (2, "group 2", 1)]
    assert layers(body, layers="one") == [(1, "drawing", 2)]
    assert layers(body, layers="inkscape") == [(1, "drawing", 2)]
    assert layers('<path d="M0 0h5"/>') == [(1, "drawing", 1)]


def test_a_group_around_every_shape_makes_no_layers() -> None:
    drawing = page('<g><path d="M0 0h5"/></g>' * 300)
    assert [(layer.name, len(layer.strokes)) for layer in drawing.layers] == [("drawing", 300)]
    assert any("--layers groups" in warning for warning in drawing.warnings)
    assert len(page('<g><path d="M0 0h5"/></g>' * 300, layers="groups").layers) == 300


def test_documentation_pause_hidden_and_locked_layers() -> None:
    body = (
        LAYER.format("%notes", "a", "")
        + LAYER.format("!red pen", "b", ' sodipodi:insensitive="true"')
        + LAYER.format("off", "c", ' style="display:none"')
    )
    drawing = page(body)
    assert [(layer.number, layer.name, layer.pause_before) for layer in drawing.layers] == [(2, "!red pen", True)]
    facts = {one.name: one for one in drawing.file_layers}
    assert facts["%notes"].documentation and facts["!red pen"].locked and facts["off"].hidden
    assert any("%notes" in warning for warning in drawing.warnings)
    assert [layer.name for layer in page(body, hidden="all").layers] == ["!red pen", "off"]


def pauses(body: str) -> list[tuple[str, tuple[str, ...]]]:
    """The layers that pause, and the empty ones whose pause they make."""
    return [(layer.name, layer.pause_for) for layer in page(body).layers if layer.pause_before]


def test_an_empty_layer_that_pauses_does_so_before_the_next_that_is_drawn() -> None:
    empty = '<g inkscape:groupmode="layer" inkscape:label="{}"{}/>'
    one, two, own = LAYER.format("1", "a", ""), LAYER.format("2", "b", ""), LAYER.format("!3", "c", "")
    change, again, nothing = empty.format("! change", ""), empty.format("!again", ""), empty.format("%", "")
    assert pauses(one + change + two) == [("2", ("! change",))]
    assert pauses(change + one + two) == [("1", ("! change",))]
    assert pauses(one + change + nothing + again + two) == [("2", ("! change", "!again"))]
    assert pauses(one + change + own) == [("!3", ("! change",))]
    assert pauses(one + empty.format("!off", ' style="display:none"') + two) == []


def test_a_pause_that_nothing_follows_is_none_and_is_not_listed() -> None:
    drawing = page(LAYER.format("1", "a", "") + '<g inkscape:groupmode="layer" inkscape:label="!end"/>')
    assert [facts.pause_before for facts in drawing.file_layers] == [False, False]
    assert [layer.pause_before for layer in drawing.layers] == [False]


def test_names_are_one_line_that_a_terminal_shows() -> None:
    given = ("!evil&#10;SM,1,2,3&#x9b;31m", "a&#x202e;b", "&#10;", "%no\u200dte", " Z\u00fcrich  \u65e5\u672c")
    names = ["!evil SM,1,2,3 31m", "a b", "l2", *given[3:]]
    drawing = page("".join(LAYER.format(name, f"l{i}", "") for i, name in enumerate(given)))
    assert [facts.name for facts in drawing.file_layers] == names
    assert [layer.name for layer in drawing.layers] == [*names[:3], names[4]]
    nested = page('<path id="a&#x9b;31m" d="M0 0h5" mask="url(#m)"/>').warnings
    assert nested and all(sentence.isprintable() for sentence in nested)


def test_a_layer_has_a_colour_when_its_strokes_agree() -> None:
    same = page('<g id="a"><path stroke="red" d="M0 0h5"/><path stroke="#f00" d="M0 0h5"/></g>').layers[0]
    mixed = page('<g id="a"><path stroke="red" d="M0 0h5"/><path d="M0 0h5"/></g>').layers[0]
    assert same.color == "#ff0000" and mixed.color is None


def test_use_of_what_comes_later_nested_and_placed() -> None:
    group = '<g id="b" transform="translate(0 5)"><use xlink:href="#a" y="2"/></g>'
    body = f'<use href="#b" x="1"/><defs>{group}<path id="a" d="M0 0h5"/></defs>'
    assert rounded(page(body)) == [[[1, 7], [6, 7]]]


def test_cycles_are_left_out_and_named() -> None:
    for body in (
        '<use id="u" href="#u"/>',
        '<g id="g"><path d="M0 0h5"/><use href="#g"/></g>',
        '<g id="g"><path d="M0 0h5"/><use href="#v"/></g><defs><use id="v" href="#g"/></defs>',
    ):
        drawing = page(body)
        assert drawing.stroke_count == body.count("<path")
        assert any("refers to itself" in warning for warning in drawing.warnings)


def test_references_outside_and_to_nothing_are_named() -> None:
    drawing = page('<use href="other.svg#a"/><use href="#none"/>')
    assert any("outside the file (other.svg#a)" in warning for warning in drawing.warnings)
    assert any("not there (#none)" in warning for warning in drawing.warnings)


def test_switch_draws_the_first_child_that_fits() -> None:
    body = (
        '<switch><foreignObject/><g requiredExtensions="http://x"><path d="M1 0h5"/></g>'
        '<path systemLanguage="xx" d="M2 0h5"/><path systemLanguage="de, en-GB" d="M3 0h5"/><path d="M4 0h5"/></switch>'
    )
    assert rounded(page(body)) == [[[3, 0], [8, 0]]]


def test_inner_entities_are_read() -> None:
    from plotter.svg.read import read_drawing

    text = (
        '<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd" ['
        "<!ENTITY ns \"http://www.w3.org/2000/svg\"><!ENTITY p \"<path d='M0 0h5' stroke='red'/>\">]>"
        '<svg xmlns="&ns;" width="9mm" height="9mm">&p;&p;</svg>'
    )
    assert read_drawing(text.encode()).stroke_count == 2


def test_links_are_groups_and_foreign_elements_are_skipped() -> None:
    body = (
        '<a href="x"><path d="M0 0h5"/></a><x:y xmlns:x="urn:x"><path d="M0 0h5"/></x:y><unknown><path d="M0 0h5"/></unknown>'
    )
    assert page(body).stroke_count == 1


def test_undeclared_prefixes_are_tolerated_and_said() -> None:
    from plotter.svg.read import read_drawing

    text = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="9mm" height="9mm"><path id="p" d="M0 0h5" sodipodi:x="1"/>'
        '<use xlink:href="#p" x="1"/></svg>'
    )
    drawing = read_drawing(text.encode())
    assert drawing.stroke_count == 2 and any("prefixes" in warning for warning in drawing.warnings)


def test_illustrators_entities_do_not_limit_the_length_of_a_path() -> None:
    from plotter.svg.read import read_drawing

    path = "M0 0" + "l1 1-1-1" * 1_400_000
    assert len(path) > 10_000_000
    prolog = '<!DOCTYPE svg [<!ENTITY ns "http://www.w3.org/2000/svg">]>'
    text = f'{prolog}<svg xmlns="&ns;" width="9mm" height="9mm"><path d="{path}"/></svg>'
    (stroke,) = read_drawing(text.encode()).layers[0].strokes
    assert len(stroke.points_mm) == 2_800_001
