"""Frames that a CANopen node sends unasked: heartbeat, boot-up, EMCY (CiA 301, 7.2.8 and 7.2.7).

A node that was reset is back within a second with its settings lost. Only its boot-up frame shows
it, so one that comes once the node is being set up is a failure.
"""

from __future__ import annotations

import struct

from drivers.canopen import cia
from drivers.canopen.can_link import CanLink
from drivers.canopen.cia import NodeState, state_text
from drivers.device_errors import RAIL

PC_HEARTBEAT_LIMIT_MS = 1000
GENERIC, COMMUNICATION = 1 << 0, 1 << 4  # of the error register, 1001h


def doubts_sensor(register: int) -> bool:
    """Whether an error register leaves a sensor in doubt: by anything but its communication.

    The generic bit comes with each error; which of the others does is the maker's choice.
    """
    return register not in (0, COMMUNICATION, GENERIC | COMMUNICATION)


class NodeWatch:
    """Listens to one node; ``check`` raises the first thing that went wrong.

    Emergencies of the family ``in_pdo`` repeat what a PDO says with each of its values, or what
    `sensor_fails` says where no PDO has it: neither is a failure here.
    """

    HEARTBEAT_AGE_S = 1.0  # of link time

    def __init__(self, link: CanLink, node: int, in_pdo: int | None = None) -> None:
        self.state: int | None = None
        self.sensor_fails = False  # from an emergency of that family on, until it is gone
        self.speaks_for_sensor = False  # which has no alarms of its own
        self.node, self._in_pdo = node, in_pdo
        self._link = link
        self._heard_s = 0.0
        self._set_up = self._armed = False
        self._code = self._failure = self._act = ""
        link.subscribe(0x700 + node, self._on_heartbeat)
        link.subscribe(0x080 + node, self._on_emergency)

    def begin_set_up(self) -> None:
        """Take a boot-up from now on as a failure: the settings would be lost."""
        self._set_up = True

    def forget_state(self) -> None:
        """Wait for the next heartbeat to say the NMT state."""
        self.state = None

    def arm(self) -> None:
        """Take emergencies and silence from now on as failures, too."""
        self._armed = True

    def check(self, operation: str) -> None:
        """Raise `DeviceError` for an emergency, a boot-up, or a heartbeat that is too old."""
        if self._armed and not self._failure:
            self._look()
        if self._failure:
            raise RAIL.failed(self._code, operation, self._failure, act=self._act, node=self.node)

    def _look(self) -> None:
        age_s = self._link.time.listened_s - self._heard_s
        if not age_s <= self.HEARTBEAT_AGE_S:
            self._fail("HC-R02", f"node {self.node}: no heartbeat for {age_s:.1f} s")
        elif self.state != NodeState.OPERATIONAL:
            state = state_text(self.state)
            self._fail("HC-R03", f"node {self.node}: NMT state {state}, not operational")

    def _on_heartbeat(self, _cob_id: int, data: bytearray, _at_s: float) -> None:
        self.state = data[0] & 0x7F
        self._heard_s = self._link.time.listened_s
        if self._set_up and self.state == NodeState.BOOT_UP:
            self._fail("HC-R03", f"node {self.node}: unexpected boot-up: the node was reset")

    def _on_emergency(self, _cob_id: int, data: bytearray, _at_s: float) -> None:
        code, register, _vendor = struct.unpack("<HB5s", data)
        if code >> 8 == self._in_pdo:
            self.sensor_fails = True
        elif not cia.is_error(code):  # one is gone; the register has those that are left
            self.sensor_fails = doubts_sensor(register)
        if self._armed and cia.is_error(code) and code >> 8 != self._in_pdo:
            found = f"EMCY {cia.error_text(code)}, error register 0x{register:02X}"
            pause_s = self._link.pause_s
            if code != cia.HEARTBEAT_LOST:
                self._fail(cia.error_alarm(code), f"node {self.node}: {found}")
            elif pause_s * 1000 < PC_HEARTBEAT_LIMIT_MS:
                found += f"; the PC's heartbeat has paused for {pause_s:.1f} s"
                self._fail(cia.error_alarm(code), f"node {self.node}: {found}")
            else:
                late = f"PC late: its heartbeat paused for {pause_s:.1f} s"
                reports = f"so node {self.node} reports {cia.error_text(code)}"
                act = (
                    "give the engine a PC of its own, or end what keeps this one busy; resume; "
                    "home the rail after a reset of its drive"
                )
                self._fail("HC-R44", f"{late}, {reports}", act)

    def _fail(self, code: str, found: str, act: str = "put the cause right, then resume") -> None:
        if not self._failure:
            self._code, self._failure, self._act = code, found, act
