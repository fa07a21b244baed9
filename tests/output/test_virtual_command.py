"""`plotter virtual`: the board in the foreground."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import serial

from output.ebb.virtual.process import start_virtual_board
from output.ebb.virtual.server import make_server
from output.errors import BadCommand

RUN = [sys.executable, "-c", "from plotter.cli.main import main; main()", "virtual"]


def test_it_prints_its_port_serves_until_ctrl_c_and_leaves_a_record(tmp_path: Path) -> None:
    link, record = tmp_path / "ebb", tmp_path / "drawn.json"
    options = ["--pty", str(link), "--firmware", "2.8.1", "--record", str(record), "--json"]
    with subprocess.Popen([*RUN, *options], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline()) == {"port": str(link)}
        with serial.Serial(str(link), timeout=5) as port:
            port.write(b"V\r")
            assert port.read_until(b"\n") == b"EBBv13_and_above EB Firmware Version 2.8.1\r\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    assert json.loads(record.read_text())["commands"] == 1
    assert not link.exists()


def test_what_it_cannot_be_is_one_sentence(tmp_path: Path) -> None:
    script = tmp_path / "faults.json"
    script.write_text('[{"fault": "explode", "at": {"command": 1}}]')
    taken = tmp_path / "taken"
    taken.write_text("")
    for options, words in ((["--faults", str(script)], "explode"), (["--pty", str(taken)], "taken")):
        done = subprocess.run([*RUN, *options], capture_output=True, text=True, timeout=30, check=False)
        assert done.returncode == 2
        assert words in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
    assert taken.exists()


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ('"a"', 'a list of objects, not "a"'),
        ("[3]", 'a fault is an object such as {"fault": "button", "at": {"time_s": 2}}, not 3'),
        ('[{"fault": ["power"], "at": {"byte": 1}}]', "fault ['power'] is not known"),
        ('[{"fault": "power", "at": {"time_s": "x"}}]', 'fault power: time_s is "x"; give a number from 0 up to 1000000000'),
        ('[{"fault": "power", "at": {"time_s": NaN}}]', "time_s is NaN; give a number"),
        ('[{"fault": "drop_ack", "at": {"command": -1}}]', "command is -1; give a whole number from 0 to 1000000000"),
        ('[{"fault": "drop_ack", "at": {"byte": 1.5}}]', "byte is 1.5; give a whole number"),
        ('[{"fault": "drop_ack", "at": {"stroke": true}}]', "stroke is true; give a whole number"),
        ('[{"fault": "drop_ack", "at": {"command": 1}, "times": 0}]', "times is 0; give a whole number from 1"),
        ('[{"fault": "delay_ack", "at": {"command": 3}, "delay_s": null}]', "delay_s is null; give a number"),
        ('[{"fault": "slow", "at": {"command": 3}, "factor": 0}]', "factor is 0; give a number above 0"),
        ('[{"fault": "power", "at": {"command": 3}, "on": "no"}]', 'on is "no"; give true or false'),
        ('[{"fault": "notice", "at": {"command": 3}, "text": "\\u20ac"}]', "give a string of characters up to"),
        ('[{"fault": "notice", "at": {"command": 3}, "place": []}]', "place is []; give before, inside or after"),
    ],
)
def test_a_fault_script_of_the_wrong_kind_is_refused_by_name(script: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "faults.json"
    file.write_text(script)
    with pytest.raises(BadCommand) as refused:
        make_server(faults=file)
    assert words in str(refused.value)


@pytest.mark.parametrize("name", ["x" * 17, "a,b", "a\nb"])
def test_a_nickname_that_no_board_keeps_is_refused(name: str) -> None:
    with pytest.raises(BadCommand, match="at most 16"):
        make_server(nickname=name)


def test_a_wrong_fault_by_control_is_answered_and_the_board_goes_on() -> None:
    with start_virtual_board() as board:
        for wrong in ('{"fault": "explode"}', '{"fault": "slow", "factor": "x"}', "3"):
            with pytest.raises(BadCommand, match="fault"):
                board.control(f"fault {wrong}")
        assert board.state()["idle"]


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (
            "record /nodir/q",
            "'record /nodir/q': the record cannot be written to /nodir/q: /nodir is not a directory; make it first",
        ),
        ("record", "'record': write it as `record PATH`"),
        ("record a\0b", "write it as `record PATH`"),
        ("power", "'power': write it as `power on|off`"),
        ("power maybe", "'power maybe': write it as `power on|off`"),
        ("hangup x", "'hangup x': write it as `hangup [SECONDS [PATH]]`"),
        ("hangup -1", "'hangup -1': write it as `hangup [SECONDS [PATH]]`"),
        ("hangup inf", "'hangup inf': write it as `hangup [SECONDS [PATH]]`"),
        ("hangup 1 /nodir/ebb", "the port cannot come back as /nodir/ebb: /nodir is not a directory; make it first"),
        ("wire B", "'wire B': write it as `wire PORT PIN 0|1`"),
        ("wire Q 2 0", "'wire Q 2 0': write it as `wire PORT PIN 0|1`"),
        ("wire B 9 0", "'wire B 9 0': write it as `wire PORT PIN 0|1`"),
        ("wire B 2 high", "'wire B 2 high': write it as `wire PORT PIN 0|1`"),
        ("button twice", "'button twice': write it as `button`"),
        ("fault {", "'fault {': write it as `fault {...}`"),
        ("fly", "'fly': unknown control command; give one of state, button, power, "),
        ("", "'': unknown control command; give one of state, "),
    ],
)
def test_what_control_cannot_do_is_answered_in_one_sentence_and_the_board_goes_on(line: str, answer: str) -> None:
    with start_virtual_board() as board:
        with pytest.raises(BadCommand) as refused:
            board.control(line)
        assert answer in str(refused.value)
        assert "Error" not in str(refused.value)
        assert board.state()["idle"]


def test_a_port_that_cannot_come_back_stays_away_and_the_board_goes_on(tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    with start_virtual_board(speed=10) as board:
        board.control(f"hangup 1 {taken}")
        taken.write_text("")
        deadline = time.monotonic() + 10
        while not any("cannot be made" in str(note) for note in board.record()["notes"]):
            assert time.monotonic() < deadline
        assert board.state()["port"] is None
        taken.unlink()
        board.control("return")
        assert board.state()["port"] == str(taken)
        assert board.control("return")["port"] == str(taken)  # it is there
        with serial.Serial(str(taken), timeout=5) as port:
            port.write(b"V\r")
            assert port.read_until(b"\n").startswith(b"EBB")


def test_a_record_that_cannot_be_written_at_the_end_is_one_sentence(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    with subprocess.Popen(
        [*RUN, "--record", str(folder / "drawn.json")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.readline()
        folder.rmdir()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 2
        (said,) = process.stderr.read().splitlines()
    assert "the record cannot be written to" in said


def test_a_port_of_another_board_is_left_to_it_and_one_left_behind_is_replaced(tmp_path: Path) -> None:
    link = tmp_path / "ebb"
    with start_virtual_board(pty=link, nickname="first") as first:
        for second in (RUN, [sys.executable, "-m", "output.ebb.virtual"]):
            done = subprocess.run([*second, "--pty", str(link)], capture_output=True, text=True, timeout=30, check=False)
            assert done.returncode == 2 and done.stdout == ""
            (said,) = done.stderr.splitlines()
            assert f"{link} leads to {link.readlink()}, which is there: another virtual board may be running" in said
        with serial.Serial(str(link), timeout=5) as port:
            port.write(b"QT\r")
            assert port.read_until(b"\n").strip() == b"first"
        assert first.state()["idle"]
    link.symlink_to("/dev/pts/999999")
    with start_virtual_board(pty=link) as board:
        assert board.state()["port"] == str(link)
    assert not link.is_symlink()
