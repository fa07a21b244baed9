"""Where results are written: never over what they are made from."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Mapping
from pathlib import Path

from plotter.errors import BadInput


def spare(inputs: Mapping[str, str | Path | None], *outputs: str | Path | None) -> None:
    """Raise BadInput when an output is a file that is read, under whatever name, or has no folder; to be asked before anything
    is done.

    `inputs` by what they are ("drawing"). `-` is standard input or output, None is not given.
    """
    for output in outputs:
        if output is None or str(output) == "-":
            continue
        folder = Path(output).parent
        if not folder.is_dir():
            raise BadInput(f"{output} cannot be written: there is no folder {folder}; make it first, or give another place")
        written = _file(output)
        if written is None:
            continue
        for what, source in inputs.items():
            read = None if source is None else _file(source)
            if read is not None and os.path.samestat(read, written):
                raise BadInput(f"the output {output} is the {what} itself; choose another name for it")


def _file(path: str | Path) -> os.stat_result | None:
    """What a name leads to, also through links; None for what is not there, and for what cannot be lost: devices and pipes."""
    try:
        found = os.fstat(sys.stdin.fileno()) if str(path) == "-" else Path(path).stat()
    except (OSError, ValueError):
        return None
    return found if stat.S_ISREG(found.st_mode) else None
