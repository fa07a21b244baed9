"""What tests of the whole program share: a drawing, and folders for settings and journals that are nobody's own."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def drawing(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file with the test module's DRAWING."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    file = tmp_path / "drawing.svg"
    file.write_text(request.module.DRAWING)
    return file
