"""How long the board's parser is busy with a line, in ticks.

Measured times between idle motors and both axes at 25 kHz (the step interrupt takes its share of the processor); lines with
more digits than usual cost more.
"""

from __future__ import annotations

from output.ebb.virtual.registers import ONE_STEP, TICKS_PER_S

# Command: (ms with idle motors, ms with both axes at 25 kHz, characters of the line that was measured).
_MEASURED_MS = {
    b"QG": (0.27, 0.37, 2),
    b"SM": (1.2, 1.7, 12),
    b"XM": (1.2, 1.7, 12),
    b"LT": (2.3, 3.2, 36),
    b"LM": (2.7, 3.7, 40),
    b"T3": (2.2, 2.9, 30),
    b"L3": (3.0, 4.1, 50),
    b"TD": (4.1, 5.4, 50),
    b"SP": (0.65, 0.8, 8),
    b"TP": (0.65, 0.8, 6),
    b"S2": (0.65, 0.8, 12),
    b"EM": (0.45, 0.6, 6),
}
_OTHER = (0.4, 0.55, 8)
# T3 takes 2.2 ms with short and 2.7 ms with long numbers: some 25 digits more.
_MS_PER_CHARACTER = 0.02


def parse_ticks(line: bytes, rates: tuple[int, int]) -> int:
    """Ticks from the line's end until the command has been handled; `rates` are the motors' rate registers."""
    idle_ms, busy_ms, usual = _MEASURED_MS.get(line[:2].upper(), _OTHER)
    load = min(1.0, (abs(rates[0]) + abs(rates[1])) / (2 * ONE_STEP))
    ms = idle_ms + (busy_ms - idle_ms) * load + _MS_PER_CHARACTER * max(0, len(line) - usual)
    return max(1, round(ms * TICKS_PER_S / 1000))
