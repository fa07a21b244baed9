"""The virtual EiBotBoard: bytes in, bytes out, on a clock of 40 us ticks that the caller advances. No ports, files or threads.

One thing at a time is parsed. A motion command that finds the queue full stays in the parser, and nothing behind it is read:
ES, QG and SP,2 wait for it like on the real board.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from output.ebb.virtual.firmware import firmware as firmware_named
from output.ebb.virtual.guards import LimitSwitch, Supply
from output.ebb.virtual.motion import MotionQueue, Running
from output.ebb.virtual.moves import EnableMotors, Engrave, PenMove, QueueEntry
from output.ebb.virtual.packet import Syntax
from output.ebb.virtual.parser import Parser
from output.ebb.virtual.pins import Pins
from output.ebb.virtual.record import Recorder
from output.ebb.virtual.registers import TICKS_PER_S
from output.ebb.virtual.servo import PEN_RP_PIN, Servo
from output.ebb.virtual.timed_reports import TimedReports

CURRENT_ADC = 394
_MICROSTEPS = {1: 16, 2: 8, 3: 4, 4: 2, 5: 1}


@dataclass(frozen=True, slots=True)
class Sent:
    """Bytes that left the board at `tick`; `command` counts the commands since power-on, from 0 (-1 before the first)."""

    tick: int
    data: bytes
    command: int


class Board:
    """One board. `timed` false makes parsing take no time (for tables of single commands).

    `version_line` is what V answers instead of the firmware's own line: an older board, or something else altogether.
    """

    def __init__(
        self,
        firmware: str = "3.0.3",
        *,
        nickname: str = "",
        timed: bool = True,
        pen_down: bool = False,
        version_line: str | None = None,
        recorder: Recorder | None = None,
    ) -> None:
        self.firmware = firmware_named(firmware)
        self.version_line = self.firmware.version_line if version_line is None else version_line
        self.now = 0
        self.timed = timed
        self.recorder = recorder if recorder is not None else Recorder()
        self.nickname = nickname.encode("latin-1")[:16]
        self.supply = Supply()
        self.memory = bytearray(4096)
        self.stack_high_water = 0xE71
        self.usb_dropped = False
        self.in_bootloader = False
        self.pins = Pins()
        self.motion = MotionQueue()
        self.servo = Servo()
        if pen_down:
            self.servo.start_position = self.servo.target = self.servo.maximum
        self._output: list[Sent] = []
        self.parser = Parser(self)
        self._defaults()

    # ---- power-on state

    def _defaults(self) -> None:
        """What boot and R set; the nickname and the outside world stay."""
        self.syntax = Syntax()
        self.limit_checks = True
        self.auto_enable = True
        self.discard_moves = False
        self.checksums = False
        self.limit = LimitSwitch()
        self.supply.forget(self.now)
        self.stepper_timeout_s = 0
        self._motors_off_at: int | None = None
        self.variables = [0] * (32 if self.firmware.since(3, 0, 0) else 1)
        self.node_count = 0
        self.motors_on = (False, False)
        self.microstep = 16
        self.engraver_power = 0
        self.pen_mechanism = 2
        self.alternative_button = True
        self.button_pressed = False
        self.analog_channels = {0, 11}
        self.reports = TimedReports()
        self.pins.reset()
        self.motion.abort(self.now)
        self.motion = MotionQueue(idle_since=self.now)
        self.motion.on_load = self._loaded
        self.motion.on_end = self._ended
        self.motion.on_run = self._ran
        # The queued SP,1 of the boot only sets the state: the servo has no power and stays where it is.
        position = self.servo.position(self.now)
        self.servo = Servo(start_position=position, start_tick=self.now, target=round(position))
        self.recorder.servo_changed(self.now, self.servo)
        self.motion.push(PenMove("boot", 1, self.servo.minimum, 0, PEN_RP_PIN), self.now)

    def reset(self) -> None:
        """R: the application's state as at boot."""
        self._defaults()

    def reboot(self) -> None:
        """RB or a brown-out: everything as after power-on, and the USB connection drops."""
        self.usb_dropped = True
        self.in_bootloader = False
        self.parser.restart()
        self._defaults()

    def enter_bootloader(self) -> None:
        """BL: the firmware is gone until the board is rebooted."""
        self.usb_dropped = True
        self.in_bootloader = True

    # ---- bytes and time

    def feed(self, data: bytes) -> None:
        """Bytes that reach the board at the present tick."""
        if not self.in_bootloader:
            self.parser.feed(data)

    def output(self) -> list[Sent]:
        """What the board has sent since the last call, in order."""
        sent, self._output = self._output, []
        return sent

    def send(self, data: bytes) -> None:
        """Bytes leave the board now."""
        if data:
            self._output.append(Sent(self.now, data, self.parser.commands_seen - 1))

    @property
    def wants_bytes(self) -> bool:
        """False while commands wait to be parsed: the board takes no more from USB then."""
        return self.parser.free

    @property
    def intercept(self) -> Callable[[int, bytes], bytes | None] | None:
        """Asked before each command: an error text refuses it. Given its number since the board was made, and its line."""
        return self.parser.intercept

    @intercept.setter
    def intercept(self, refusal: Callable[[int, bytes], bytes | None] | None) -> None:
        self.parser.intercept = refusal

    @property
    def blocked_on_motion(self) -> bool:
        """A motion command is in the parser and waits for the queue."""
        return self.parser.blocked

    def next_event(self) -> int | None:
        """The next tick at which the board does something by itself, or None."""
        events = [
            self.motion.next_event(),
            self.parser.parsed_at,
            self.servo.power_off_at,
            self._motors_off_at,
            self.reports.next_tick(),
        ]
        return min((event for event in events if event is not None), default=None)

    def advance(self, ticks: int) -> None:
        """Let `ticks` ticks pass."""
        self.advance_to(self.now + ticks)

    def advance_to(self, tick: int) -> None:
        """Let time pass until `tick`; ticks that are over already change nothing."""
        while True:
            event = self.next_event()
            if event is None or event > tick:
                break
            self.now = max(self.now, event)
            self._step()
        self.now = max(self.now, tick)

    def _step(self) -> None:
        now = self.now
        event = self.motion.next_event()
        if event is not None and event <= now:
            self.motion.step_event(event)
            self._after_motion()
        if self.servo.power_off_at is not None and self.servo.power_off_at <= now:
            self.servo.unpower(now)
            self.recorder.servo_changed(now, self.servo)
        if self._motors_off_at is not None and self._motors_off_at <= now:
            self._motors_off_at = None
            self.set_motors(False, False)
        if self.reports.due:
            for packet in self.reports.packets(self):
                self.send(packet)
        self.parser.step()

    def command_was_handled(self) -> None:
        """A reply has gone out; 3.0.3 tells of a limit switch only now."""
        if self.limit.reply_due:
            self._send_limit_reply()

    # ---- what happens as the queue runs

    def _loaded(self, entry: QueueEntry, tick: int) -> None:
        self._motors_off_at = None
        self.recorder.loaded(tick, entry, self.motion)
        if isinstance(entry, PenMove) and entry.command != "boot":
            self._move_pen(entry, tick)

    def _ended(self, entry: QueueEntry, tick: int) -> None:
        if isinstance(entry, EnableMotors):
            self.enable_motors(entry)
        elif isinstance(entry, Engrave):
            self.engraver_power = entry.power
        self.recorder.ended(tick, entry)

    def _after_motion(self) -> None:
        if self.motion.idle:
            self.restart_stepper_timeout()

    def _ran(self, running: Running, ticks: int) -> None:
        self.recorder.ran(running, ticks, moving=self.supply.on and all(self.motors_on))

    def _move_pen(self, entry: PenMove, tick: int, *, queued: bool = True) -> None:
        if entry.command in ("SP", "TP") and queued:
            # The pen is whatever the queue's SP moves, on whichever pin.
            self.servo.rp_pin = entry.rp_pin
        elif entry.rp_pin != self.servo.rp_pin:
            if entry.command in ("SP", "TP"):
                self.servo.up = entry.target == self.servo.minimum
                self.recorder.servo_changed(tick, self.servo)
            return
        self.servo.send(entry.target, entry.rate, tick)
        self.recorder.servo_changed(tick, self.servo, brief=entry.command == "SP" and entry.ticks <= 1)

    def send_pen(self, entry: PenMove) -> None:
        """SP,2 and SP,3: the servo starts now, whatever the queue holds."""
        self._move_pen(entry, self.now, queued=False)

    def retarget_queued_pen_moves(self, target: int) -> None:
        """SP,3: nothing that waits in the queue lowers the pen any more."""
        for entry, _ in self.motion.entries:
            if isinstance(entry, PenMove):
                entry.target = target

    def stop_servo_output(self, rp_pin: int) -> None:
        """S2,0,pin: no more pulses; the servo stays where it is."""
        if rp_pin == self.servo.rp_pin:
            self.servo.unpower(self.now)
            self.recorder.servo_changed(self.now, self.servo)

    def set_servo_power(self, timeout_ms: int, state: int | None) -> None:
        """SR."""
        servo = self.servo
        servo.power_timeout_ms = timeout_ms
        if state == 0:
            servo.unpower(self.now)
        elif state is not None or servo.powered:
            servo.power(self.now)
        self.recorder.servo_changed(self.now, servo)

    # ---- motors

    def set_motors(self, first: bool, second: bool) -> None:
        """Switch the drivers; a move that is running goes on being counted but no longer moves anything."""
        if (first, second) != self.motors_on:
            self.motion.split(self.now)
            self.motors_on = (first, second)

    def enable_for_move(self) -> None:
        """Every stepper command switches both drivers on as it is parsed, unless CU,50,0."""
        if self.auto_enable:
            self.set_motors(True, True)

    def enable_motors(self, entry: EnableMotors) -> None:
        """EM as it is executed: drivers, step size, and all counters back to zero."""
        first = entry.motor1 > 0
        second = self.motors_on[1] if entry.motor2 is None else entry.motor2 > 0
        self.set_motors(first, second)
        self.microstep = _MICROSTEPS.get(entry.motor1, self.microstep)
        self.clear_counters()
        self.limit.clear()
        self.check_limit_switch()

    def clear_counters(self) -> None:
        """Step positions and accumulators to zero; the paper does not move."""
        self.motion.clear_counters(self.now)
        self.recorder.counters_cleared()

    def emergency_stop(self) -> bool:
        """ES: the running command and the queue are dropped at once, positions and accumulators stay."""
        interrupted = self.motion.abort(self.now)
        self.recorder.stopped(self.now)
        self.restart_stepper_timeout()
        return interrupted

    def state(self) -> dict[str, Any]:
        """What can be asked of the board at this tick without sending it anything."""
        position, acc = self.motion.state(self.now)
        return {
            "firmware": self.firmware.version,
            "nickname": self.nickname.decode("latin-1"),
            "position": position,
            "accumulators": acc,
            "pen_up": self.servo.up,
            "pen_touches": self.servo.touches(self.servo.position(self.now)),
            "servo_position": self.servo.position(self.now),
            "servo_powered": self.servo.powered,
            "motors_on": list(self.motors_on),
            "idle": self.motion.idle,
            "queued": len(self.motion.entries),
            "queue_depth": self.motion.depth,
            "supply_on": self.supply.on,
            "future_syntax": self.syntax.future,
            "variables": list(self.variables),
        }

    def restart_stepper_timeout(self) -> None:
        """CU,61: the drivers are switched off that long after the last motion."""
        if self.stepper_timeout_s and self.motion.idle and any(self.motors_on):
            self._motors_off_at = self.now + self.stepper_timeout_s * TICKS_PER_S
        else:
            self._motors_off_at = None

    # ---- status

    def status_byte(self) -> int:
        """The bits of QG."""
        self.supply.scan(self.now)
        remaining = self.motion.remaining(self.now)
        bits = (
            bool(self.motion.entries)
            | bool(remaining[1]) << 1
            | bool(remaining[0]) << 2
            | (self.motion.running is not None) << 3
            | self.servo.up << 4
            | self.button_pressed << 5
        )
        if self.firmware.since(3, 0, 0):
            return bits | self.supply.lost << 6 | self.limit.triggered << 7
        port_b = self.pins.read("B")
        return bits | (port_b >> 2 & 1) << 6 | (port_b >> 5 & 1) << 7

    def status_was_read(self) -> None:
        """QG clears the button and the power flag; the limit flag stays."""
        self.button_pressed = False
        self.supply.lost = False

    def adc(self, channel: int) -> int:
        """The reading of an analog channel: 0 is the motor current's setting, 11 is V+."""
        if channel == 11:
            return self.supply.adc
        return CURRENT_ADC if channel == 0 else 0

    def set_power_threshold(self, value: int) -> None:
        """CU,60."""
        self.supply.scan(self.now)
        self.supply.threshold = value

    # ---- the world outside

    def switch_supply(self, on: bool) -> None:
        """The barrel jack: without it commands are taken and counted, and nothing moves."""
        self.supply.scan(self.now)
        if on != self.supply.on:
            self.motion.split(self.now)
            self.supply.on = on

    def press_button(self) -> None:
        """PRG, or B0 pulled low while that is enabled."""
        self.button_pressed = True

    def wire_pin(self, port: str, pin: int, level: bool) -> None:
        """Put a level on an input pin."""
        self.pins.wired[port] = self.pins.with_bit(self.pins.wired[port], pin, level)
        if port == "B" and pin == 0 and not level and self.alternative_button:
            self.button_pressed = True
        self.check_limit_switch()

    def set_limit_mask(self, mask: int) -> None:
        """CU,51; a mask of 0 clears the stop."""
        self.limit.mask = mask
        if mask == 0:
            self.limit.clear()
        self.check_limit_switch()

    def check_limit_switch(self) -> None:
        """Stop if a switch has closed; the board looks at its pins every tick."""
        port_b = self.pins.read("B")
        if self.limit.triggered or not self.limit.closed(port_b):
            return
        self.limit.triggered = True
        self.limit.port_b = port_b
        self.motion.abort(self.now)
        self.recorder.stopped(self.now)
        if self.limit.replies:
            self.limit.reply_due = True
            if not self.firmware.one_error:
                self._send_limit_reply()

    def _send_limit_reply(self) -> None:
        self.limit.reply_due = False
        end = b"\n" if self.syntax.future else b"\r\n"
        self.send(b"Limit switch triggered. PortB=%02X" % self.limit.port_b + end)
