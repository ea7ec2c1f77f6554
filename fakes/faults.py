"""Faults on demand: each has a name and its own kind of occasion.

A fake asks `Faults.take` at every occasion (a reply, a motion, a measurement); the answer is the
fault's value if it is injected now, else None. ``after`` occasions pass first, then it is injected
``count`` times. Occasions count from when the fault is set, not from power-on. A fault that waits
for a motion is also injected at rest if ``at_rest`` is set.
"""

from __future__ import annotations

import threading
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from hilcell.cell.settings import convert, did_you_mean, read_text, unreadable

Value = bool | int | float | str
UNTIL_CLEARED = 0


class Vanished(Exception):
    """The device is gone: its server closes every socket and stops answering."""


# name: its effect (its value) | its occasion
KNOWN = {
    "rail.vanish": "sockets close, no more answers | a poll of the moving slide",
    "rail.wrong_identity": "1018h names another product (product code) | an identity read",
    "rail.heartbeat_loss": "this node's heartbeats stop (node) | a heartbeat",
    "rail.node_reset": "this node of the drive's bus reboots (node) | a poll of the moving slide",
    "rail.emcy": "EMCY with this code, e.g. 0x7305 (code) | a poll of the moving slide",
    "rail.unplugged": "no frame passes to or from the PC for this (s) | a poll of the moving slide",
    "rail.fault": "the drive goes to FAULT (EMCY code) | a poll of the moving slide",
    "rail.limit_switch": "a limit switch opens (-1 or 1) | a poll of the moving slide",
    "rail.no_acknowledge": "set-point never acknowledged | a new set-point",
    "rail.early_target_reached": "bit 10 is set while moving | a new set-point",
    "rail.sdo_abort": "SDO abort with this code (code) | an SDO request",
    "rail.sdo_timeout": "no SDO reply | an SDO request",
    "rail.late_reply": "SDO reply late by this (s) | an SDO request",
    "rail.late_tpdo": "TPDOs late by this (s) | a SYNC",
    "rail.strip_frozen": "6004h keeps its value | a SYNC",
    "rail.strip_jump": "the strip reads this much more (mm), permanent | a SYNC",
    "rail.missing_magnet": "6503h bit 0 is set | a SYNC",
    "rail.strip_jitter": "the strip reads this much to either side (counts) | a SYNC",
    "rail.strip_silent": "a strip on its own wire does not answer | a command to it",
    "rail.backlash": "the backlash grows by this (mm), permanent | a motion",
    "rail.overspeed": "the drive runs faster than commanded, by this factor | a new set-point",
    "rail.pushed": "the held slide is pushed with its motor (mm), permanent | a poll of it at rest",
    "rail.reference_lost": "the encoder reads this much more (mm), until homed | a poll",
    "rail.slip": "the slide slips by this against the drive (mm), permanent | a motion",
    "rail.wrong_mode": "6061h shows this mode (mode) | a mode read",
    "rail.eof": "the gateway closes the connection | a frame from the client",
    "rail.bus_off": "the gateway is off the bus until it is opened again | a frame from the client",
    "rail.second_node": "another node with this number answers, too (node) | a node's frame",
    "rail.double_frame": "a frame is duplicated | a frame to the client",
    "rail.swapped_frames": "a frame arrives after the next one | a frame to the client",
    "rail.garbage": "a byte >= 0x80 on the line | a frame to the client",
    "rail.nack": "BELL in place of an acknowledge | a frame from the client",
    "rail.stalled": "the gateway accepts frames, sends none | a frame from the client",
    "robot.vanish": "sockets close, no more answers | a poll of the moving robot",
    "robot.wrong_identity": "$TRAFONAME[] is another robot's (name) | an identity read",
    "robot.e_stop": "E-stop: motion stops, $ALARM_STOP FALSE | a poll of the moving robot",
    "robot.stopmess": "$STOPMESS TRUE, motion stops | a poll of the moving robot",
    "robot.mode_t1": "$MODE_OP becomes #T1, motion stops | a request",
    "robot.override_zero": "$OV_PRO becomes 0, motion stops | a poll of the moving robot",
    "robot.deselected": "no program: $PRO_STATE1 #P_FREE | a request",
    "robot.wrong_tool": "$ACT_TOOL is this (number) | a request",
    "robot.wrong_base": "$ACT_BASE is this (number) | a request",
    "robot.softlimit": "HC_ERR 2, no motion | a motion",
    "robot.stops_short": "motion ends this much early, acknowledged (deg) | a motion",
    "robot.wrong_turn": "motion ends with axis 6 a full turn off, acknowledged | a motion",
    "robot.frozen": "motion never progresses | a motion",
    "robot.idle_close": "the server closes the connection | a request",
    "robot.split_reply": "the reply comes in two halves | a request",
    "robot.tag_mismatch": "the reply's tag, or Id, is off by one | a request",
    "robot.xml_bomb": "the answer declares entities (kuka-eki) | a request",
    "robot.no_end": "the answer never ends (kuka-eki) | a request",
    "robot.glued_reply": "the previous answer is repeated before this one (kuka-eki) | a request",
    "robot.no_reply": "the request is not answered | a request",
    "robot.failure_footer": "the reply reports failure (0 C3 Bridge, 1 KUKAVARPROXY) | a request",
    "robot.restarted": "every read and write fails | a request",
    "robot.stale_position": "$POS_ACT and $AXIS_ACT keep their values | a position read",
    "robot.half_open": "the server goes silent but stays connected | a request",
    "robot.late_reply": "the reply is late by this (s) | a request",
    "robot.bad_number": "a position's X or A1 is this text, e.g. NaN | a position read",
    "robot.ack_previous": "HC_ACK keeps the number of the last command | a motion",
    "robot.lost_zero": "axis 1 is off by this (deg), permanent | a motion",
    "robot.lost_zero_2": "axis 2 is off by this (deg), permanent | a motion",
    "robot.lost_zero_3": "axis 3 is off by this (deg), permanent | a motion",
    "robot.lost_zero_4": "axis 4 is off by this (deg), permanent | a motion",
    "robot.lost_zero_5": "axis 5 is off by this (deg), permanent | a motion",
    "robot.lost_zero_6": "axis 6 is off by this (deg), permanent | a motion",
    "robot.lost_motion": "axis 3 loses this much at each reversal (urad), permanent | a motion",
    "robot.mount_slip": "the reflector slips along the flange's x (mm), permanent | a motion",
    "robot.growing": "the arm grows by this in 1000 measurements (um/m), from now on | a motion",
    "robot.brake_slips": "axis 2 misses by this at each stop (deg, 1 sigma), permanent | a motion",
    "robot.mastership_taken": "the pendant takes the mastership (abb-egm) | a request",
    "robot.motors_off": "the motors go off, motion stops (abb-egm) | a poll of the moving robot",
    "robot.speed_ratio": "the speed ratio becomes this, % (abb-egm) | a poll of the moving robot",
    "robot.stream_silent": "no position comes for this, s (abb-egm) | a position sent",
    "robot.stream_time": "the positions' time stands still (abb-egm) | a position sent",
    "robot.second_stream": "another controller sends positions (abb-egm) | a position sent",
    "robot.no_slide": "$EX_AX_NUM is 0 | a read of it",
    "robot.slide_unmastered": "$AXIS_JUS[7] is FALSE | a read of it",
    "robot.slide_fast": "E1 runs faster than commanded, by this factor | a motion of E1",
    "tracker.vanish": "sockets close, no more answers | a measurement",
    "tracker.wrong_identity": "GetSystemStatus reports another processor | an identity read",
    "tracker.beam_break_before": "beam breaks before the acknowledge | a measurement",
    "tracker.beam_break_after": "beam breaks after the acknowledge | a measurement",
    "tracker.no_reflector": "nothing found where it points | a search",
    "tracker.no_result": "acknowledged, but no result | a measurement",
    "tracker.late_result": "the result arrives with that of the next measurement | a measurement",
    "tracker.wrong_reflector": "status 23 in place of the acknowledge | a measurement",
    "tracker.not_warmed_up": "status 10012 in place of the acknowledge | a measurement",
    "tracker.no_distance": "status 37 in place of the acknowledge | a measurement",
    "tracker.nest_lifted": "the reflector sits this far off (mm), permanent | a measurement",
    "tracker.init_lost": "status 39 until initialised again | a measurement",
    "tracker.drift_step": "the tracker shifts by this along x (mm), permanent | a measurement",
    "tracker.scale_ppm": "all measurements are larger by this (ppm), permanent | a measurement",
    "tracker.collimation": "its line of sight is off by this (urad), permanent | a measurement",
    "tracker.transit": "its transit axis tilts by this (urad), permanent | a measurement",
    "tracker.index": "its vertical circle is off by this (urad), permanent | a measurement",
    "tracker.unadjusted": "all three are off by this (urad), until cleared | a measurement",
    "tracker.warming": "it turns by this in all as it warms up (urad), from now on | a measurement",
    "tracker.turning": "it turns by this in 1000 measurements (urad), from now on | a measurement",
    "tracker.wrong_offset": "the reflector has another offset (mm), permanent | a measurement",
    "tracker.warmer": "the room is warmer by this (K), permanent | a measurement",
    "tracker.noisy": "stdTotal and noise of the reading are this (mm) | a measurement",
    "tracker.metres": "values are in m, SetUnits is ignored | a measurement",
    "tracker.left_handed": "y has the wrong sign | a measurement",
    "tracker.spike": "the reading is off by this (mm) | a measurement",
    "tracker.no_weather": "T, P and H are 0, status 94 | a measurement",
    "tracker.bad_number": "x is this text as a double, e.g. nan | a measurement",
    "tracker.busy": "status 1 in place of the acknowledge | a measurement",
    "tracker.status_storm": "this many status changes precede the result (number) | a measurement",
    "tracker.split_packet": "the result is cut after byte 5 | a measurement",
    "tracker.glued_packets": "result and a status change share one segment | a measurement",
    "tracker.length_zero": "a packet of length 0 arrives | a measurement",
    "tracker.length_huge": "a packet of length 2^31 arrives | a measurement",
    "tracker.stream_break": "the beam breaks within a stream | a sample of a stream",
    "tracker.eof": "the server closes the connection | a measurement",
    "tracker.geocom_code": "GeoCOM: this return code, e.g. 1284 (code) | a measurement",
    "tracker.geocom_number": "GeoCOM: another transaction's number | a measurement",
    "tracker.geocom_noise": "GeoCOM: bytes that are not text precede the answer | a measurement",
    "tracker.t2sa_code": "T2SA: this error, e.g. 338 (code) | a measurement",
    "tracker.t2sa_inches": "T2SA: values are in inches | an answer with a position",
    "tracker.t2sa_nominal": "T2SA: the result is the nominal point itself | a measurement",
    "tracker.t2sa_old_result": "T2SA: the previous result is repeated | a measurement",
    "tracker.t2sa_renamed": "T2SA: the group has another name | a query for a point",
    "tracker.t2sa_simulation": "T2SA: simulation is not switched off | a connect",
    "tracker.wrong_target": "it finds another SMR, this far off (mm) | a search",
}
LASTING = frozenset({"tracker.unadjusted"})  # until they are cleared, whatever their count
TEXTS = frozenset({"robot.bad_number", "robot.wrong_identity", "tracker.bad_number"})


class Fault(Struct, kw_only=True):
    """One fault: a ``[[fault]]`` of a faults file, or an order of the control channel."""

    name: str
    value: Value = True  # the default of every fault
    after: Annotated[int, Meta(ge=0)] = 0  # occasions that pass first
    count: Annotated[int, Meta(ge=0)] = 1  # injections left; `UNTIL_CLEARED`: no limit
    at_rest: bool = False  # polls at rest are occasions, too, like those of a motion

    def __post_init__(self) -> None:
        self.count = UNTIL_CLEARED if self.name in LASTING else self.count
        if self.name not in KNOWN:
            hint = did_you_mean(self.name, KNOWN) or f"; known: {', '.join(KNOWN)}"
            raise ValueError(f"name: unknown fault {self.name!r}{hint}")
        if self.value is not True and isinstance(self.value, str) != (self.name in TEXTS):
            wanted = "text" if self.name in TEXTS else "a number"
            raise ValueError(f"value: expected {wanted} for {self.name}, got {self.value!r:.80}")


class FaultFile(Struct, frozen=True, kw_only=True):
    """A faults file."""

    fault: list[Fault] = []


class Faults:
    """The armed faults of one simulated cell; safe to use from several threads."""

    def __init__(self, armed: Iterable[Fault] = ()) -> None:
        self._lock = threading.Lock()
        self._armed = {fault.name: fault for fault in armed}

    def set(self, name: str, value: Value = True, **occasions: int) -> None:
        """Arm a `Fault`; raises `SettingsError` for an unknown one."""
        fault = convert({"name": name, "value": value, **occasions}, Fault, "fault")
        with self._lock:
            self._armed[name] = fault

    def clear(self, name: str = "") -> None:
        with self._lock:
            for each in [name] if name else [*self._armed]:
                self._armed.pop(each, None)

    @property
    def any_armed(self) -> bool:
        """Whether a fault is armed; read without the lock: the common case must be cheap."""
        return bool(self._armed)

    def take(self, name: str, *, moving: bool = True) -> Value | None:
        """Return the fault's value if it is injected on this occasion, ``moving`` or at rest."""
        if not self.any_armed:
            return None
        with self._lock:
            armed = self._armed.get(name)
            if armed is None or not (moving or armed.at_rest):
                return None
            if armed.after > 0:
                armed.after -= 1
                return None
            armed.count -= 1
            if armed.count == 0:
                del self._armed[name]
            return armed.value

    def strikes(self, name: str, *, moving: bool = True) -> bool:
        """Whether the fault is injected on this occasion."""
        return self.take(name, moving=moving) is not None

    def instead(self, name: str, usual: int) -> int:
        """Return the whole number of a fault that strikes, else the ``usual`` one."""
        value = self.take(name)
        return usual if value is None else int(value)

    def number(self, name: str) -> float | None:
        """Return as `take`, as a number."""
        value = self.take(name)
        return None if value is None else float(value)

    def amount(self, name: str) -> float:
        """Return as `number`; 0 if it is not injected now."""
        return self.number(name) or 0.0


def load_faults(path: str) -> Faults:
    """Read a faults file; raises `SettingsError` naming all problems. An empty path is none."""
    if not path:
        return Faults()
    try:
        values = tomllib.loads(read_text(Path(path)))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise unreadable(path, error) from error
    return Faults(convert(values, FaultFile, path).fault)
