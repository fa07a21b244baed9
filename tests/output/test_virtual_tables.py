"""The virtual board against the tables of what real firmware does: every motion row and every byte of every reply."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from output.ebb.virtual.board import Board
from output.ebb.virtual.firmware import FIRMWARES

DATA = Path(__file__).parent.parent / "data"


def rows(name: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (DATA / name).read_text().splitlines()]


MOVES = rows("ebb_moves_sample.jsonl")
PROTOCOL = rows("ebb_protocol_sample.jsonl")


def versions_of(span: str) -> list[str]:
    first, last = span.split("-")
    return [version for version in FIRMWARES if first <= version <= last]


def run_dry(board: Board) -> None:
    while not board.motion.idle:
        event = board.motion.next_event()
        assert event is not None, "the queue holds a move that never ends"
        board.advance_to(event)


def fresh(version: str) -> Board:
    """A board whose parser takes no time and whose queue holds all of a row."""
    board = Board(version, timed=False)
    board.advance(10)
    board.feed(b"CU,4,32\r")
    run_dry(board)
    return board


@pytest.mark.parametrize("row", MOVES, ids=lambda row: str(row["id"]))
def test_positions_accumulators_and_ticks_are_those_of_the_table(row: dict[str, Any]) -> None:
    for version in versions_of(row["fw"]):
        board = fresh(version)
        for command, expected in zip(row["cmds"], row["per"], strict=True):
            board.feed(command.encode() + b"\r")
            loaded = board.now + 1
            run_dry(board)
            position, acc = board.motion.state(board.now)
            halves = 2 if command.startswith("TD") else 1
            dead = halves if command[:2] in ("LT", "T3", "TD") else 0
            assert [*position, *acc, board.now - loaded - dead] == expected, (version, command)
        assert (position, acc) == (row["pos"], row["acc"])


@pytest.mark.parametrize("row", MOVES, ids=lambda row: str(row["id"]))
def test_queued_together_they_take_the_wall_time_of_the_table(row: dict[str, Any]) -> None:
    for version in versions_of(row["fw"]):
        board = fresh(version)
        for command in row["cmds"]:
            board.feed(command.encode() + b"\r")
        loaded = board.now + 1
        run_dry(board)
        assert board.now - loaded == row["wall"]
        assert board.motion.state(board.now) == (row["pos"], row["acc"])


@pytest.mark.parametrize("row", PROTOCOL, ids=lambda row: f"{row['mode']}-{row['send']!r}")
def test_replies_are_those_of_the_table_to_the_byte(row: dict[str, Any]) -> None:
    for version in row["fw"]:
        board = Board(version)
        board.advance(250)
        for command in (["CU,10,1"] if row["mode"] == "future" else []) + row["setup"]:
            board.feed(command.encode() + b"\r")
            board.advance(500)
        board.output()
        board.feed(row["send"].encode("latin-1"))
        board.advance(2000)
        assert b"".join(sent.data for sent in board.output()).decode("latin-1") == row["recv"], version


def test_the_tables_are_the_whole_sample() -> None:
    assert (len(MOVES), len(PROTOCOL)) == (400, 220)
