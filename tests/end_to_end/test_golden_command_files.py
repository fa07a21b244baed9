"""Golden command files: what export writes for small drawings, firmware by firmware.

`pytest tests/end_to_end/test_golden_command_files.py --renew-golden` writes them anew; a failure leaves what was written
beside the golden file, as `.new`, and shows the difference. Numbers of motion commands may differ by what another
processor's arithmetic makes of them; everything else, the number of lines included, must be the same.
"""

from __future__ import annotations

import difflib
from pathlib import Path

import pytest

from plotter.cli.main import run

HERE = Path(__file__).parent / "golden"
DRAWINGS = sorted(HERE.glob("*.svg"))
FIRMWARES = ("3.0.3", "3.0.0", "2.8.1", "2.6.6", "1.9.5")
MOTION = ("T3", "TD", "L3", "LT", "LM")
# Rates, accelerations and jerks: relative to the greatest number in the line.
TOLERANCE = 1e-3


def same(old: str, new: str) -> bool:
    """Whether two lines say the same; durations, steps and everything but motion rates to the letter."""
    if old == new:
        return True
    a, b = old.split(","), new.split(",")
    if a[0] != b[0] or len(a) != len(b) or a[0] not in MOTION:
        return False
    one, other = [int(word) for word in a[1:]], [int(word) for word in b[1:]]
    if a[0] not in ("LM", "L3") and one[0] != other[0]:
        return False
    allowed = TOLERANCE * max(1000, *map(abs, one))
    return all(abs(x - y) <= allowed for x, y in zip(one, other, strict=True))


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("drawing", DRAWINGS, ids=lambda path: path.stem)
def test_export_writes_the_golden_file(
    drawing: Path, firmware: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    golden = HERE / f"{drawing.stem}-{firmware}.ebb"
    written = tmp_path / "written.ebb"
    assert run(["export", str(drawing), "-o", str(written), "--firmware", firmware]) == 0
    text = written.read_text()
    if request.config.getoption("--renew-golden"):
        golden.write_text(text)
        return
    old, new = golden.read_text().splitlines(), text.splitlines()
    fresh = golden.with_suffix(".new")
    fresh.unlink(missing_ok=True)
    if len(old) == len(new) and all(same(a, b) for a, b in zip(old, new, strict=True)):
        return
    fresh.write_text(text)
    difference = "\n".join(difflib.unified_diff(old, new, golden.name, fresh.name, lineterm="", n=1))
    pytest.fail(f"export changed; if that is meant, renew with --renew-golden\n{difference[:4000]}")


@pytest.mark.parametrize(
    ("old", "new", "equal"),
    [
        ("T3,100,2000000,0,0,5,0,0", "T3,100,2000001,0,0,5,0,0", True),
        ("T3,100,2000000,0,0,5,0,0", "T3,101,2000000,0,0,5,0,0", False),
        ("T3,100,2000000,0,0,5,0,0", "T3,100,2100000,0,0,5,0,0", False),
        ("SP,1,100", "SP,1,101", False),
        ("# end 3 steps 100 20", "# end 3 steps 100 21", False),
        ("SP,1,100", "# stroke 2", False),
    ],
)
def test_the_comparison_can_fail(old: str, new: str, equal: bool) -> None:
    assert same(old, new) is equal
