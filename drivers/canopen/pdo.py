"""PDO mappings written by SDO, read back, and the process image that they fill (CiA 301, 7.5.2).

A received PDO does not say when it was sampled. All PDOs are synchronous, and a reading counts only
when every one of them came after the SYNC that asked for it. On a slow gateway the answer to an
earlier SYNC may still be under way: it is waited for, and does not count.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

from drivers.canopen.can_link import CanLink
from drivers.canopen.sdo import Aborted, SdoChannel, Unsupported
from hilcell.ports import DeviceError

SYNC = 0x080
REPLY_S = 0.2  # of link time
STALE_S = 0.3
SYNCS = 3
POLL_S = 0.02
DISABLED, NO_RTR = 1 << 31, 1 << 30


class Transmission(IntEnum):
    """Types of transmission; a PDO that is received counts at once by either kind of event."""

    EVERY_SYNC = 1
    OWN_EVENT = 254  # of the maker
    ON_EVENT = 255


@dataclass(frozen=True, slots=True)
class Mapping:
    """One PDO: its parameter objects, identifier, transmission type and mapped objects."""

    communication: int  # 14xxh or 18xxh
    mapping: int  # 16xxh or 1Axxh
    cob_id: int
    transmission: int
    entries: tuple[tuple[int, int], ...]  # object, bits
    layout: struct.Struct

    def shorter(self) -> Mapping:
        """Return the same PDO without its last object."""
        layout = struct.Struct(self.layout.format[:-1])
        return replace(self, entries=self.entries[:-1], layout=layout)

    def configure(self, sdo: SdoChannel) -> None:
        """Write it in the order that the standard wants (7.5.2.36): off, emptied, filled, on.

        A part that the device refuses to change is right where it reads so already. Bit 30 (no
        remote frames) stays as found: devices that know none refuse to have it cleared. Raises
        `Unsupported`.
        """
        what = f"PDO of {self._objects} with identifier {self.cob_id:03X}h"
        parameters = self.communication
        try:
            held = sdo.read(parameters, 1)
        except Aborted as refusal:
            raise Unsupported(refusal, f"{parameters:04X}h ({what})") from refusal
        cob_id = held & NO_RTR | self.cob_id
        fixed = sdo.offer(parameters, 1, DISABLED | cob_id)
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

    def configure_most(self, sdo: SdoChannel) -> Mapping:
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
        coded = [index << 16 | bits for index, bits in self.entries]
        try:
            sdo.write(self.mapping, 0, 0)
            for sub, value in enumerate(coded, start=1):
                sdo.write(self.mapping, sub, value)
            sdo.write(self.mapping, 0, len(coded))
        except Aborted as refusal:
            same = sdo.read(self.mapping, 0) == len(coded) and all(
                sdo.read(self.mapping, sub) == value for sub, value in enumerate(coded, start=1)
            )
            if not same:
                what = f"{self.mapping:04X}h (PDO of {self._objects})"
                raise Unsupported(refusal, what) from refusal

    @property
    def _objects(self) -> str:
        return " and ".join(f"{index:04X}h" for index, _ in self.entries)


class Inbox:
    """The last values of some TPDOs, and how often and when each came."""

    def __init__(
        self, device: str, link: CanLink, pdos: tuple[Mapping, ...], syncs: int = SYNCS
    ) -> None:
        self._device, self._link, self._syncs = device, link, syncs
        self._changed = threading.Condition()
        self._layouts = {pdo.cob_id: pdo.layout for pdo in pdos}
        self._values: dict[int, tuple[int, ...]] = {}
        self._count = dict.fromkeys(self._layouts, 0)
        self._owed = dict.fromkeys(self._layouts, 0)  # SYNCs without an answer so far
        self._arrived_s = dict.fromkeys(self._layouts, 0.0)
        self._heard_s = 0.0  # of link time
        for cob_id in self._layouts:
            link.subscribe(cob_id, self._on_pdo)

    def expect(self, pdo: Mapping) -> None:
        """Take a PDO of this inbox as it is mapped in this device."""
        self._layouts[pdo.cob_id] = pdo.layout

    def refresh(self, check: Callable[[], None]) -> tuple[dict[int, tuple[int, ...]], float]:
        """Send SYNC; return all values by identifier and since when the oldest may be true.

        A lost frame costs one more SYNC; raises `DeviceError` when so many of them bring nothing.
        Values that have waited in this PC for `STALE_S` are asked for again.
        """
        before, owed, sent_s = *self._counted(), self._link.clock.pc_s()
        for _ in range(self._syncs):
            earlier_s, sent_s = sent_s, self._link.clock.pc_s()
            with self._changed:
                self._owed = {cob_id: count + 1 for cob_id, count in self._owed.items()}
            self._link.send(SYNC, b"")
            if self._await(before, owed, check):
                with self._changed:
                    arrived_s = max(sent_s, min(self._arrived_s.values()))
                    values = dict(self._values)
                if self._link.clock.pc_s() - arrived_s <= STALE_S:
                    return values, earlier_s  # the SYNC before may have been answered
                before, owed, sent_s = *self._counted(), self._link.clock.pc_s()
        missing = [f"0x{cob_id:03X}" for cob_id in before if self._count[cob_id] == before[cob_id]]
        if not missing:
            raise DeviceError(
                "HC-R39",
                self._device,
                "read",
                f"PC late: {self._syncs} readings in a row waited here for over {STALE_S:.1f} s",
                act="give the engine a PC of its own, or end other programs on it; then resume",
                fields={"limit_s": STALE_S},
            )
        raise DeviceError(
            "HC-R07",
            self._device,
            "read",
            f"no fresh TPDO {', '.join(missing)} within {self._syncs} SYNCs",
            act="check the nodes' power and the bus load, then resume",
            fields={"cob_ids": missing, "syncs": self._syncs},
        )

    def _counted(self) -> tuple[dict[int, int], dict[int, int]]:
        with self._changed:
            return dict(self._count), dict(self._owed)

    def _await(
        self, before: dict[int, int], owed: dict[int, int], check: Callable[[], None]
    ) -> bool:
        """Return whether a SYNC of this refresh was answered.

        Answers that were owed ``before`` have come by `REPLY_S` after the last frame, or are lost.
        """
        began_s = self._link.time.listened_s
        while True:
            check()
            self._link.check()
            now_s = self._link.time.listened_s
            with self._changed:
                new = {cob_id: self._count[cob_id] - count for cob_id, count in before.items()}
                if all(new[cob_id] > owed[cob_id] for cob_id in new):
                    return True
                if now_s > max(began_s, self._heard_s) + REPLY_S:  # frames until then count
                    answered = all(new.values())
                    if answered:
                        self._owed = dict.fromkeys(self._owed, 0)
                    return answered
                self._changed.wait(POLL_S)

    def _on_pdo(self, cob_id: int, data: bytearray, _at_s: float) -> None:
        values = self._layouts[cob_id].unpack(data)  # a truncated frame is no reading
        with self._changed:
            self._values[cob_id] = values
            self._count[cob_id] += 1
            self._owed[cob_id] = max(0, self._owed[cob_id] - 1)
            self._heard_s = self._link.time.listened_s
            self._arrived_s[cob_id] = self._link.time.emptied_s
            self._changed.notify_all()
