"""Commands as values: wire forms, refusals, parsing of text and of replies."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from output.ebb import commands as c
from output.ebb import commands_pins as pins
from output.ebb.commands_reply import BoardError, Form, Status, parse_reply, parse_version, reply_form
from output.ebb.commands_text import KINDS, checksum, parse_command, with_checksum
from output.errors import BadCommand, BoardRefused

DATA = Path(__file__).parents[1] / "data"
ROWS = [json.loads(line) for line in (DATA / "ebb_protocol_sample.jsonl").read_text().splitlines()]

# One line for each command of the references, as their examples write it.
EXAMPLES = """A|AC,5,1|BL|C,255,1,2,3,4|CK,1,-2,3,-4,5,-6,a,B|CN|CS|CU,4,32|CU,10,1|CU,54,1|CU,61,300|CU,250,1|EM,1,1|EM,0,0
ES|ES,1|HM,1000|HM,3000,100,-200|I|L3,85899346,10,0,0,17180814,2,0,0,3|LM,17179000,75,-687,8592000,75,687|LM,1,-5,0,2,5,0,3
LT,10169,3865471,1732,0,0,3|LT,25000,33865471,0,0,0|MR,422|MW,422,7|ND|NI|O,1|O,1,2,3,4,5|PC,100,150|PC,12,123,0,0,2000,10000
PD,C,3,0|PG,1|PI,D,2|PO,C,7,1|QB|QC|QE|QG|QL|QL,21|QM|QN|QP|QR|QS|QT|QU,2|QU,200|R|RB|S2,24000,6|S2,0,5|S2,27500,5,50,10
SC,4,8000|SC,1,1|SE,1,1023|SE,0|SE,0,0,1|SL,4|SL,125,19|SM,1000,250,-766|SM,10,0|SN,123456789|SP,1|SP,0,300|SP,0,300,4|SP,3
SR,60000,1|ST,East EBB|ST,|T,250,0|T3,4294967295,0,0,0,0,0,0|TD,252,-2028360747,-1053052208,7740544,30716,0,0,0,0,1|TP|TP,10
TR,1000,10,-10|V|XM,1000,550,-1234|XM,10,1,1,3""".replace("\n", "|").split("|")


@pytest.mark.parametrize("line", EXAMPLES)
def test_every_example_goes_in_and_out_again(line: str) -> None:
    command = parse_command(line)
    assert command.wire() == line
    assert parse_command(line.lower().replace("east ebb", "East EBB").replace(",a,b", ",a,B")) == command


def test_every_command_has_an_example_and_a_place_in_the_protocols_description() -> None:
    shown = {line.split(",")[0] for line in EXAMPLES}
    assert set(KINDS) == shown
    described = (Path(__file__).parents[2] / "docs" / "ebb-protocol.md").read_text()
    assert [name for name in KINDS if not re.search(rf"`{name}[`,\[]", described)] == []


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("T3,0,0,0,0,0,0,0", "intervals is 0, allowed is 1 to 4294967295"),
        ("T3,1,2147483648,0,0,0,0,0", "rate1 is 2147483648, allowed is -2147483648 to 2147483647"),
        ("T3,1,0,0,99999999999,0,0,0", "jerk1 is 99999999999, allowed is -2147483648 to 2147483647"),
        ("T3,1,0,0,0,0,0,-1" + 60 * "0", "jerk2 is -1000000000000000000..., allowed is -2147483648 to 2147483647"),
        ("T3,00000000250,0,0,0,0,0,0", "intervals is 00000000250, allowed is a number of up to 10 digits"),
        ("PO,B,99999999999,1", "pin is 99999999999, allowed is a number of up to 10 digits"),
        ("SM,10,251,0", "251 steps in 10 ms, allowed is 25 steps per ms"),
        ("XM,10,200,100", "300 steps in 10 ms"),
        ("XM,1,2147483647,1", "axis 1 is 2147483648"),
        ("SM,0,1,1", "duration_ms is 0"),
        ("SM,10,1,1,4", "clear is 4, allowed is 0 to 3"),
        ("LM,-1,-1,0,0,0,0", "rate1 is -1, allowed is 0 or more when steps1"),
        ("LM,0,5,0,5,0,0", "neither axis can move"),
        ("L3,0,0,0,0,0,5,0,7", "neither axis can move"),
        ("EM,6,0", "enable1 is 6, allowed is 0 to 5"),
        ("SP,4", "value is 4"),
        ("CU,4,0", "value of CU,4 is 0, allowed is 1 to"),
        ("CU,11,1", "number is 11, allowed is one of"),
        ("QU,7", "number is 7"),
        ("SC,4,0", "value of SC,4 is 0"),
        ("S2,0,25", "pin is 25, allowed is 0 to 24"),
        ("PD,F,1,0", "port is 'F'"),
        ("PI,B,8", "pin is 8"),
        ("PC,5,4", "period0_ms is 4, allowed is 5"),
        ("ST,seventeen letters", "allowed are at most 16"),
        ("HM,0", "steps_per_s is 0"),
        ("SM,10", "2 are needed"),
        ("SM,10,1,1,1,1", "at most 4"),
        ("SM,1.5,1,1", "'1.5', allowed is a whole number"),
        ("SM,,1,1", "''"),
        ("G1 X10", "is not a command"),
    ],
)
def test_what_a_board_would_refuse_is_refused_with_value_and_bound(line: str, said: str) -> None:
    with pytest.raises(BadCommand, match=re.escape(said)):
        parse_command(line)


def test_what_waits_in_the_queue_says_so() -> None:
    assert [x.queued for x in (c.SP(0), c.SP(1), c.SP(2), c.SP(3))] == [True, True, False, False]
    assert c.S2(100, 4).queued and not c.S2(0, 4).queued
    assert c.SE(1, 5, 1).queued and not c.SE(1).queued
    assert c.EM(1, 1).queued and not c.CS().queued and c.HM(1000).waits_for_idle and c.CU(4, 8).waits_for_idle
    assert not c.TR(1000, 0, 0).queued
    assert (c.TD(1, 0, 0, 0, 0, 0, 0, 0, 0).fifo_entries, c.T3(1, 0, 0, 0, 0, 0, 0).fifo_entries, c.QG().fifo_entries) == (
        2,
        1,
        0,
    )


def test_checksums_are_those_of_the_table() -> None:
    assert with_checksum("SM,1000,1000,1000") == "SM,1000,1000,1000,153"
    assert checksum("V") == 170 and checksum("v") == 138 and checksum("CU,54,0") == 119


COMMANDS = [kind for kind in KINDS.values() if kind.bounds and not issubclass(kind, pins.PinCommand)]


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_whatever_can_be_built_is_read_back_the_same(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(COMMANDS))
    values = [data.draw(st.integers(low, high)) for low, high in kind.bounds]
    try:
        command = kind(*values)
    except BadCommand:
        return
    assert parse_command(command.wire()) == command
    assert len(command.wire()) < 256


def names_sent(text: str) -> list[str]:
    return [word for word in re.split(r"[\r\n]+", text) if word]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['mode']}-{row['send']!r}")
def test_every_reply_of_the_table_is_understood(row: dict) -> None:
    future, sent, data = row["mode"] == "future", names_sent(row["send"])[0], row["recv"].encode("latin-1")
    if len(names_sent(row["send"])) == 2:
        data = data[: len(data) // 2]
    reply = parse_reply(sent, data, future)
    assert [str(e.code) for e in reply.errors] == re.findall(r"!(\d+) ", row["recv"])
    assert "".join(f"!{e.code} {e.text}" for e in reply.errors) == "".join(re.findall(r"![^\r\n]*", row["recv"])).replace(
        ",!", "!"
    )
    carries = re.sub(r"![^\r\n]*|OK|\x08| ", "", row["recv"])
    assert bool(reply.values) == bool(set(re.split(r"[,\r\n]", carries)) - {reply.name, ""})


def test_replies_become_values_in_both_syntaxes() -> None:
    assert parse_reply(c.QS(), b"1421,-429\n\rOK\r\n", False).values == (1421, -429)
    assert parse_reply(c.QS(), b"QS,1421,-429\n", True).values == (1421, -429)
    assert (
        parse_reply(c.QM(), b"QM,1,1,0,1\n\r", False).values
        == parse_reply(c.QM(), b"QM,1,1,0,1\n", True).values
        == (1, 1, 0, 1)
    )
    assert parse_reply(c.QU(2), b"QU,2,32\r\nOK\r\n", False).values == parse_reply(c.QU(2), b"QU,32\n\n", True).values == (32,)
    assert parse_reply(c.QU(1), b"QU,F7\r\nOK\r\n", False).values == (0xF7,)
    assert parse_reply(c.QT(), b"East EBB\r\nOK\r\n", False).values == ("East EBB",)
    assert parse_reply(c.ES(), b"1,50,1200,18634,9848\n\rOK\r\n", False).values == (1, 50, 1200, 18634, 9848)
    assert parse_reply(pins.A(), b"A,0:394,11:300\n\r", False).values == (0, 394, 11, 300)
    assert parse_version(parse_reply(c.V(), b"EBBv13_and_above EB Firmware Version 2.8.1\r\n", False)) == (2, 8, 1)
    status = Status.of(int(parse_reply(c.QG(), b"QG,3E\n", True).values[0]))
    assert (status.queue_not_empty, status.executing, status.pen_up, status.limit) == (False, True, True, False)
    limit = parse_reply(c.SM(10, 1, 1), b"OK\r\nLimit switch triggered. PortB=F7\r\n", False)
    assert limit.ok and limit.limit == 0xF7


def test_errors_say_whether_the_command_was_taken() -> None:
    taken = parse_reply("SM,10,1,1,1,1", b"OK\r\n!7 Err: Extra parameter\r\n", False)
    assert taken.acknowledged and taken.errors[0].executed
    refused = parse_reply("SM,0,1,1", b"!6 Err: Invalid parameter value\r\n", False)
    assert not refused.acknowledged
    with pytest.raises(BoardRefused, match="!6"):
        refused.raise_for_errors()
    assert BoardError(9, "Err: Checksum incorrect, expected 170").expected_checksum == 170
    with pytest.raises(BoardRefused, match="not what QS"):
        parse_reply(c.QS(), b"hello\r\n", False)
    assert reply_form(c.V()) is Form.DATA and reply_form(c.RB()) is Form.NOTHING and reply_form(c.QS()) is Form.DATA_OK
