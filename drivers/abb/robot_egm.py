"""A robot of ABB by Robot Web Services, a RAPID module of ours, and the position stream of EGM.

A PC without real time does not guide an arm every 4 ms. So the module ``rapid/hilcell.mod`` moves,
by MoveAbsJ to a fine point: the controller plans the whole path, with all axes in step. The PC
writes a target, a time and a number; the module acknowledges with that number. Motion has ended
only when the measured joints of the stream are at the target and a dwell's samples show no spread.
A PC that dies does not count its sign of life up any more, and the module stops the motion.

HTTP answers have no number: the last question of each reading is the module's state, which contains
the last sign of life, so that an answer of another question is noticed. The stop has a connection
of its own, in the same session.
"""

from __future__ import annotations

import secrets
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import msgspec
import numpy as np
from msgspec import Meta

from drivers.abb.controller_side import DEVICE, controller_side
from drivers.abb.egm import PositionStream, Sample
from drivers.abb.first_contact import (
    abilities,
    absolute_accuracy,
    candidate,
    check_module,
    check_options,
    check_type,
    controller_settings,
    identity_of,
    login_of,
    opened,
    rotation,
    stream_port,
)
from drivers.abb.http_channel import Trust
from drivers.abb.web_services import WebServices
from drivers.device_errors import ROBOT
from drivers.supervision import (
    MotionLimits,
    Watchdog,
    check_sweep,
    checked_target,
    ignore_stop,
    joints_text,
    not_at_target,
    on_failure,
    planned_s,
    polls,
    state_error,
)
from hilcell.cell.file import Joint
from hilcell.geometry.frames import matrix
from hilcell.ports import (
    Ability,
    Array,
    Candidate,
    Clock,
    ControllerSide,
    DeviceError,
    DeviceRefused,
    Identity,
    JointSample,
    RobotReading,
    RobotSettings,
    Stopped,
)
from hilcell.wire.channel import Host, Port

STALL_S = 5.0  # wire deadline: no axis moved and no acknowledgement came
REST_S = 3.0  # wire deadline: from the acknowledgement, or a brake, to standstill
STEP_S = 0.5  # one poll counts for this long, at most
DWELL_S = 0.05  # of the samples that show standstill
STILL_RAD = 5e-5  # spread of measured joints at rest
LOST, BRAKED = 8, 9  # errors of the module
UNITS = "/rw/motionsystem/mechunits/ROB_1"
ROBTARGET = ("x", "y", "z", "q1", "q2", "q3", "q4")


@dataclass(frozen=True, slots=True)
class ModuleState:
    """State of the module."""

    version: int
    session: int
    life: int  # the last sign of life that it has seen
    done: int  # number of the last order that has ended
    error: int
    begun: int


class AbbEgmRobot:
    """Satisfies `hilcell.ports.Robot` and `hilcell.ports.Sweeps`.

    For commissioning also `hilcell.ports.Inspects`, `hilcell.ports.Discovers`,
    `hilcell.ports.StatesSettings` and `hilcell.ports.NeedsFiles`.
    """

    STARTED_S = 5.0  # wire deadline: from the start of the program to its state
    ANSWERED_S = 2.0  # wire deadline: the module sees a sign of life
    RELEASE_S = 5.0  # wire deadline: from a stop to a robot at rest
    ENDS_S = 0.5  # in which the module ends by itself and gives its identity of EGM back
    LISTENED = 25  # datagrams at connect, in which a second controller would show
    POLL_S = 0.1  # between two looks at a motion
    PANEL_S = 1.0  # real time between two looks at the panel
    AXIS_TOLERANCE_RAD = 2e-4
    SAME_JOINTS_DEG = 0.02  # of the stream and of the web services, at rest
    PROGRESS_DEG = 0.01
    TOOL_MM, TOOL_QUATERNION = 1e-3, 1e-5
    LARGEST = 1_000_000  # of a number: num in RAPID has 24 bits
    SHORTEST_S = 0.05  # of a motion

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Address and expected identity of the controller, and who logs in.

        ``name`` is handed over from `[robot]`. ``serial`` is the controller's id. The password is
        in ``password_file``, else in the environment variable HILCELL_ABB_PASSWORD, else the
        maker's usual one.
        ``certificate_sha256`` or ``ca_file`` are needed for web services 2 (https).
        """

        host: Host
        smr_mm: tuple[float, float, float]
        joint: list[Joint]
        port: Port = 80
        web_services: Literal[1, 2] = 1
        model: str = "IRB 6700"
        name: str = ""
        serial: str = ""
        user: Annotated[str, Meta(min_length=1)] = "Default User"
        password_file: str = ""
        certificate_sha256: Annotated[str, Meta(pattern="^[0-9A-Fa-f: ]*$")] = ""
        ca_file: str = ""
        egm_device: Annotated[str, Meta(pattern="^[A-Za-z0-9_]{1,32}$")] = DEVICE

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._services: WebServices | None = None
        self._stop_line: WebServices | None = None
        self._stream: PositionStream | None = None
        self.watch = Watchdog(ROBOT, "HC-B27", clock)
        self._speed_deg_s = np.array([joint.speed_deg_s for joint in options.joint])
        self._session = self._life = self._order = 0
        self._logged = 0  # the newest error of the event log at connect
        self.rest_rad = np.zeros(6)  # the last target, or the position at connect
        self._panel_due_s = 0.0
        self._ratio = 100.0
        self._moving = self._stopped = self._started = self._absolute = False
        self._ended_s: float | None = None  # when the end of the last motion was detected

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        """Log in, verify everything, start the module and its stream; nothing moves."""
        self._close_wires()
        self._session = secrets.randbelow(self.LARGEST - 1) + 1
        self._stopped, self._moving, self._ended_s = False, False, None
        with on_failure(self._give_up):
            self._open()
            services = self.services()
            identity = self._identify(services)
            self._logged = self._last_error(services)[0]
            check_options(services)
            self.check_panel(moving=False)
            port = stream_port(services, self._options.egm_device)
            check_module(services, self._options.egm_device)
            self._absolute = absolute_accuracy(services)
            self._end_former_program(services)
            self._stream = PositionStream(port, self._check_wait)
            self._start_module(services)
            self._check_stream(services)
            self._check_tool()
        return [identity]

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        target_rad = checked_target(joints_rad, speed_percent)
        distance_deg = np.degrees(target_rad - self.rest_rad)
        planned = planned_s(distance_deg, self._speed_deg_s, speed_percent)
        try:
            number = self.command(target_rad, planned)
            limits = MotionLimits(planned, STALL_S, self.PROGRESS_DEG)
            while not self.acknowledged(number, limits):
                self._clock.wait(self.POLL_S)
            return self.rest(target_rad)
        finally:
            self.watch.stop()

    def read(self) -> RobotReading:
        asked_s = self._clock.pc_s()
        if self._stopped:
            return self._read_stopped(asked_s)
        samples, pose, state = self._dwell()
        still = not self._moving and state.begun == state.done and at_rest(samples)
        return self._reading(samples[-1].joints_rad, pose, asked_s, still=still)

    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> AbbSweep:
        full_rad_s = float(np.radians(self._speed_deg_s[axis])) if 0 <= axis < 6 else np.nan
        return AbbSweep(self, self._clock, axis, end_rad, speed_rad_s, full_rad_s)

    def stop(self) -> None:
        """Stop the program's execution; any thread; waits for no answer.

        No sign of life follows, so the module stops the motion where this stop is not taken.
        """
        self._stopped = True
        if (line := self._stop_line) is not None:
            line.send_stop()

    def close(self) -> None:
        """End the program, so that data moves nothing any more, and leave the session.

        At rest the module is asked to end by itself; where it does not, it is stopped.

        Raises `DeviceError` where a program was started, and its end or rest is not confirmed.
        """
        try:
            if self._started:
                self._stopped = True
                self._leave_at_rest()
        finally:
            self._started = False
            self._close_wires()

    # -- commissioning ------------------------------------------------------------------------

    def inspect(self) -> list[Ability]:
        options = self._options
        with opened(msgspec.to_builtins(options)) as services:
            return abilities(services, options.egm_device, self._check_robot)

    def settings(self) -> RobotSettings:
        with opened(msgspec.to_builtins(self._options)) as services:
            return controller_settings(services)

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the controller whose web services answer at the host, if one is given."""
        return candidate(known)

    @classmethod
    def controller_side(cls, options: Mapping[str, object]) -> ControllerSide:
        return controller_side(options)

    # -- connecting ---------------------------------------------------------------------------

    def _open(self) -> None:
        options = self._options
        login = login_of(options.user, options.password_file)
        trust = Trust(options.certificate_sha256, options.ca_file)
        address = (options.web_services, options.host, options.port, trust, login)
        self._services = WebServices(*address, self._check_wait)
        self._services.operation_mode()  # opens the session that both connections use
        # The stop must get through while the run is already stopping.
        self._stop_line = WebServices(*address, ignore_stop)
        self._stop_line.operation_mode()

    def _identify(self, services: WebServices) -> Identity:
        identity = identity_of(services)
        self._check_robot(identity)
        return identity

    def _check_robot(self, identity: Identity) -> str:
        options = self._options
        return check_type(identity, options.model, options.serial, options.name)

    def check_panel(self, *, moving: bool) -> None:
        """Raise `DeviceError` where the controller's state forbids to move."""
        services = self.services()
        self._panel_due_s = time.monotonic() + self.PANEL_S
        mode, state = services.operation_mode(), services.controller_state()
        if mode != "AUTO":
            raise state_error("HC-B12", "the operation mode", mode, "AUTO", moving=moving)
        if state != "motoron":
            code = STATES.get(state, "HC-B13")
            found = f"{state}{self._event(services)}"
            raise state_error(code, "the controller's state", found, "motoron", moving=moving)
        ratio = services.speed_ratio()
        if moving:
            self._ratio = ratio
            if not ratio > 0.0:
                found = f"{ratio:g} %"
                raise state_error("HC-B16", "the speed ratio", found, "above 0 %", moving=True)
            return
        self._ratio = ratio
        if ratio != 100.0:  # NaN, too
            found = f"{ratio:g} %"
            raise state_error("HC-B84", "the speed ratio", found, "100 %", moving=False)

    def _end_former_program(self, services: WebServices) -> None:
        """Stop a program of ours that a dead engine left behind; refuse any other one."""
        if not services.program_runs():
            return
        self._life = int(services.symbol_numbers("hc_life")[0])
        try:
            self._ask_module(services)
        except DeviceError as error:
            raise ROBOT.refused(
                "HC-B67",
                "connect",
                f"a RAPID program runs, and it is no module of hilcell ({error.found})",
                expected="stopped",
            ) from error
        services.stop()
        for _ in polls(self.RELEASE_S, STEP_S):
            if not services.program_runs():
                return
        found = f"the program runs {self.RELEASE_S:.0f} s after the stop"
        raise ROBOT.refused("HC-B25", "connect", found, expected="stopped")

    def _start_module(self, services: WebServices) -> None:
        """Start the routine hc_main; return when its state shows the session."""
        services.request_mastership()
        try:
            services.set_symbol("hc_session", str(self._session))
            services.set_program_pointer("hc_main")
        finally:
            services.release_mastership()
        self._started = True
        services.start()
        for _ in polls(self.STARTED_S, STEP_S):
            if self._module_state(services).session == self._session:
                break
        else:
            raise self._program_ended(f"no word of it within {self.STARTED_S:.0f} s")
        self._life = self._order = 0
        self._ask_module(services)

    def _check_stream(self, services: WebServices) -> None:
        """Refuse positions of another robot or from another address than the controller's."""
        stream = self.stream()
        sample, _ = stream.fresh(self.STARTED_S), stream.some(self.LISTENED)
        try:
            address = socket.gethostbyname(self._options.host)
        except OSError:
            address = self._options.host
        if stream.source_host != address:
            raise ROBOT.refused(
                "HC-B85",
                "connect",
                f"positions on UDP port {stream.port} come from {stream.source_host}",
                expected=f"{address}, the controller",
            )
        stated_deg = self._joints_deg(services)
        found_deg = np.degrees(sample.joints_rad)
        if not bool(np.all(np.abs(found_deg - stated_deg) <= self.SAME_JOINTS_DEG)):
            raise ROBOT.refused(
                "HC-B85",
                "connect",
                f"the position stream has the joints {joints_text(found_deg)}",
                expected=f"{joints_text(stated_deg)}, by the web services: is it another robot's?",
            )
        self.rest_rad = sample.joints_rad

    def _check_tool(self) -> None:
        """Refuse a tool that is not the cell file's: the pose would be another point's."""
        robhold, *found = self.services().symbol_numbers("hc_tool")[:8]
        expected = np.array([*self._options.smr_mm, 1.0, 0.0, 0.0, 0.0])
        limits = np.array([self.TOOL_MM] * 3 + [self.TOOL_QUATERNION] * 4)
        off = np.abs(np.array(found) - expected) if len(found) == 7 else np.full(7, np.nan)
        if not (np.isnan(robhold) and bool(np.all(off <= limits))):
            form = "X {:.3f}, Y {:.3f}, Z {:.3f}, rotation {:.5f} {:.5f} {:.5f} {:.5f}".format
            shown = form(*found) if len(found) == 7 else str(found)
            own = f"robot.smr_mm of the cell file, {form(*expected)}"
            raise ROBOT.refused("HC-B06", "connect", f"hc_tool is {shown}", expected=own)

    # -- moving -------------------------------------------------------------------------------

    def command(self, target_rad: Array, duration_s: float) -> int:
        """Start a motion to joints (6,) in this time; return its number."""
        if self._stopped:
            raise ROBOT.failed("HC-B21", "move", "the robot was stopped")
        services, stop_line = self.services(), ROBOT.connected(self._stop_line)
        stop_line.operation_mode()  # the stop's connection is open, and its login valid
        self.check_panel(moving=False)
        self.fresh_position()  # what waits in the stream is of the time before
        self._check_session(self._ask_module(services))
        number = self._order % self.LARGEST + 1
        target = ",".join(f"{each:.6f}" for each in np.degrees(target_rad))
        free = ",".join(["9E9"] * 6)
        services.set_symbol("hc_target", f"[[{target}],[{free}]]")
        services.set_symbol("hc_seconds", f"{max(duration_s, self.SHORTEST_S):.4f}")
        self._send_life(services)
        self._order = number
        self._moving, self._ended_s = True, None
        self.watch.start()
        if self._stopped:
            raise ROBOT.failed("HC-B21", "move", "the robot was stopped")
        services.set_symbol("hc_order", str(number))
        return number

    def acknowledged(self, number: int, limits: MotionLimits) -> bool:
        """Look at the motion once; return whether the module shows that it has ended.

        Raises `DeviceError` for a faulty state, a motion that stalls, or one that was braked.
        """
        samples = self.positions()
        services = self.services()
        state = self._ask_module(services)
        self._check_session(state)
        if time.monotonic() >= self._panel_due_s:
            self.check_panel(moving=True)
        if state.done == number:
            if state.error:
                self._clock.check()  # the run's own stop brakes as well
                raise self._braked(state.error)
            return True
        self._check_progress(limits, number, state, samples[-1])
        return False

    def positions(self) -> list[Sample]:
        """Return the samples since the last call, at least one; raises `DeviceError`."""
        return self._streamed(self.stream().following)

    def fresh_position(self) -> Sample:
        """Return a sample that came after the call began; raises `DeviceError`."""
        return self._streamed(lambda: [self.stream().fresh()])[0]

    def _streamed(self, ask: Callable[[], list[Sample]]) -> list[Sample]:
        """Return samples that show motors and program on; raises `DeviceError`."""
        try:
            samples = ask()
        except DeviceError as error:
            if error.code == "HC-B85" and not self.services().program_runs():
                raise self._program_ended("the program has stopped") from error
            raise
        for sample in samples:
            self.check_sample(sample)
        return samples

    def check_sample(self, sample: Sample) -> None:
        """Raise `DeviceError` where the stream shows that the controller moves nothing."""
        if not sample.motors_on:
            self.check_panel(moving=self._moving)
            raise state_error("HC-B13", "the motors' state", "off", "on", moving=self._moving)
        if not sample.running:
            self.check_panel(moving=self._moving)
            raise self._program_ended("the position stream shows a stopped program")

    def _check_progress(
        self, limits: MotionLimits, number: int, state: ModuleState, sample: Sample
    ) -> None:
        now_deg, expected = np.degrees(sample.joints_rad), f"acknowledged {number}"
        where = f"at {joints_text(now_deg)}, acknowledged {state.done}"
        if limits.stalled(now_deg):
            raise limits.stall_error(where, expected, now_deg)
        if limits.overdue(self._clock.now_s(), self._ratio):
            raise limits.time_error(where, expected, now_deg)

    def rest(self, target_rad: Array) -> RobotReading:
        """Return the reading at rest at joints (6,), after an acknowledged motion."""
        for _ in polls(REST_S, STEP_S):
            asked_s = self._clock.pc_s()
            samples, pose, state = self._dwell()
            self._check_session(state)
            last = samples[-1]
            arrived = np.abs(last.joints_rad - target_rad) <= self.AXIS_TOLERANCE_RAD
            if bool(np.all(arrived)) and at_rest(samples):
                # The pose means something only with the tool that connect has verified.
                self._check_tool()
                self._moving, self.rest_rad = False, target_rad
                self._ended_s = asked_s
                return self._reading(last.joints_rad, pose, asked_s, still=True)
        target_deg, axes_deg = np.degrees(target_rad), np.degrees(last.joints_rad)
        tolerance = f"{joints_text(target_deg)} +-{np.degrees(self.AXIS_TOLERANCE_RAD):.3f}"
        raise not_at_target(joints_text(axes_deg), tolerance, axes_deg, target_deg)

    def _dwell(self) -> tuple[list[Sample], Array, ModuleState]:
        """Return samples of a dwell that began after this call, the pose in it, and the state.

        The state is asked for last: only it shows that no answer belongs to another question.
        """
        services = self.services()
        samples = [self.fresh_position()]
        self._clock.wait(DWELL_S)
        pose = self._pose(services)
        samples += self.positions()
        state = self._ask_module(services)
        self._check_session(state)
        samples += self.positions()
        began_s, ended_s = samples[0].device_s, samples[-1].device_s
        if not ended_s > began_s:
            raise ROBOT.failed(
                "HC-B26",
                "read",
                f"the controller's time went from {began_s:.3f} to {ended_s:.3f} s in "
                f"{len(samples)} positions",
                expected=f"a time that goes on, in a dwell of {DWELL_S:g} s",
                act="restart the controller",
            )
        return samples, pose, state

    def _read_stopped(self, asked_s: float) -> RobotReading:
        """Return a reading by the web services: a stop ends the program, with it the stream."""
        services = self.services()
        before_deg = self._joints_deg(services)
        self._clock.wait(DWELL_S)
        pose, now_deg = self._pose(services), self._joints_deg(services)
        spread_rad = np.radians(np.abs(now_deg - before_deg))
        still = not services.program_runs() and bool(np.all(spread_rad <= STILL_RAD))
        return self._reading(np.radians(now_deg), pose, asked_s, still=still)

    def _reading(
        self, joints_rad: Array, pose: Array, asked_s: float, *, still: bool
    ) -> RobotReading:
        return RobotReading(
            joints_rad, pose, still, asked_s, self._ended_s, by_factory_links=self._absolute
        )

    # -- the module ---------------------------------------------------------------------------

    def _send_life(self, services: WebServices) -> None:
        self._life = self._life % self.LARGEST + 1
        services.set_symbol("hc_life", str(self._life))

    def _ask_module(self, services: WebServices) -> ModuleState:
        """Send a sign of life; return the first state that has seen it."""
        self._send_life(services)
        for _ in polls(self.ANSWERED_S, STEP_S):
            state = self._module_state(services)
            if state.life == self._life:
                return state
            if not services.program_runs():
                raise self._program_ended("the program has stopped")
        raise self._program_ended(
            f"its sign of life is {state.life} {self.ANSWERED_S:g} s after {self._life} was sent"
        )

    @staticmethod
    def _module_state(services: WebServices) -> ModuleState:
        found = services.symbol_numbers("hc_state")
        if len(found) != 6 or not all(map(float.is_integer, found)):
            raise ROBOT.failed(
                "HC-B26", "read", f"hc_state is {found}", expected="six whole numbers"
            )
        return ModuleState(*map(int, found))

    def _check_session(self, state: ModuleState) -> None:
        if state.session != self._session:
            raise self._program_ended(f"its session is {state.session}, not {self._session}")

    def _braked(self, error: int) -> DeviceError:
        found = {LOST: "the PC's sign of life was late, and the robot has braked by itself"}
        text = found.get(error, "the motion was braked")
        code = "HC-B43" if error == LOST else "HC-B21"
        return ROBOT.failed(
            code,
            "move",
            f"error {error} of hilcell.mod: {text}",
            expected="a motion to its end",
            act="read the panel, then resume",
        )

    def _program_ended(self, found: str) -> DeviceError:
        """Return the error of a module that does not run; panel, log and mastership come first."""
        try:
            self.check_panel(moving=self._moving)
            services = self.services()
            if event := self._event(services):
                code = EVENTS.get(event[2:].partition(":")[0], "HC-B14")
                return ROBOT.failed(
                    code,
                    "move",
                    found + event,
                    expected="no error in the event log",
                    act="read the event at the pendant and remove its cause",
                )
            if holder := services.holder():
                found = f"{holder}: {found}"
                return ROBOT.failed("HC-B83", "move", found, expected="nobody, or hilcell")
        except DeviceError as error:
            if error.code in PANEL:
                return error
        return ROBOT.failed("HC-B66", "move", found, expected="the module that hilcell started")

    def _event(self, services: WebServices) -> str:
        """Return the newest error of the event log since connect in brackets, "" for none."""
        place, text = self._last_error(services)
        return f" ({text})" if text and place > self._logged else ""

    @staticmethod
    def _last_error(services: WebServices) -> tuple[int, str]:
        """Return the newest error of the event log; none where the log cannot be read."""
        try:
            return services.last_error()
        except DeviceError as error:
            if error.code not in ("HC-B03", "HC-B26"):
                raise
            return 0, ""

    # -- also for a sweep ---------------------------------------------------------------------

    def services(self) -> WebServices:
        return ROBOT.connected(self._services)

    def stream(self) -> PositionStream:
        return ROBOT.connected(self._stream)

    @property
    def ratio(self) -> float:
        return self._ratio

    @property
    def under_way(self) -> bool:
        """Whether an order was sent, and its end not read."""
        return self._moving

    def brake(self) -> None:
        """Brake the last motion by the module; return at standstill, also while a stop is on."""
        line, begun_s, number = ROBOT.connected(self._stop_line), time.monotonic(), self._order
        line.set_symbol("hc_brake", str(number))
        before_deg = self._joints_deg(line)
        for _ in polls(REST_S):
            time.sleep(DWELL_S)
            state, now_deg = self._module_state(line), self._joints_deg(line)
            still = bool(np.all(np.abs(now_deg - before_deg) <= np.degrees(STILL_RAD)))
            ended = number in (state.done, 0) or state.begun != number
            if still and (ended or not line.program_runs()):
                break
            before_deg = now_deg
        else:
            found = f"not at rest {time.monotonic() - begun_s:.1f} s after the brake"
            raise ROBOT.failed("HC-B71", "sweep", found, expected=f"at rest within {REST_S:g} s")
        self._moving, self.rest_rad = False, np.radians(now_deg)

    @staticmethod
    def _pose(services: WebServices) -> Array:
        """Return the frame (4, 4) of hc_tool in {B}."""
        x, y, z, *quaternion = services.numbers(
            f"{UNITS}/robtarget?tool=hc_tool&wobj=wobj0&coordinate=Base", *ROBTARGET
        )
        return matrix(rotation(quaternion), np.array([x, y, z]))

    @staticmethod
    def _joints_deg(services: WebServices) -> Array:
        names = [f"rax_{axis}" for axis in range(1, 7)]
        return np.array(services.numbers(f"{UNITS}/jointtarget", *names))

    # -- wires --------------------------------------------------------------------------------

    def _leave_at_rest(self) -> None:
        """Return when the program has ended and the joints rest; raises `DeviceError`."""
        try:
            line = ROBOT.connected(self._stop_line)
            ends_s = time.monotonic()  # from now on the program is stopped, if it still runs
            if not self._moving:
                with suppress(DeviceRefused):  # mastership is another's
                    line.set_symbol("hc_session", "0")
                    ends_s += self.ENDS_S
            before_deg, runs, still = self._joints_deg(line), True, False
            for _ in polls(self.RELEASE_S, STEP_S):
                if runs and time.monotonic() >= ends_s:
                    line.stop()
                time.sleep(DWELL_S)
                now_deg, runs = self._joints_deg(line), line.program_runs()
                still = bool(np.all(np.abs(now_deg - before_deg) <= np.degrees(STILL_RAD)))
                if still and not runs:
                    line.log_out()
                    return
                before_deg = now_deg
            program = "runs" if runs else "has stopped"
            found = f"the program {program}, {'at rest' if still else 'moving'} at "
            found += joints_text(now_deg)
        except DeviceError as error:
            found = error.found
        raise ROBOT.failed(
            "HC-B71",
            "close",
            f"the arm is not confirmed at rest: {found}",
            expected=f"program stopped and joints at rest within {self.RELEASE_S:g} s",
            act="keep away from the arm, it may move: press the E-stop; then see the panel",
        )

    def _give_up(self) -> None:
        """Close after a failed connect; nothing has moved."""
        if self._stop_line is not None:
            try:
                if self._started:
                    self._stop_line.stop()
                self._stop_line.log_out()
            except DeviceError:
                pass  # the error of connect says more
        self._started = False
        self._close_wires()

    def _check_wait(self) -> None:
        self._clock.check()
        self.watch.feed()

    def _close_wires(self) -> None:
        for wire in (self._stream, self._services, self._stop_line):
            if wire is not None:
                wire.close()
        self._stream = self._services = self._stop_line = None


STATES = {"guardstop": "HC-B11", "emergencystop": "HC-B10", "emergencystopreset": "HC-B10"}
EVENTS = {"event 50027": "HC-B20"}  # joint out of range; others: HC-B14
PANEL = {"HC-B10", "HC-B11", "HC-B12", "HC-B13", "HC-B16", "HC-B84"}


class AbbSweep:
    """Satisfies `hilcell.ports.Sweep`: one axis moves slowly while its joints are read.

    The module's motion lasts distance over speed at the speed ratio of 100 %; a ratio that is
    changed meanwhile ends the sweep.
    """

    PROGRESS_DEG = 0.002

    def __init__(
        self,
        robot: AbbEgmRobot,
        clock: Clock,
        axis: int,
        end_rad: float,
        speed_rad_s: float,
        full_rad_s: float,
    ) -> None:
        check_sweep(axis, end_rad, speed_rad_s, full_rad_s)
        self.speed_rad_s, self.ended = speed_rad_s, False
        self._robot, self._clock = robot, clock
        self._axis, self._end_rad = axis, end_rad
        self._number = 0

    def __enter__(self) -> Self:
        """Plan the motion; nothing moves."""
        robot = self._robot
        robot.check_panel(moving=False)
        self._target_rad = robot.rest_rad.copy()
        self._planned_s = abs(self._end_rad - self._target_rad[self._axis]) / self.speed_rad_s
        self._target_rad[self._axis] = self._end_rad
        self._limits = MotionLimits(float(self._planned_s), STALL_S, self.PROGRESS_DEG)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._robot.watch.stop()
        if not self._robot.under_way:
            return
        try:
            self._robot.brake()
        except DeviceError as failure:
            if error is None:
                raise
            if not isinstance(error, Stopped):
                error.add_note(f"the brake was not confirmed: {failure}")

    def kickoff(self) -> None:
        """Start the motion; return when the controller has the order."""
        self._number = self._robot.command(self._target_rad, float(self._planned_s))

    def collect(self) -> JointSample:
        """Return the joints as they left the controller after this call began."""
        before_s = self._clock.now_s()
        sample = self._robot.fresh_position()
        after_s = self._clock.now_s()
        self._look()
        return JointSample(sample.joints_rad, before_s, after_s, sample.device_s)

    def complete(self) -> RobotReading:
        while not self.ended:
            self._clock.wait(AbbEgmRobot.POLL_S)
            self._look()
        return self._robot.rest(self._target_rad)

    def _look(self) -> None:
        if self.ended:
            return
        self.ended = self._robot.acknowledged(self._number, self._limits)
        if self._robot.ratio != 100.0:
            raise ROBOT.failed(
                "HC-B70",
                "sweep",
                f"the speed ratio is {self._robot.ratio:g} %",
                expected="100 %",
                fraction=self._robot.ratio / 100.0,
                wanted_fraction=1.0,
            )


def at_rest(samples: Sequence[Sample]) -> bool:
    """Whether no joint moves, by the spread of the measured joints."""
    joints_rad = np.array([sample.joints_rad for sample in samples])
    return bool(np.all(np.ptp(joints_rad, axis=0) <= STILL_RAD))
