"""Imports run one way: plotter -> planning, plotter -> output, output -> planning.motion, and nothing back."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
NOT_FOR_PLANNING = {"serial", "time", "os", "socket", "pathlib", "subprocess", "io", "click", "rich", "requests", "urllib"}


def imported(path: Path) -> set[str]:
    """Every module that `path` imports, anywhere in it, by its full name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are written in full"
            found.add(node.module or "")
    return found


def offences(room: str, module: str) -> bool:
    top = module.split(".")[0]
    if room == "planning":
        return top in {"plotter", "output"} | NOT_FOR_PLANNING
    if room == "output":
        return top == "plotter" or (top == "planning" and not module.startswith("planning.motion"))
    return False


@pytest.mark.parametrize("room", ["planning", "output", "plotter"])
def test_no_room_reaches_up(room: str) -> None:
    files = sorted((ROOT / room).rglob("*.py"))
    assert files
    bad = [f"{path.relative_to(ROOT)}: {name}" for path in files for name in imported(path) if offences(room, name)]
    assert not bad


def test_virtual_board_shares_no_arithmetic_with_the_encoder() -> None:
    """The virtual board is written from the protocol reference, so that the two can disagree."""
    files = sorted((ROOT / "output/ebb/virtual").rglob("*.py"))
    bad = [
        f"{path.name}: {name}"
        for path in files
        for name in imported(path)
        if name.startswith("output.") and not name.startswith(("output.ebb.virtual", "output.errors"))
    ]
    assert not bad


@pytest.mark.parametrize(
    ("room", "module"),
    [("planning", "output.ebb"), ("planning", "time"), ("output", "plotter.svg"), ("output", "planning.ordering")],
)
def test_the_check_can_fail(room: str, module: str) -> None:
    assert offences(room, module)
