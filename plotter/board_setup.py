"""From settings to what the encoder must know of machine and board."""

from __future__ import annotations

import numpy as np

from output.ebb.encode import BoardSetup, PenCommands
from output.ebb.encode_families import Sizing
from output.ebb.firmware import firmware
from plotter.machines.profile import Machine
from plotter.settings import Settings

HOME_MM = np.zeros(2)


def board_setup(
    settings: Settings, machine: Machine, firmware_version: str | None = None, origin_mm: np.ndarray = HOME_MM
) -> BoardSetup:
    """How this machine's board is driven; `firmware_version` is the connected board's, else the settings'.

    `origin_mm` (2,) is where the encoder's step counters are 0.
    """
    lift = settings.pen_lift()
    return BoardSetup(
        kinematics=machine.kinematics(),
        firmware=firmware(firmware_version or settings.firmware),
        pen=PenCommands(
            lift.up_pulse,
            lift.down_pulse,
            lift.rate_up,
            lift.rate_down,
            pin=lift.other_pin,
            low=lift.pulse(settings.low_percent),
            channels=lift.channels,
            solenoid=lift.output == "solenoid",
        ),
        origin_mm=origin_mm,
        family=settings.commands,
        sizing=Sizing(least_lead_s=settings.lead),
        # Away from home the motors hold, and the counters with them: else nobody would know where the pen is.
        motors_off_at_end=settings.ends_at_home,
    )
