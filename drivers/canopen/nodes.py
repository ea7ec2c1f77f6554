"""Nodes of the rail's buses: identities, settings, and unsolicited frames.

Heartbeat, boot-up and emergencies: CiA 301, 7.2.8 and 7.2.7. A node that was reset is back within a
second with its settings lost, and only its boot-up frame shows it: during and after set-up this is
a failure. A node may acknowledge a setting and not store it, so every object is read back; those
that stop the slide when the PC dies (1016h, 6007h, 605Ah, 6085h) matter most.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.canopen import cia
from drivers.canopen.can_link import CanLink, LinkLost, heartbeat_period_s
from drivers.canopen.cia import NMT, NodeCommand, NodeState, Object, Option, state_text
from drivers.canopen.drive_units import DriveUnits
from drivers.canopen.motion_guard import Limits
from drivers.canopen.requirements import OPTIONAL_OF_DRIVE
from drivers.canopen.sdo import Aborted, SdoChannel, Unsupported, open_channel
from drivers.canopen.slcan_bus import has_long_stamp
from drivers.device_errors import RAIL
from hilcell.ports import DeviceError, Identity, is_simulated_name
from hilcell.sanitize import clean

FIND_S = 5.0
OPERATIONAL_S = 3.0  # wire deadline
START_PERIOD_S = 0.5
POLL_S = 0.02
HOMING_SLOW_MM_S = 5.0

PC_HEARTBEAT_LIMIT_MS = 1000
GENERIC, COMMUNICATION = 1 << 0, 1 << 4  # of the error register, 1001h


def has_sensor_error(register: int) -> bool:
    """Whether an error register (1001h) has errors other than of communication. The generic bit
    comes with each error; the other bits depend on the maker.
    """
    return register not in (0, COMMUNICATION, GENERIC | COMMUNICATION)


class NodeMonitor:
    """Listens to one node; ``check`` raises the first failure. Emergencies of the family ``in_pdo``
    repeat a PDO, or set `sensor_fails` where no PDO has the alarms: neither is a failure here.
    """

    HEARTBEAT_AGE_S = 1.0  # of link time

    def __init__(self, link: CanLink, node: int, in_pdo: int | None = None) -> None:
        self.state: int | None = None
        self.sensor_fails = False  # from an emergency of that family on, until its reset
        self.number, self._in_pdo = node, in_pdo
        self._link = link
        self._received_s = 0.0
        self._set_up = self._armed = False
        self._code = self._failure = self._act = ""
        link.subscribe(0x700 + node, self._on_heartbeat)
        link.subscribe(0x080 + node, self._on_emergency)

    def arm(self) -> None:
        """Treat emergencies and silence from now on as failures, too."""
        self._armed = True

    def check(self, operation: str) -> None:
        """Raise `DeviceError` for an emergency, a boot-up, or a heartbeat that is too old."""
        if self._armed and not self._failure:
            self._poll()
        if self._failure:
            raise RAIL.failed(self._code, operation, self._failure, act=self._act, node=self.number)

    def _poll(self) -> None:
        age_s = self._link.time.listened_s - self._received_s
        if not age_s <= self.HEARTBEAT_AGE_S:
            self._fail("HC-R02", f"node {self.number}: no heartbeat for {age_s:.1f} s")
        elif self.state != NodeState.OPERATIONAL:
            state = state_text(self.state)
            self._fail("HC-R03", f"node {self.number}: NMT state {state}, not operational")

    def _on_heartbeat(self, _cob_id: int, data: bytearray, _at_s: float) -> None:
        self.state = data[0] & 0x7F
        self._received_s = self._link.time.listened_s
        if self._set_up and self.state == NodeState.BOOT_UP:
            self._fail("HC-R03", f"node {self.number}: unexpected boot-up: the node was reset")

    def _on_emergency(self, _cob_id: int, data: bytearray, _at_s: float) -> None:
        code, register, _vendor = struct.unpack("<HB5s", data)
        if code >> 8 == self._in_pdo:
            self.sensor_fails = True
        elif not cia.is_error(code):  # one is reset; the register has those that remain
            self.sensor_fails = has_sensor_error(register)
        if self._armed and cia.is_error(code) and code >> 8 != self._in_pdo:
            found = f"EMCY {cia.error_text(code)}, error register 0x{register:02X}"
            pause_s = self._link.pause_s
            if code != cia.HEARTBEAT_LOST:
                self._fail(cia.error_alarm(code), f"node {self.number}: {found}")
            elif pause_s * 1000 < PC_HEARTBEAT_LIMIT_MS:
                found += f"; the PC's heartbeat has paused for {pause_s:.1f} s"
                self._fail(cia.error_alarm(code), f"node {self.number}: {found}")
            else:
                late = f"PC late: its heartbeat paused for {pause_s:.1f} s"
                reports = f"so node {self.number} reports {cia.error_text(code)}"
                act = (
                    "give the engine a PC of its own, or end what keeps this one busy; resume; "
                    "home the rail after a reset of its drive"
                )
                self._fail("HC-R44", f"{late}, {reports}", act)

    def _fail(self, code: str, found: str, act: str = "put the cause right, then resume") -> None:
        if not self._failure:
            self._code, self._failure, self._act = code, found, act


@dataclass(frozen=True, slots=True)
class Expected:
    """The expected identity of a node; 0 is not checked."""

    name: str
    node: int
    profile: int
    vendor: int
    product: int
    serial: int


class Node(NodeMonitor):
    """A node in set-up: its identity, its objects, and its unsolicited frames."""

    def __init__(
        self,
        link: CanLink,
        expected: Expected,
        check: Callable[[], None],
        in_pdo: int | None = None,
    ) -> None:
        """``check`` runs in every wait."""
        super().__init__(link, expected.node, in_pdo)
        self._device_type: int | None = None
        self._expected, self._check = expected, check
        self.sdo = open_channel(link, expected.node, f"{expected.name}.eds", check)

    def identify(self, address: str) -> Identity:
        """Wait for the node and compare it with the cell file; raises `DeviceError`."""
        return identify(self.sdo, self._expected, self.profile(), address)

    def profile(self) -> int:
        """Return the device profile (1000h) as soon as the node answers; raises `DeviceError`."""
        if self._device_type is None:
            self._device_type = self._wait_for_type()
        return self._device_type & 0xFFFF

    def _wait_for_type(self) -> int:
        """Return 1000h; raises `DeviceError` after `FIND_S`, and `LinkLost` at once."""
        link, expected = self._link, self._expected
        deadline_s = link.time.listened_s + FIND_S
        while True:
            try:
                return self.sdo.read(Object.DEVICE_TYPE)
            except (Aborted, LinkLost):
                raise
            except DeviceError as error:
                if link.time.listened_s > deadline_s:
                    lost, losses = link.statistics(), ""
                    act = "check its power, cable, terminators, bit rate and node number"
                    if lost.bad_lines + lost.refused + lost.malformed:
                        losses = f"; {lost.bad_lines} bad lines, {lost.refused} refused"
                        losses += f", {lost.malformed} malformed" if lost.malformed else ""
                        losses += " on this link"
                        if link.bad_line:
                            line = clean(repr(link.bad_line)[2:-1])
                            losses += f", lines of another form, as {line}"
                    if has_long_stamp(link.bad_line):
                        act = "switch the gateway's time stamps off: it sends them with 32 bits"
                    raise RAIL.failed(
                        "HC-R05",
                        "connect",
                        f"node {expected.node} ({expected.name}) does not answer{losses}",
                        expected=f"an answer within {FIND_S:.0f} s",
                        act=act,
                        node=expected.node,
                        name=expected.name,
                        waited_s=FIND_S,
                    ) from error
            self._check()

    def begin_set_up(self) -> None:
        """Treat a boot-up from now on as a failure: the settings would be lost."""
        self._set_up = True
        self.command(NodeCommand.ENTER_PRE_OPERATIONAL)

    def command(self, command: NodeCommand) -> None:
        self._link.send(NMT, bytes((command, self.number)))

    def set_heartbeat(self, bitrate: int) -> None:
        """Set the heartbeat period to the PC's, or the nearest possible; raises `Unsupported`."""
        expected_ms = round(1000 * heartbeat_period_s(bitrate))
        refusals = []
        for period_ms in (expected_ms, 100, 200):  # several within the limit of a node's silence
            refusal = self.sdo.offer(Object.PRODUCER_HEARTBEAT, 0, period_ms)
            if refusal is None:
                return
            refusals.append(refusal)
        what = f"1017h:00 = {expected_ms} (the PC notices that the node has died)"
        raise Unsupported(refusals[0], what)


def identify(sdo: SdoChannel, expected: Expected, profile: int, address: str) -> Identity:
    """Compare 1000h and 1018h with the cell file; raises `DeviceRefused`."""
    checks = (
        ("device profile (1000h)", profile & 0xFFFF, expected.profile),
        ("vendor (1018h:01)", sdo.read(Object.IDENTITY, 1), expected.vendor),
        ("product (1018h:02)", sdo.read_if_present(Object.IDENTITY, 2) or 0, expected.product),
        ("serial (1018h:04)", sdo.read_if_present(Object.IDENTITY, 4) or 0, expected.serial),
    )
    for what, value, required in checks:
        if required and value != required:
            raise RAIL.refused(
                "HC-R08",
                "connect",
                f"node {expected.node} ({expected.name}): {what} is 0x{value:X} ({value})",
                expected=f"0x{required:X} ({required})",
                node=expected.node,
                name=expected.name,
                object=what,
                found_value=value,
                wanted_value=required,
            )
    vendor, product, serial = (value for _, value, _ in checks[1:])
    model = clean(f"{expected.name} vendor 0x{vendor:X} product 0x{product:X}")
    where = f"{address} node {expected.node}"
    try:
        name = sdo.read_bytes(Object.DEVICE_NAME).decode("ascii", errors="replace")
    except Aborted:
        name = ""  # which a device may leave out
    revision = sdo.read_if_present(Object.IDENTITY, 3)  # major above, minor below (7.5.2.19)
    firmware = "" if revision is None else f"revision {revision >> 16}.{revision & 0xFFFF}"
    return Identity(
        RAIL.name,
        model,
        str(serial),
        where,
        is_simulated_name(name),
        expected.name,
        f"vendor 0x{vendor:X}",
        firmware,
    )


@dataclass(frozen=True, slots=True)
class Homing:
    """How a drive gets its reference; ``counts``: its position where a motion has found it."""

    HERE = (35, 37)  # methods: the slide stays, and is where the offset says

    method: int | None  # 6098h; None: the drive is absolute
    fast_mm_s: float
    counts: int
    offset: int = Object.HOME_OFFSET  # or the maker's own object

    @property
    def moves(self) -> bool:
        return self.method is not None and self.method not in self.HERE


def set_up_drive(
    sdo: SdoChannel, limits: Limits, units: DriveUnits, pc_node: int, homing: Homing
) -> None:
    """Write a drive's settings, each read back; raises `Unsupported`, or `DeviceError`.

    Objects that `requirements.DRIVE` has as optional may be missing, unless the options need them.
    Without 6084h the ramp up is that down (CiA 402-2), without 607Ch the offset is 0.
    """

    def require(index: int, sub: int, value: int, what: str, *, needed: bool = False) -> None:
        optional = index in (*OPTIONAL_OF_DRIVE, homing.offset) and not needed
        sdo.require(index, sub, value, what, optional=optional)

    acceleration = units.of_acceleration(limits.acceleration)
    fast, slow = (
        units.of_speed(min(limits.speed, mm_s * limits.counts_per_mm))
        for mm_s in (homing.fast_mm_s, HOMING_SLOW_MM_S)
    )
    heartbeat = pc_node << 16 | PC_HEARTBEAT_LIMIT_MS
    require(Object.CONSUMER_HEARTBEAT, 1, heartbeat, "the drive notices that the PC has died")
    stops = "the drive stops by itself when the PC has died"
    require(Object.ABORT_CONNECTION_OPTION, 0, Option.QUICK_STOP_ON_LOST_CONNECTION, stops)
    require(Object.PROFILE_VELOCITY, 0, units.of_speed(limits.speed), "speed of motions")
    require(Object.PROFILE_ACCELERATION, 0, acceleration, "ramp of motions")
    require(Object.PROFILE_DECELERATION, 0, acceleration, "ramp of motions")
    if homing.method is not None:
        require(Object.HOMING_METHOD, 0, homing.method, "homing method", needed=True)
    if homing.moves:
        where = "the drive reads home_mm where it has homed"
        at = units.position(homing.counts)
        require(homing.offset, 0, at, where, needed=at != 0)
        require(Object.HOMING_SPEEDS, 1, fast, "speeds of homing", needed=True)
        require(Object.HOMING_SPEEDS, 2, slow, "speeds of homing", needed=True)
        require(Object.HOMING_ACCELERATION, 0, acceleration, "ramp of homing")
    set_quick_stop(sdo, acceleration)
    dwell_ms = min(0xFFFF, round(limits.windows.dwell_s * 1000))
    threshold = min(0xFFFF, units.of_speed(limits.windows.speed))
    window, standstill = "window of a target that is reached", "threshold of standstill"
    require(Object.POSITION_WINDOW, 0, limits.window, window)
    require(Object.POSITION_WINDOW_TIME, 0, dwell_ms, window)
    require(Object.VELOCITY_THRESHOLD, 0, threshold, standstill)
    require(Object.VELOCITY_THRESHOLD_TIME, 0, dwell_ms, standstill)


def set_quick_stop(sdo: SdoChannel, acceleration: int) -> None:
    """Set a stop ramp as steep as that of motions; raises `Unsupported`.

    Steeper quick-stop ramps (6085h) stay. A drive without that object stops on the ramp of its
    motions, where this can be set. One that does not brake in a fault is detected because it does
    not come to rest.
    """
    held, ramp = sdo.read_if_present(Object.QUICK_STOP_DECELERATION), Option.QUICK_STOP_RAMP
    if held is None and sdo.offer(Object.QUICK_STOP_OPTION, 0, Option.SLOW_DOWN_RAMP) is None:
        ramp = Option.SLOW_DOWN_RAMP
    else:
        sdo.require(Object.QUICK_STOP_OPTION, 0, ramp, "a quick stop ends on the brake")
    if held is not None and held < acceleration:
        what = "a quick stop takes no longer than a motion's own ramp"
        sdo.require(Object.QUICK_STOP_DECELERATION, 0, acceleration, what)
    sdo.offer(Object.FAULT_REACTION_OPTION, 0, ramp)


def homing_s(*, travel_mm: float, speed_mm_s: float) -> float:
    """Return how long homing is planned to take from the far end of the travel."""
    fast_s = travel_mm / speed_mm_s
    # Off the switch it goes 20 mm at most.
    return fast_s + 20.0 / min(speed_mm_s, HOMING_SLOW_MM_S)


def start_nodes(link: CanLink, nodes: Sequence[Node], check: Callable[[], None]) -> None:
    """Send NMT START until every node is operational; raises `DeviceError` after `OPERATIONAL_S`.

    Repeated, because a node that has lost a heartbeat rejects the first one as too early. For
    set-up only: a node that leaves operational later is at fault and is not started again.
    """
    next_s = link.time.listened_s
    deadline_s = next_s + OPERATIONAL_S
    for node in nodes:
        node.state = None  # until the next heartbeat
    while waiting := [node for node in nodes if node.state != NodeState.OPERATIONAL]:
        link.check()
        now_s = link.time.listened_s
        if now_s > deadline_s:
            states = ", ".join(f"node {n.number} is {state_text(n.state)}" for n in waiting)
            raise RAIL.failed(
                "HC-R10",
                "connect",
                f"nodes do not start: {states}",
                expected=f"{state_text(NodeState.OPERATIONAL)} within {OPERATIONAL_S:.0f} s",
                nodes=[n.number for n in waiting],
                waited_s=OPERATIONAL_S,
            )
        if now_s >= next_s:
            next_s = now_s + START_PERIOD_S
            for node in waiting:
                node.command(NodeCommand.START)
        check()
        time.sleep(POLL_S)  # heartbeats come in real time, whatever the cell's clock does
