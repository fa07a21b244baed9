"""Keeping the computer from going to sleep while it plots, where the system has a way to ask for that."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# Windows: ES_CONTINUOUS | ES_SYSTEM_REQUIRED, and ES_CONTINUOUS alone to end it.
_STAY_AWAKE, _AS_BEFORE = 0x80000001, 0x80000000


def _command() -> list[str] | None:
    """A program that holds sleep off for as long as it runs, and ends with this one."""
    if sys.platform == "darwin" and shutil.which("caffeinate"):
        return ["caffeinate", "-i", "-w", str(os.getpid())]
    if shutil.which("systemd-inhibit") and shutil.which("tail"):
        why = ["--what=sleep:idle", "--who=plotter", "--why=a plot is running"]
        return ["systemd-inhibit", *why, "tail", f"--pid={os.getpid()}", "-f", os.devnull]
    return None


@contextmanager
def awake() -> Iterator[None]:
    """No sleep until the context is left. Where that cannot be had, nothing happens: a plot does not depend on it."""
    if sys.platform == "win32":
        ctypes.windll.kernel32.SetThreadExecutionState(_STAY_AWAKE)
        try:
            yield
        finally:
            ctypes.windll.kernel32.SetThreadExecutionState(_AS_BEFORE)
        return
    holder = None
    if (command := _command()) is not None:
        try:
            quiet = subprocess.DEVNULL
            holder = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
        except OSError:
            holder = None
    try:
        yield
    finally:
        if holder is not None:
            holder.terminate()
            holder.wait()
