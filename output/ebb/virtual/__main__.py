"""`python -m output.ebb.virtual`: a virtual board in a process of its own."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path

from output.ebb.virtual.server import make_server
from output.errors import BadCommand


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m output.ebb.virtual", description="A virtual EiBotBoard on a pseudo-terminal."
    )
    parser.add_argument("--pty", type=Path, help="symbolic link to make for the port")
    parser.add_argument("--firmware", default="3.0.3", help="2.7.0, 2.8.1 or 3.0.0 to 3.0.3 (default 3.0.3)")
    parser.add_argument("--speed", type=float, default=1.0, help="how many times faster than real time (default 1)")
    parser.add_argument("--record", type=Path, help="where to write what was drawn, as JSON")
    parser.add_argument("--faults", type=Path, help="fault script, as JSON")
    parser.add_argument("--nickname", default="", help="the board's name tag")
    parser.add_argument("--no-wire", action="store_true", help="leave the bytes of the wire out of the record")
    parser.add_argument("--pen-down", action="store_true", help="start with the pen on the paper")
    parser.add_argument("--version-line", help="what V answers, for a board of another age or kind")
    parser.add_argument("--patience", type=float, default=0.0, help="seconds a board about to run dry waits for the host")
    parser.add_argument("--control", action="store_true", help="take control commands on stdin; its end stops the board")
    return parser


def main() -> int:
    options = arguments().parse_args()
    try:
        server = make_server(
            firmware=options.firmware,
            link=options.pty,
            speed=options.speed,
            record=options.record,
            faults=options.faults,
            nickname=options.nickname,
            keep_wire=not options.no_wire,
            pen_down=options.pen_down,
            version_line=options.version_line,
            patience_s=options.patience,
            control=0 if options.control else None,
        )
    except BadCommand as problem:
        if options.control:  # whoever reads the answers says it
            print(json.dumps({"error": str(problem)}), flush=True)
        else:
            print(problem, file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, lambda *_: server.stop())
    signal.signal(signal.SIGINT, signal.SIG_IGN if options.control else lambda *_: server.stop())
    assert server.wire is not None
    print(json.dumps({"port": server.wire.port}), flush=True)
    try:
        server.run()
    except BadCommand as problem:
        print(problem, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
