"""Every command of the board: its handler, and the firmware that has it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from output.ebb.virtual import motion_commands as motion
from output.ebb.virtual import older_motion as older
from output.ebb.virtual import query_commands as query
from output.ebb.virtual import setting_commands as setting
from output.ebb.virtual import timed_reports as timed
from output.ebb.virtual.firmware import Firmware
from output.ebb.virtual.motion_commands import Handling
from output.ebb.virtual.packet import Packet

if TYPE_CHECKING:
    from output.ebb.virtual.board import Board

Handler = Callable[["Board", Packet], Handling | None]
Version = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Command:
    """`handler` answers the command on firmware `since` up to, but not including, `until`; `older` does before 3.0."""

    handler: Handler
    since: Version = (0, 0, 0)
    until: Version = (99, 0, 0)
    older: Handler | None = None


_V3: Version = (3, 0, 0)

COMMANDS: dict[bytes, Command] = {
    b"A": Command(query.a),
    b"AC": Command(setting.ac),
    b"BL": Command(setting.bl),
    b"C": Command(setting.c),
    b"CK": Command(query.ck),
    b"CM": Command(setting.cm, since=_V3),
    b"CS": Command(setting.cs),
    b"CU": Command(setting.cu),
    b"EM": Command(motion.em, older=older.em),
    b"ES": Command(query.es, older=older.es),
    b"HM": Command(motion.hm, older=older.hm),
    b"I": Command(query.i),
    b"L3": Command(motion.l3, since=_V3),
    b"LM": Command(motion.lm, older=older.lm),
    b"LT": Command(motion.lt, older=older.lt),
    b"MR": Command(query.mr),
    b"MW": Command(setting.mw),
    b"ND": Command(setting.nd),
    b"NI": Command(setting.ni),
    b"O": Command(setting.o),
    b"PC": Command(timed.pc, until=_V3),
    b"PD": Command(setting.pd),
    b"PG": Command(timed.pg, until=_V3),
    b"PI": Command(query.pi),
    b"PO": Command(setting.po),
    b"QB": Command(query.qb),
    b"QC": Command(query.qc),
    b"QE": Command(query.qe, since=(2, 8, 0)),
    b"QG": Command(query.qg),
    b"QL": Command(query.ql),
    b"QM": Command(query.qm),
    b"QN": Command(query.qn),
    b"QP": Command(query.qp),
    b"QR": Command(query.qr),
    b"QS": Command(query.qs),
    b"QT": Command(query.qt),
    b"QU": Command(query.qu, since=_V3),
    b"R": Command(setting.r),
    b"RB": Command(setting.rb),
    b"S2": Command(motion.s2),
    b"SC": Command(setting.sc),
    b"SE": Command(motion.se),
    b"SL": Command(setting.sl),
    b"SM": Command(motion.sm, older=older.sm),
    b"SN": Command(setting.sn),
    b"SP": Command(motion.sp),
    b"SR": Command(setting.sr),
    b"ST": Command(setting.st),
    b"T": Command(timed.t, until=_V3),
    b"T3": Command(motion.t3, since=_V3),
    b"TD": Command(motion.td, since=(3, 0, 1)),
    b"TP": Command(motion.tp),
    b"TR": Command(motion.tr, since=_V3),
    b"V": Command(query.v),
    b"XM": Command(motion.xm, older=older.xm),
}


def commands_of(firmware: Firmware) -> dict[bytes, Handler]:
    """The handlers of the commands that this firmware has, by upper-case name."""
    return {
        name: command.older if command.older is not None and firmware.number < _V3 else command.handler
        for name, command in COMMANDS.items()
        if command.since <= firmware.number < command.until
    }
