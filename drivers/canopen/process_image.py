"""The rail's process image: readings of drive and strip at one SYNC, and the drive's commands.

The trap: a stop from another thread must not be undone by a control word that the worker was just
about to send. Both pass one lock; after a quick stop no word that enables the drive goes out.
"""

from __future__ import annotations

import math
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import or_

from drivers.canopen import cia402, cia406
from drivers.canopen.can_link import CanLink
from drivers.canopen.cia402 import Control, Object, State
from drivers.canopen.node_watch import NodeWatch
from drivers.canopen.pdo import Inbox, Mapping, Transmission
from drivers.standstill import DEVICE
from hilcell.ports import DeviceError

COMMAND_AGE_S = 0.5  # nothing is enabled or started by a reading that is older
NO_MODE = 0  # of CiA 402: no mode assigned


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Drive and strip at one SYNC, in counts and counts/s."""

    statusword: int
    position: int
    velocity: int
    mode: int
    strip: int
    alarms: int
    taken_s: float

    @property
    def state(self) -> State:
        """Return the state of the power drive system."""
        return cia402.state_of(self.statusword)

    @property
    def powered(self) -> bool:
        """Whether the drive has the power to move."""
        return self.state in cia402.POWERED

    def has(self, bits: int) -> bool:
        """Whether all ``bits`` of the status word are set."""
        return self.statusword & bits == bits


class ProcessImage:
    """Four PDOs: TPDO1 and 2 and RPDO1 of the drive, TPDO1 of the strip sensor on its bus."""

    def __init__(
        self,
        link: CanLink,
        drive_node: int,
        strip_node: int,
        other_strip: Callable[[Callable[[], None]], tuple[int, int]] | None = None,
        strip_watch: NodeWatch | None = None,
    ) -> None:
        """``other_strip`` returns counts and alarms of a strip that is not on this bus.

        ``strip_watch`` knows the alarms of a strip on it that has no object for them.
        """
        self._link = link
        self._lock = threading.Lock()
        self._stopped = False
        self._target = 0
        self._taken_s = -math.inf
        self.status = Mapping(
            0x1800,
            0x1A00,
            0x180 + drive_node,
            Transmission.EVERY_SYNC,
            ((Object.STATUSWORD, 16), (Object.POSITION_ACTUAL, 32)),
            struct.Struct("<Hi"),
        )
        self.motion = Mapping(
            0x1801,
            0x1A01,
            0x280 + drive_node,
            Transmission.EVERY_SYNC,
            ((Object.VELOCITY_ACTUAL, 32), (Object.MODE_DISPLAY, 8)),
            struct.Struct("<ib"),
        )
        self.command = Mapping(
            0x1400,
            0x1600,
            0x200 + drive_node,
            Transmission.ON_EVENT,
            ((Object.CONTROLWORD, 16), (Object.TARGET_POSITION, 32)),
            struct.Struct("<Hi"),
        )
        self.strip = strip_mapping(strip_node)
        self._other_strip, self._strip_watch = other_strip, strip_watch
        pdos = (self.status, self.motion)
        self._inbox = Inbox(DEVICE, link, pdos if other_strip else (*pdos, self.strip))

    def refresh(self, check: Callable[[], None]) -> Snapshot:
        """Return the values of drive and strip at a SYNC sent now."""
        values, taken_s = self._inbox.refresh(check)
        statusword, position = values[self.status.cob_id]
        velocity, mode, *_ = *values[self.motion.cob_id], NO_MODE
        if self._other_strip is None:
            strip, alarms = strip_values(values[self.strip.cob_id], self._strip_watch)
        else:
            strip, alarms = self._other_strip(check)
        self._taken_s = taken_s
        return Snapshot(statusword, position, velocity, mode, strip, alarms, taken_s)

    def take(self, pdo: Mapping) -> None:
        """Take a PDO that may lack an object, as the device has mapped it."""
        if pdo.cob_id == self.motion.cob_id:
            self.motion = pdo
        self._inbox.expect(pdo)

    @property
    def shows_mode(self) -> bool:
        """Whether the mode is part of it; it is `NO_MODE` where 6061h cannot be mapped."""
        return len(self.motion.entries) > 1

    def control(self, controlword: int, target: int | None = None) -> None:
        """Send a control word, with the target position in counts where it matters.

        Raises `DeviceError` for one that enables the drive by a reading that is too old.
        """
        age_s = self._link.clock.pc_s() - self._taken_s
        if cia402.enables(controlword) and not age_s <= COMMAND_AGE_S:
            raise DeviceError(
                "HC-R39",
                DEVICE,
                "move",
                f"PC late: the reading to move by is {age_s:.1f} s old",
                wanted=f"<= {COMMAND_AGE_S:.1f} s",
                act="give the engine a PC of its own, or end other programs on it; then resume",
                fields={"age_s": age_s, "limit_s": COMMAND_AGE_S},
            )
        with self._lock:
            if cia402.enables(controlword):
                self.check_not_stopped()
            if target is not None:
                self._target = target
            self._send(controlword)

    def check_not_stopped(self) -> None:
        """Raise `DeviceError` after a quick stop."""
        if self._stopped:
            raise DeviceError(
                "HC-R38", DEVICE, "move", "the rail was stopped", act="resume to reconnect"
            )

    def quick_stop(self) -> None:
        """Stop on the quick-stop ramp, and never enable again; any thread, waits for nothing."""
        self._stopped = True
        if self._lock.acquire(timeout=0.1):
            try:
                self._send(Control.QUICK_STOP)
            finally:
                self._lock.release()
        else:  # another frame hangs in the gateway; this one goes out all the same
            self._send(Control.QUICK_STOP)

    @property
    def stopped(self) -> bool:
        """Whether a quick stop was sent."""
        return self._stopped

    def _send(self, controlword: int) -> None:
        self._link.send(self.command.cob_id, self.command.layout.pack(controlword, self._target))


def strip_mapping(node: int) -> Mapping:
    """Return TPDO1 of a strip sensor: its counts and alarms."""
    return Mapping(
        0x1800,
        0x1A00,
        0x180 + node,
        Transmission.EVERY_SYNC,
        ((cia406.Object.POSITION, 32), (cia406.Object.ALARMS, 16)),
        struct.Struct("<iH"),
    )


def strip_values(values: tuple[int, ...], watch: NodeWatch | None) -> tuple[int, int]:
    """Return counts and alarms; where 6503h is absent or says none, emergencies are the alarms."""
    counts, *alarms = values
    if watch is not None and watch.speaks_for_sensor:
        alarms.append(cia406.POSITION_ERROR if watch.sensor_fails else 0)
    return counts, reduce(or_, alarms, 0)
