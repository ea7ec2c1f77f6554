"""A robot of Universal Robots by RTDE and a script of ours, ``script/hilcell.script``.

The script is sent once. The PC then writes a target and a number into registers; the script moves
and acknowledges with that number. Motion has ended only when the joints are at the target and a
dwell's packages show no speed and no spread. Every package meanwhile is judged. A PC that dies
sends no heartbeat, and the script brakes.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Self

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import fields

from drivers.device_errors import ROBOT
from drivers.supervision import (
    HEARTBEAT_TIMEOUT_S,
    Deadline,
    MotionLimits,
    Watchdog,
    check_identity,
    check_sweep,
    checked_target,
    ignore_stop,
    joints_text,
    not_at_target,
    on_failure,
    planned_s,
    polls,
)
from drivers.universal_robots.controller_side import nothing_to_install, shipped_script
from drivers.universal_robots.first_contact import (
    abilities,
    controller_settings,
    describe_silence,
    field_types,
    panel_answers,
)
from drivers.universal_robots.rtde import Dashboard, Order, Runtime, UrLink, UrState
from drivers.wires import TcpLink
from hilcell.cell.file import Joint
from hilcell.decoding import typed
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
    is_simulated_name,
)
from hilcell.wire.channel import Host, Port

STALL_S = 5.0  # wire deadline: no axis moved and no acknowledgement came
REST_S = 3.0  # wire deadline: from the acknowledgement, or a brake of a sweep, to standstill
STEP_S = 0.5  # one poll counts for this long, at most
DWELL_S = 0.05  # of the packages that show standstill
LOST, STOPPED = 8, 9  # errors of the script
ERRORS = {
    1: ("HC-B20", "unknown command"),
    2: ("HC-B20", "target outside the safety limits"),
    LOST: ("HC-B43", "the PC's sign of life was late, and the robot has braked by itself"),
    STOPPED: ("HC-B21", "stopped"),
}


class UrRtdeRobot:
    """Satisfies `hilcell.ports.Robot` and `hilcell.ports.Sweeps`.

    For commissioning also `hilcell.ports.Inspects`, `hilcell.ports.Discovers` and
    `hilcell.ports.StatesSettings`.
    """

    HEARTBEAT_S = 0.2
    STARTED_S = 5.0  # wire deadline: from sending the script to its first state
    ENDED_S = 5.0  # wire deadline: a script of an earlier session ends
    BRAKED_S = 2.0  # wire deadline: a script that brakes (stopj, 2 rad/s2) goes on
    CLOCK_S = 0.5  # wire deadline: until the controller's time advances
    PROGRESS_S = 0.2  # between two checks of the progress of a motion
    COUNT_S = 1.0  # the script's counter must change within it
    AXIS_TOLERANCE_RAD = 2e-4
    STILL_RAD_S = 2e-3  # of a motion that was braked
    PROGRESS_DEG = 0.01
    TOOL_MM, TOOL_RAD = 1e-3, 1e-5

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Address and expected identity of the controller."""

        host: Host
        smr_mm: tuple[float, float, float]
        joint: list[Joint]
        rtde_port: Port = 30004
        script_port: Port = 30002
        dashboard_port: Port = 29999
        rate_hz: Annotated[float, Meta(ge=10, le=500)] = 125.0
        model: str = "UR10"
        serial: str = ""

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._link: UrLink | None = None
        self._dashboard: Dashboard | None = None
        self._stop_line: Dashboard | None = None
        self.watch = Watchdog(ROBOT, "HC-B27", clock)
        self._speed_deg_s = np.array([joint.speed_deg_s for joint in options.joint])
        self._session = 0
        self._order = Order(0, np.zeros(6), 0.0)
        self.rest_rad = np.zeros(6)  # the last target, or the position at connect
        self._count, self._counted_s = 0, 0.0  # of the script's loop, and when it last changed
        self._heartbeat_due_s = self._seen_s = 0.0
        self._asked_s = 0.0  # when the state of the last reading was asked for
        self._moving = self._stopped = self._started = False
        self._ended_s: float | None = None  # when the end of the last motion was detected

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        """Open all connections, verify everything, and send the script; nothing moves."""
        self._close_wires()
        self._session = secrets.randbelow(UrLink.MAX_NUMBER) + Order.BRAKE + 1
        self._stopped, options = False, self._options
        with on_failure(self.close):
            self._open_panels()
            identity = self._identify()
            self._check_remote()
            self._link = UrLink(options.host, options.rtde_port, options.rate_hz, self._check_wait)
            if state_error := self._link.next().problem(moving=False):
                raise state_error
            self._end_former_script()
            self._start_script()
            state = self._link.fresh()
            self._check_tool(state)
            self.rest_rad = state.joints_rad
        return [identity]

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        target_rad = checked_target(joints_rad, speed_percent)
        distance_deg = np.degrees(target_rad - self.rest_rad)
        planned = planned_s(distance_deg, self._speed_deg_s, speed_percent)
        # The script takes the speed of the joint that moves farthest; the others keep step with it.
        leading_deg = float(np.max(np.abs(distance_deg)))
        slowest = float(np.radians(np.min(self._speed_deg_s))) * speed_percent / 100.0
        speed_rad_s = np.radians(leading_deg) / planned if planned > 0.0 else slowest
        try:
            number = self.command(target_rad, speed_rad_s)
            limits = MotionLimits(planned, STALL_S, self.PROGRESS_DEG)
            due_s = time.monotonic() + self.PROGRESS_S
            while not self.acknowledged(number):
                if time.monotonic() >= due_s:
                    due_s = time.monotonic() + self.PROGRESS_S
                    self.check_progress(limits, number, self.link().next())
            return self.rest(target_rad)
        finally:
            self.watch.stop()

    def read(self) -> RobotReading:
        states = self._dwell()
        still = not self._moving and at_rest(states)
        return self._reading(states[-1], still=still)

    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> UrSweep:
        full_rad_s = float(np.radians(self._speed_deg_s[axis])) if 0 <= axis < 6 else np.nan
        return UrSweep(self, self._clock, axis, end_rad, speed_rad_s, full_rad_s)

    def stop(self) -> None:
        """Brake and end the script, over all wires; any thread; waits for no answer."""
        self._stopped = True
        Release(self._link, self._stop_line, self._session).stop()

    def close(self) -> None:
        """End the script, so that registers move nothing any more, then close all connections.

        Raises `DeviceError` where a script was started, and its end or rest is not confirmed.
        """
        try:
            if self._started:
                self._stopped = True
                Release(self._link, self._stop_line, self._session).leave_at_rest()
        finally:
            self._started = False
            self._close_wires()

    # -- commissioning ------------------------------------------------------------------------

    def inspect(self) -> list[Ability]:
        options = self._options
        return abilities(
            panel_answers(options.host, options.dashboard_port),
            controller_settings(options.host, options.script_port),
            field_types(options.host, options.rtde_port, options.rate_hz),
        )

    def settings(self) -> RobotSettings:
        """Return model and serial number of the dashboard, the rest of the secondary client."""
        options = self._options
        answers = panel_answers(options.host, options.dashboard_port)
        limits_rad, tool = controller_settings(options.host, options.script_port)
        model, serial = answers["get robot model"], answers["get serial number"]
        return RobotSettings(model, serial, limits_rad, tool, None)

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the controller whose dashboard server answers at the host, if one is given."""
        host, usual = known.get("host"), {each.name: each.default for each in fields(cls.Options)}
        if not isinstance(host, str):
            return []
        ports = {
            name: typed(known.get(name, usual[name]), int)
            for name in ("rtde_port", "script_port", "dashboard_port")
        }
        found: dict[str, object] = {"host": host, **{n: p for n, p in ports.items() if n in known}}
        try:
            answers = panel_answers(host, ports["dashboard_port"])
        except DeviceError as error:
            silence = describe_silence(host, ports["rtde_port"])
            if error.code == ROBOT.unreachable and not silence:
                return []
            return [Candidate(silence or f"{host}: {error.found}", found, [])]
        model, serial = answers["get robot model"], answers["get serial number"]
        software = answers["PolyscopeVersion"] or "version unknown"
        if model is None or serial is None:
            title = f"Universal Robots at {host}, {software}: required is {UrLink.POLYSCOPE}"
            return [Candidate(title, found, [])]
        address, maker = f"{host}:{ports['rtde_port']}", "Universal Robots"
        simulated = is_simulated_name(model)
        identity = Identity(ROBOT.name, model, serial, address, simulated, "robot", maker, software)
        title = f"Universal Robots {model}, serial number {serial}, {software}, at {host}"
        return [Candidate(title, {**found, "model": model, "serial": serial}, [identity])]

    @classmethod
    def controller_side(cls, options: Mapping[str, object]) -> ControllerSide:
        return nothing_to_install(options)

    # -- connecting ---------------------------------------------------------------------------

    def _identify(self) -> Identity:
        options, panel = self._options, self._panel()
        model, serial = panel.answer_to("get robot model"), panel.answer_to("get serial number")
        software = panel.answer_to("PolyscopeVersion") or "version unknown"
        if model is None or serial is None:
            untold = "model" if model is None else "serial number"
            found = f"this PolyScope ({software}) does not tell its {untold}"
            raise ROBOT.refused("HC-B69", "connect", found, expected=UrLink.POLYSCOPE)
        check_identity(model, options.model, serial, options.serial)
        address, maker = f"{options.host}:{options.rtde_port}", "Universal Robots"
        simulated = is_simulated_name(model)
        return Identity(ROBOT.name, model, serial, address, simulated, "robot", maker, software)

    def _check_remote(self) -> None:
        """Refuse local control; a controller without the question (CB3) is always remote."""
        if (answer := self._panel().ask("is in remote control")).casefold() == "false":
            raise ROBOT.refused(
                "HC-B60", "connect", f"is in remote control: {answer}", expected="true"
            )

    def _end_former_script(self) -> None:
        """End a script of ours that a dead engine left behind; refuse any other program."""
        link = self.link()
        if (before := link.next()).runtime_state == Runtime.STOPPED and not self._started:
            return
        if self._is_own_script(before):
            self._panel().ask("stop")
        for _ in polls(self.ENDED_S, STEP_S):
            state = link.fresh()
            if state.runtime_state == Runtime.STOPPED and at_rest([state]):
                self._started = False
                return
        found = f"{state.runtime}, {self.ENDED_S:.0f} s after stop"
        expected = f"{Runtime.STOPPED} (stopped), at rest"
        raise ROBOT.refused("HC-B25", "connect", found, expected=expected)

    def _is_own_script(self, before: UrState) -> bool:
        """Whether a script of ours plays; false for any program that stops by itself.

        Our script's counter stops while it brakes, so it has the time of a brake to continue.
        Raises `DeviceRefused` for another program.
        """
        for _ in polls(self.BRAKED_S, STEP_S):
            state = self.link().fresh()
            if state.count != before.count:
                return True
            if state.runtime_state in (Runtime.STOPPING, Runtime.STOPPED):
                return False
        found = f"{state.runtime}, and it is no script of hilcell"
        expected = f"{Runtime.STOPPED} (stopped)"
        raise ROBOT.refused("HC-B67", "connect", found, expected=expected)

    def _start_script(self) -> None:
        """Send the script; return when its state shows that it runs."""
        link, options = self.link(), self._options
        # The script may begin before these registers arrive, which must move nothing then.
        self._order = Order(0, link.fresh().joints_rad, 0.0, command=Order.NOTHING)
        link.write(self._order)
        line = TcpLink(ROBOT, options.host, options.script_port, self._check_wait)
        try:
            self._started = True
            line.send(script_text(self._session), "send the script")
            for _ in polls(self.STARTED_S, STEP_S):
                state = link.fresh()
                if state.session == self._session and state.acknowledged == 0:
                    break
                line.receive(65536, Deadline(0.0))  # states, not used
            else:
                self._check_remote()
                raise self._script_ended(state, f"no word of it within {self.STARTED_S:.0f} s")
        finally:
            line.close()
        self._count, self._counted_s = state.count, state.by_s
        self._moving = False

    def _check_tool(self, state: UrState) -> None:
        """Refuse a tool that is not the cell file's: the pose would be another point's."""
        expected = np.array([*self._options.smr_mm, 0.0, 0.0, 0.0])
        limits = np.array([self.TOOL_MM] * 3 + [self.TOOL_RAD] * 3)
        if not bool(np.all(np.abs(state.tool - expected) <= limits)):
            form = "X {:.3f}, Y {:.3f}, Z {:.3f}, RX {:.3f}, RY {:.3f}, RZ {:.3f}".format
            found = f"the controller's TCP is {form(*state.tool)}"
            own = f"robot.smr_mm of the cell file, {form(*expected)}"
            raise ROBOT.refused("HC-B06", "connect", found, expected=own)

    # -- moving -------------------------------------------------------------------------------

    def command(self, target_rad: Array, speed_rad_s: float) -> int:
        """Start a motion to joints (6,); return its number."""
        if self._stopped:
            raise ROBOT.failed("HC-B21", "move", "the robot was stopped")
        self._open_panels()
        self.check_state(self.link().next())
        number = self._order.sequence % UrLink.MAX_NUMBER + 1
        self._order = Order(number, target_rad, speed_rad_s)
        self._moving, self._ended_s = True, None
        self.watch.start()
        self._seen_s = time.monotonic()
        self.heartbeat()
        return number

    def heartbeat(self) -> None:
        self._heartbeat_due_s = time.monotonic() + self.HEARTBEAT_S
        self.link().write(self._order)

    def acknowledged(self, number: int) -> bool:
        """Wait for the next packages; return whether one shows that a motion has ended.

        Raises `DeviceError` for a faulty state, or where the script refused the motion.
        """
        states = self.link().following(self._seen_s)
        self._seen_s = states[-1].by_s
        for state in states:
            if state.acknowledged == number and state.error != 0:
                self._clock.check()  # the run's own stop brakes by the script as well
                self._check_health(state)
                code, text = ERRORS.get(state.error, ("HC-B20", "unknown"))
                found = f"error {state.error} of the script: {text}"
                act = "read the panel, then resume"
                raise ROBOT.failed(code, "move", found, act=act, error=state.error)
            self.check_state(state)
        return states[-1].acknowledged == number

    def _check_health(self, state: UrState) -> None:
        if state_error := state.problem(moving=self._moving):
            raise state_error

    def check_state(self, state: UrState) -> None:
        """Raise `DeviceError` where a state forbids to continue."""
        self._check_health(state)
        if state.runtime_state != Runtime.PLAYING or state.session != self._session:
            raise self._script_ended(state, "")
        if state.count != self._count:
            self._count, self._counted_s = state.count, state.by_s
        elif not state.by_s - self._counted_s <= self.COUNT_S:
            raise self._script_ended(state, f"its counter stands at {state.count}")

    def check_progress(self, limits: MotionLimits, number: int, state: UrState) -> None:
        """Raise `DeviceError` where a motion stalls or creeps."""
        now_deg, expected = np.degrees(state.joints_rad), f"acknowledged {number}"
        where = f"at {joints_text(now_deg)}, acknowledged {state.acknowledged}"
        if limits.stalled(now_deg):
            raise limits.stall_error(where, expected, now_deg)
        if limits.overdue(self._clock.now_s(), 100.0 * state.speed_fraction):
            raise limits.time_error(where, expected, now_deg)

    def rest(self, target_rad: Array) -> RobotReading:
        """Return the reading at rest at joints (6,), after an acknowledged motion."""
        for _ in polls(REST_S, STEP_S):
            began_s, states = self._clock.pc_s(), self._dwell()
            for state in states:
                self.check_state(state)
            last = states[-1]
            arrived = np.abs(last.joints_rad - target_rad) <= self.AXIS_TOLERANCE_RAD
            if bool(np.all(arrived)) and at_rest(states):
                # The pose means something only with the tool that connect has verified.
                self._check_tool(last)
                self._moving, self.rest_rad = False, target_rad
                self._ended_s = began_s
                return self._reading(last, still=True)
        target_deg, axes_deg = np.degrees(target_rad), np.degrees(last.joints_rad)
        tolerance = f"{joints_text(target_deg)} +-{np.degrees(self.AXIS_TOLERANCE_RAD):.3f}"
        raise not_at_target(joints_text(axes_deg), tolerance, axes_deg, target_deg)

    def _dwell(self) -> list[UrState]:
        """Return the states of a dwell that began after this call."""
        link = self.link()
        first = link.next()
        self._clock.wait(DWELL_S)
        self._asked_s = self._clock.pc_s()
        last = link.fresh()
        for _ in polls(self.CLOCK_S, STEP_S):
            if last.timestamp_s > first.timestamp_s:
                dwell = (each for each in link.following(first.by_s) if each.by_s <= last.by_s)
                return [first, *dwell]
            last = link.next()  # several packages may have been in transit
        found = f"the controller's time stands at {last.timestamp_s:.3f} s"
        expected = f"a later time within {self.CLOCK_S:g} s"
        raise ROBOT.failed("HC-B26", "read", found, expected=expected)

    def _reading(self, state: UrState, *, still: bool) -> RobotReading:
        """Return a reading of a dwell's last state; no part of it is older than its time."""
        return RobotReading(
            state.joints_rad, state.pose, still, self._asked_s, self._ended_s, by_factory_links=True
        )

    # -- also for a sweep ----------------------------------------------------------------------

    def link(self) -> UrLink:
        return ROBOT.connected(self._link)

    def brake(self, number: int) -> None:
        """Brake a motion by the script; return at standstill, also while a stop is on."""
        begun_s = time.monotonic()
        self._order = replace(self._order, stop=Order.BRAKE)
        self.heartbeat()
        for _ in polls(REST_S):
            state = self.link().fresh(patiently=True)
            done = state.acknowledged == number and state.error in (STOPPED, LOST)
            ended = state.runtime_state != Runtime.PLAYING or done
            if ended and bool(np.all(np.abs(state.speeds_rad_s) <= self.STILL_RAD_S)):
                break
            self.heartbeat()
        else:
            found = f"not at rest {time.monotonic() - begun_s:.1f} s after the brake"
            raise ROBOT.failed("HC-B71", "sweep", found, expected=f"at rest within {REST_S:g} s")
        self._order = replace(self._order, stop=Order.GO)
        self.heartbeat()
        self._moving, self.rest_rad = False, state.joints_rad

    # -- wires --------------------------------------------------------------------------------

    def _script_ended(self, state: UrState, found: str) -> DeviceError:
        """Return the error of a script that does not run; local control comes first."""
        try:
            self._check_remote()
        except DeviceRefused as error:
            return error
        if not found:
            found = state.runtime
            if state.runtime_state == Runtime.PLAYING:
                found = "another script of hilcell has taken the robot"
        return ROBOT.failed("HC-B66", "move", found, expected="the script that hilcell sent")

    def _open_panels(self) -> None:
        """Connect to the dashboard; where it has closed an idle connection meanwhile, again."""
        self._dashboard = self._open_panel(self._dashboard, self._check_wait)
        # The stop must get through while the run is already stopping.
        self._stop_line = self._open_panel(self._stop_line, ignore_stop)

    def _open_panel(self, before: Dashboard | None, check: Callable[[], None]) -> Dashboard:
        if before is not None:
            if before.is_open():
                return before
            before.close()
        return Dashboard(self._options.host, self._options.dashboard_port, check)

    def _panel(self) -> Dashboard:
        return ROBOT.connected(self._dashboard)

    def _check_wait(self) -> None:
        self._clock.check()
        self.watch.feed()
        if self.watch.active and time.monotonic() >= self._heartbeat_due_s:
            self.heartbeat()

    def _close_wires(self) -> None:
        for line in (self._link, self._dashboard, self._stop_line):
            if line is not None:
                line.close()
        self._link = self._dashboard = self._stop_line = None


def script_text(session: int) -> bytes:
    return (
        shipped_script()
        .replace("HC_SESSION", str(session))
        .replace("HC_LIFE", f"{HEARTBEAT_TIMEOUT_S:g}")
        .encode()
    )


def at_rest(states: Sequence[UrState]) -> bool:
    """Whether no joint moves, by speed and by spread."""
    joints_rad = np.array([state.joints_rad for state in states])
    speeds = np.abs([state.speeds_rad_s for state in states])
    still = np.all(np.ptp(joints_rad, axis=0) <= 2e-5)  # rad; a joint that holds dithers
    return bool(still and np.all(speeds <= 2e-3))  # rad/s


class UrSweep:
    """Satisfies `hilcell.ports.Sweep`: one axis moves slowly while its joints are read.

    The script multiplies the ordered speed by the speed slider at the panel: a slider that is moved
    meanwhile ends the sweep.
    """

    PROGRESS_DEG = 0.002
    POLL_S = 0.05  # while the end is waited for
    SAME_SPEED = 1e-3

    def __init__(
        self,
        robot: UrRtdeRobot,
        clock: Clock,
        axis: int,
        end_rad: float,
        speed_rad_s: float,
        full_rad_s: float,
    ) -> None:
        check_sweep(axis, end_rad, speed_rad_s, full_rad_s)
        self.speed_rad_s, self.ended = speed_rad_s, False
        self._robot, self._clock = robot, clock
        self._axis, self._end_rad, self._wanted_rad_s = axis, end_rad, speed_rad_s
        self._number, self._moving = 0, False

    def __enter__(self) -> Self:
        """Set the speed; nothing moves."""
        robot = self._robot
        state = robot.link().fresh()
        robot.check_state(state)
        self._fraction = state.speed_fraction
        self.speed_rad_s = self._wanted_rad_s * self._fraction
        self._target_rad = robot.rest_rad.copy()
        planned_s = abs(self._end_rad - self._target_rad[self._axis]) / self._wanted_rad_s
        self._target_rad[self._axis] = self._end_rad
        self._limits = MotionLimits(float(planned_s), STALL_S, self.PROGRESS_DEG)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._robot.watch.stop()
        if not self._moving:
            return
        try:
            self._robot.brake(self._number)
        except DeviceError as failure:
            if error is None:
                raise
            if not isinstance(error, Stopped):
                error.add_note(f"the brake was not confirmed: {failure}")

    def kickoff(self) -> None:
        """Start the motion; return when the controller has the order."""
        self._number = self._robot.command(self._target_rad, self._wanted_rad_s)
        self._moving = True
        self._robot.link().fresh()

    def collect(self) -> JointSample:
        """Return the joints as they left the controller after this call began."""
        before_s = self._clock.now_s()
        self._robot.heartbeat()
        state = self._robot.link().fresh()
        after_s = self._clock.now_s()
        self._look(state)
        return JointSample(state.joints_rad, before_s, after_s, state.timestamp_s)

    def complete(self) -> RobotReading:
        while not self.ended:
            self._clock.wait(self.POLL_S)
            self._robot.heartbeat()
            self._look(self._robot.link().fresh())
        reading = self._robot.rest(self._target_rad)
        self._moving = False
        return reading

    def _look(self, state: UrState) -> None:
        if self.ended:
            return
        if self._robot.acknowledged(self._number):
            self.ended = True
            return
        self._robot.check_progress(self._limits, self._number, state)
        if not abs(state.speed_fraction - self._fraction) <= self.SAME_SPEED:
            raise ROBOT.failed(
                "HC-B70",
                "sweep",
                f"target_speed_fraction is {state.speed_fraction:g}",
                expected=f"{self._fraction:g}",
                fraction=state.speed_fraction,
                wanted_fraction=self._fraction,
            )


class Release:
    """The end of a session: our script has ended and the arm is at rest, and both are confirmed.

    It polls without the run's clock, which no longer waits after a stop. A sent stop guarantees
    nothing: the dashboard may refuse it, be busy, or have closed an idle connection, and a register
    may not be read. So fresh packages are judged, and the stop is sent again over all wires until
    they show rest. It sends no heartbeat: a script that does not read the stop brakes by itself.
    """

    RELEASE_S = 5.0  # wire deadline: a brake (stopj, 2 rad/s2) from full speed, 3 s to standstill
    AGAIN_S = 0.5  # between two stops
    ANSWER_S = 0.5  # for the dashboard's answer, where the packages do not show rest

    def __init__(self, link: UrLink | None, panel: Dashboard | None, session: int) -> None:
        self._link, self._panel, self._session = link, panel, session
        self._answer = "none"  # of the dashboard to the last stop
        self._again_s = time.monotonic()

    def stop(self) -> None:
        """Send the stop over each wire that there is; raises `DeviceError` where none takes it."""
        stops = [partial(self._panel.send, "stop")] if self._panel is not None else []
        if self._link is not None:
            stops.append(partial(self._link.end_script, self._session))
        failures = list[DeviceError]()
        for stop in stops:
            try:
                stop()
            except DeviceError as error:
                failures.append(error)
        if failures and len(failures) == len(stops):
            raise failures[0]

    def leave_at_rest(self) -> None:
        """Return when no program plays and the joints are at rest; raises `DeviceError`."""
        link = self._link
        for _ in polls(self.RELEASE_S, STEP_S):
            try:
                self._stop_again()
                if link is None:
                    break
                first = link.fresh(patiently=True)
                time.sleep(DWELL_S)
                by_s = link.fresh(patiently=True).by_s
                between = link.following(first.by_s, patiently=True)
            except DeviceError as error:
                raise self._unconfirmed(error.found) from error
            states = [first, *(state for state in between if state.by_s <= by_s)]
            last, ended = states[-1], all(s.runtime_state == Runtime.STOPPED for s in states)
            # At rest no joint moves while the controller's time advances.
            if ended and at_rest(states) and last.timestamp_s > first.timestamp_s:
                return
            self._read_answer(Deadline(0.0))
        if link is None:
            raise self._unconfirmed("no connection by RTDE")
        fastest_deg_s = float(np.degrees(np.max(np.abs(last.speeds_rad_s))))
        where = joints_text(np.degrees(last.joints_rad))
        raise self._unconfirmed(
            f"{last.runtime}, {fastest_deg_s:.2f} deg/s at {where}, "
            f"{last.timestamp_s:.3f} s by the controller's clock"
        )

    def _stop_again(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._again_s:
            self._again_s = now_s + self.AGAIN_S
            self.stop()

    def _read_answer(self, deadline: Deadline) -> None:
        if self._panel is None:
            return
        try:
            self._answer = self._panel.last_answer(deadline) or self._answer
        except DeviceError as error:
            self._answer = error.found

    def _unconfirmed(self, found: str) -> DeviceError:
        self._read_answer(Deadline(self.ANSWER_S))
        return ROBOT.failed(
            "HC-B71",
            "close",
            f"the arm is not confirmed at rest: {found}; answer of the dashboard to stop: "
            f"{self._answer}",
            expected=f"program stopped and joints at rest within {self.RELEASE_S:g} s",
            act="keep away from the arm, it may move: press the E-stop; then see the panel",
            answer=self._answer,
        )
