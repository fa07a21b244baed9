"""The help of every command, as a golden file: renewed by `--renew-golden`, a failure shows the difference."""

from __future__ import annotations

import difflib
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import output.ebb.producer  # noqa: F401 - loaded, as it is when something was plotted
from plotter.cli.main import LazyGroup, cli, main, run

HERE = Path(__file__).parent / "help"
COMMANDS = sorted(LazyGroup.homes)


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_help_is_as_it_was(name: str, request: pytest.FixtureRequest) -> None:
    result = CliRunner().invoke(cli, [*name.split(), "--help"], prog_name="plotter", terminal_width=100)
    assert result.exit_code == 0
    golden = HERE / f"{name or 'plotter'}.txt"
    if request.config.getoption("--renew-golden"):
        golden.write_text(result.output)
    old, new = golden.read_text().splitlines(), result.output.splitlines()
    assert old == new, "\n".join(difflib.unified_diff(old, new, golden.name, "now", lineterm="", n=1))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_says_what_it_does(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    assert command.help
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"{name} {parameter.opts[0]}"


def test_the_version_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert "plotter" in capsys.readouterr().out


def test_an_error_inside_the_program_has_its_own_exit_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr("plotter.cli.settings.machine_names", broken)
    assert run(["machines"]) == 1
    assert "planted" in capsys.readouterr().err


def test_a_planner_that_is_still_busy_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[int] = []
    monkeypatch.setattr("os._exit", ended.append)
    monkeypatch.setattr("output.ebb.producer.still_planning", lambda: True)
    with pytest.raises(SystemExit):
        main(["machines", "--nonsense"])
    assert ended == [2]
    monkeypatch.setattr("output.ebb.producer.still_planning", lambda: False)
    with pytest.raises(SystemExit) as ending:
        main(["machines"])
    assert ending.value.code == 0
    assert ended == [2]
