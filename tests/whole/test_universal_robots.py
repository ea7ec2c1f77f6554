"""The driver of Universal Robots against the simulated controller, over its three ports."""

from __future__ import annotations

import contextlib
import signal
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.universal_robots import robot_rtde as robot_ur_rtde
from drivers.universal_robots.robot_rtde import STOPPED, UrRtdeRobot, script_text
from drivers.universal_robots.rtde import Dashboard, Order, Runtime, UrLink, UrState
from fakes.faults import Faults
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from fakes.universal_robots.server import UrController, UrServer
from fakes.wires import Listener
from hilcell.alarms.catalogue import entry_of
from hilcell.cell.file import load_cell
from hilcell.clock import WallClock
from hilcell.geometry.kinematics import forward
from hilcell.ports import (
    Array,
    DeviceError,
    DeviceRefused,
    JointSample,
    Robot,
    Stopped,
    Sweep,
    Sweeps,
)
from tests.drivers.peers import refusal
from tests.fakes.rail_bench import until
from tests.fakes.wires import RtdeClient, connected
from tests.whole.bench import Engine, sets, simulation

pytestmark = pytest.mark.waits

LAB = load_cell("lab")
HOME = np.radians(LAB.robot.home_deg)
TARGET = HOME + np.radians([20.0, -5.0, 8.0, 3.0, -4.0, 30.0])
FAR = HOME + np.radians([90.0, 0.0, 0.0, 0.0, 0.0, 0.0])
OTHER = b"def other():\n  sync()\nend\n"


@dataclass
class Bench:
    """A robot on its wires, and its driver."""

    controller: UrController
    server: UrServer
    faults: Faults
    truth: CellTruth
    stop: threading.Event

    def robot(self, **options: Any) -> UrRtdeRobot:
        values = self.server.address | {"smr_mm": LAB.robot.smr_mm, "joint": LAB.robot.joint}
        return UrRtdeRobot(
            msgspec.convert(
                {k: v for k, v in values.items() if k != "joint"}
                | {"joint": msgspec.to_builtins(LAB.robot.joint)}
                | options,
                UrRtdeRobot.Options,
            ),
            WallClock(self.stop),
        )

    def play(self, script: bytes) -> None:
        port = self.server.address["script_port"]
        assert isinstance(port, int)
        with connected(port) as wire:
            wire.sendall(script)
            until(lambda: self.controller.ask("running").endswith("true"))


# Of a robot that gets nowhere, how long it is waited for in place of several seconds.
WAITS_S = {
    "robot.frozen": ("STALL_S", 0.5),
    "robot.ack_previous": ("STALL_S", 0.5),
    "robot.stops_short": ("REST_S", 0.3),
    "robot.wrong_turn": ("REST_S", 0.3),
}
# Packages that no longer come, or are wrong, prove no rest.
PROVES_NOTHING = {
    f"robot.{name}"
    for name in (
        "stale_position", "bad_number", "tag_mismatch", "idle_close", "no_reply", "half_open",
        "vanish",
    )
}  # fmt: skip


@pytest.fixture
def bench() -> Iterator[Bench]:
    faults, time = Faults(), CellTime(10.0)
    truth = CellTruth(LAB, 1, time, faults)
    server = UrServer(Site(LAB, truth, faults, time))
    with contextlib.closing(server):
        server.start()
        yield Bench(server.controller, server, faults, truth, threading.Event())


@pytest.fixture
def robot(bench: Bench) -> Iterator[UrRtdeRobot]:
    robot = bench.robot()
    robot.connect()
    yield robot
    robot.close()


def refused(bench: Bench, **options: Any) -> str:
    """Return the alarm by which a robot is refused when it is connected."""
    error = refusal(bench.robot(**options).connect)
    assert isinstance(error, DeviceRefused)
    return error.code


def works(bench: Bench) -> None:
    robot = bench.robot()
    robot.connect()
    assert robot.move_to(TARGET, 100.0).still
    robot.close()


def samples_of(sweep: Sweep) -> list[JointSample]:
    """Return the samples of a sweep that was just started, until it has ended."""
    samples = []
    while not sweep.ended:
        samples.append(sweep.collect())
    return samples


def test_it_goes_where_it_is_sent(bench: Bench) -> None:
    robot = bench.robot()
    port: Robot = robot
    assert isinstance(robot, Sweeps)
    (identity,) = port.connect()
    assert (identity.model, identity.serial) == ("UR10e SIMULATED", "20225500147")
    assert (identity.simulated, identity.maker) == (True, "Universal Robots")
    reading = port.move_to(TARGET, 100.0)
    assert reading.still
    assert reading.by_factory_links
    assert np.abs(reading.joints_rad - TARGET).max() < 2e-5
    assert np.abs(reading.pose - forward(LAB.robot.arm(), reading.joints_rad)).max() < 1e-6
    assert reading.ended_s is not None
    assert reading.taken_s >= reading.ended_s
    again = port.read()
    assert again.still
    assert again.by_factory_links
    assert again.taken_s > reading.taken_s
    port.close()
    until(lambda: bench.controller.ask("running").endswith("false"))


def test_packages_that_are_split_and_glued(bench: Bench, robot: UrRtdeRobot) -> None:
    bench.faults.set("robot.split_reply", count=0)
    assert robot.move_to(TARGET, 100.0).still


@pytest.mark.parametrize(
    ("fault", "value", "code"),
    [
        ("robot.e_stop", True, "HC-B10"),
        ("robot.stopmess", True, "HC-B62"),
        ("robot.override_zero", True, "HC-B16"),
        ("robot.mode_t1", True, "HC-B60"),
        ("robot.deselected", True, "HC-B66"),
        ("robot.restarted", True, "HC-B13"),
        ("robot.softlimit", True, "HC-B20"),
        ("robot.stops_short", 0.1, "HC-B24"),
        ("robot.wrong_turn", True, "HC-B24"),
        ("robot.frozen", True, "HC-B23"),
        ("robot.ack_previous", True, "HC-B23"),
        ("robot.stale_position", True, "HC-B26"),
        ("robot.wrong_tool", True, "HC-B06"),
        ("robot.bad_number", "nan", "HC-B26"),
        ("robot.tag_mismatch", True, "HC-B26"),
        ("robot.idle_close", True, "HC-B02"),
        ("robot.no_reply", True, "HC-B02"),
        ("robot.half_open", True, "HC-B02"),
        ("robot.vanish", True, "HC-B02"),
    ],
)
def test_a_fault_in_a_motion(
    bench: Bench,
    robot: UrRtdeRobot,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
    value: Any,
    code: str,
) -> None:
    if fault in WAITS_S:
        monkeypatch.setattr(robot_ur_rtde, *WAITS_S[fault])
    bench.faults.set(fault, value, count=0)
    speed = 100.0 if fault in WAITS_S else 2.0  # a busy PC, too, polls while it moves
    assert refusal(lambda: robot.move_to(TARGET, speed)).code == code
    assert entry_of(code).do
    if fault in PROVES_NOTHING:
        monkeypatch.setattr(robot_ur_rtde.Release, "RELEASE_S", 0.2)
        with pytest.raises(DeviceError, match="the arm is not confirmed at rest") as left:
            robot.close()
        assert (left.value.code, "press the E-stop" in left.value.act) == ("HC-B71", True)


@pytest.mark.parametrize(
    ("status", "code"),
    [(2, "HC-B61"), (3, "HC-B62"), (4, "HC-B65"), (5, "HC-B11"), (6, "HC-B10"), (7, "HC-B10"),
     (8, "HC-B63"), (9, "HC-B64"), (11, "HC-B65")],
)  # fmt: skip
def test_each_safety_status_is_refused(bench: Bench, status: int, code: str) -> None:
    bench.controller.safety = status
    assert refused(bench) == code


def test_reduced_mode_ends_a_motion(bench: Bench, robot: UrRtdeRobot) -> None:
    bench.controller.safety = 2
    assert refusal(lambda: robot.move_to(TARGET, 100.0)).code == "HC-B61"


def test_local_control_is_refused(bench: Bench) -> None:
    bench.controller.remote = False
    assert refused(bench) == "HC-B60"


def test_ports_that_were_mixed_up_are_named(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Dashboard, "ANSWER_S", 0.5)  # there is nobody who would answer
    of_rtde, of_dashboard = (bench.server.address[name] for name in ("rtde_port", "dashboard_port"))
    for option, port in (("rtde_port", of_dashboard), ("dashboard_port", of_rtde)):
        assert option in refusal(bench.robot(**{option: port}).connect).found


@pytest.mark.parametrize("options", [{"model": "UR5e"}, {"serial": "20225500148"}])
def test_another_robot_is_refused(bench: Bench, options: dict[str, str]) -> None:
    assert refused(bench, **options) == "HC-B05"


def test_a_program_of_another_client_is_left_alone(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_ur_rtde.UrRtdeRobot, "BRAKED_S", 0.2)
    bench.play(OTHER)
    assert refused(bench) == "HC-B67"
    assert bench.controller.ask("programState") == "PLAYING other"


def test_registers_have_one_writer(bench: Bench, robot: UrRtdeRobot) -> None:
    assert refused(bench) == "HC-B68"
    assert robot.move_to(TARGET, 100.0).still


def moving(bench: Bench, robot: UrRtdeRobot, joints: Any = FAR) -> list[BaseException]:
    """Start a slow motion in a thread; return the list that its error will be in."""
    errors: list[BaseException] = []

    def move() -> None:
        try:
            robot.move_to(joints, 5.0)
        except (DeviceError, Stopped) as error:
            errors.append(error)

    threading.Thread(target=move, daemon=True).start()
    until(lambda: bench.truth.robot.moving)
    return errors


def test_another_script_in_its_place(bench: Bench, robot: UrRtdeRobot) -> None:
    errors = moving(bench, robot)
    bench.play(OTHER)
    until(lambda: bool(errors))
    assert isinstance(errors[0], DeviceError)
    assert errors[0].code == "HC-B66"
    until(lambda: not bench.truth.robot.moving)


def test_a_stop_from_another_thread(bench: Bench, robot: UrRtdeRobot) -> None:
    errors = moving(bench, robot)
    bench.stop.set()
    robot.stop()
    until(lambda: bool(errors))
    assert isinstance(errors[0], Stopped)
    until(lambda: not bench.truth.robot.moving)
    assert refusal(lambda: robot.move_to(HOME, 100.0)).code == "HC-B21"


def close_idle_panels(bench: Bench) -> None:
    """Have the dashboard server close its connections, and take new ones."""
    *_, dashboard = bench.server._listeners
    assert isinstance(dashboard, Listener)
    for client in list(dashboard._clients):
        client.shutdown(socket.SHUT_RDWR)


def refuse_stops(bench: Bench, monkeypatch: pytest.MonkeyPatch, *, but_from: int = 99) -> list[str]:
    """Have the dashboard refuse to stop, up to a number; return the list that each comes into."""
    ask, stops = bench.controller.ask, list[str]()

    def answer(command: str) -> str:
        if command != "stop":
            return ask(command)
        stops.append(command)
        return ask(command) if len(stops) >= but_from else "Failed to execute: stop"

    monkeypatch.setattr(bench.controller, "ask", answer)
    return stops


def lose_the_stop_register(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    write = bench.controller.write
    monkeypatch.setattr(
        bench.controller,
        "write",
        lambda values: write({k: v for k, v in values.items() if k != "input_int_register_27"}),
    )


def test_a_stop_that_the_dashboard_refuses_brakes_by_the_script(
    bench: Bench, robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_stops(bench, monkeypatch)
    moving(bench, robot)
    robot.stop()
    until(lambda: not bench.truth.robot.moving)
    assert bench.controller._error == STOPPED
    until(lambda: bench.controller.ask("running").endswith("false"))


def test_a_stop_whose_connection_the_dashboard_has_closed(bench: Bench, robot: UrRtdeRobot) -> None:
    moving(bench, robot)
    close_idle_panels(bench)
    robot.stop()
    until(lambda: not bench.truth.robot.moving)
    robot.close()
    assert bench.controller.ask("running").endswith("false")


def test_an_idle_dashboard_connection_that_was_closed_is_replaced_before_a_motion(
    bench: Bench, robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    lose_the_stop_register(bench, monkeypatch)
    close_idle_panels(bench)
    assert robot.move_to(TARGET, 100.0).still
    moving(bench, robot)
    robot.stop()
    until(lambda: not bench.truth.robot.moving)


def test_close_returns_when_the_arm_is_at_rest(
    bench: Bench, robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the program has ended long before, and the arm brakes slowly."""
    robot.move_to(HOME, 100.0)
    monkeypatch.setattr(bench.truth.robot, "brake", lambda: None)
    errors = moving(bench, robot, HOME + np.radians([6.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    bench.stop.set()
    robot.stop()
    until(lambda: bool(errors))
    robot.close()
    assert not bench.truth.robot.moving


def test_close_repeats_a_stop_that_was_not_carried_out(
    bench: Bench, robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_ur_rtde.Release, "AGAIN_S", 0.0)
    lose_the_stop_register(bench, monkeypatch)
    stops = refuse_stops(bench, monkeypatch, but_from=3)
    robot.close()
    assert len(stops) >= 3
    assert bench.controller.ask("running").endswith("false")


def test_close_names_a_script_that_plays_on(
    bench: Bench, robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_ur_rtde.Release, "RELEASE_S", 0.2)
    lose_the_stop_register(bench, monkeypatch)
    refuse_stops(bench, monkeypatch)
    error = refusal(robot.close)
    assert error.code == "HC-B71"
    assert "runtime_state is 2 (playing)" in error.found
    assert "Failed to execute: stop" in error.found
    robot.close()  # all wires are closed, nothing is left to confirm


def test_another_client_moves_nothing_after_close(
    bench: Bench, robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_stops(bench, monkeypatch)
    robot.close()
    bench.controller.write({"input_int_register_27": 0, "input_double_register_30": 1.0})
    bench.controller.write({"input_int_register_25": 1, "input_int_register_24": 77})
    assert not bench.truth.robot.moving


def test_a_script_is_ended_where_connect_fails_behind_it(bench: Bench) -> None:
    bench.faults.set("robot.wrong_tool")
    assert refused(bench) == "HC-B06"
    assert bench.controller.ask("running").endswith("false")


def test_a_script_left_behind_is_ended_by_the_next_connect(bench: Bench) -> None:
    bench.play(script_text(5))
    works(bench)


def test_a_script_of_ours_that_stops_by_itself_is_waited_for(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.play(script_text(5))
    controller, states = bench.controller, iter(range(20))
    controller._runtime = Runtime.STOPPING
    inner = controller.state

    def stopping() -> dict[str, Any]:
        if next(states, None) is None and controller._runtime == Runtime.STOPPING:
            controller._end_program()
        return inner()

    monkeypatch.setattr(controller, "state", stopping)
    ask = controller.ask  # the panel has no state of its own for a program that stops
    monkeypatch.setattr(controller, "ask", lambda line: ask(line).replace("STOPPING", "STOPPED"))
    works(bench)


def test_a_script_of_ours_that_brakes_is_no_program_of_another_client(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its counter stands until the arm does."""
    bench.play(script_text(5))
    loops, inner = iter(range(20)), bench.controller._run
    monkeypatch.setattr(
        bench.controller, "_run", lambda: inner() if next(loops, None) is None else None
    )
    works(bench)


def test_registers_that_arrive_after_the_script_move_nothing(bench: Bench) -> None:
    write, play = bench.controller.write, bench.controller.play
    bench.controller.write({"input_int_register_24": 5.0})
    played = threading.Event()

    def write_late(values: dict[str, float]) -> None:
        if "input_int_register_24" in values:
            played.wait(5.0)
        write(values)

    def play_first(script: str) -> None:
        play(script)
        played.set()

    bench.controller.write = write_late  # type: ignore[method-assign]  # the other order of ports
    bench.controller.play = play_first  # type: ignore[method-assign]  # the other order of ports
    robot = bench.robot()
    robot.connect()
    assert not bench.truth.robot.moving
    assert robot.move_to(TARGET, 100.0).still
    robot.close()


def test_a_sweep_at_its_speed(bench: Bench, robot: UrRtdeRobot) -> None:
    end = float(HOME[2]) + np.radians(10.0)
    with robot.sweep(2, end, float(np.radians(20.0))) as sweep:
        assert sweep.speed_rad_s == pytest.approx(np.radians(20.0))
        sweep.kickoff()
        samples = samples_of(sweep)
        reading = sweep.complete()
    assert reading.joints_rad[2] == pytest.approx(end, abs=1e-5)
    turned = np.array([sample.joints_rad for sample in samples])
    assert np.abs(turned[:, [0, 1, 3, 4, 5]] - HOME[[0, 1, 3, 4, 5]]).max() < 1e-4
    assert all(sample.before_s < sample.after_s for sample in samples)
    assert robot.move_to(HOME, 100.0).still


def test_the_joints_of_a_sweep_bear_the_controller_s_time(bench: Bench, robot: UrRtdeRobot) -> None:
    """However late they come, they are where the axis was at that time."""
    bench.faults.set("robot.late_reply", 0.005, count=0)
    start, inner = robot.read().joints_rad, np.empty((0, 2))
    while len(inner) <= 3:  # a busy PC takes few looks at a sweep of 0.8 s
        robot.move_to(start, 100.0)
        with robot.sweep(2, float(start[2] + 0.8), 0.1) as sweep:
            sweep.kickoff()
            samples = [sweep.collect(), *samples_of(sweep)]
            sweep.complete()
        turned = np.array([(s.device_s, s.joints_rad[2]) for s in samples])
        inner = turned[(turned[:, 1] > start[2] + 0.05) & (turned[:, 1] < start[2] + 0.75)]
    line = np.polyfit(inner[:, 0], inner[:, 1], 1)
    assert np.abs(inner[:, 1] - np.polyval(line, inner[:, 0])).max() < 2e-5
    assert line[0] == pytest.approx(0.1, rel=1e-3)


def test_the_time_of_a_state_is_that_of_its_joints(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the controller is held up while it makes the state, as on a busy PC."""
    now_s, arm = CellTime.now_s, bench.truth.robot

    def held_up(clock: CellTime) -> float:
        found_s = now_s(clock)
        threading.Event().wait(0.002)
        return found_s

    arm.move(FAR, 0.01)
    monkeypatch.setattr(CellTime, "now_s", held_up)
    states = [bench.controller.state() for _ in range(3)]
    assert arm.moving
    for state in states:
        joints_rad = arm.past(np.array([state["timestamp"]]))[0][0]
        assert np.abs(state["actual_q"] - joints_rad).max() < 1e-9


def test_a_sweep_that_is_left_is_braked(bench: Bench, robot: UrRtdeRobot) -> None:
    class Left(Exception):
        pass

    def leave() -> None:
        with robot.sweep(0, float(FAR[0]), 0.01) as sweep:
            sweep.kickoff()
            sweep.collect()
            raise Left

    with pytest.raises(Left):
        leave()
    assert not bench.truth.robot.moving
    assert robot.move_to(HOME, 100.0).still


def test_a_close_without_rtde_stops_by_the_dashboard_and_is_not_confirmed(
    bench: Bench, robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(link: UrLink) -> None:
        raise DeviceError("HC-B01", "Robot", "connect", "no RTDE")

    monkeypatch.setattr(UrLink, "_set_up", lost)
    with pytest.raises(DeviceError, match="no connection by RTDE") as left:
        robot.connect()
    assert left.value.code == "HC-B71"
    until(lambda: bench.controller.ask("running").endswith("false"))


def test_a_brake_ends_when_the_script_has_taken_it_and_no_joint_moves(
    robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A state at rest of before the brake proves as little as one that still rolls out."""
    now = robot.link().fresh()
    taken = replace(now, acknowledged=7, error=STOPPED)
    rolls = replace(taken, speeds_rad_s=np.full(6, 0.01))
    at_rest = replace(taken, joints_rad=now.joints_rad + 0.1)
    states, orders = iter([now, rolls, at_rest, now]), list[int]()
    with monkeypatch.context() as patch:
        patch.setattr(UrLink, "fresh", lambda link, patiently=False: next(states))
        patch.setattr(UrLink, "write", lambda link, order: orders.append(order.stop))
        robot.brake(7)
    assert robot.rest_rad is at_rest.joints_rad
    assert orders == [Order.BRAKE, Order.BRAKE, Order.BRAKE, Order.GO]


def test_a_sweep_whose_states_come_late_goes_on(bench: Bench, robot: UrRtdeRobot) -> None:
    """Each wait gives signs of life: three states of 0.6 s are longer than the script waits."""
    with robot.sweep(0, float(FAR[0]), 0.02) as sweep:
        sweep.kickoff()
        bench.faults.set("robot.late_reply", 0.6, count=0)
        for _ in range(2):
            sweep.collect()
            assert not sweep.ended
        bench.faults.set("robot.late_reply", 0.0, count=0)
    assert robot.move_to(HOME, 100.0).still


def test_the_slider_must_stay_during_a_sweep(bench: Bench, robot: UrRtdeRobot) -> None:
    def sweep_on() -> None:
        with robot.sweep(0, float(FAR[0]), 0.5) as sweep:
            sweep.kickoff()
            bench.controller.slide(0.5)
            samples_of(sweep)

    assert refusal(sweep_on).code == "HC-B70"


@pytest.mark.parametrize(
    ("axis", "end", "speed"), [(6, 0.0, 0.1), (0, np.nan, 0.1), (0, 1.0, 9.0), (0, 1.0, np.nan)]
)
def test_an_impossible_sweep(robot: UrRtdeRobot, axis: int, end: float, speed: float) -> None:
    assert refusal(lambda: robot.sweep(axis, end, speed)).code == "HC-B28"


@pytest.mark.parametrize(("joint", "speed"), [(np.nan, 50.0), (0.0, 0.0), (0.0, np.nan)])
def test_an_impossible_motion(robot: UrRtdeRobot, joint: float, speed: float) -> None:
    assert refusal(lambda: robot.move_to(HOME * 0 + joint, speed)).code == "HC-B28"


@pytest.mark.process
def test_the_script_brakes_when_the_engine_is_killed(tmp_path: Path) -> None:
    """It would be on its way for half a minute, however slow the PC that kills the engine."""
    slow = {"robot.speed_percent": "1.0"}
    with simulation(1.2, name="lab") as cell:
        words = sets({"simulation.address": cell.control} | slow)
        engine = Engine("run", "home", "--cell", "lab", "--runs", tmp_path, *words)
        with connected(cell.addresses["robot"]["rtde_port"]) as wire:
            states = RtdeClient(wire)
            states.begin(write=False)

            def move_from(joints_rad: Array) -> None:
                while np.abs(np.array(states.state()[2:8]) - joints_rad).max() < 0.001:
                    pass  # the test's time limit bounds the wait

            move_from(HOME)
            engine.kill()
            while (state := states.state())[-1] != 8:
                pass
            braked_rad = np.array(state[2:8])
            assert np.abs(braked_rad - np.radians(LAB.robot.safe_deg)).max() > 0.01
            again = Engine("resume", engine.run, "--runs", tmp_path)
            move_from(braked_rad)
            again.process.send_signal(signal.SIGTERM)
            assert again.rest()[-1]["exit"] == 4


def test_a_package_that_was_in_transit_is_no_stopped_clock(
    robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[UrState] = []
    following = UrLink.next

    def noted(link: UrLink) -> UrState:
        found.append(following(link))
        return found[-1]

    def late(link: UrLink, *, patiently: bool = False) -> UrState:
        return found[0]

    monkeypatch.setattr(UrLink, "next", noted)
    monkeypatch.setattr(UrLink, "fresh", late)
    assert robot.read().still
    assert found[-1].timestamp_s > found[0].timestamp_s
    monkeypatch.undo()


def test_a_clock_that_has_stopped_is_refused(
    robot: UrRtdeRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = robot.link().fresh()
    monkeypatch.setattr(UrLink, "next", lambda link: state)
    monkeypatch.setattr(UrLink, "fresh", lambda link, patiently=False: state)
    assert refusal(lambda: robot.rest(state.joints_rad)).code == "HC-B26"
    monkeypatch.undo()
