"""What a person, or a test, may say to a running virtual board: a line each, and what it means."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from output.ebb.virtual.pins import WIRED
from output.errors import BadCommand

_LONGEST_HANGUP_S = 1e9
# How each is written.
_FORMS = {
    "state": "state",
    "button": "button",
    "power": "power on|off",
    "wire": "wire PORT PIN 0|1",
    "reboot": "reboot",
    "hangup": "hangup [SECONDS [PATH]]",
    "return": "return",
    "fault": "fault {...}",
    "record": "record PATH",
    "stop": "stop",
}


def understood(words: list[str]) -> tuple[str, list[Any]]:
    """A control line's verb and its values. Raises BadCommand, with the line's form, for too few, too many or others."""
    verb = words[0] if words else ""
    if verb not in _FORMS:
        raise BadCommand(f"unknown control command; give one of {', '.join(_FORMS)}")
    return verb, _values(verb, words[1:])


def _values(verb: str, words: list[str]) -> list[Any]:
    match verb, words:
        case "state" | "button" | "reboot" | "return" | "stop", []:
            return []
        case "power", ["on" | "off" as supply]:
            return [supply == "on"]
        case "wire", [port, pin, "0" | "1" as level] if port.upper() in WIRED and pin in map(str, range(8)):
            return [port.upper(), int(pin), level == "1"]
        case "hangup", []:
            return [None, None]
        case "hangup", [seconds, *link] if len(link) <= 1:
            with suppress(ValueError):
                if math.isfinite(away_s := float(seconds)) and 0 <= away_s <= _LONGEST_HANGUP_S:
                    return [away_s, link[0] if link else None]
        case "record", [_, *_] if "\0" not in " ".join(words):
            return [Path(" ".join(words))]
        case "fault", [_, *_]:
            with suppress(ValueError):
                return [json.loads(" ".join(words))]
    raise BadCommand(f"write it as `{_FORMS[verb]}`")
