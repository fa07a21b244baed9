"""The help of every command, as a golden file: renewed by `--renew-golden`, a failure shows the difference."""

from __future__ import annotations

import difflib
import re
import subprocess
import sys
import threading
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from plotter.cli.help import EXPERT, HeadedCommand, Heading
from plotter.cli.main import LazyGroup, cli, main, run
from plotter.settings import Settings

HERE = Path(__file__).parent / "help"
COMMANDS = sorted(LazyGroup.homes)


def help_of(name: str, flag: str) -> str:
    result = CliRunner().invoke(cli, [*name.split(), flag], prog_name="plotter", terminal_width=100)
    assert result.exit_code == 0
    return str(result.output)


@pytest.mark.parametrize(
    ("name", "flag"), [*((name, "--help") for name in ("", *COMMANDS)), ("plot", "--help-all"), ("verify", "--help-all")]
)
def test_help_is_as_it_was(name: str, flag: str, request: pytest.FixtureRequest) -> None:
    output = help_of(name, flag)
    golden = HERE / f"{name or 'plotter'}{flag.removeprefix('--help')}.txt"
    if request.config.getoption("--renew-golden"):
        golden.write_text(output)
    old, new = golden.read_text().splitlines(), output.splitlines()
    assert old == new, "\n".join(difflib.unified_diff(old, new, golden.name, "now", lineterm="", n=1))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_and_option_says_what_it_does(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    assert command.help
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"{name} {parameter.opts[0]}"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_the_whole_help_and_what_is_left_out_of_the_usual_is_counted(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    options = [parameter for parameter in command.params if isinstance(parameter, click.Option)]
    headed = isinstance(command, HeadedCommand)
    usual, whole = (re.findall(r"^  (?:-\w, )?(--[\w-]+)", help_of(name, flag), re.MULTILINE)
                    for flag in ("--help", "--help-all" if headed else "--help"))  # fmt: skip
    assert sorted(whole) == sorted([option.opts[-1] for option in options] + ["--help"] + ["--help-all"] * headed)
    left_out = [option for option in options if getattr(option, "heading", Heading.OWN) in EXPERT]
    assert set(whole) - set(usual) == {option.opts[-1] for option in left_out}
    assert (f"{len(left_out)} more options with --help-all: " in help_of(name, "--help")) == bool(left_out)
    assert "more options" not in help_of(name, "--help-all" if headed else "-h") or not headed


def test_the_texts_of_all_sections_begin_in_one_column() -> None:
    """But for flags that are longer than the column, whose text is on the next line."""
    rows = re.findall(r"^  -.*?  +(?=\S)", help_of("plot", "--help-all"), re.MULTILINE)
    assert len(rows) > 40 and {len(row) for row in rows} == {34}


def test_every_setting_has_one_place_in_the_help() -> None:
    command = cli.get_command(click.Context(cli), "settings")
    assert command is not None
    names = [parameter.name for parameter in command.params if parameter.name not in ("settings_file", "as_json")]
    assert sorted(map(str, names)) == sorted(Settings.model_fields)


def test_the_version_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert "plotter" in capsys.readouterr().out


def test_it_runs_as_a_module() -> None:
    said = subprocess.run([sys.executable, "-m", "plotter", "--version"], capture_output=True, text=True, check=True)
    assert said.stdout.startswith("plotter")
    wrong = subprocess.run([sys.executable, "-m", "plotter", "preview", "none.svg"], capture_output=True, check=False)
    assert wrong.returncode == 2


def test_an_error_inside_the_program_has_its_own_exit_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr("plotter.cli.settings.machine_names", broken)
    assert run(["machines"]) == 1
    assert "planted" in capsys.readouterr().err


def test_what_is_still_busy_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[int] = []
    monkeypatch.setattr("os._exit", ended.append)
    done = threading.Event()
    busy = threading.Thread(target=done.wait, daemon=True, name="errand")
    busy.start()
    with pytest.raises(SystemExit):
        main(["machines", "--nonsense"])
    assert ended == [2]
    done.set()
    busy.join()
    with pytest.raises(SystemExit) as ending:
        main(["machines"])
    assert ending.value.code == 0
    assert ended == [2]
