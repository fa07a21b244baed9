"""Finding out who is there, from whatever state the board was left in.

The board may be in either syntax, in the middle of a line, still answering a program that was killed, still moving, or asking
for checksums. Nothing is assumed: end the line, let the old output pass, ask the version until a version comes, choose the
syntax, and then find the place in the replies by a token that cannot have been in the line before.
"""

from __future__ import annotations

from output.ebb.abilities import Abilities, abilities_of
from output.ebb.conversation import NOTHING_S, Conversation
from output.errors import BoardRefused, LinkLost

_QUIET_S = 0.03
_DRAIN_S = 0.5
# A board whose queue was overfilled by another program is deaf until a place is free, hence the long last try.
_VERSION_TIMEOUTS_S = (0.7, 0.7, 2.0)
_CHECKSUMS_OFF = b"CU,54,0,119\r"


def greet(talk: Conversation) -> Abilities:
    """The board's firmware and what it can do; afterwards the conversation is in step, in future syntax where there is one.

    Idempotent. Raises BoardRefused when something else answers, or nothing; LinkLost when the port goes away.
    """
    talk.port.send(b"\r")
    _drain(talk)
    line, heard = None, b""
    for timeout_s in _VERSION_TIMEOUTS_S:
        talk.port.send(b"V\r")
        line, more = _version_line(talk, timeout_s)
        heard += more
        if line is not None:
            break
        if b"hecksum" in more:
            talk.port.send(_CHECKSUMS_OFF)
            _drain(talk)
    if line is None:
        raise BoardRefused(_not_an_ebb(talk.port.name, heard))
    abilities = abilities_of(line)
    # CU,10,1 has an irregular answer, and CU,1,1 undoes another program's silencing of OK: the resync skips what they say.
    talk.port.send(b"CU,10,1\r" if abilities.future_syntax else b"CU,1,1\r")
    for _ in range(3):
        if talk.resync():
            return abilities
    raise LinkLost(f"{talk.port.name}: the board tells its version but then answers nothing: unplug it and plug it in again")


def _drain(talk: Conversation) -> None:
    """Reads until the line has been quiet for a moment; bounded, because a stuck sender never falls quiet."""
    end_s = talk.waited_s + _DRAIN_S
    while talk.waited_s < end_s and talk.wait(_QUIET_S):
        pass


def _version_line(talk: Conversation, timeout_s: float) -> tuple[str | None, bytes]:
    end_s, heard = talk.waited_s + timeout_s, bytearray()
    while (left_s := end_s - talk.waited_s) > NOTHING_S:
        heard += talk.wait(left_s)
        *lines, _unfinished = bytes(heard[-2048:]).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if b"Firmware Version" in line and b"EBB" in line:
                return line[line.index(b"EBB") :].decode("ascii", "backslashreplace"), bytes(heard)
        if any(b"hecksum" in line for line in lines):
            break
    return None, bytes(heard[-2048:])


def _not_an_ebb(name: str, heard: bytes) -> str:
    text = heard.decode("ascii", "backslashreplace").strip()
    answer = f"answers {text.splitlines()[-1][:60]!r}" if text else "answers nothing"
    return f"{name} {answer} when asked for its version, so it is not an EiBotBoard: choose another port, see `plotter ports`"
