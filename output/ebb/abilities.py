"""What the conversation may ask of each firmware: the streamer's side of the version table.

Which motion commands a firmware has is the encoder's business; here is only what streaming and stopping need. Versions are
those of the public releases; sources: the protocol references for 2.8.1 and 3.0, and the firmware's own release notes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from output.errors import BoardRefused

Version = tuple[int, int, int]

_VERSION_LINE = re.compile(r"EBB.*Firmware Version (\d{1,3})\.(\d{1,3})(?:\.(\d{1,3}))?")
# The oldest firmware whose queue can be watched: QM with the FIFO's state (2.4.4). Before it, a stop could not be kept prompt.
OLDEST: Version = (2, 4, 4)


@dataclass(frozen=True, slots=True)
class Abilities:
    """Facts by version. `text` is the board's own version line.

    `status_query`  QG (2.6.2) or QM: how the motion state is asked for;
    `counts_queue`  QU,6 tells how many commands wait (3.0.1);
    `deep_queue`    QU,2, QU,3 and CU,4: a queue deeper than one (3.0.0), future syntax with it;
    `pen_now`       SP,2 and SP,3 raise the pen past the queue (3.0.1);
    `stop_clears`   ES empties the whole queue (3.0.0); before, servo moves, delays and LT stay in it;
    `stop_frees`    ES,1 also lets go of the motors (2.8.0);
    `variables`     how many bytes SL and QL have: 32 (3.0.0) or 1;
    `checksums`     CU,54 (3.0.0);
    `power_flag`    CU,60 and bit 6 of QG tell of lost motor power (3.0.0).
    """

    text: str
    version: Version

    @property
    def name(self) -> str:
        return ".".join(str(part) for part in self.version)

    @property
    def status_query(self) -> str:
        return "QG" if self.version >= (2, 6, 2) else "QM"

    @property
    def counts_queue(self) -> bool:
        return self.version >= (3, 0, 1)

    @property
    def deep_queue(self) -> bool:
        return self.version >= (3, 0, 0)

    future_syntax = power_flag = checksums = deep_queue

    @property
    def pen_now(self) -> bool:
        return self.version >= (3, 0, 1)

    @property
    def stop_clears(self) -> bool:
        return self.version >= (3, 0, 0)

    @property
    def stop_frees(self) -> bool:
        return self.version >= (2, 8, 0)

    @property
    def variables(self) -> int:
        return 32 if self.version >= (3, 0, 0) else 1

    @property
    def nickname(self) -> bool:
        return self.version >= (2, 5, 5)


def abilities_of(version_line: str) -> Abilities:
    """From the line that V answers. A version newer than any we know is taken to have what the newest known one has.

    Raises BoardRefused when the line is not an EiBotBoard's, or its firmware is too old to be streamed to safely.
    """
    match = _VERSION_LINE.search(version_line)
    if match is None:
        raise BoardRefused(
            f"the port answers {version_line[:60]!r}, which is not an EiBotBoard: choose another port, see `plotter ports`"
        )
    version = (int(match[1]), int(match[2]), int(match[3] or 0))
    if version < OLDEST:
        raise BoardRefused(
            f"the board's firmware {'.'.join(map(str, version))} is older than {'.'.join(map(str, OLDEST))}, the first whose "
            "queue can be watched: update it (https://wiki.evilmadscientist.com/Updating_EBB_firmware)"
        )
    return Abilities(match.group(0), version)
