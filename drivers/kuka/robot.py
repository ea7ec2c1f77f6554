"""A KUKA robot and its resident program ``krl/hilcell.src``, over any wire that reaches both.

The PC sends a target and a number; the program moves and acknowledges with that number. Motion has
ended only when the number is this command's, the axes are at the target and two polls, more than a
cycle of the controller apart, read the same: within one cycle a robot at full speed reads the same
twice, and one at rest flickers in the last digit. Joints are the measured ones where the controller
has them: the ordered ones stay while a brake slips.

As external axis E1 the slide moves alone (HC_CMD 2), and only while HC_HELD is FALSE; motions of
the arm carry the held position of E1. So one sequence of commands, one heartbeat and one stop serve
both, and the program's timer brakes both when the PC dies.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from itertools import cycle
from typing import Annotated, Self

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import fields, replace

from drivers.device_errors import RAIL, ROBOT
from drivers.kuka.controller import (
    HEALTH,
    LOST,
    PROGRAM_VERSION,
    PROGRESS,
    STOPPED,
    Controller,
    Need,
    frame_text,
    refused_motion,
)
from drivers.kuka.krl import JOINTS, POSE, SLIDE
from drivers.supervision import (
    MotionLimits,
    Watchdog,
    check_identity,
    checked_target,
    joints_text,
    not_at_target,
    on_failure,
    planned_s,
    polls,
    state_error,
)
from hilcell.cell.file import Joint
from hilcell.decoding import typed
from hilcell.geometry.frames import from_zyx, matrix
from hilcell.ports import (
    Ability,
    Array,
    AxisReading,
    Candidate,
    Clock,
    DeviceError,
    HilcellError,
    Identity,
    JointSample,
    RobotReading,
    RobotSettings,
    Stopped,
    is_simulated_name,
)
from hilcell.sanitize import clean
from hilcell.wire.channel import Host

POLL_S = 0.03
STALL_S = 5.0  # wire deadline: no axis moved and no acknowledgement came
REST_S = 3.0  # wire deadline: from the acknowledgement to standstill
STILL_DEG, STILL_MM = 0.0005, 0.01
BRAKED_S = 3.0  # wire deadline: from a brake to standstill
BRAKED_DWELL_S = 0.05  # between two reads that show standstill


class KukaOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The expected identity of the controller, whichever wire leads to it."""

    host: Host
    smr_mm: tuple[float, float, float]
    joint: list[Joint]
    model: str = "KR210"
    serial: int = 0
    tool: Annotated[int, Meta(ge=1, le=16)] = 1
    base: Annotated[int, Meta(ge=0, le=32)] = 0


def frame_matrix(values: Sequence[float]) -> Array:
    """Return the matrix (4, 4), mm, of X, Y, Z and KUKA's Z-Y-X angles A, B, C in deg (6,)."""
    return matrix(from_zyx(values[3:]), np.array(values[:3]))


def candidates(
    known: Mapping[str, object],
    interface: str,
    options: type[KukaOptions],
    ask: Callable[[str, int], tuple[str, str]],
) -> list[Candidate]:
    """Return the controller at ``known["host"]``; ``ask`` reads its model and serial number."""
    host = known.get("host")
    if not isinstance(host, str):
        return []
    (usual,) = (each.default for each in fields(options) if each.name == "port")
    port = typed(known.get("port", usual), int)
    address = f"{host}:{port}"
    found: dict[str, object] = {"host": host, "port": port}
    try:
        model, serial = ask(host, port)
    except DeviceError as error:
        if error.code == ROBOT.unreachable:
            return []
        return [Candidate(f"{interface} at {address} does not answer: {error.found}", found, [])]
    identity = Identity(
        ROBOT.name, model, serial, address, is_simulated_name(model), "robot", "KUKA"
    )
    number = {"serial": int(serial)} if serial.isdecimal() else {}
    title = f"KUKA {model}, serial number {serial}, by {interface} at {address}"
    return [Candidate(title, {**found, "model": model, **number}, [identity])]


class KukaRobot:
    """Satisfies `hilcell.ports.Robot`, `hilcell.ports.Sweeps` and `hilcell.ports.ExternalAxis`.

    For commissioning also `hilcell.ports.Inspects`, `hilcell.ports.Discovers` and
    `hilcell.ports.StatesSettings`.
    """

    DRIVER = ""  # name of the entry point
    AXIS_TOLERANCE_DEG = 0.005
    STILL = np.array([STILL_DEG] * 6 + [STILL_MM])  # with a slide
    ARRIVED = np.array([AXIS_TOLERANCE_DEG] * 6 + [0.02])
    MAX_SEQUENCE = 1_000_000_000
    STEP_S = 0.5  # one poll counts for this long, at most
    CATCH_UP_S = 30.0  # wire deadline: a command of an earlier session ends
    DWELL_S = 0.05  # between two polls that show standstill; $AXIS_ACT changes once in 4 to 12 ms
    PROGRESS_DEG = 0.01
    FRAME_TOLERANCE = 0.001  # mm and deg
    PROGRESS_MM = 0.01
    OVERSPEED = 1.2
    SPEED_OVER_S = 0.3  # many cycles of the controller

    def __init__(
        self, options: KukaOptions, clock: Clock, wires: Callable[[KukaRobot], Controller]
    ) -> None:
        """``wires`` opens the wires to the controller."""
        self._options, self._clock, self._wires = options, clock, wires
        self._controller: Controller | None = None
        self._watch = Watchdog(ROBOT, "HC-B27", clock)
        self._speed_deg_s = np.array([joint.speed_deg_s for joint in options.joint])
        self._override = 100
        # The valid values of a variable, and the alarm of any other.
        self._good: dict[str, tuple[Sequence[str | bool | int], str]] = {
            **HEALTH,
            "$OV_PRO": (range(1, 101), "HC-B16"),
            "$ACT_TOOL": ((options.tool,), "HC-B07"),
            "$ACT_BASE": ((options.base,), "HC-B07"),
        }
        self._rest_deg = np.zeros(6)
        self._identity = Identity(ROBOT.name, "", "", "")
        self.slide_mm: float | None = None  # where a slide is held that is an axis of this robot
        self._slide_free = False  # E1 may move
        self._slide_seen: tuple[float, float] | None = None  # where E1 was, and when
        self._sequence = 0
        self._moving = False
        self._ended_s: float | None = None  # when the end of the last motion was detected
        self._stopped = False

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        """Open the wires, verify everything, then reset an earlier stop; E1 is held."""
        self._close_wires()
        self.slide_mm = None
        with on_failure(self._close_wires):
            controller = self._controller = self._wires(self)
            self._round = cycle(controller.poll_groups)
            controller.refresh()
            identity = self._identify()
            for name, version in controller.versions.items():
                self._check_version(name, version)
            self.check(*HEALTH, "$OV_PRO", "$ACT_TOOL", "$ACT_BASE")
            self._check_frame("$TOOL", (*self._options.smr_mm, 0.0, 0.0, 0.0))
            self._check_frame("$BASE", (0.0,) * 6)
            self._reset_stop()
            self._identity = msgspec.structs.replace(
                identity, firmware=f"hilcell.src {PROGRAM_VERSION}"
            )
            if controller.has_slide():
                self.hold_axis()
                (self.slide_mm,) = controller.numbers(PROGRESS, (SLIDE,))
        return [self._identity]

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        target_deg = np.degrees(checked_target(joints_rad, speed_percent))
        self.wire().check()
        planned = planned_s(target_deg - self._rest_deg, self._speed_deg_s, round(speed_percent))
        try:
            number = self.command(target_deg, round(speed_percent))
            limits = MotionLimits(planned, STALL_S, self.PROGRESS_DEG)
            while self.poll_motion(number, limits, self._round):
                self._clock.wait(POLL_S)
            return self.rest(target_deg)
        finally:
            self._watch.stop()

    def read(self) -> RobotReading:
        """A reading requested after this call began. Its time is that of the request: no part of
        the answer is older.
        """
        self.wire().check()
        taken_s = self._clock.pc_s()
        self.wire().refresh()
        before = self._axes()
        self._clock.wait(self.DWELL_S)
        self.wire().refresh()
        pose = self._pose()
        moved = np.abs(self._axes() - before)
        still = not self._moving and bool(np.all(moved <= self.STILL[: len(moved)]))
        return RobotReading(np.radians(before[:6]), pose, still, taken_s, self._ended_s)

    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> KukaSweep:
        """Return a motion of one axis (0 to 5) alone, at the next speed below ``speed_rad_s``."""
        self.wire().check()
        end_deg, speed_deg_s = float(np.degrees(end_rad)), float(np.degrees(speed_rad_s))
        return KukaSweep(self, self._clock, axis, end_deg, speed_deg_s, self._speed_deg_s)

    def stop(self) -> None:
        self._stopped = True
        if (controller := self._controller) is not None:  # another thread may be closing
            controller.stop()

    def close(self) -> None:
        """Brake a motion in progress, confirm all axes at rest, hold E1, and close the wires.

        Raises `DeviceError` where rest is not confirmed.
        """
        try:
            if self._moving and self._controller is not None:
                with suppress(DeviceError):  # rest is confirmed below
                    self.stop()
                with self._controller.ignoring_stop() as access:
                    await_rest(
                        access, self._controller.joints_variable, self._names(), closing=True
                    )
            elif self._slide_free and not self._stopped and not self._moving:
                self.hold_axis()
        finally:
            self._close_wires()

    # -- commissioning ------------------------------------------------------------------------

    def inspect(self) -> list[Ability]:
        with closing(self._wires(self)) as controller:
            return [self._ability(controller, need) for need in controller.needs]

    @staticmethod
    def _ability(controller: Controller, need: Need) -> Ability:
        found, name = controller.found(need.variable), need.variable
        if found is None:
            return Ability(ROBOT.name, name, "has not", need.needed, need.otherwise)
        expected = str(controller.versions.get(name, found))
        if found != expected:
            note = f"version {found}, expected {expected}; see `hilcell files`"
            return Ability(ROBOT.name, name, "has not", need.needed, note)
        return Ability(ROBOT.name, name, "has", need.needed, found)

    def settings(self) -> RobotSettings:
        if self._controller is not None:
            return self._settings(self._controller)
        with closing(self._wires(self)) as controller:
            return self._settings(controller)

    def _settings(self, controller: Controller) -> RobotSettings:
        controller.refresh()
        model, serial = controller.text("$TRAFONAME[]"), controller.integer("$KR_SERIALNO")
        tool = controller.tool(self._options.tool)
        names = (*JOINTS, SLIDE) if controller.has_slide() else JOINTS
        limits = controller.limits(names)
        return RobotSettings(
            model,
            str(serial),
            None if limits is None else np.radians(limits[:6]),
            None if tool is None else frame_matrix(tool),
            None if limits is None or len(limits) == len(JOINTS) else limits[6],
        )

    # -- external axis E1 ---------------------------------------------------------------------

    def verify_axis(self) -> Identity:
        if self.slide_mm is None:
            found = "the controller has no external axis: $EX_AX_NUM is 0"
            raise RAIL.refused("HC-R50", "connect", found, expected="one")
        if not self._slide_wire().is_mastered():
            raise RAIL.refused("HC-R51", "connect", "$AXIS_JUS[7] is FALSE", expected="TRUE")
        of = self._identity
        return replace(of, device=RAIL.name, model=f"E1 of {of.model}", kind="drive")

    def read_axis(self) -> AxisReading:
        """Return a reading; its time is that of the question."""
        taken_s = self._clock.pc_s()
        self.wire().check()
        self.wire().refresh()
        return AxisReading(*self._slide_wire().slide(), taken_s)

    def move_axis(
        self,
        position_mm: float,
        speed_mm_s: float,
        full_mm_s: float,
        attend: Callable[[float], object],
    ) -> None:
        controller = self._slide_wire()
        percent = max(1, min(100, int(100.0 * speed_mm_s / full_mm_s)))
        controller.check()
        way_mm = abs(position_mm - self.read_axis().position_mm)
        limits = MotionLimits(100.0 * way_mm / (percent * full_mm_s), STALL_S, self.PROGRESS_MM)
        self._slide_free, self._slide_seen = True, None
        try:
            controller.hold_slide(held=False)
            number = self.begin(lambda n: controller.start_slide(n, position_mm, percent))
            self.slide_mm = position_mm
            while self.poll_motion(number, limits, self._round):
                attend(self._judged_speed(self.OVERSPEED * speed_mm_s))
                self._clock.wait(POLL_S)
            self.rest(self.commanded_deg())
        finally:
            self.end_motion()

    def hold_axis(self) -> None:
        self._slide_wire().hold_slide(held=True)
        self._slide_free = False

    def brake_axis(self, attend: Callable[[float], object]) -> None:
        controller, before_mm = self._slide_wire(), np.inf
        controller.brake()
        for last in polls(BRAKED_S, self.STEP_S):
            self._clock.wait(POLL_S)
            controller.refresh()
            place_mm, _ = controller.slide()
            attend(place_mm)
            stands = abs(place_mm - before_mm) <= STILL_MM
            if stands and controller.integer("HC_ERR") in (STOPPED, LOST):
                break
            if last:
                found = f"E1 at {place_mm:.2f} mm is not at rest {BRAKED_S:g} s after the brake"
                raise RAIL.failed("HC-B41", "brake", found, position_mm=place_mm)
            before_mm = place_mm
        self.resume()
        self.hold_axis()
        self.slide_mm, _ = controller.slide()

    def _judged_speed(self, allowed_mm_s: float) -> float:
        """Position of the slide; judge the least speed that two polls of its motion allow for. From
        before the earlier request to after the later answer, so a late answer is no speed.
        """
        before_s, (place_mm, _) = self._clock.now_s(), self._slide_wire().slide()
        seen, after_s = self._slide_seen, self._clock.now_s()
        if seen is not None and after_s - seen[1] < self.SPEED_OVER_S:
            return place_mm
        self._slide_seen = (place_mm, before_s)
        if seen is None:
            return place_mm
        speed_mm_s = abs(place_mm - seen[0]) / (after_s - seen[1])
        if not speed_mm_s <= allowed_mm_s:
            raise RAIL.failed(
                "HC-R33",
                "move",
                f"speed {speed_mm_s:.1f} mm/s, allowed {allowed_mm_s:.1f} mm/s",
                act="compare rail.options.full_mm_s with the speed of E1, then resume",
                speed_mm_s=speed_mm_s,
                position_mm=place_mm,
            )
        return place_mm

    def _slide_wire(self) -> Controller:
        return RAIL.connected(self._controller)

    # -- connecting ---------------------------------------------------------------------------

    def _identify(self) -> Identity:
        model, serial = self.wire().text("$TRAFONAME[]"), self.wire().integer("$KR_SERIALNO")
        expected = self._options
        check_identity(model, expected.model, str(serial), str(expected.serial or ""))
        simulated = is_simulated_name(model)
        return Identity(
            ROBOT.name, model, str(serial), self.wire().address, simulated, "robot", "KUKA"
        )

    def _check_version(self, name: str, expected: int) -> None:
        found, driver = self.wire().integer(name), self.DRIVER
        if found != expected:
            raise ROBOT.refused(
                "HC-B17",
                "connect",
                f"the controller has version {found} ({name})",
                expected=f"version {expected}",
                act=f"`hilcell files {driver} -o FOLDER` writes it: copy it and start it again",
                found_version=found,
                wanted_version=expected,
            )

    def check(self, *names: str) -> None:
        """Refuse to work with a wrong state; report the first cause, not its consequence."""
        for name in names:
            if problem := self._problem(name):
                raise next(filter(None, map(self._problem, HEALTH)), problem)

    def _problem(self, name: str) -> DeviceError | None:
        """Read one variable of the controller's state; return its error, if any."""
        good, code = self._good[name]
        found = self.wire().value(name) if name in HEALTH else self.wire().integer(name)
        if name == "$OV_PRO":
            self._override = int(found)
        if any(found == value and type(found) is type(value) for value in good):
            return None
        text = str(found).upper() if isinstance(found, bool) else clean(str(found))
        expected = " or ".join(str(value).upper() for value in good)
        if isinstance(good, range):
            expected = f"{good[0]} to {good[-1]}"
        return state_error(code, name, text, expected, moving=self._moving)

    def _check_frame(self, name: str, expected: tuple[float, ...]) -> None:
        found = self.wire().numbers(name, POSE)
        if not all(
            abs(f - w) <= self.FRAME_TOLERANCE for f, w in zip(found, expected, strict=True)
        ):
            tool = name == "$TOOL"
            own = f"tool {self._options.tool}" if tool else f"base {self._options.base}"
            source = "robot.smr_mm of the cell file, " if tool else ""
            raise ROBOT.refused(
                "HC-B06",
                "connect",
                f"the controller's {own} ({name}) is {frame_text(found)}",
                expected=f"{source}{frame_text(expected)}",
                variable=name,
                found_frame=found,
                wanted_frame=expected,
            )

    def _reset_stop(self) -> None:
        """The reset edge: only a new connection resets a stop, and nothing moves by it."""
        controller = self.wire()
        controller.refresh()
        if controller.has_lowered_override():  # by a dead engine, whose sweep is braked first
            if self.wire().integer("HC_SEQ") != self.wire().integer("HC_ACK"):
                controller.brake()
                await_rest(controller)
            controller.restore_override()
        controller.release()
        self._sequence = controller.integer("HC_SEQ")
        for last in polls(self.CATCH_UP_S, self.STEP_S):
            if (acknowledged := controller.integer("HC_ACK")) == self._sequence:
                break
            if last:
                raise ROBOT.refused(
                    "HC-B25",
                    "connect",
                    f"HC_ACK {acknowledged}",
                    expected=f"HC_SEQ {self._sequence}",
                    acknowledged=acknowledged,
                    sequence=self._sequence,
                )
            self._clock.wait(POLL_S)
            controller.refresh()
            controller.release()  # a motion that a dead engine left behind brakes by itself
        self._rest_deg = self._axes()[:6]
        self._moving = self._stopped = False

    # -- moving -------------------------------------------------------------------------------

    def command(self, target_deg: Array, speed_percent: int) -> int:
        """Start a motion to joints (6,); return its number."""
        target = self._whole(target_deg)
        return self.begin(lambda n: self.wire().start(n, target, speed_percent))

    def begin(self, start: Callable[[int], None]) -> int:
        """Start a motion, where the controller is ready; return its number."""
        self._check_stopped()
        self.wire().refresh()
        self.check(*self.wire().motion_checks)
        number = self._sequence % self.MAX_SEQUENCE + 1
        self._moving, self._ended_s = True, None
        self._watch.start()
        start(number)
        self._sequence = number
        return number

    def poll_motion(
        self, number: int, limits: MotionLimits, rounds: Iterator[tuple[str, ...]]
    ) -> tuple[str, ...]:
        """Poll a motion; return the variables that were read, none once it has ended."""
        if self.acknowledged(number):
            return ()
        names = next(rounds)
        self.check(*(name for name in names if name != PROGRESS))
        if PROGRESS in names:
            self._check_progress(limits, number)
        return names

    def _check_progress(self, limits: MotionLimits, number: int) -> None:
        """Raise `DeviceError` where a motion stalls or creeps."""
        now_deg, expected = self._axes(), f"HC_ACK {number}"
        if limits.stalled(now_deg):
            self.check(*HEALTH, "$OV_PRO", "$ACT_TOOL", "$ACT_BASE")
            if error := self.wire().integer("HC_ERR"):
                raise refused_motion(error)
            raise limits.stall_error(self._where(now_deg), expected, now_deg)
        if limits.overdue(self._clock.now_s(), self._override):
            raise limits.time_error(self._where(now_deg), expected, now_deg)

    def _where(self, now_deg: Array) -> str:
        return f"at {joints_text(now_deg)}, HC_ACK {self.wire().integer('HC_ACK')}"

    def rest(self, target_deg: Array) -> RobotReading:
        """Return the reading at rest at joints (6,), after an acknowledged motion."""
        # The pose means something only with the tool and the base that connect has verified.
        controller = self.wire()
        self.check("$ACT_TOOL", "$ACT_BASE")
        expected = self._whole(target_deg)
        for _ in polls(REST_S, self.STEP_S):
            taken_s = self._clock.pc_s()
            controller.refresh()
            axes, before = self._axes(), self._pose()
            self._clock.wait(self.DWELL_S)
            controller.refresh()
            pose = self._pose()
            arrived = bool(np.all(np.abs(axes - expected) <= self.ARRIVED[: len(expected)]))
            if arrived and bool(np.all(np.abs(pose - before) <= STILL_MM)):
                self._moving, self._rest_deg, self._ended_s = False, target_deg, taken_s
                return RobotReading(np.radians(axes[:6]), pose, True, taken_s, taken_s)
        tolerance = f"{joints_text(expected)} +-{self.AXIS_TOLERANCE_DEG}"
        raise not_at_target(joints_text(axes), tolerance, axes, expected)

    # -- also for a sweep ----------------------------------------------------------------------

    def resume(self) -> None:
        """Reset a brake of our own, unless the robot was stopped otherwise as well."""
        if not self._stopped:
            self._reset_stop()

    def end_motion(self) -> None:
        self._watch.stop()

    def commanded_deg(self) -> Array:
        """Return the joints (6,) in deg of the last target, or of the position at connect."""
        return self._rest_deg

    def acknowledged(self, number: int) -> bool:
        """Whether a motion has ended; raises `DeviceError` where it was stopped, or refused. Each
        poll is a heartbeat for the program.
        """
        self._check_stopped()
        self.wire().heartbeat()
        self.wire().refresh()
        if self.wire().integer("HC_ACK") != number:
            return False
        if (error := self.wire().integer("HC_ERR")) != 0:
            raise refused_motion(error)
        return True

    def wire(self) -> Controller:
        return ROBOT.connected(self._controller)

    def check_wait(self) -> None:
        """Runs in every wait on a wire."""
        self._clock.check()
        self._watch.feed()

    def _check_stopped(self) -> None:
        if self._stopped:
            raise ROBOT.failed("HC-B21", "move", "the robot was stopped")

    def _axes(self) -> Array:
        """Return joints (6,) in deg, and a slide that is the robot's axis in mm (7,)."""
        return np.array(self.wire().numbers(self.wire().joints_variable, self._names()))

    def _names(self) -> tuple[str, ...]:
        return JOINTS if self.slide_mm is None else (*JOINTS, SLIDE)

    def _whole(self, target_deg: Array) -> Array:
        """Return joints (6,), and where the slide is held (7,): the arm's motions carry it."""
        return target_deg if self.slide_mm is None else np.append(target_deg, self.slide_mm)

    def _pose(self) -> Array:
        """Return {T} in {B} (4, 4), mm."""
        return frame_matrix(self.wire().numbers("$POS_ACT", POSE))

    def _close_wires(self) -> None:
        controller, self._controller = self._controller, None
        if controller is not None:
            controller.close()


class KukaSweep:
    """Satisfies `hilcell.ports.Sweep`: one axis moves slowly while its joints are read.

    Speed is HC_VEL (1 to 100 % of an axis) times $OV_PRO, which a sweep lowers: down to 1/10000 of
    an axis' speed. $OV_PRO stays lowered when the PC dies, so the controller stores its old value
    (HC_OV_OLD) and the lowered one (HC_OV_SET); every exit of a sweep and every connect restore it,
    at rest only, and only unless it has been changed meanwhile.
    """

    PROGRESS_DEG = 0.002
    POLL_S = 0.05  # while the end is waited for

    def __init__(
        self,
        robot: KukaRobot,
        clock: Clock,
        axis: int,
        end_deg: float,
        speed_deg_s: float,
        full_deg_s: Array,
    ) -> None:
        """``full_deg_s`` (6,) are the axes' speeds at HC_VEL 100 and $OV_PRO 100."""
        if not (0 <= axis < len(JOINTS) and np.isfinite(end_deg)):
            raise ROBOT.failed(
                "HC-B28",
                "sweep",
                f"axis {axis + 1} to {end_deg} deg",
                expected="an axis of 1 to 6, a finite angle",
            )
        full = float(full_deg_s[axis])
        if not full / 100**2 <= speed_deg_s <= full:
            raise ROBOT.failed(
                "HC-B28",
                "sweep",
                f"{speed_deg_s} deg/s",
                expected=f"{full / 100**2:.4f} to {full:g} deg/s",
                speed_deg_s=speed_deg_s,
            )
        self.speed_rad_s, self.ended = float(np.radians(speed_deg_s)), False
        self._robot, self._clock = robot, clock
        self._axis, self._end_deg = axis, end_deg
        self._speed_deg_s, self._full_deg_s = speed_deg_s, full
        self._target_deg = np.zeros(6)
        self._velocity = self._override = 100
        self._variable, self._number, self._moving = PROGRESS, 0, False
        self._round: Iterator[tuple[str, ...]] = iter(())
        self._limits = MotionLimits(0.0, STALL_S, self.PROGRESS_DEG)

    def __enter__(self) -> Self:
        """Set the speed; nothing moves."""
        robot, controller = self._robot, self._robot.wire()
        controller.refresh()
        robot.check(*HEALTH, "$OV_PRO")
        self._variable, self._round = controller.joints_variable, cycle(controller.poll_groups)
        found = controller.integer("$OV_PRO")
        share = self._speed_deg_s / self._full_deg_s
        self._velocity, self._override = self.split_speed(share, found)
        self.speed_rad_s = float(
            np.radians(self._full_deg_s) * self._velocity * self._override / 100**2
        )
        self._target_deg = robot.commanded_deg().copy()
        way_deg = self._end_deg - self._target_deg[self._axis]
        self._target_deg[self._axis] = self._end_deg
        planned = planned_s(way_deg, np.array(self._full_deg_s), self._velocity)
        self._limits = MotionLimits(planned, STALL_S, self.PROGRESS_DEG)
        if self._override != found:
            try:
                controller.lower_override(found, self._override)
            except BaseException as error:  # also a stop: the override is the operator's
                self._restore(error)
                raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._restore(error)

    def kickoff(self) -> None:
        self._moving = True
        self._number = self._robot.command(self._target_deg, self._velocity)

    def collect(self) -> JointSample:
        controller, before_s = self._robot.wire(), self._clock.now_s()
        controller.refresh()
        joints_deg = controller.numbers(self._variable, JOINTS)
        after_s = self._clock.now_s()
        self._look()
        return JointSample(np.radians(joints_deg), before_s, after_s)

    def complete(self) -> RobotReading:
        while not self.ended:
            self._clock.wait(self.POLL_S)
            self._look()
        reading = self._robot.rest(self._target_deg)
        self._moving = False
        return reading

    def _look(self) -> None:
        if self.ended:
            return
        names = self._robot.poll_motion(self._number, self._limits, self._round)
        self.ended = not names
        if "$OV_PRO" in names:
            self._robot.wire().check_override(self._override)

    def _restore(self, error: BaseException | None) -> None:
        """Leave the robot at rest with its override as it was."""
        self._robot.end_motion()
        try:
            with self._robot.wire().ignoring_stop() as access:
                if self._moving:
                    access.brake()
                    await_rest(access)
                access.restore_override()
            if self._moving and not isinstance(error, Stopped):
                self._robot.resume()
        except HilcellError as failure:  # a stop, too, would hide the error
            if error is None:
                raise
            error.add_note(f"not all was restored: {failure}; the next connect does it")

    @staticmethod
    def split_speed(share: float, override: int) -> tuple[int, int]:
        """HC_VEL and $OV_PRO whose product is the next to a share of full speed from below. The
        operator's ``override`` is never raised; of equal ones the highest is taken.
        """
        expected = share * 100**2 * (1.0 + 1e-9)
        pairs = [
            (velocity * lowered, lowered, velocity)
            for velocity in range(1, 101)
            if (lowered := min(override, int(expected / velocity))) >= 1
        ]
        _, lowered, velocity = max(pairs)
        return velocity, lowered


def await_rest(
    controller: Controller,
    joints: str = PROGRESS,
    names: tuple[str, ...] = JOINTS,
    *,
    closing: bool = False,
) -> None:
    """Wait until the program has accepted the stop and no axis moves; also while a stop is on.

    ``closing`` writes the stop again at each poll, since an unacknowledged one may be lost, and
    reads the axes only.
    """
    before, pause = np.full(len(names), np.inf), threading.Event()
    for _ in polls(BRAKED_S):
        if closing:
            controller.brake()
        controller.refresh()
        now = np.array(controller.numbers(joints, names))
        stands = bool(np.all(np.abs(now - before) <= STILL_DEG))
        if stands and (closing or controller.integer("HC_ERR") in (STOPPED, LOST)):
            return
        before = now
        pause.wait(BRAKED_DWELL_S)
    operation = "close" if closing else "sweep"
    found = f"not at rest {BRAKED_S:.0f} s after the brake"
    raise ROBOT.failed("HC-B41", operation, found, waited_s=BRAKED_S)
