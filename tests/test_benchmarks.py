"""The benchmarks can still be run: what they import is there."""

from __future__ import annotations

import importlib
import pkgutil

import pytest

import benchmarks

NAMES = [module.name for module in pkgutil.iter_modules(benchmarks.__path__) if not module.name.startswith("_")]


@pytest.mark.parametrize("name", NAMES)
def test_it_is_importable(name: str) -> None:
    assert callable(getattr(importlib.import_module(f"benchmarks.{name}"), "run", None))
