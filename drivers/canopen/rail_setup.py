"""Identities of the rail's two nodes, and the settings that make the drive stop by itself.

A node may acknowledge a setting and not keep it, so every object is read back; the ones that stop
the slide when the PC dies (1016h, 6007h, 605Ah, 6085h) matter most.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from drivers.canopen import cia
from drivers.canopen.can_link import CanLink, LinkLost, heartbeat_period_s
from drivers.canopen.cia import NMT, NodeCommand, NodeObject, NodeState, Object, Option, state_text
from drivers.canopen.node_watch import PC_HEARTBEAT_LIMIT_MS, NodeWatch, doubts_sensor
from drivers.canopen.process_image import Mapping as Pdo
from drivers.canopen.sdo import ABSENT, Aborted, SdoChannel, Unsupported
from drivers.canopen.slcan_bus import has_long_stamp
from drivers.device_errors import RAIL
from hilcell.clean import clean
from hilcell.ports import DeviceError, Identity, says_simulated

FIND_S = 5.0
OPERATIONAL_S = 3.0  # wire deadline
START_PERIOD_S = 0.5
POLL_S = 0.02
HOMING_SLOW_MM_S = 5.0

# Why a node has the settings that it is given here.
PURPOSES: dict[int, str] = {
    NodeObject.CONSUMER_HEARTBEAT: "the drive notices that the PC has died",
    NodeObject.PRODUCER_HEARTBEAT: "the PC notices that the node has died",
    Object.ABORT_CONNECTION_OPTION: "the drive stops by itself when the PC has died",
    Object.QUICK_STOP_OPTION: "a quick stop ends on the brake",
    Object.QUICK_STOP_DECELERATION: "a quick stop takes no longer than a motion's own ramp",
    Object.PROFILE_VELOCITY: "speed of motions",
    Object.PROFILE_ACCELERATION: "ramp of motions",
    Object.PROFILE_DECELERATION: "ramp of motions",
    Object.HOMING_METHOD: "homing to the negative limit switch",
    Object.HOME_OFFSET: "the drive reads 0 where it has homed",
    Object.HOMING_SPEEDS: "speeds of homing",
    Object.HOMING_ACCELERATION: "ramp of homing",
    Object.POSITION_WINDOW: "window of a target that is reached",
    Object.POSITION_WINDOW_TIME: "window of a target that is reached",
    Object.VELOCITY_THRESHOLD: "threshold of standstill",
    Object.VELOCITY_THRESHOLD_TIME: "threshold of standstill",
}
# Without 6084h the ramp up is that down (CiA 402-2), without 607Ch the offset is 0; the others only
# help the drive: hilcell judges arrival and standstill itself, and guards each speed.
OPTIONAL = frozenset[int](
    {
        Object.PROFILE_DECELERATION,
        Object.HOME_OFFSET,
        Object.HOMING_ACCELERATION,
        Object.POSITION_WINDOW,
        Object.POSITION_WINDOW_TIME,
        Object.VELOCITY_THRESHOLD,
        Object.VELOCITY_THRESHOLD_TIME,
    }
)


@dataclass(frozen=True, slots=True)
class Expected:
    """The wanted identity of a node; 0 is not checked."""

    name: str
    node: int
    profile: int
    vendor: int
    product: int
    serial: int


def find_node(link: CanLink, sdo: SdoChannel, expected: Expected, check: Callable[[], None]) -> int:
    """Return the node's device type as soon as it answers; raises `DeviceError` after `FIND_S`.

    A lost link is raised at once as `LinkLost`.
    """
    deadline_s = link.time.listened_s + FIND_S
    while True:
        try:
            return sdo.read(NodeObject.DEVICE_TYPE)
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
                    wanted=f"an answer within {FIND_S:.0f} s",
                    act=act,
                    node=expected.node,
                    name=expected.name,
                    waited_s=FIND_S,
                ) from error
        check()


def identify(sdo: SdoChannel, expected: Expected, device_type: int, address: str) -> Identity:
    """Compare 1000h and 1018h with the cell file; raises `DeviceRefused`."""
    checks = (
        ("device profile (1000h)", device_type & 0xFFFF, expected.profile),
        ("vendor (1018h:01)", sdo.read(NodeObject.IDENTITY, 1), expected.vendor),
        ("product (1018h:02)", sdo.read_if_present(NodeObject.IDENTITY, 2) or 0, expected.product),
        ("serial (1018h:04)", sdo.read_if_present(NodeObject.IDENTITY, 4) or 0, expected.serial),
    )
    for what, found, wanted in checks:
        if wanted and found != wanted:
            raise RAIL.refused(
                "HC-R08",
                "connect",
                f"node {expected.node} ({expected.name}): {what} is 0x{found:X}",
                wanted=f"0x{wanted:X}",
                node=expected.node,
                name=expected.name,
                object=what,
                found_value=found,
                wanted_value=wanted,
            )
    vendor, product, serial = (found for _, found, _ in checks[1:])
    model = clean(f"{expected.name} vendor 0x{vendor:X} product 0x{product:X}")
    where = f"{address} node {expected.node}"
    try:
        name = sdo.read_bytes(NodeObject.DEVICE_NAME).decode("ascii", errors="replace")
    except Aborted:
        name = ""  # which a device may leave out
    revision = sdo.read_if_present(NodeObject.IDENTITY, 3)  # major above, minor below (7.5.2.19)
    firmware = "" if revision is None else f"revision {revision >> 16}.{revision & 0xFFFF}"
    return Identity(
        RAIL.name,
        model,
        str(serial),
        where,
        says_simulated(name),
        expected.name,
        f"vendor 0x{vendor:X}",
        firmware,
    )


def check_strip_step(sdo: SdoChannel, counts_per_mm: float) -> None:
    """Refuse a strip whose step, where it tells one, is not that of the cell file."""
    wanted_nm = cia.step_nm(counts_per_mm)
    for found_nm, where in (
        (_step(sdo), "6005h"),
        (sdo.read_if_present(cia.StripObject.POSITION_STEP), "6501h"),
    ):
        if found_nm is not None and found_nm != wanted_nm:
            raise RAIL.refused(
                "HC-S07",
                "connect",
                f"strip step ({where}) is {found_nm} nm",
                wanted=f"{wanted_nm} nm",
                step_nm=found_nm,
                wanted_nm=wanted_nm,
            )


def _step(sdo: SdoChannel) -> int | None:
    """Return 6005h: sub-index 1 of an array, or the plain value."""
    step = sdo.read_if_present(cia.StripObject.MEASURING_STEP, 1)
    if step is not None:
        return step
    try:
        return int.from_bytes(sdo.read_bytes(cia.StripObject.MEASURING_STEP, 0), "little")
    except Aborted as error:
        if error.abort_code not in ABSENT:
            raise
        return None


def drive_settings(
    *,
    pc_node: int,
    counts_per_mm: float,
    speed_mm_s: float,
    acceleration_mm_s2: float,
    homing_mm_s: float,
) -> Mapping[tuple[int, int], int]:
    """Return the settings of the drive: (object, sub-index) to value."""
    speed = round(speed_mm_s * counts_per_mm)
    acceleration = round(acceleration_mm_s2 * counts_per_mm)
    homing = round(min(speed_mm_s, homing_mm_s) * counts_per_mm)
    homing_slow = round(min(speed_mm_s, HOMING_SLOW_MM_S) * counts_per_mm)
    return {
        (NodeObject.CONSUMER_HEARTBEAT, 1): pc_node << 16 | PC_HEARTBEAT_LIMIT_MS,
        (Object.ABORT_CONNECTION_OPTION, 0): Option.QUICK_STOP_ON_LOST_CONNECTION,
        (Object.PROFILE_VELOCITY, 0): speed,
        (Object.PROFILE_ACCELERATION, 0): acceleration,
        (Object.PROFILE_DECELERATION, 0): acceleration,
        (Object.HOMING_METHOD, 0): Option.HOME_NEGATIVE_LIMIT,
        (Object.HOME_OFFSET, 0): 0,
        (Object.HOMING_SPEEDS, 1): homing,
        (Object.HOMING_SPEEDS, 2): homing_slow,
        (Object.HOMING_ACCELERATION, 0): acceleration,
    }


def set_quick_stop(sdo: SdoChannel, acceleration: int) -> None:
    """Let a drive stop on a ramp that is as steep as that of its motions; raises `Unsupported`.

    Steeper ones of its quick stop (6085h) stay. A drive without that object stops on the ramp of
    its motions, where it can be asked to. One that will not brake in a fault is seen when it does
    not come to rest.
    """
    held, ramp = sdo.read_if_present(Object.QUICK_STOP_DECELERATION), Option.QUICK_STOP_RAMP
    if held is None and sdo.offer(Object.QUICK_STOP_OPTION, 0, Option.SLOW_DOWN_RAMP) is None:
        ramp = Option.SLOW_DOWN_RAMP
    else:
        apply(sdo, {(Object.QUICK_STOP_OPTION, 0): ramp})
    if held is not None and held < acceleration:
        apply(sdo, {(Object.QUICK_STOP_DECELERATION, 0): acceleration})
    sdo.offer(Object.FAULT_REACTION_OPTION, 0, ramp)


def set_heartbeat(sdo: SdoChannel, bitrate: int) -> None:
    """Let a node send its heartbeat as often as the PC does, or as it can; raises `Unsupported`."""
    wanted_ms = round(1000 * heartbeat_period_s(bitrate))
    if (refusal := sdo.offer(NodeObject.PRODUCER_HEARTBEAT, 0, wanted_ms)) is None:
        return
    for slower_ms in (100, 200):  # several within the limit of a node's silence
        if sdo.offer(NodeObject.PRODUCER_HEARTBEAT, 0, slower_ms) is None:
            return
    raise Unsupported(
        refusal, f"1017h:00 = {wanted_ms} ({PURPOSES[NodeObject.PRODUCER_HEARTBEAT]})"
    )


def homing_s(*, travel_mm: float, speed_mm_s: float) -> float:
    """Return how long homing is planned to take from the far end of the travel."""
    fast_s = travel_mm / speed_mm_s
    # Off the switch it goes 20 mm at most.
    return fast_s + 20.0 / min(speed_mm_s, HOMING_SLOW_MM_S)


def window_settings(*, arrived: int, speed: float, dwell_s: float) -> Mapping[tuple[int, int], int]:
    """Return the drive's own windows of arrival (counts) and standstill (counts/s)."""
    dwell_ms = min(0xFFFF, round(dwell_s * 1000))
    return {
        (Object.POSITION_WINDOW, 0): arrived,
        (Object.POSITION_WINDOW_TIME, 0): dwell_ms,
        (Object.VELOCITY_THRESHOLD, 0): min(0xFFFF, round(speed)),
        (Object.VELOCITY_THRESHOLD_TIME, 0): dwell_ms,
    }


def apply(sdo: SdoChannel, settings: Mapping[tuple[int, int], int]) -> None:
    """Write settings, each read back; raises `Unsupported`, or `DeviceError`.

    A device may lack those in `OPTIONAL`.
    """
    for (index, sub), value in settings.items():
        refusal = sdo.offer(index, sub, value)
        if refusal is None or (index in OPTIONAL and refusal.abort_code in ABSENT):
            continue
        raise Unsupported(refusal, f"{index:04X}h:{sub:02X} = {value} ({PURPOSES[index]})")


def map_strip(sdo: SdoChannel, pdo: Pdo, watch: NodeWatch) -> Pdo:
    """Configure the PDO of a strip sensor and return it: without its alarms where it has no 6503h.

    Then, or where 6503h never has a position error (6504h), its emergencies have them; one that
    was sent before is still in the error register.
    """
    mapped = pdo.configure_most(sdo)
    supported = sdo.read_if_present(cia.StripObject.SUPPORTED_ALARMS)
    silent = supported is not None and not supported & cia.POSITION_ERROR
    watch.speaks_for_sensor = silent or mapped is not pdo
    watch.sensor_fails = watch.speaks_for_sensor and doubts_sensor(
        sdo.read(NodeObject.ERROR_REGISTER)
    )
    return mapped


def start_nodes(link: CanLink, watches: Sequence[NodeWatch], check: Callable[[], None]) -> None:
    """Send NMT START until every node is operational; raises `DeviceError` after `OPERATIONAL_S`.

    Repeated, because a node that has lost a heartbeat takes the first one for too early. For
    set-up only: a node that leaves operational later is at fault and is not started again.
    """
    next_s = link.time.listened_s
    deadline_s = next_s + OPERATIONAL_S
    for watch in watches:
        watch.forget_state()
    while waiting := [watch for watch in watches if watch.state != NodeState.OPERATIONAL]:
        link.check()
        now_s = link.time.listened_s
        if now_s > deadline_s:
            states = ", ".join(f"node {w.node} is {state_text(w.state)}" for w in waiting)
            raise RAIL.failed(
                "HC-R10",
                "connect",
                f"nodes do not start: {states}",
                wanted=f"{state_text(NodeState.OPERATIONAL)} within {OPERATIONAL_S:.0f} s",
                nodes=[w.node for w in waiting],
                waited_s=OPERATIONAL_S,
            )
        if now_s >= next_s:
            next_s = now_s + START_PERIOD_S
            for watch in waiting:
                link.send(NMT, bytes((NodeCommand.START, watch.node)))
        check()
        time.sleep(POLL_S)  # heartbeats come in real time, whatever the cell's clock does
