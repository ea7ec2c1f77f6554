"""A robot of Mecademic (Meca500) by its text API.

A motion is three commands: speed, joints, checkpoint. That the checkpoint was reached proves
nothing by itself: a motion has ended when the joints stand at the target as well. Each poll of a
motion sets the controller's connection watchdog again, so that a PC that dies, or hangs, stops it.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from drivers.device_errors import ROBOT
from drivers.supervision import (
    Deadline,
    MotionLimits,
    Watchdog,
    check_identity,
    checked_target,
    not_at_target,
    planned_s,
)
from hilcell.cell.file import Joint
from hilcell.ports import Array, Clock, DeviceError, Identity, RobotReading, is_simulated_name
from hilcell_meca500.euler import rotations
from hilcell_meca500.wire import Wire

CHECKPOINTS = 8000  # they are numbered from 1
WATCHDOG_S = 1.5  # longer than `Watchdog` allows, which then reports that the PC was late
POLL_S = 0.05
DWELL_S = 0.05  # between the two looks that tell standstill
STALL_S = 5.0
SETTLE_S = 3.0  # from the checkpoint to standstill
ARRIVED_DEG, STILL_DEG, PROGRESS_DEG = 0.01, 0.001, 0.01
FRAME_MM = 0.001
# Of the controller's status: its place there, its name, the value expected, alarm, next act.
READY = (
    (0, "activated", 1, "HC-B13", "activate the robot in the MecaPortal"),
    (1, "homed", 1, "MX-B01", "home the robot in the MecaPortal"),
    (2, "simulation mode", 0, "MX-B02", "switch the simulation mode off in the MecaPortal"),
    (3, "error", 0, "MX-B03", "read and reset the error in the MecaPortal"),
    (4, "paused", 0, "HC-B21", "resume to reconnect"),
)
PAUSED = 4


class Look(NamedTuple):
    """The robot at one moment: the controller's time, joints (6,), pose (4, 4), arrival here."""

    controller_us: float
    joints_deg: Array
    pose: Array
    taken_s: float


class MecaRobot:
    """Satisfies `hilcell.ports.Robot`."""

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Keys of `[robot.options]`; ``smr_mm`` and ``joint`` are handed over from `[robot]`."""

        host: str
        smr_mm: tuple[float, float, float]
        joint: list[Joint]
        port: Annotated[int, Meta(ge=1, le=65535)] = 10000
        model: str = "Meca500"
        serial: str = ""

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._speed_deg_s = np.array([joint.speed_deg_s for joint in options.joint])
        self._watch = Watchdog(ROBOT, "HC-B27", clock)
        self._wire: Wire | None = None
        self._number = 0  # of the last checkpoint
        self._under_way = self._stopped = False
        self._ended_s: float | None = None

    def connect(self) -> list[Identity]:
        """Open the wire, verify robot and state, set the frames; nothing moves."""
        self._close_wire()
        self._stopped = self._under_way = False
        options = self._options
        self._wire = Wire(options.host, options.port, self._attend)
        try:
            identity = self._identify()
            self._check_state(but=PAUSED)
            self._clear_queue()
            self._set_frames()
        except BaseException:
            self._close_wire()
            raise
        return [identity]

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        """Move all axes in step; return the reading at rest, after the motion."""
        target_deg = np.degrees(checked_target(joints_rad, speed_percent))
        way_deg = target_deg - self._look().joints_deg
        planned = planned_s(way_deg, self._speed_deg_s, speed_percent)
        limits = MotionLimits(planned, STALL_S, PROGRESS_DEG)
        with self._watch.motion():
            self._start(target_deg, speed_percent)
            while self._connected().checkpoint != self._number:
                self._clock.wait(POLL_S)
                self._check_state()
                self._check_progress(limits)
            reading = self._rest(target_deg)
            self._connected().send("ConnectionWatchdog(0)")
        return reading

    def read(self) -> RobotReading:
        """Return a reading asked for after this call began."""
        self._check_state()
        before, after = self._two_looks()
        return self._reading(after, still=not self._under_way and _rest_position(before, after))

    def stop(self) -> None:
        """Brake and forget the queue; any thread; waits for no answer.

        A motion that another thread sends behind it stays in the queue: only `connect` resumes.
        """
        self._stopped = True
        if self._wire is not None:
            self._wire.send("ClearMotion()")

    def close(self) -> None:
        """Brake a motion that is still under way, then close the wire."""
        try:
            if self._under_way and not self._stopped:
                self.stop()
        finally:
            self._close_wire()

    # -- connecting ---------------------------------------------------------------------------

    def _identify(self) -> Identity:
        wire, options = self._connected(), self._options
        model, serial = wire.ask("GetProductType()", 2084), wire.ask("GetRobotSerial()", 2083)
        check_identity(model, options.model, serial, options.serial)
        return Identity(
            ROBOT.name,
            model,
            serial,
            wire.address,
            simulated=is_simulated_name(model),
            kind="robot",
            maker="Mecademic",
            firmware=wire.ask("GetFwVersion()", 2081),
        )

    def _clear_queue(self) -> None:
        """Forget all motions, also those of a dead program, and take a stop back."""
        wire = self._connected()
        wire.send("ConnectionWatchdog(0)")
        wire.ask("ClearMotion()", 2044)
        wire.ask("ResumeMotion()", 2043)
        self._check_state()

    def _set_frames(self) -> None:
        """Set the tool to the reflector and the world to the base; read both back."""
        wire = self._connected()
        tool = np.array([*self._options.smr_mm, 0.0, 0.0, 0.0])
        wire.send(f"SetWrf({_text(np.zeros(6))})", f"SetTrf({_text(tool)})", "SetBlending(0)")
        for command, code, expected in (("GetWrf()", 2013, np.zeros(6)), ("GetTrf()", 2014, tool)):
            deadline, over = Deadline(SETTLE_S), False
            while not bool(np.all(np.abs(wire.numbers(command, code, 6) - expected) <= FRAME_MM)):
                if over:
                    found = f"{command}: {_text(wire.numbers(command, code, 6))}"
                    raise ROBOT.refused("HC-B06", "connect", found, expected=_text(expected))
                over = deadline.expired()

    # -- moving -------------------------------------------------------------------------------

    def _start(self, target_deg: Array, speed_percent: float) -> None:
        if self._stopped:
            raise ROBOT.failed("HC-B21", "move", "the robot was stopped")
        self._number = self._number % CHECKPOINTS + 1
        self._under_way, self._ended_s = True, None
        self._connected().send(
            f"ConnectionWatchdog({WATCHDOG_S})",
            f"SetJointVel({speed_percent:.3f})",
            f"MoveJoints({_text(target_deg)})",
            f"SetCheckpoint({self._number})",
        )

    def _check_state(self, but: int | None = None) -> None:
        """Raise `DeviceError` where the controller's state forbids to go on."""
        wire = self._connected()
        if self._under_way:
            wire.send(f"ConnectionWatchdog({WATCHDOG_S})")
        if (problem := self._problem(but)) is not None:
            # A state is sent before its cause: an answer more brings the message with that.
            raise self._problem(but) or problem

    def _problem(self, but: int | None) -> DeviceError | None:
        status = self._connected().numbers("GetStatusRobot()", 2007, 7)
        moving = self._under_way
        error, operation = (ROBOT.failed, "move") if moving else (ROBOT.refused, "check")
        if self._connected().emergency_stop:
            act = "release the emergency stop, reset it at the power supply"
            return error("HC-B10", operation, "emergency stop", act=act)
        for place, name, expected, code, act in READY:
            if place != but and status[place] != expected:
                found = f"{name} is {status[place]:g}"
                return error(code, operation, found, expected=f"{expected}", act=act)
        return None

    def _check_progress(self, limits: MotionLimits) -> None:
        """Raise `DeviceError` where a motion stands or creeps."""
        now_deg = self._look().joints_deg
        where, expected = f"at {_text(now_deg)} deg", f"checkpoint {self._number}"
        if limits.stalled(now_deg):
            raise limits.stall_error(where, expected, now_deg)
        if limits.overdue(self._clock.now_s(), 100.0):
            raise limits.time_error(where, expected, now_deg)

    def _rest(self, target_deg: Array) -> RobotReading:
        """Return the reading at rest at joints (6,), after the checkpoint."""
        deadline, over = Deadline(SETTLE_S), False
        while True:
            self._check_state()
            before, after = self._two_looks()
            arrived = bool(np.all(np.abs(after.joints_deg - target_deg) <= ARRIVED_DEG))
            if arrived and _rest_position(before, after):
                self._under_way, self._ended_s = False, before.taken_s
                return self._reading(after, still=True)
            if over:
                break
            over = deadline.expired()
        at, expected = _text(after.joints_deg), f"{_text(target_deg)} +-{ARRIVED_DEG}"
        raise not_at_target(at, expected, after.joints_deg, target_deg)

    def _two_looks(self) -> tuple[Look, Look]:
        before = self._look()
        self._clock.wait(DWELL_S)
        after = self._look()
        if not after.controller_us > before.controller_us:
            found = f"the controller's time stands at {after.controller_us:.0f} us"
            raise ROBOT.failed("HC-B26", "read", found, act="restart the robot; resume")
        return before, after

    def _look(self) -> Look:
        wire = self._connected()
        joints = wire.numbers("GetRtJointPos()", 2210, 7)
        taken_s = self._clock.pc_s()
        place = wire.numbers("GetRtCartPos()", 2211, 7)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotations(place[4:]), place[1:4]
        return Look(joints[0], joints[1:], pose, taken_s)

    def _reading(self, look: Look, *, still: bool) -> RobotReading:
        joints_rad = np.radians(look.joints_deg)
        return RobotReading(joints_rad, look.pose, still, look.taken_s, self._ended_s)

    # -- the wire -----------------------------------------------------------------------------

    def _connected(self) -> Wire:
        if self._wire is None:
            raise ROBOT.failed("HC-B21", "use", "not connected")
        return self._wire

    def _attend(self) -> None:
        """Run in every wait on the wire."""
        self._clock.check()
        self._watch.feed()

    def _close_wire(self) -> None:
        wire, self._wire = self._wire, None
        if wire is not None:
            wire.close()


def _rest_position(before: Look, after: Look) -> bool:
    return bool(np.all(np.abs(after.joints_deg - before.joints_deg) <= STILL_DEG))


def _text(numbers: Array) -> str:
    return ",".join(f"{each:.6f}" for each in numbers)
