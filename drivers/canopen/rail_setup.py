"""Identities of the rail's two nodes, and the settings that make the drive stop by itself.

A node may acknowledge a setting and not keep it, so every object is read back; the ones that stop
the slide when the PC dies (1016h, 6007h, 605Ah) matter most.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from drivers.canopen import cia402, cia406, nmt
from drivers.canopen.can_link import CanLink, LinkLost
from drivers.canopen.node_watch import HEARTBEAT_PERIOD_MS, PC_HEARTBEAT_LIMIT_MS, NodeWatch
from drivers.canopen.sdo import ABSENT, Aborted, SdoChannel
from hilcell.clean import clean
from hilcell.ports import DeviceError, DeviceRefused, Identity, says_simulated

DEVICE_TYPE = 0x1000
DEVICE_NAME = 0x1008
CONSUMER_HEARTBEAT = 0x1016
PRODUCER_HEARTBEAT = 0x1017
IDENTITY = 0x1018
FIND_S = 5.0
OPERATIONAL_S = 3.0  # wire deadline
START_PERIOD_S = 0.5
POLL_S = 0.02
HOMING_SLOW_MM_S, HOMING_SLOW_MM = 5.0, 20.0  # off the switch, at most so far
LARGEST_U16 = 0xFFFF


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
            return sdo.read(DEVICE_TYPE)
        except (Aborted, LinkLost):
            raise
        except DeviceError as error:
            if link.time.listened_s > deadline_s:
                raise DeviceError(
                    "HC-R05",
                    "Rail",
                    "connect",
                    f"node {expected.node} ({expected.name}) does not answer{_losses(link)}",
                    wanted=f"an answer within {FIND_S:.0f} s",
                    act="check its power, cable, terminators, bit rate and node number",
                    fields={"node": expected.node, "name": expected.name, "waited_s": FIND_S},
                ) from error
        check()


def _losses(link: CanLink) -> str:
    """Return the losses on a link, to be named behind a node's silence; "" for none."""
    lost = link.statistics()
    if not lost.bad_lines + lost.refused + lost.malformed:
        return ""
    malformed = f", {lost.malformed} malformed" if lost.malformed else ""
    return f"; {lost.bad_lines} bad lines, {lost.refused} refused{malformed} on this link"


def identify(sdo: SdoChannel, expected: Expected, device_type: int, address: str) -> Identity:
    """Compare 1000h and 1018h with the cell file; raises `DeviceRefused`."""
    checks = (
        ("device profile (1000h)", device_type & 0xFFFF, expected.profile),
        ("vendor (1018h:01)", sdo.read(IDENTITY, 1), expected.vendor),
        ("product (1018h:02)", sdo.read(IDENTITY, 2), expected.product),
        ("serial (1018h:04)", sdo.read(IDENTITY, 4), expected.serial),
    )
    for what, found, wanted in checks:
        if wanted and found != wanted:
            raise DeviceRefused(
                "HC-R08",
                "Rail",
                "connect",
                f"node {expected.node} ({expected.name}): {what} is 0x{found:X}",
                wanted=f"0x{wanted:X}",
                act="another device; check node numbers and options",
                fields={
                    "node": expected.node,
                    "name": expected.name,
                    "object": what,
                    "found_value": found,
                    "wanted_value": wanted,
                },
            )
    vendor, product, serial = (found for _, found, _ in checks[1:])
    model = clean(f"{expected.name} vendor 0x{vendor:X} product 0x{product:X}")
    where = f"{address} node {expected.node}"
    return Identity(
        "Rail",
        model,
        str(serial),
        where,
        says_simulated(_device_name(sdo)),
        expected.name,
        f"vendor 0x{vendor:X}",
        _revision(sdo),
    )


def _revision(sdo: SdoChannel) -> str:
    """Return 1018h:03, which a device may leave out: major in the upper half, minor in the lower.

    CiA 301, 7.5.2.19.
    """
    found = _optional(sdo, IDENTITY, 3)
    return "" if found is None else f"revision {found >> 16}.{found & 0xFFFF}"


def _device_name(sdo: SdoChannel) -> str:
    """Return 1008h, which a device may leave out."""
    try:
        return sdo.read_bytes(DEVICE_NAME).decode("ascii", errors="replace")
    except Aborted:
        return ""


def check_strip_step(sdo: SdoChannel, counts_per_mm: float) -> None:
    """Refuse a strip whose step, where it tells one, is not that of the cell file."""
    wanted_nm = cia406.step_nm(counts_per_mm)
    for found_nm, where in ((_step(sdo), "6005h"), (_optional(sdo, cia406.POSITION_STEP), "6501h")):
        if found_nm is not None and found_nm != wanted_nm:
            raise DeviceRefused(
                "HC-S07",
                "Rail",
                "connect",
                f"strip step ({where}) is {found_nm} nm",
                wanted=f"{wanted_nm} nm",
                act="correct strip_counts_per_mm or the sensor",
                fields={"step_nm": found_nm, "wanted_nm": wanted_nm},
            )


def _step(sdo: SdoChannel) -> int | None:
    """Return 6005h: sub-index 1 of an array, or the plain value."""
    step = _optional(sdo, cia406.MEASURING_STEP, 1)
    if step is not None:
        return step
    try:
        return int.from_bytes(sdo.read_bytes(cia406.MEASURING_STEP, 0), "little")
    except Aborted as error:
        if error.abort_code not in ABSENT:
            raise
        return None


def _optional(sdo: SdoChannel, index: int, sub: int = 0) -> int | None:
    try:
        return sdo.read(index, sub)
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
        (CONSUMER_HEARTBEAT, 1): pc_node << 16 | PC_HEARTBEAT_LIMIT_MS,
        (PRODUCER_HEARTBEAT, 0): HEARTBEAT_PERIOD_MS,
        (cia402.ABORT_CONNECTION_OPTION, 0): cia402.QUICK_STOP_ON_LOST_CONNECTION,
        (cia402.QUICK_STOP_OPTION, 0): cia402.SLOW_DOWN_ON_QUICK_STOP_RAMP,
        (cia402.PROFILE_VELOCITY, 0): speed,
        (cia402.PROFILE_ACCELERATION, 0): acceleration,
        (cia402.PROFILE_DECELERATION, 0): acceleration,
        (cia402.HOMING_METHOD, 0): cia402.HOME_NEGATIVE_LIMIT,
        (cia402.HOME_OFFSET, 0): 0,
        (cia402.HOMING_SPEEDS, 1): homing,
        (cia402.HOMING_SPEEDS, 2): homing_slow,
        (cia402.HOMING_ACCELERATION, 0): acceleration,
    }


STRIP_SETTINGS: Mapping[tuple[int, int], int] = {(PRODUCER_HEARTBEAT, 0): HEARTBEAT_PERIOD_MS}


def homing_s(*, travel_mm: float, speed_mm_s: float) -> float:
    """Return how long homing is planned to take from the far end of the travel."""
    fast_s = travel_mm / speed_mm_s
    return fast_s + HOMING_SLOW_MM / min(speed_mm_s, HOMING_SLOW_MM_S)


def window_settings(*, arrived: int, speed: float, dwell_s: float) -> Mapping[tuple[int, int], int]:
    """Return the drive's own windows of arrival (counts) and standstill (counts/s)."""
    dwell_ms = min(LARGEST_U16, round(dwell_s * 1000))
    return {
        (cia402.POSITION_WINDOW, 0): arrived,
        (cia402.POSITION_WINDOW_TIME, 0): dwell_ms,
        (cia402.VELOCITY_THRESHOLD, 0): min(LARGEST_U16, round(speed)),
        (cia402.VELOCITY_THRESHOLD_TIME, 0): dwell_ms,
    }


def apply_where_present(sdo: SdoChannel, settings: Mapping[tuple[int, int], int]) -> None:
    """Write settings that not every device has, each read back; raises `DeviceError`."""
    for (index, sub), value in settings.items():
        try:
            sdo.write(index, sub, value)
        except Aborted as error:
            if error.abort_code not in ABSENT:
                raise


def apply(sdo: SdoChannel, settings: Mapping[tuple[int, int], int]) -> None:
    """Write settings and read each back; raises `DeviceError`."""
    for (index, sub), value in settings.items():
        sdo.write(index, sub, value)


def start_nodes(link: CanLink, watches: Sequence[NodeWatch], check: Callable[[], None]) -> None:
    """Send NMT START until every node is operational; raises `DeviceError` after `OPERATIONAL_S`.

    Repeated, because a node that has lost a heartbeat takes the first one for too early. For
    set-up only: a node that leaves operational later is at fault and is not started again.
    """
    next_s = link.time.listened_s
    deadline_s = next_s + OPERATIONAL_S
    for watch in watches:
        watch.forget_state()
    while waiting := [watch for watch in watches if watch.state != nmt.OPERATIONAL]:
        link.check()
        now_s = link.time.listened_s
        if now_s > deadline_s:
            states = ", ".join(f"node {w.node} is {nmt.state_text(w.state)}" for w in waiting)
            raise DeviceError(
                "HC-R10",
                "Rail",
                "connect",
                f"nodes do not start: {states}",
                wanted=f"{nmt.state_text(nmt.OPERATIONAL)} within {OPERATIONAL_S:.0f} s",
                act="switch the nodes off and on, then resume",
                fields={"nodes": [w.node for w in waiting], "waited_s": OPERATIONAL_S},
            )
        if now_s >= next_s:
            next_s = now_s + START_PERIOD_S
            for watch in waiting:
                link.send(nmt.COMMAND, bytes((nmt.START, watch.node)))
        check()
        time.sleep(POLL_S)  # heartbeats come in real time, whatever the cell's clock does
