"""Finding the board's port: by what the USB says it is, and by the nickname that is written in it.

pyserial gives vendor and product as integers on every system; names of ports and texts differ and are never compared. A board's
nickname is its USB serial number (firmware 2.5.5 and later) and also ends its product name, "EiBotBoard,East EBB".
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from serial.tools import list_ports

from output.errors import BoardRefused, LinkLost

VENDOR, PRODUCT = 0x04D8, 0xFD92
_PRODUCT_NAME = "EiBotBoard"

UDEV_RULE = (
    'SUBSYSTEM=="tty", ATTRS{idVendor}=="04d8", ATTRS{idProduct}=="fd92", '
    'MODE="0660", GROUP="dialout", TAG+="uaccess", ENV{ID_MM_DEVICE_IGNORE}="1"'
)


@dataclass(frozen=True, slots=True)
class FoundPort:
    """An EiBotBoard that is plugged in: the port's name, and the board's nickname or ""."""

    device: str
    nickname: str
    description: str = ""

    def __str__(self) -> str:
        return f"{self.device} ({self.nickname})" if self.nickname else self.device


def find_ports(listed: Iterable[Any] | None = None) -> list[FoundPort]:
    """The EiBotBoards among the system's ports (pyserial's ListPortInfo), ordered by name. Opens nothing."""
    ports = list_ports.comports() if listed is None else listed
    found = [
        FoundPort(str(port.device), _nickname(port), str(port.description or ""))
        for port in ports
        if (port.vid, port.pid) == (VENDOR, PRODUCT)
    ]
    return sorted(found, key=lambda port: port.device)


def _nickname(port: Any) -> str:
    for text in (port.product, port.description):
        if text and str(text).startswith(f"{_PRODUCT_NAME},"):
            # Some systems add the port's name: "EiBotBoard,East EBB (COM4)".
            return str(text)[len(_PRODUCT_NAME) + 1 :].split(" (COM")[0].strip()
    return str(port.serial_number or "").strip()


def choose_port(wanted: str | None, found: list[FoundPort] | None = None) -> str:
    """The port to open: `wanted` is a port's name, a nickname or its beginning, or None for the only board there is.

    Raises LinkLost when there is none, BoardRefused when there are several and nothing says which. Never simulates.
    """
    if wanted is not None and _is_device(wanted):
        return wanted
    boards = find_ports() if found is None else found
    listing = ", ".join(str(board) for board in boards)
    if wanted is None:
        if not boards:
            raise LinkLost(
                "no EiBotBoard is plugged in: check the USB cable and that it carries data, or plot on the virtual board with "
                "--port sim"
            )
        if len(boards) > 1:
            raise BoardRefused(f"{len(boards)} boards are plugged in: choose one with --port ({listing})")
        return boards[0].device
    key = wanted.casefold()
    exact = [board for board in boards if board.nickname.casefold() == key]
    matching = exact or [board for board in boards if board.nickname.casefold().startswith(key)]
    if not matching:
        here = f"there are: {listing}" if boards else "no EiBotBoard is plugged in"
        raise LinkLost(f"no board is named {wanted!r} ({here}): see `plotter ports`, or give the port itself")
    if len(matching) > 1:
        raise BoardRefused(
            f"{wanted!r} fits {len(matching)} boards ({', '.join(map(str, matching))}): give more of the name, or the port"
        )
    return matching[0].device


def _is_device(name: str) -> bool:
    upper = name.upper()
    return os.sep in name or (upper.startswith("COM") and upper[3:].isdigit()) or "://" in name


def wait_for_board(
    nickname: str,
    timeout_s: float,
    *,
    find: Callable[[], list[FoundPort]] = find_ports,
    sleep: Callable[[float], None] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> str:
    """The port of the board with this nickname once it is back, under whatever name; a board without one only if it is alone.

    Raises LinkLost when it has not come back within `timeout_s`.
    """
    end = clock() + timeout_s
    while True:
        late = clock() >= end  # before it looks: it looks once more when this program was stopped meanwhile
        boards = find()
        same = [board for board in boards if board.nickname == nickname]
        if len(same) == 1:
            return same[0].device
        if late:
            name = f"the board {nickname!r}" if nickname else "the board"
            raise LinkLost(f"{name} did not come back within {timeout_s:g} s: plug it in, then `plotter resume`")
        sleep(0.2)
