"""The rail of the simulated cell on its bus: gateway, drive and strip sensor, in one thread.

Drive and sensor keep their state when a client leaves; the next one gets a new channel, and
heartbeats that a fault suppressed. Heartbeats and wire deadlines run in real time, the slide in
cell time: a SYNC or an SDO read polls the slide once, before the nodes answer. In stepped time a
dead master does not poll, so a drive that brakes by itself is polled until it is at rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum, IntEnum
from functools import partial

from fakes.canopen.rail_device import RailDevice
from fakes.canopen.slave import (
    HEADER,
    SYNC_COB_ID,
    Abort,
    CanopenSlave,
    Entry,
    ErrorKind,
    NodeIdentity,
    ReceivePdo,
    SdoAbortError,
    TransmitPdo,
    abort_reply,
)
from fakes.canopen.slcan_gateway import BusServer
from fakes.faults import Faults
from fakes.site import Site
from fakes.strip import RailStrip
from fakes.strip import serve as strip_server
from fakes.truth.noise import Dither
from fakes.truth.rail_truth import RailState, RailTruth
from hilcell.cell.file import RailTable

IDENTITY = NodeIdentity(0x00020192, "hilcell rail drive (simulated)", 0x484, 0x402, 1, 2014001)


class Mode(IntEnum):
    """Modes of operation, 6060h."""

    NONE = 0
    PROFILE_POSITION = 1
    HOMING = 6


class State(Enum):
    """States of the power drive system, with their bits in the statusword."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Command(Enum):
    """Commands of the controlword."""

    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on, or disable operation"
    ENABLE_OPERATION = "enable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"
    FAULT_RESET = "fault reset"

    @staticmethod
    def of(word: int) -> Command:
        """Return the command that bits 0-3 of a controlword give."""
        if not word & 0x02:
            return Command.DISABLE_VOLTAGE
        if not word & 0x04:
            return Command.QUICK_STOP
        if not word & 0x01:
            return Command.SHUTDOWN
        return Command.ENABLE_OPERATION if word & 0x08 else Command.SWITCH_ON


# CiA 402-2, figure of the state machine, by the number of each transition. 0, 1, 13 and 14 are the
# drive's own; ENABLE OPERATION in READY TO SWITCH ON passes through SWITCHED ON (3, then 4).
TRANSITIONS = {
    (State.SWITCH_ON_DISABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 2
    (State.READY_TO_SWITCH_ON, Command.SWITCH_ON): State.SWITCHED_ON,  # 3
    (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): State.SWITCHED_ON,  # 3
    (State.SWITCHED_ON, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 4
    (State.OPERATION_ENABLED, Command.SWITCH_ON): State.SWITCHED_ON,  # 5
    (State.SWITCHED_ON, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 6
    (State.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 7
    (State.READY_TO_SWITCH_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 7
    (State.OPERATION_ENABLED, Command.SHUTDOWN): State.READY_TO_SWITCH_ON,  # 8
    (State.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 9
    (State.SWITCHED_ON, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 10
    (State.SWITCHED_ON, Command.QUICK_STOP): State.SWITCH_ON_DISABLED,  # 10
    (State.OPERATION_ENABLED, Command.QUICK_STOP): State.QUICK_STOP_ACTIVE,  # 11
    (State.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): State.SWITCH_ON_DISABLED,  # 12
    (State.FAULT, Command.FAULT_RESET): State.SWITCH_ON_DISABLED,  # 15
    (State.QUICK_STOP_ACTIVE, Command.ENABLE_OPERATION): State.OPERATION_ENABLED,  # 16
}


class Control(IntEnum):
    """Bits of the controlword."""

    NEW_SET_POINT = 0x10
    AT_ONCE = 0x20
    RELATIVE = 0x40
    FAULT_RESET = 0x80
    HALT = 0x100


class Status(IntEnum):
    """Bits of the statusword."""

    VOLTAGE = 1 << 4
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    INTERNAL_LIMIT = 1 << 11
    MODE_DONE = 1 << 12
    MODE_ERROR = 1 << 13


class RailDrive(CanopenSlave):
    """CiA 402: moves the simulated rail in the modes profile position and homing.

    The brake is closed at rest except in OPERATION ENABLED; while it is open, the servo dithers by
    a few counts and its speed is almost never 0. Bit 12 of the statusword is "set-point
    acknowledged" in mode 1 and "homing attained" in mode 6.
    """

    FOLLOWING_ERROR, LIMIT_SWITCH_HIT = 0x8611, 0x8612
    ABOVE_ZERO = range(1, 1 << 32)
    DITHER_COUNTS, DITHER_HZ, DITHER_SCOPE = 2, 50.0, 5
    INT32 = range(-(1 << 31), 1 << 31)

    def __init__(
        self,
        rail: RailTruth,
        faults: Faults,
        table: RailTable,
        send: Callable[[int, bytes], None],
        device: RailDevice,
    ) -> None:
        super().__init__(device.drive_node, IDENTITY, send)
        self._rail, self._faults, self._device = rail, faults, device
        if device.absolute:
            rail.master()
        self._slide = rail.poll()
        self._dither = Dither(self.DITHER_COUNTS, self.DITHER_SCOPE)
        self._reset_state()
        self._add_objects(table)
        self._add_pdos()
        self._rail.brake(closed=True)

    def _reset_state(self) -> None:
        """Reset the drive to its state after power-on (transitions 0 and 1)."""
        self.state = State.SWITCH_ON_DISABLED
        self._controlword = 0
        self._commanded = False
        self._busy = False  # a motion was started, and no poll has seen its end
        self._target = 0
        self._direction = 0
        self._pending: int | None = None
        self._reached = self._early = self._acknowledged = self._halted = False
        self._overspeed = 1.0
        self._limited = self._following_error = False
        self._open_switch = 0
        self._homing = self._homing_error = False
        self._homed = self._device.absolute

    # -- observed values ------------------------------------------------------------------

    @property
    def _mode(self) -> int:
        return self.dictionary.number(0x6060)

    @property
    def moving(self) -> bool:
        return self._busy

    @property
    def stopping(self) -> bool:
        return self._busy and self.state in (State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)

    def dither(self) -> None:
        """Advance the servo's dither by a step; once a SYNC."""
        self._dither.step()

    def observe(self, slide: RailState) -> None:
        """Process the slide's state: end motions, trip limits."""
        self._slide = slide
        if not self._busy:
            return
        if not self._homing and self.state is State.OPERATION_ENABLED:
            blocked = {-1: slide.at_negative_limit, 1: slide.at_positive_limit}
            if blocked.get(self._direction, False):
                self.trip_limit(0)
        if not slide.moving:
            self._busy = False
            self._come_to_rest()

    def _come_to_rest(self) -> None:
        match self.state:
            case State.OPERATION_ENABLED:
                self._reached = True
                self._homed = self._homed or self._homing
                self._homing = False
                if self._pending is not None:
                    target, self._pending = self._pending, None
                    self._start(target)
            case State.QUICK_STOP_ACTIVE:
                self._rail.brake(closed=True)
                if self._stays_in_quick_stop():
                    self._reached = True
                else:
                    self.state = State.SWITCH_ON_DISABLED  # transition 12
            case State.FAULT_REACTION_ACTIVE | State.FAULT:
                self._rail.brake(closed=True)
                self.state = State.FAULT  # transition 14
            case _:
                pass

    # -- faults -------------------------------------------------------------------------------

    def fail(self, code: int) -> None:
        """Go through FAULT REACTION ACTIVE to FAULT with EMCY ``code`` (transitions 13, 14).

        Ignored in fault: the first fault counts.
        """
        if self.state in {State.FAULT_REACTION_ACTIVE, State.FAULT}:
            return
        self._following_error = code == self.FOLLOWING_ERROR
        self.emergency(code, ErrorKind.DEVICE_PROFILE)
        self._react_to_fault()

    def _react_to_fault(self) -> None:
        self._cancel()
        self.state = State.FAULT_REACTION_ACTIVE
        option = self.dictionary.number(0x605E)
        rolling_mm_s2 = 30.0  # of a slide without power or brake
        if option == 0:
            self.state = State.FAULT  # without power the slide continues to roll
            self._rail.quick_stop(rolling_mm_s2)
        else:
            self._brake_down(self.dictionary.number(0x6084 if option == 1 else 0x6085))

    def trip_limit(self, switch: int) -> None:
        """Stop on a limit switch; ``switch`` -1 or 1 holds it open until the fault is reset."""
        self._open_switch = switch
        self._limited = True
        self.fail(self.LIMIT_SWITCH_HIT)

    def _brake_down(self, deceleration: int) -> None:
        if self._busy:
            self._rail.quick_stop(self._ramp_mm_s2(deceleration))
        else:
            self._come_to_rest()

    def _cancel(self) -> None:
        self._pending = None
        self._homing = self._reached = self._early = self._halted = False

    def emergency(self, code: int, register: int) -> None:
        """Send EMCY ``code``; 603Fh holds the last error."""
        if code:
            self.dictionary.set(0x603F, 0, code)
        super().emergency(code, register)

    # -- hooks of the node --------------------------------------------------------------------

    def connection_lost(self) -> None:
        """Act by 6007h: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop."""
        if self.state is not State.OPERATION_ENABLED:
            return
        match self.dictionary.number(0x6007):
            case 1:
                self._react_to_fault()
            case 2:
                self._enter(State.SWITCH_ON_DISABLED)
            case 3:
                self._enter(State.QUICK_STOP_ACTIVE)
            case _:
                pass

    def _heard(self, node: int, now_s: float) -> None:
        if self._device.watchful:
            super()._heard(node, now_s)

    def switched_off(self) -> None:
        """Close the brake and enter SWITCH ON DISABLED; the reference is lost."""
        self._rail.brake(closed=True)
        self._reset_state()

    def written(self) -> None:
        """Execute a controlword after all objects of its frame."""
        if not self._commanded:
            return
        self._commanded = False
        before, self._controlword = self._controlword, self.dictionary.number(0x6040)
        rising = self._controlword & ~before
        if rising & Control.FAULT_RESET:
            self._clear_fault()
        if self.state is not State.FAULT:
            self._transition(Command.of(self._controlword))
        elif rising & Control.FAULT_RESET:
            self._transition(Command.FAULT_RESET)
        if not self._controlword & Control.NEW_SET_POINT:
            self._acknowledged = False
        if self.state is State.OPERATION_ENABLED:
            self._operate(rising, before & ~self._controlword)

    # -- the state machine --------------------------------------------------------------------

    def _transition(self, command: Command) -> None:
        target = TRANSITIONS.get((self.state, command))
        leaves = command is Command.ENABLE_OPERATION and self.state is State.QUICK_STOP_ACTIVE
        if target is None or (leaves and not self._stays_in_quick_stop()):
            return
        self._enter(target)
        if command is Command.ENABLE_OPERATION and target is State.SWITCHED_ON:
            self._transition(command)

    def _enter(self, state: State) -> None:
        was_enabled = self.state is State.OPERATION_ENABLED
        self.state = state
        if state is State.OPERATION_ENABLED:
            self._target = self._position()
            self._rail.brake(closed=False)
        elif state is State.QUICK_STOP_ACTIVE:
            self._quick_stop()
        elif was_enabled or self._busy:
            self._cancel()
            self._busy = False
            self._rail.brake(closed=True)

    def _quick_stop(self) -> None:
        self._cancel()
        option = self.dictionary.number(0x605A)
        if option == 0:
            self._busy = False
            self._enter(State.SWITCH_ON_DISABLED)
            self._rail.brake(closed=True)
            return
        self._brake_down(self.dictionary.number(0x6084 if option in {1, 5} else 0x6085))

    def _stays_in_quick_stop(self) -> bool:
        return self.dictionary.number(0x605A) >= 5

    def _clear_fault(self) -> None:
        if not self.dictionary.number(0x1001):
            return
        self._following_error = self._limited = False
        self._open_switch = 0
        self.emergency(0, ErrorKind.DEVICE_PROFILE)

    # -- operation ----------------------------------------------------------------------------

    def _operate(self, rising: int, falling: int) -> None:
        if rising & Control.HALT and self._busy:
            self._halted = True
            self._rail.quick_stop(self._ramp_mm_s2(self.dictionary.number(0x6084)))
        if self._mode == Mode.PROFILE_POSITION:
            if falling & Control.HALT and self._halted:
                self._halted = False
                self._start(self._target)
            if rising & Control.NEW_SET_POINT and not self._controlword & Control.HALT:
                self._take_set_point()
        elif self._mode == Mode.HOMING and rising & Control.NEW_SET_POINT:
            self._start_homing()

    def _take_set_point(self) -> None:
        if self._faults.strikes("rail.no_acknowledge"):
            return
        wanted = self.dictionary.number(0x607A)
        wanted += self._target if self._controlword & Control.RELATIVE else 0
        low, high = (self.dictionary.number(0x607D, sub) for sub in (1, 2))
        target = min(max(wanted, low), high) if self._homed else wanted
        self._limited = target != wanted
        self._acknowledged = True
        self._early = self._faults.strikes("rail.early_target_reached")
        self._overspeed = self._faults.number("rail.overspeed") or 1.0
        if self._busy and not self._controlword & Control.AT_ONCE:
            self._pending = target
        else:
            self._start(target)

    def _start(self, target: int) -> None:
        number = self.dictionary.number
        self._target, self._reached, self._busy = target, False, True
        gap_mm = (target - self._position()) / self._device.counts_per_mm  # of counts, which wrap
        self._direction = (gap_mm > 0) - (gap_mm < 0)
        speed = self._overspeed * min(number(0x6081), number(0x607F))
        # The simulated trapezoid is symmetric; the gentler ramp applies at both ends.
        ramp_mm_s2 = self._ramp_mm_s2(min(number(0x6083), number(0x6084)))
        self._rail.move(self._slide.encoder_mm + gap_mm, self._speed_mm_s(speed), ramp_mm_s2)

    def _speed_mm_s(self, speed: float) -> float:
        device = self._device
        return min(speed * device.unit_counts_s / abs(device.counts_per_mm), device.motor_mm_s)

    def _ramp_mm_s2(self, ramp: float) -> float:
        device = self._device
        return min(ramp * device.unit_counts_s / abs(device.counts_per_mm), device.motor_mm_s2)

    def _start_homing(self) -> None:
        number, device = self.dictionary.number, self._device
        method, speed_mm_s = number(0x6098), self._speed_mm_s(number(0x6099, 1))
        self._reached = self._homed = False
        self._homing_error = method not in device.homing_methods
        if self._homing_error:
            return
        self._homing = self._busy = True
        self._target = device.home_offset_sign * number(0x607C)
        reads_mm = self._target / device.counts_per_mm
        positive = method in (18, 34)  # for the drive
        upper = positive == (device.sense > 0)
        if method in (17, 18):
            self._rail.home(speed_mm_s, upper=upper, reads_mm=reads_mm)
        elif method in (33, 34):
            turn_mm = device.counts_per_turn / abs(device.counts_per_mm)
            slow_mm_s = self._speed_mm_s(number(0x6099, 2))
            self._rail.home_to_index(slow_mm_s, turn_mm, upwards=upper, reads_mm=reads_mm)
        else:
            self._rail.master(reads_mm)

    # -- objects ------------------------------------------------------------------------------

    def _position(self) -> int:
        """Return the encoder's count, which wraps at 32 bits."""
        count = round(self._slide.encoder_mm * self._device.counts_per_mm)
        return (count - self.INT32[0]) % len(self.INT32) + self.INT32[0]

    def _dithers(self) -> bool:
        return self._busy or self.state is State.OPERATION_ENABLED

    def _position_shown(self) -> int:
        return self._position() + (self._dither.counts if self._dithers() else 0)

    def _velocity(self) -> int:
        hunting = self.DITHER_HZ * self._dither.change if self._dithers() else 0.0
        speed = self._slide.velocity_mm_s * self._device.counts_per_mm + hunting  # counts/s
        return round(speed / self._device.unit_counts_s)

    def _inputs(self) -> int:
        negative = self._slide.at_negative_limit or self._open_switch < 0
        positive = self._slide.at_positive_limit or self._open_switch > 0
        if self._device.sense < 0:
            negative, positive = positive, negative
        return int(negative) | int(positive) << 1

    def _statusword(self) -> int:
        word = self.state.value | Status.VOLTAGE | Status.REMOTE
        word |= Status.TARGET_REACHED if self._reached or self._early else 0
        word |= Status.INTERNAL_LIMIT if self._limited else 0
        if self._mode == Mode.HOMING:
            done, error = self._homed, self._homing_error
        else:
            done = self._acknowledged or self._pending is not None
            error = self._following_error
        return word | (Status.MODE_DONE if done else 0) | (Status.MODE_ERROR if error else 0)

    def _change_mode(self, _mode: int) -> None:
        if self._busy:
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _shown_mode(self) -> int:
        return self._faults.instead("rail.wrong_mode", self._mode)

    def _note_command(self, _controlword: int) -> None:
        self._commanded = True

    def _add_objects(self, table: RailTable) -> None:
        device, unit_mm_s = self._device, self._device.unit_mm_s
        speed = round(table.speed_mm_s / unit_mm_s)
        acceleration = round(table.acceleration_mm_s2 / unit_mm_s)
        add, record = self.dictionary.add, self.dictionary.add_array
        product = partial(self._faults.instead, "rail.wrong_identity", IDENTITY.product)
        self.dictionary.entry(0x1018, 2).read = product
        add(0x6007, 0, Entry("h", 1, allowed=range(4)))
        add(0x603F, 0, Entry("H", 0, "ro", mappable=True))
        add(0x6040, 0, Entry("H", 0, mappable=True, write=self._note_command))
        add(0x6041, 0, Entry("H", 0, "ro", mappable=True, read=self._statusword))
        add(0x605A, 0, Entry("h", 2, allowed=(0, 1, 2, 5, 6)))
        modes = tuple(Mode)
        add(0x605E, 0, Entry("h", 2, allowed=(0, 1, 2)))
        add(0x6060, 0, Entry("b", 0, mappable=True, allowed=modes, write=self._change_mode))
        add(0x6061, 0, Entry("b", 0, "ro", mappable=True, read=self._shown_mode))
        add(0x6064, 0, Entry("i", 0, "ro", mappable=True, read=self._position_shown))
        add(0x6067, 0, Entry("I", 100))
        add(0x6068, 0, Entry("H", 0))
        add(0x606C, 0, Entry("i", 0, "ro", mappable=True, read=self._velocity))
        add(0x606F, 0, Entry("H", 100))
        add(0x6070, 0, Entry("H", 0))
        add(0x607A, 0, Entry("i", 0, mappable=True))
        add(0x607C, 0, Entry("i", 0))
        record(0x607D, Entry("i", self.INT32[0]), Entry("i", self.INT32[-1]))
        for index, value in {
            0x607F: 2 * speed,
            0x6081: speed,
            0x6083: acceleration,
            0x6084: acceleration,
            0x6085: 2 * acceleration,
        }.items():
            add(index, 0, Entry("I", value, mappable=True, allowed=self.ABOVE_ZERO))
        add(0x6098, 0, Entry("b", 0, allowed=(0, *device.homing_methods)))
        speeds = (max(1, speed // 5), max(1, speed // 50))
        record(0x6099, *(Entry("I", value, allowed=self.ABOVE_ZERO) for value in speeds))
        add(0x609A, 0, Entry("I", acceleration, allowed=self.ABOVE_ZERO))
        add(0x60FD, 0, Entry("I", 0, "ro", mappable=True, read=self._inputs))
        add(0x6502, 0, Entry("I", 1 << 0 | 1 << 5, "ro"))
        if device.states_units:
            turn, increments = Entry("I", 1, "ro"), Entry("I", device.counts_per_turn, "ro")
            record(0x6090, increments, turn)
            add(0x60A8, 0, Entry("I", 0x00B50000, "ro"))  # increments
            add(0x60A9, 0, Entry("I", device.speed_code, "ro"))

    def _add_pdos(self) -> None:
        for number, more in enumerate(((), (0x6060,), (0x607A,))):
            self.receive_pdos += [ReceivePdo(self.dictionary, self.node, number, (0x6040, *more))]
        for number, more in enumerate(((), (0x6061,), (0x6064,), (0x606C,))):
            self.transmit_pdos += [TransmitPdo(self.dictionary, self.node, number, (0x6041, *more))]


class RailServer(BusServer):
    """Serves the rail as slcan over TCP on a port, 0 for one that the system chooses."""

    UNPLUGGED_S = 3  # by default

    def __init__(self, site: Site, port: int = 0) -> None:
        """Raises `SettingsError` without a slide."""
        rail, faults, table = site.slide(), site.faults, site.cell.rail
        super().__init__("rail server", faults, table.options, port)
        # the strip's, where that is not on the bus
        line = strip_server(site) if table.options.get("strip") else None
        if line is not None:
            self._listeners, self.address = (line,), self.address | line.address
        self._rail, self._faults, self._time = rail, faults, site.time
        self._device = device = site.rail_device
        self._drive = RailDrive(rail, faults, table, self._transmit, device)
        self._strip = None if line else RailStrip(rail.poll(), faults, self._transmit, device)
        self._nodes[device.drive_node] = self._drive
        if self._strip is not None:
            self._nodes[device.strip_node] = self._strip
        self._slide_moves = False
        self._silent: set[int] = set()
        self._delay_s = 0.0
        self._late: list[tuple[float, int, bytes]] = []
        self._plugged_s = -math.inf  # from when on frames pass

    def _wait_s(self) -> float:
        look_period_s = 0.01
        longest_s = look_period_s if self._needs_poll() else self.IDLE_S
        late_s = min((late[0] for late in self._late), default=math.inf)
        return min(super()._wait_s(), max(0.0, late_s - self.now_s()), longest_s)

    def _needs_poll(self) -> bool:
        """Whether the slide must be polled without a request."""
        if self._drive.stopping or (self._slide_moves and not self._drive.moving):
            return True
        cyclic = any(node.cyclic() for node in self._nodes.values())
        return self._drive.moving and (cyclic or not self._time.stepped)

    def _tick(self, now_s: float) -> None:
        if self._needs_poll():
            self._poll_slide(now_s)
        super()._tick(now_s)
        for late in [late for late in self._late if late[0] <= now_s]:
            self._late.remove(late)
            self._gateway.send(late[1], late[2])

    def _poll_slide(self, now_s: float) -> None:
        slide = self._rail.poll()
        self._slide_moves = slide.moving
        self._apply_faults(now_s, slide.moving)
        self._drive.observe(slide)
        if self._strip is not None:
            self._strip.observe(slide)

    def _open(self) -> None:
        self._silent.clear()
        super()._open()

    def _receive(self, cob_id: int, data: bytes) -> None:
        if self.now_s() < self._plugged_s:
            return
        self._delay_s = 0.0
        sdo_requests = tuple(0x600 + node for node in self._nodes)
        sdo_read = b"\x40"
        if cob_id == SYNC_COB_ID:
            self._delay_s = self._faults.amount("rail.late_tpdo")
            if self._strip is not None:
                self._strip.apply_faults()
            self._drive.dither()
            self._poll_slide(self.now_s())
        elif cob_id in sdo_requests:
            if data[:1] == sdo_read:
                self._poll_slide(self.now_s())
            if self._fault_reply(cob_id, data):
                return
        super()._receive(cob_id, data)
        self._delay_s = 0.0

    def _transmit(self, cob_id: int, data: bytes) -> None:
        heartbeats = range(0x700, 0x780)
        if cob_id in heartbeats and not self._heartbeat_sent(cob_id & 0x7F, boot_up=data == b"\0"):
            return
        if self.now_s() < self._plugged_s:
            return
        twin = self._faults.number("rail.second_node")
        if twin is not None and cob_id in (0x580 + twin, 0x700 + twin):
            self._gateway.send(cob_id, data)
        if self._delay_s:
            self._late.append((self.now_s() + self._delay_s, cob_id, data))
        else:
            self._gateway.send(cob_id, data)

    def _number(self, fault: str, usual: int, *, moving: bool = True) -> int | None:
        """Return the value of a fault that strikes, ``usual`` by default."""
        value = self._faults.take(fault, moving=moving)
        return None if value is None else usual if value is True else int(value)

    def _fault_reply(self, cob_id: int, data: bytes) -> bool:
        if self._faults.strikes("rail.sdo_timeout"):
            return True
        code = self._number("rail.sdo_abort", Abort.DEVICE_STATE)
        if code is not None and len(data) == 8:
            _, index, sub = HEADER.unpack_from(data)
            self._transmit(cob_id - 0x80, abort_reply(index, sub, code))
            return True
        self._delay_s = self._faults.amount("rail.late_reply")
        return False

    def _apply_faults(self, now_s: float, moving: bool) -> None:
        """Apply the faults of a moving slide, and those that are set to strike at rest."""
        take = partial(self._number, moving=moving)
        if (out_s := take("rail.unplugged", self.UNPLUGGED_S)) is not None:
            self._plugged_s = now_s + out_s
        if (code := take("rail.emcy", 0x7305)) is not None:
            self._drive.emergency(code, 0)
        if (code := take("rail.fault", 0x8611)) is not None:
            self._drive.fail(code)
        if (switch := take("rail.limit_switch", 1)) is not None:
            self._drive.trip_limit(switch)
        if (number := take("rail.node_reset", self._device.drive_node)) is not None:
            self._silent.discard(number)
            if (node := self._nodes.get(number)) is not None:  # which this bus has
                node.reset(now_s)
        if self._faults.strikes("rail.vanish", moving=moving):
            self._gateway.close()

    def _heartbeat_sent(self, node: int, *, boot_up: bool) -> bool:
        if boot_up:
            return True
        if (lost := self._number("rail.heartbeat_loss", self._device.drive_node)) is not None:
            self._silent.add(lost)
        return node not in self._silent


serve = RailServer
