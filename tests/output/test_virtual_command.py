"""`plotter virtual`: the board in the foreground."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import serial

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
