"""The table of firmware generations against the references' own figures and version notes."""

from __future__ import annotations

import pytest

from output.ebb.commands import Command
from output.ebb.commands_text import KINDS, parse_command
from output.ebb.firmware import firmware, parse_version
from output.errors import BadCommand

# The references' performance tables, worst of what they give: SM, LM and L3 in ms for each range of versions.
LEAST_MS = {"3.0.3": {"SM": 2, "LM": 4}, "3.0.0": {"SM": 2, "LM": 4}, "2.8.1": {"SM": 4, "LM": 5}, "2.6.5": {"SM": 7}}


@pytest.mark.parametrize(("version", "figures"), LEAST_MS.items())
def test_least_durations_are_those_of_the_performance_tables(version: str, figures: dict[str, float]) -> None:
    for name, least in figures.items():
        assert firmware(version).least_ms[name] >= least


@pytest.mark.parametrize(
    ("version", "motion", "depth", "dead"),
    [
        ("3.0.3", {"TD", "T3", "L3", "LT", "LM", "XM", "SM"}, 32, 1),
        ("3.0.1", {"TD", "T3", "L3", "LT", "LM", "XM", "SM"}, 32, 1),
        ("3.0.0", {"T3", "L3", "LT", "LM", "XM", "SM"}, 32, 1),
        ("2.8.1", {"LT", "LM", "XM", "SM"}, 1, 0),
        ("2.7.0", {"LT", "LM", "XM", "SM"}, 1, 0),
        ("2.6.6", {"XM", "SM"}, 1, 0),
        ("2.2.9", {"SM"}, 1, 0),
        ("1.9.2", {"SM"}, 1, 0),
    ],
)
def test_generations(version: str, motion: set[str], depth: int, dead: int) -> None:
    board = firmware(version)
    assert (set(board.motion), board.queue_max, board.dead_ticks) == (motion, depth, dead)
    # The motion commands of the table are exactly those that exist then, HM and TR aside.
    samples = {"T3": "T3,1,0,0,0,0,0,0", "TD": "TD,1,0,0,0,0,0,0,0,0", "L3": "L3,1,1,0,0,1,1,0,0", "LT": "LT,1,1,0,1,0",
               "LM": "LM,1,1,0,1,1,0", "XM": "XM,10,1,0", "SM": "SM,10,1,0"}  # fmt: skip
    assert {name for name, line in samples.items() if board.refusal(parse_command(line)) is None} == motion


@pytest.mark.parametrize(
    ("line", "last_without", "first_with"),
    [
        ("QE", "2.7.0", "2.8.0"),
        ("QU,2", "2.8.1", "3.0.0"),
        ("QU,6", "3.0.0", "3.0.1"),
        ("SP,3", "3.0.0", "3.0.1"),
        ("TD,1,0,0,0,0,0,0,0,0", "3.0.0", "3.0.1"),
        ("QS", "2.4.2", "2.4.3"),
        ("QG", "2.6.1", "2.6.2"),
        ("SL,1,2", "2.8.1", "3.0.0"),
        ("ES,1", "2.7.0", "2.8.0"),
        ("CU,3,1", "2.8.0", "2.8.1"),
        ("CU,4,8", "2.8.1", "3.0.0"),
        ("SM,10,1,1,3", "2.8.1", "3.0.0"),
        ("HM,1000", "2.6.1", "2.6.2"),
        ("SR,1000", "2.5.9", "2.6.0"),
        ("QM", "2.4.3", "2.4.4"),
        ("ST,x", "2.5.3", "2.5.4"),
    ],
)
def test_commands_come_with_their_version(line: str, last_without: str, first_with: str) -> None:
    command = parse_command(line)
    refusal = firmware(last_without).refusal(command)
    assert refusal is not None and last_without in refusal and first_with in refusal
    assert firmware(first_with).refusal(command) is None


@pytest.mark.parametrize(
    ("line", "version", "said"),
    [
        ("PG,1", "3.0.0", "before 3.0.0"),
        ("T,100,0", "3.0.3", "before 3.0.0"),
        ("CN", "1.9.5", "before 1.9.5"),
        ("EM,1", "2.8.0", "both parameters"),
        ("SC,8,9", "3.0.3", "allowed is up to 8"),
        ("SM,16777216,1,1", "2.8.1", "16777215"),
        ("SM,16777215,16777216,1", "2.8.1", "16777215"),
        ("SM,70000,0,0", "2.8.1", "65535"),
        ("SM,100001,0,0", "3.0.3", "100000"),
        ("LM,-5,1,0,1,1,0", "2.8.1", "0 or more"),
        ("LT,10,0,5,0,5", "2.8.1", "both rates are 0"),
        ("HM,1000,4294968,0", "2.8.1", "4294967"),
    ],
)
def test_what_only_some_versions_refuse(line: str, version: str, said: str) -> None:
    refusal = firmware(version).refusal(parse_command(line))
    assert refusal is not None and said in refusal


def test_em_waits_in_the_queue_since_2_8_0() -> None:
    command: Command = parse_command("EM,1,1")
    assert [firmware(version).queues(command) for version in ("2.7.0", "2.8.0", "3.0.3")] == [False, True, True]


def test_versions_that_are_not_known_are_refused() -> None:
    assert parse_version("2.8") == (2, 8, 0)
    for text in ("0.9", "4.0.0", "three", "2.x"):
        with pytest.raises(BadCommand):
            firmware(text)
    assert all(kind.since >= (1, 0, 0) for kind in KINDS.values())
