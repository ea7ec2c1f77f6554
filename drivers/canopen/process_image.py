"""The rail's process image: readings of drive and strip at one SYNC, and the drive's commands.

PDOs are mapped by SDO and read back (CiA 301, 7.5.2). A received PDO has no sampling time, so all
are synchronous, and a reading counts only when each came after the SYNC that requested it. On a
slow gateway the answer to an earlier SYNC may still be in transit: it is awaited, and does not
count.

The trap: a stop from another thread must not be undone by a control word that the worker is about
to send. Both pass one lock; after a quick stop no word that enables the drive is sent.
"""

from __future__ import annotations

import math
import struct
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum

from drivers.canopen import cia
from drivers.canopen.can_link import CanLink
from drivers.canopen.cia import Control, Object, State
from drivers.canopen.drive_units import DriveUnits
from drivers.canopen.sdo import Aborted, SdoChannel, Unsupported
from drivers.device_errors import RAIL
from drivers.slide import Poll

SYNC = 0x080
REPLY_S = 0.2  # of link time
STALE_S = 0.3
SYNCS = 3
POLL_S = 0.02
NO_MODE = 0  # of CiA 402: no mode assigned
AS_COUNTED = DriveUnits()
ReadStrip = Callable[[Mapping[int, tuple[int, ...]], Callable[[], None]], tuple[int, int]]


class Transmission(IntEnum):
    """Types of transmission; a PDO that is received counts at once by either kind of event."""

    EVERY_SYNC = 1
    OWN_EVENT = 254  # of the maker
    ON_EVENT = 255


@dataclass(frozen=True, slots=True)
class Pdo:
    """One PDO; its mapping (16xxh or 1Axxh) is 200h above its ``parameters``."""

    DISABLED, NO_RTR = 1 << 31, 1 << 30

    parameters: int  # 14xxh or 18xxh
    cob_id: int
    transmission: int
    objects: tuple[int, ...]
    layout: str  # of their values, as `struct` knows it

    def values(self, data: bytes | bytearray) -> tuple[int, ...]:
        """Return the objects' values; raises `struct.error` for a truncated frame."""
        return struct.unpack(self.layout, data)

    def shorter(self) -> Pdo:
        """Return the same PDO without its last object."""
        return replace(self, objects=self.objects[:-1], layout=self.layout[:-1])

    def configure(self, sdo: SdoChannel) -> None:
        """Write it in the order of the standard (7.5.2.36): off, emptied, filled, on.

        A part that the device refuses to change is right where it reads so already. Bit 30 (no
        remote frames) is left unchanged: devices without remote frames refuse to clear it. Raises
        `Unsupported`.
        """
        what, parameters = f"{self._what} with identifier {self.cob_id:03X}h", self.parameters
        try:
            held = sdo.read(parameters, 1)
        except Aborted as refusal:
            raise Unsupported(refusal, f"{parameters:04X}h ({what})") from refusal
        cob_id = held & self.NO_RTR | self.cob_id
        fixed = sdo.offer(parameters, 1, self.DISABLED | cob_id)
        if fixed is not None and held != cob_id:
            raise Unsupported(fixed, f"{parameters:04X}h:01 ({what})")
        self._map(sdo)
        other = sdo.offer(parameters, 2, self.transmission)
        if other is not None and not (
            self.transmission == Transmission.ON_EVENT
            and sdo.read(parameters, 2) == Transmission.OWN_EVENT
        ):
            raise Unsupported(other, f"{parameters:04X}h:02 = {self.transmission} ({what})")
        if fixed is None:
            sdo.require(parameters, 1, cob_id, what)

    def configure_most(self, sdo: SdoChannel) -> Pdo:
        """Configure it, or the `shorter` one of a device that does not support it; return which."""
        try:
            self.configure(sdo)
        except Unsupported:
            shorter = self.shorter()
            shorter.configure(sdo)
            return shorter
        return self

    def _map(self, sdo: SdoChannel) -> None:
        """Write the mapped objects; a device that refuses may have the same already."""
        mapping, count = self.parameters + 0x200, len(self.objects)
        coded = [
            (sub, index << 16 | 8 * struct.calcsize(f"<{kind}"))
            for sub, index, kind in zip(
                range(1, count + 1), self.objects, self.layout[1:], strict=True
            )
        ]
        try:
            for sub, value in ((0, 0), *coded, (0, count)):
                sdo.write(mapping, sub, value)
        except Aborted as refusal:
            same = all(sdo.read(mapping, sub) == value for sub, value in ((0, count), *coded))
            if not same:
                raise Unsupported(refusal, f"{mapping:04X}h ({self._what})") from refusal

    @property
    def _what(self) -> str:
        return "PDO of " + " and ".join(f"{index:04X}h" for index in self.objects)


class Inbox:
    """The last values of some TPDOs, and how often and when each came."""

    def __init__(self, link: CanLink, pdos: Iterable[Pdo], syncs: int = SYNCS) -> None:
        self._link, self._syncs = link, syncs
        self._changed = threading.Condition()
        self._pdos = {pdo.cob_id: pdo for pdo in pdos}
        self._values: dict[int, tuple[int, ...]] = {}
        self._sent = 0  # SYNCs
        self._answered = dict.fromkeys(self._pdos, 0)  # so many of them, by each PDO
        self._arrived_s = dict.fromkeys(self._pdos, 0.0)
        self._received_s = 0.0  # of link time
        for cob_id in self._pdos:
            link.subscribe(cob_id, self._on_pdo)

    def expect(self, pdo: Pdo) -> None:
        self._pdos[pdo.cob_id] = pdo

    def refresh(self, check: Callable[[], None]) -> tuple[dict[int, tuple[int, ...]], float]:
        """Send SYNC; return all values by identifier and since when the oldest may be true.

        A lost frame costs one more SYNC; raises `DeviceError` after that many unanswered SYNCs.
        Values that have waited in this PC for `STALE_S` are asked for again.
        """
        sent, before, sent_s = self._sent, dict(self._answered), self._link.clock.pc_s()
        for _ in range(self._syncs):
            earlier_s, sent_s = sent_s, self._link.clock.pc_s()
            with self._changed:
                self._sent += 1
            self._link.send(SYNC, b"")
            if self._await(sent, before, check):
                with self._changed:
                    arrived_s = max(sent_s, min(self._arrived_s.values()))
                    values = dict(self._values)
                if self._link.clock.pc_s() - arrived_s <= STALE_S:
                    return values, earlier_s  # the SYNC before may have been answered
                sent, before, sent_s = self._sent, dict(self._answered), self._link.clock.pc_s()
        missing = [f"0x{cob_id:03X}" for cob_id, n in before.items() if self._answered[cob_id] == n]
        if not missing:
            raise RAIL.failed(
                "HC-R39",
                "read",
                f"PC late: {self._syncs} readings in a row waited here for over {STALE_S:.1f} s",
                limit_s=STALE_S,
            )
        raise RAIL.failed(
            "HC-R07",
            "read",
            f"no fresh TPDO {', '.join(missing)} within {self._syncs} SYNCs",
            cob_ids=missing,
            syncs=self._syncs,
        )

    def _await(self, sent: int, before: dict[int, int], check: Callable[[], None]) -> bool:
        """Whether a SYNC of this refresh was answered, one behind the ``sent`` ones. Answers owed
        from ``before`` have come by `REPLY_S` after the last frame, or are lost.
        """
        began_s = self._link.time.listened_s
        while True:
            check()
            self._link.check()
            now_s = self._link.time.listened_s
            with self._changed:
                if all(count > sent for count in self._answered.values()):
                    return True
                if now_s > max(began_s, self._received_s) + REPLY_S:  # frames until then count
                    answered = all(self._answered[cob_id] > before[cob_id] for cob_id in before)
                    if answered:
                        self._answered = dict.fromkeys(self._answered, self._sent)
                    return answered
                self._changed.wait(POLL_S)

    def _on_pdo(self, cob_id: int, data: bytearray, _at_s: float) -> None:
        values = self._pdos[cob_id].values(data)  # a truncated frame is no reading
        with self._changed:
            self._values[cob_id] = values
            self._answered[cob_id] = min(self._sent, self._answered[cob_id] + 1)
            self._received_s = self._link.time.listened_s
            self._arrived_s[cob_id] = self._link.time.emptied_s
            self._changed.notify_all()


@dataclass(frozen=True, slots=True)
class Snapshot(Poll):
    """Drive and strip at one SYNC, in counts that rise with the travel, and counts/s."""

    position: int
    velocity: float
    statusword: int
    mode: int

    @classmethod
    def of(
        cls,
        statusword: int,
        position: int,
        velocity: float,
        *,
        strip: int,
        alarms: int,
        taken_s: float,
        mode: int = NO_MODE,
    ) -> Snapshot:
        """Return a snapshot; the status word shows whether the drive has power."""
        powered = cia.state_of(statusword) in cia.POWERED
        return cls(position, velocity, strip, alarms, powered, taken_s, statusword, mode)

    @property
    def state(self) -> State:
        return cia.state_of(self.statusword)

    def has(self, bits: int) -> bool:
        """Whether all ``bits`` of the status word are set."""
        return self.statusword & bits == bits


class ProcessImage:
    """Four PDOs: TPDO1 and 2 and RPDO1 of the drive, TPDO1 of the strip sensor on its bus."""

    COMMAND_AGE_S = 0.5  # nothing is enabled or started by a reading that is older

    def __init__(
        self,
        link: CanLink,
        drive_node: int,
        read_strip: ReadStrip,
        strip: Pdo | None = None,
        units: DriveUnits = AS_COUNTED,
    ) -> None:
        """``read_strip`` returns the strip's counts and alarms, of a SYNC's values by identifier.
        ``strip``: its PDO on this bus; None: it is queried, with a check for each wait.
        """
        self._link, self._read_strip, self.units = link, read_strip, units
        self._lock = threading.Lock()
        self._stopped = False
        self._target = 0
        self._taken_s = -math.inf
        status = (Object.STATUSWORD, Object.POSITION_ACTUAL)
        motion = (Object.VELOCITY_ACTUAL, Object.MODE_DISPLAY)
        command = (Object.CONTROLWORD, Object.TARGET_POSITION)
        self.status = Pdo(0x1800, 0x180 + drive_node, Transmission.EVERY_SYNC, status, "<Hi")
        self.motion = Pdo(0x1801, 0x280 + drive_node, Transmission.EVERY_SYNC, motion, "<ib")
        self.command = Pdo(0x1400, 0x200 + drive_node, Transmission.ON_EVENT, command, "<Hi")
        self.inbox = Inbox(link, [self.status, self.motion, *([strip] if strip else [])])

    def configure(self, sdo: SdoChannel) -> None:
        """Map the drive's PDOs; it may have none for 6061h."""
        self.status.configure(sdo)
        self.motion = self.motion.configure_most(sdo)
        self.inbox.expect(self.motion)
        self.command.configure(sdo)

    def refresh(self, check: Callable[[], None]) -> Snapshot:
        values, taken_s = self.inbox.refresh(check)
        statusword, position = values[self.status.cob_id]
        velocity, mode, *_ = *values[self.motion.cob_id], NO_MODE
        strip, alarms = self._read_strip(values, check)
        self._taken_s = taken_s
        return Snapshot.of(
            statusword,
            self.units.position(position),
            self.units.velocity(velocity),
            strip=strip,
            alarms=alarms,
            taken_s=taken_s,
            mode=mode,
        )

    @property
    def shows_mode(self) -> bool:
        """Whether the mode is part of it; it is `NO_MODE` where 6061h cannot be mapped."""
        return len(self.motion.objects) > 1

    def control(self, controlword: int, target: int | None = None) -> None:
        """Send a control word, with the target position in counts where it matters. Raises
        `DeviceError` for one that enables the drive by a reading that is too old.
        """
        age_s = self._link.clock.pc_s() - self._taken_s
        if cia.enables(controlword) and not age_s <= self.COMMAND_AGE_S:
            raise RAIL.failed(
                "HC-R39",
                "move",
                f"PC late: the reading to move by is {age_s:.1f} s old",
                expected=f"<= {self.COMMAND_AGE_S:.1f} s",
                age_s=age_s,
                limit_s=self.COMMAND_AGE_S,
            )
        with self._lock:
            if cia.enables(controlword):
                self.check_not_stopped()
            if target is not None:
                self._target = self.units.position(target)
            self._send(controlword)

    def check_not_stopped(self) -> None:
        """Raise `DeviceError` after a quick stop."""
        if self._stopped:
            raise RAIL.failed("HC-R38", "move", "the rail was stopped")

    def quick_stop(self) -> None:
        """Stop on the quick-stop ramp and never enable again; any thread, waits 0.1 s at most."""
        self._stopped = True
        if self._lock.acquire(timeout=0.1):
            try:
                self._send(Control.QUICK_STOP)
            finally:
                self._lock.release()
        else:  # another frame hangs in the gateway; this one is sent all the same
            self._send(Control.QUICK_STOP)

    @property
    def stopped(self) -> bool:
        return self._stopped

    def _send(self, controlword: int) -> None:
        data = struct.pack(self.command.layout, controlword, self._target)
        self._link.send(self.command.cob_id, data)
