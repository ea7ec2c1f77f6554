"""The driver of ABB against the simulated controller: both web services, and the stream."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.abb import first_contact, robot_egm
from drivers.abb.egm import PositionStream, Sample
from drivers.abb.robot_egm import AbbEgmRobot
from fakes.abb.controller import AbbController
from fakes.abb.server import AbbServer, egm_robot
from fakes.faults import Faults
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from hilcell.alarms.alarm import line
from hilcell.alarms.catalogue import entry_of
from hilcell.cell.file import Cell, load_cell
from hilcell.clock import WallClock
from hilcell.geometry.kinematics import forward
from hilcell.ports import DeviceError, DeviceRefused, RobotReading, Stopped
from tests.drivers.peers import refusal
from tests.fakes.rail_bench import until
from tests.whole.bench import ran

pytestmark = pytest.mark.waits

ABB = load_cell("abb")
HOME = np.radians(ABB.robot.home_deg)
TARGET = HOME + np.radians([20.0, -5.0, 8.0, 3.0, -4.0, 30.0])
FAR = HOME + np.radians([90.0, 0.0, 0.0, 0.0, 0.0, 0.0])


@dataclass
class Bench:
    """A controller on its wires, and its driver."""

    controller: AbbController
    server: AbbServer
    faults: Faults
    truth: CellTruth
    stop: threading.Event

    def robot(self, **options: Any) -> AbbEgmRobot:
        values = msgspec.to_builtins(
            {"smr_mm": ABB.robot.smr_mm, "joint": ABB.robot.joint, "model": "IRB 6700"}
        )
        generation = {"web_services": self.server.generation}
        return AbbEgmRobot(
            msgspec.convert(
                values | generation | self.server.address | options,
                AbbEgmRobot.Options,
                strict=False,
            ),
            WallClock(self.stop),
        )


@contextlib.contextmanager
def served(cell: Cell = ABB, speed: float = 10.0) -> Iterator[Bench]:
    faults, time = Faults(), CellTime(speed)
    truth = CellTruth(cell, 1, time, faults)
    server = AbbServer(Site(cell, truth, faults, time))
    with contextlib.closing(server):
        server.start()
        yield Bench(server.controller, server, faults, truth, threading.Event())


@pytest.fixture
def bench() -> Iterator[Bench]:
    with served() as bench:
        yield bench


@pytest.fixture
def robot(bench: Bench) -> Iterator[AbbEgmRobot]:
    robot = bench.robot()
    robot.connect()
    yield robot
    robot.close()


def refused(bench: Bench, **options: Any) -> DeviceError:
    """Return the error of a connect, after which nothing has moved and no session is open."""
    robot = bench.robot(**options)
    error = refusal(robot.connect)
    assert isinstance(error, DeviceRefused)
    assert entry_of(error.code).do
    assert not bench.controller.running
    assert not bench.truth.robot.moving
    assert bench.server.sessions.open == set()
    return error


def agrees(reading: RobotReading) -> bool:
    """Whether joints and pose are those of one standstill, by the nominal kinematics."""
    nominal = forward(ABB.robot.arm(), reading.joints_rad)
    return bool(np.all(np.abs(reading.pose[:3, 3] - nominal[:3, 3]) < 0.05))


@pytest.mark.parametrize("generation", [1, 2])
def test_a_session_of_each_generation(generation: int) -> None:
    with served(load_cell("abb", {"robot.options.web_services": str(generation)})) as bench:
        robot = bench.robot()
        (identity,) = robot.connect()
        assert identity.model == "IRB 6700-235/2.65 SIMULATED"
        assert (identity.serial, identity.maker) == ("6700512345", "ABB")
        assert identity.firmware.startswith(f"RobotWare {5 + generation}.")
        assert identity.simulated
        first = robot.read()
        assert first.still
        assert first.ended_s is None
        assert np.abs(first.joints_rad - HOME).max() < 1e-4
        reading = robot.move_to(TARGET, 100.0)
        assert reading.still
        assert np.abs(reading.joints_rad - TARGET).max() < 2e-4
        assert agrees(reading)
        assert bench.server.sessions.holder == ""  # a PC that dies keeps nothing
        robot.close()
        assert not bench.controller.running
        assert bench.server.sessions.open == set()


# -- refused at connect --------------------------------------------------------------------------


def test_manual_mode_is_refused(bench: Bench) -> None:
    bench.controller.mode = "MANR"
    assert (refused(bench).code, refused(bench).expected) == ("HC-B12", "AUTO")


@pytest.mark.parametrize(
    ("panel", "code"),
    [
        ("motoroff", "HC-B13"),
        ("guardstop", "HC-B11"),
        ("emergencystop", "HC-B10"),
        ("emergencystopreset", "HC-B10"),
        ("init", "HC-B13"),
        ("sysfail", "HC-B13"),
    ],
)
def test_a_controller_that_is_not_ready_is_refused(bench: Bench, panel: str, code: str) -> None:
    bench.controller.panel = panel
    bench.controller.log.append((3, 10013, "of yesterday"))
    error = refused(bench)
    assert (error.code, error.expected) == (code, "motoron")
    assert panel in error.found
    assert "yesterday" not in error.found


@pytest.mark.parametrize("percent", [3.0, 99.0, 0.0])
def test_a_lowered_speed_is_refused_with_its_value(bench: Bench, percent: float) -> None:
    bench.controller.set_ratio(percent)
    error = refused(bench)
    assert error.code == "HC-B84"
    assert f"{percent:g} %" in error.found


def test_a_wrong_password_is_refused_and_not_shown(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(first_contact.PASSWORD, "secret-of-the-pc")
    error = refused(bench)
    assert error.code == "HC-B80"
    assert "secret" not in str(error)
    (tmp_path / "password").write_text("robotics\n")
    robot = bench.robot(password_file=str(tmp_path / "password"))
    robot.connect()
    robot.close()
    assert refused(bench, password_file=str(tmp_path / "none")).code == "HC-B80"


def test_a_controller_without_the_option_is_refused(bench: Bench) -> None:
    bench.controller.options.pop()
    error = refused(bench)
    assert error.code == "HC-B82"
    assert "689-1" in error.expected


@pytest.mark.parametrize(
    "options", [{"model": "IRB 120"}, {"serial": "1"}, {"name": "IRB 6700-150/3.2"}]
)
def test_another_robot_is_refused(bench: Bench, options: dict[str, str]) -> None:
    assert refused(bench, **options).code == "HC-B05"


@pytest.mark.parametrize("name", ["IRB6700-235/2.65", "IRB 6700", "the left one"])
def test_a_name_that_states_no_other_type_is_none(bench: Bench, name: str) -> None:
    robot = bench.robot(name=name)
    robot.connect()
    robot.close()


def test_a_module_that_is_missing_or_of_another_version_is_refused(bench: Bench) -> None:
    bench.controller.loaded = False
    assert refused(bench).code == "HC-B86"
    bench.controller.loaded, bench.controller.version = True, 7
    error = refused(bench)
    assert (error.code, error.expected) == ("HC-B17", "3")


def test_another_tool_is_refused(bench: Bench) -> None:
    bench.controller.tool_mm = (98.0, 0.0, 127.01)
    error = refused(bench)
    assert error.code == "HC-B06"
    assert "127.010" in error.found


@pytest.mark.parametrize("load", ["0.001", "0", "-1", "NaN", "TRUE"])
def test_a_tool_whose_load_is_not_entered_is_refused(bench: Bench, load: str) -> None:
    bench.controller.load_kg = load
    error = refused(bench)
    assert (error.code, load.casefold() in error.found.casefold()) == ("HC-B89", load != "TRUE")
    (row,) = (each for each in bench.robot().inspect() if each.feature == "module hilcell")
    assert (row.state, "load" in row.note) == ("has not", True)


@pytest.mark.parametrize("generation", [1, 2])
def test_mastership_that_the_pendant_holds_is_refused(generation: int) -> None:
    with served(load_cell("abb", {"robot.options.web_services": str(generation)})) as bench:
        bench.controller.pendant_has_mastership = True
        error = refused(bench)
    assert (error.code, error.expected) == ("HC-B83", "nobody, or hilcell")
    shown = line(error.found)  # cut at its end
    assert shown.startswith("a local client has the mastership (application FlexPendant, ")
    assert "answer 403" in shown


def test_a_holder_that_the_controller_does_not_name_has_no_name(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.server.sessions.holder = "of another PC"
    error = refusal(bench.robot().connect)
    assert error.found.startswith("a remote client has the mastership (application RWS, uid 61): ")
    with first_contact.opened(bench.server.address) as services:
        states = [{"mastership": "remote", "application": "", "location": "", "uid": ""}]
        monkeypatch.setattr(services, "states", lambda _path: states)
        assert services.holder() == "a remote client has the mastership (not named)"


@pytest.mark.parametrize("refuses", ["start", "set_pointer"])
def test_a_refusal_without_another_holder_is_no_question_of_mastership(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, refuses: str
) -> None:
    """The program pointer is set while the driver itself has the mastership."""
    monkeypatch.setattr(bench.controller, refuses, lambda *_: False)
    error = refusal(bench.robot().connect)
    assert (error.code, "403" in error.found) == ("HC-B03", True)


def test_a_virtual_controller_counts_as_simulated(bench: Bench) -> None:
    bench.controller.kind = "Virtual Controller"
    robot = bench.robot()
    (identity,) = robot.connect()
    robot.close()
    assert identity.simulated
    assert identity.model.endswith("(virtual controller, simulated)")


def test_a_program_that_is_not_ours_is_left_alone(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(AbbEgmRobot, "ANSWERED_S", 0.1)
    assert bench.controller.set_pointer("hc_main")
    assert bench.controller.start()
    monkeypatch.setattr(bench.controller, "_interrupt", lambda _name: None)
    error = refusal(bench.robot().connect)
    assert error.code == "HC-B67"
    assert bench.controller.running


def test_a_program_of_a_dead_pc_is_ended(bench: Bench) -> None:
    assert bench.controller.set_pointer("hc_main")
    assert bench.controller.start()
    robot = bench.robot()
    robot.connect()
    assert robot.move_to(TARGET, 100.0).still
    robot.close()


@pytest.mark.parametrize(
    ("served_by", "stated", "sign"),
    [(1, 2, "without TLS"), (2, 1, "HTTPS")],
)
def test_web_services_of_the_other_generation_are_named(
    served_by: int, stated: int, sign: str
) -> None:
    values = {"robot.options.web_services": str(served_by)}
    with served(load_cell("abb", values)) as bench:
        error = refused(bench, web_services=stated)
    assert error.code == "HC-B88"
    assert sign in error.found
    assert error.expected.startswith(f"web services {stated}")
    assert f"web_services = {served_by}" in error.act


# -- the position stream -------------------------------------------------------------------------


def test_a_stream_to_another_pc_is_refused(bench: Bench) -> None:
    bench.server.resources.stream_host = "192.0.2.7"
    error = refused(bench)
    assert error.code == "HC-B85"
    assert "192.0.2.7" in error.found


def test_a_channel_without_a_port_is_refused(bench: Bench) -> None:
    bench.server.resources.stream_port = 0
    assert refused(bench).code == "HC-B85"


def test_a_channel_that_does_not_exist_is_refused(bench: Bench) -> None:
    error = refused(bench, egm_device="Other")
    assert (error.code, "UCdevice" in error.found) == ("HC-B85", True)
    assert error.expected.startswith("Other, ")


def test_a_module_that_streams_to_another_channel_is_refused(bench: Bench) -> None:
    bench.controller.streams_to = "Other"
    error = refused(bench)
    assert (error.code, error.found.endswith("device Other")) == ("HC-B85", True)
    assert error.expected.startswith("UCdevice, ")


def test_a_stream_to_another_port_does_not_come(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.abb.egm.PositionStream.SILENT_S", 0.1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        bench.server.resources.stream_port = free.getsockname()[1]
    error = refusal(bench.robot().connect)
    assert (error.code, error.expected) == ("HC-B85", "one in 4 ms")
    assert not bench.controller.running


def test_a_stream_of_another_robot_is_refused(bench: Bench) -> None:
    bench.server.stream.off_deg = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    error = refused(bench)
    assert error.code == "HC-B85"
    assert "another robot" in error.expected


def test_a_second_controller_shows_at_connect(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where its first position comes after the controller's."""
    foreign = egm_robot(5, 1.0, np.zeros(6), motors_on=True, running=True)
    first = PositionStream.fresh
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))

        def fresh(stream: PositionStream, silent_s: float | None = None) -> Sample:
            found = first(stream, silent_s)
            other.sendto(foreign, ("127.0.0.1", stream.port))
            return found

        monkeypatch.setattr(PositionStream, "fresh", fresh)
        error = refused(bench)
    assert (error.code, error.expected) == ("HC-B85", "one controller")


def test_a_controller_whose_time_stands_still_is_noticed(
    bench: Bench, robot: AbbEgmRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_s, joints_deg = bench.controller.measured()
    monkeypatch.setattr(bench.controller, "measured", lambda: (at_s, joints_deg))
    error = refusal(robot.read)
    assert (error.code, error.act) == ("HC-B26", "restart the controller")
    assert "time" in error.found


def test_two_controllers_that_answer_are_refused(bench: Bench, robot: AbbEgmRobot) -> None:
    foreign = egm_robot(5, 1.0, np.zeros(6), motors_on=True, running=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(foreign, ("127.0.0.1", bench.server.stream.port))
        error = refusal(robot.read)
    assert (error.code, error.expected) == ("HC-B85", "one controller")


def test_a_stream_that_ends_is_noticed(
    bench: Bench, robot: AbbEgmRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.abb.egm.PositionStream.SILENT_S", 0.1)
    bench.server.stream.vanish()
    assert refusal(lambda: robot.move_to(TARGET, 100.0)).code == "HC-B85"


def test_a_wait_for_a_position_ends_at_a_stop(bench: Bench, robot: AbbEgmRobot) -> None:
    bench.server.stream.vanish()
    person = threading.Timer(0.1, bench.stop.set)
    person.start()
    with pytest.raises(Stopped):
        robot.fresh_position()
    person.join()


# -- moving --------------------------------------------------------------------------------------

WAITS_S = {  # of a robot that gets nowhere, in place of several seconds
    "robot.frozen": ("STALL_S", 0.5),
    "robot.ack_previous": ("STALL_S", 0.5),
    "robot.stops_short": ("REST_S", 0.3),
    "robot.wrong_turn": ("REST_S", 0.3),
}


@pytest.mark.parametrize(
    ("fault", "value", "codes"),
    [
        ("robot.e_stop", True, {"HC-B10"}),
        ("robot.stopmess", True, {"HC-B14"}),
        ("robot.mode_t1", True, {"HC-B12"}),
        ("robot.override_zero", True, {"HC-B16", "HC-B23"}),
        ("robot.deselected", True, {"HC-B83"}),
        ("robot.restarted", True, {"HC-B13"}),
        ("robot.wrong_tool", True, {"HC-B06"}),
        ("robot.softlimit", True, {"HC-B20"}),
        ("robot.stops_short", 0.1, {"HC-B24"}),
        ("robot.wrong_turn", True, {"HC-B24"}),
        ("robot.frozen", True, {"HC-B23"}),
        ("robot.ack_previous", True, {"HC-B23"}),
        ("robot.bad_number", "nan", {"HC-B26"}),
        ("robot.idle_close", True, {"HC-B02"}),
        ("robot.no_reply", True, {"HC-B02"}),
        ("robot.half_open", True, {"HC-B02"}),
        ("robot.glued_reply", True, {"HC-B02"}),
        ("robot.vanish", True, {"HC-B01", "HC-B02", "HC-B85"}),
    ],
)
def test_a_fault_of_a_motion_ends_it(
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
    value: bool | float | str,
    codes: set[str],
) -> None:
    if fault in WAITS_S:
        monkeypatch.setattr(robot_egm, *WAITS_S[fault])
    monkeypatch.setattr("drivers.abb.http_channel.HttpChannel.ANSWER_S", 0.5)
    monkeypatch.setattr(AbbEgmRobot, "PANEL_S", 0.0)
    robot = bench.robot()
    robot.connect()
    bench.faults.set(fault, value, after=8 if fault == "robot.glued_reply" else 0)
    error = refusal(lambda: robot.move_to(FAR, 30.0))
    assert error.code in codes
    with contextlib.suppress(DeviceError):
        robot.close()
    if fault != "robot.vanish":
        assert not bench.truth.robot.axes_moving or fault == "robot.override_zero"


def test_the_event_log_says_why_a_program_stopped(bench: Bench, robot: AbbEgmRobot) -> None:
    bench.controller.log.append((2, 10000, "a warning"))
    bench.faults.set("robot.softlimit")
    error = refusal(lambda: robot.move_to(TARGET, 100.0))
    assert "(event 50027: Joint Out of Range)" in error.found


def test_events_with_numbers_that_are_no_json_are_read(bench: Bench) -> None:
    """RobotWare 7.20 writes an argument of event 41830 as -01."""
    bench.controller.log.append((3, 41830, "Error sending EGM UdpUc message"))
    with first_contact.opened(bench.server.address) as services:
        answer = services._ask("GET", "/rw/elog/0")
    assert b": -01}" in answer.body
    (row,) = (each for each in bench.robot().inspect() if each.feature == "event log")
    assert (row.state, row.note) == ("has", "event 41830: Error sending EGM UdpUc message")


def test_escape_sequences_of_the_event_log_do_not_come_through(bench: Bench) -> None:
    bench.controller.log.append((3, 50056, "Joint\x1b[31m collision"))
    (row,) = (each for each in bench.robot().inspect() if each.feature == "event log")
    assert row.note == "event 50056: Joint[31m collision"


def test_mastership_lost_during_a_motion_ends_it(bench: Bench, robot: AbbEgmRobot) -> None:
    def take() -> None:
        until(lambda: bench.truth.robot.moving)
        bench.controller.pendant_has_mastership = True

    person = threading.Thread(target=take)
    person.start()
    error = refusal(lambda: robot.move_to(FAR, 10.0))
    person.join()
    assert error.code == "HC-B83"
    assert "(application FlexPendant, " in error.found
    assert error.expected == "nobody, or hilcell"


def test_a_module_that_another_has_started_is_noticed(bench: Bench, robot: AbbEgmRobot) -> None:
    bench.controller.stop()
    assert bench.controller.write_symbol("hc_session", "7")
    assert bench.controller.set_pointer("hc_main")
    assert bench.controller.start()
    error = refusal(robot.read)
    assert (error.code, "session is 7" in error.found) == ("HC-B66", True)


def test_an_invalid_target_or_speed_moves_nothing(bench: Bench, robot: AbbEgmRobot) -> None:
    for target, speed in ((TARGET * np.nan, 10.0), (TARGET, 0.5), (TARGET, np.nan)):
        assert refusal(lambda t=target, s=speed: robot.move_to(t, s)).code == "HC-B28"  # type: ignore[misc]
    assert not bench.truth.robot.moving


def test_a_stop_brakes_and_holds(bench: Bench, robot: AbbEgmRobot) -> None:
    def stop() -> None:
        until(lambda: bench.truth.robot.moving)
        robot.stop()

    person = threading.Thread(target=stop)
    person.start()
    assert refusal(lambda: robot.move_to(FAR, 5.0)).code in ("HC-B66", "HC-B21")
    person.join()
    until(lambda: not bench.truth.robot.axes_moving)
    assert refusal(lambda: robot.move_to(TARGET, 5.0)).code == "HC-B21"
    at_rad = bench.truth.robot.state().joints_rad
    assert np.abs(at_rad - FAR).max() > 0.1


def test_a_stop_in_a_sweep_is_read_where_it_rests(bench: Bench, robot: AbbEgmRobot) -> None:
    """A stop ends the module's program, and with it the stream."""

    def run() -> None:
        with robot.sweep(0, HOME[0] + 0.5, 0.05) as sweep:
            sweep.kickoff()
            robot.stop()
            while not sweep.ended:
                sweep.collect()

    assert refusal(run).code in ("HC-B66", "HC-B21")
    until(lambda: not bench.truth.robot.axes_moving)
    reading = robot.read()
    assert reading.still
    assert np.abs(reading.joints_rad - bench.truth.robot.state().joints_rad).max() < 1e-5
    assert agrees(reading)
    assert abs(reading.joints_rad[0] - HOME[0]) < 0.4


def test_at_rest_the_module_ends_by_itself(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """So it gives its identity of EGM back: a controller has four."""
    robot = bench.robot()
    robot.connect()
    monkeypatch.setattr(bench.controller, "stop", lambda: pytest.fail("stopped"))
    robot.close()
    assert not bench.controller.running


def test_a_module_that_may_not_be_asked_to_end_is_stopped(bench: Bench, robot: AbbEgmRobot) -> None:
    bench.controller.pendant_has_mastership = True
    robot.close()
    assert not bench.controller.running


def test_a_lost_stop_is_made_good_by_the_watchdog(
    bench: Bench, robot: AbbEgmRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A controller whose web server takes nothing more brakes by itself."""
    monkeypatch.setattr(bench.controller, "stop", lambda: None)
    number = robot.command(FAR, 60.0)
    robot.stop()
    until(lambda: not bench.truth.robot.axes_moving)
    assert bench.controller.read_symbol("hc_state") == f"[3,{robot._session},{robot._life},1,8,1]"
    assert number == 1
    monkeypatch.undo()


def test_a_run_that_is_stopped_leaves_the_robot_at_rest(bench: Bench) -> None:
    robot = bench.robot()
    robot.connect()
    robot.command(FAR, 60.0)
    bench.stop.set()
    with pytest.raises(Stopped):
        robot.read()
    robot.close()
    assert not bench.truth.robot.axes_moving
    assert not bench.controller.running


def test_a_busy_controller_is_asked_again_and_then_refused(
    bench: Bench, robot: AbbEgmRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.abb.web_services.WebServices.AGAIN_S", 0.0)
    bench.server.sessions.open |= {f"{n:x}" for n in range(70)}
    assert robot.read().still  # in the session that it has
    monkeypatch.setattr("drivers.abb.web_services.WebServices.BUSY_S", 0.1)
    error = refusal(bench.robot().connect)
    assert error.code == "HC-B87"


def test_a_login_that_has_expired_is_renewed_before_each_motion(
    bench: Bench, robot: AbbEgmRobot
) -> None:
    bench.server.sessions.forget_challenges()
    assert robot.move_to(TARGET, 100.0).still
    robot.stop()
    until(lambda: not bench.controller.running)


# -- sweeps --------------------------------------------------------------------------------------


def test_a_sweep_has_the_controller_s_time(robot: AbbEgmRobot) -> None:
    start_rad, inner = HOME[0], np.empty((0, 2))
    while len(inner) <= 5:  # a busy PC takes few looks at a sweep of 0.8 s
        robot.move_to(HOME, 100.0)
        with robot.sweep(0, start_rad + 0.8, 0.1) as sweep:
            sweep.kickoff()
            samples = []
            while not sweep.ended:
                samples.append(sweep.collect())
            assert sweep.complete().still
        turned = np.array([(each.device_s, each.joints_rad[0]) for each in samples])
        assert np.all(np.diff(turned[:, 0]) > 0)
        inner = turned[(turned[:, 1] > start_rad + 0.05) & (turned[:, 1] < start_rad + 0.75)]
    line = np.polyfit(inner[:, 0], inner[:, 1], 1)
    assert np.abs(inner[:, 1] - np.polyval(line, inner[:, 0])).max() < 2e-5
    assert line[0] == pytest.approx(0.1, rel=1e-3)


def test_a_speed_that_is_changed_during_a_sweep_ends_it(
    bench: Bench, robot: AbbEgmRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(AbbEgmRobot, "PANEL_S", 0.0)

    def run() -> None:
        with robot.sweep(0, HOME[0] + 0.5, 0.05) as sweep:
            sweep.kickoff()
            bench.controller.set_ratio(50.0)
            while not sweep.ended:
                sweep.collect()

    assert refusal(run).code == "HC-B70"
    assert not bench.truth.robot.axes_moving


def test_a_sweep_that_is_left_is_braked(bench: Bench, robot: AbbEgmRobot) -> None:
    with robot.sweep(0, HOME[0] + 0.5, 0.05) as sweep:
        sweep.kickoff()
        sweep.collect()
    assert not bench.truth.robot.axes_moving
    assert robot.move_to(TARGET, 100.0).still


def test_a_sweep_that_is_refused_moves_nothing(bench: Bench, robot: AbbEgmRobot) -> None:
    def run() -> None:
        with robot.sweep(0, 0.5, 0.05) as sweep:
            bench.controller.mode = "MANR"
            sweep.kickoff()

    error = refusal(run)
    assert error.code == "HC-B12"
    assert not hasattr(error, "__notes__")
    assert not bench.truth.robot.moving
    bench.controller.mode = "AUTO"


def test_a_brake_that_comes_before_its_order_holds(bench: Bench, robot: AbbEgmRobot) -> None:
    assert bench.controller.write_symbol("hc_brake", "1")
    robot.command(FAR, 60.0)
    assert bench.controller.read_symbol("hc_state") == f"[3,{robot._session},{robot._life},1,9,1]"
    assert not bench.truth.robot.moving


# -- commissioning -------------------------------------------------------------------------------


def test_settings_are_the_controller_s(bench: Bench) -> None:
    found = bench.robot().settings()
    assert (found.model, found.serial) == ("IRB 6700-235/2.65 SIMULATED", "6700512345")
    limits_deg = [(joint.min_deg, joint.max_deg) for joint in ABB.robot.joint]
    assert found.joint_limits_rad is not None
    assert np.degrees(found.joint_limits_rad) == pytest.approx(np.array(limits_deg), abs=1e-3)
    assert found.tool is not None
    assert found.tool[:3, 3].tolist() == [*ABB.robot.smr_mm]
    assert bench.server.sessions.open == set()


def test_abilities(bench: Bench) -> None:
    rows = {each.feature: each.state for each in bench.robot().inspect()}
    assert set(rows.values()) == {"has"}
    bench.controller.options.pop()
    bench.controller.loaded = False
    rows = {each.feature: each.state for each in bench.robot().inspect()}
    assert rows["option Externally Guided Motion"] == rows["module hilcell"] == "has not"
    assert rows["robot type"] == "has"


def test_an_ability_that_lacks_names_what_is_expected(bench: Bench) -> None:
    wrong = {"name": "IRB 6700-150/3.2", "egm_device": "Other"}
    rows = {each.feature: each for each in bench.robot(**wrong).inspect()}
    for feature, found, expected in (
        ("robot type", "IRB 6700-235/2.65", "IRB 6700-150/3.2"),
        ("UDP unicast device Other", "UCdevice", "Other"),
    ):
        assert (rows[feature].state, rows[feature].needed) == ("has not", "mandatory")
        assert found in rows[feature].note
        assert expected in rows[feature].note.partition("; expected ")[2]


def test_discovery(bench: Bench) -> None:
    port = bench.server.address["port"]
    (found,) = AbbEgmRobot.discover({"host": "127.0.0.1", "port": port})
    assert "IRB 6700-235/2.65" in found.title
    assert found.options["serial"] == "6700512345"
    assert AbbEgmRobot.discover({}) == []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        closed = listener.getsockname()[1]
    assert AbbEgmRobot.discover({"host": "127.0.0.1", "port": closed}) == []


def test_absolute_accuracy_is_told(bench: Bench) -> None:
    bench.controller.absolute = True
    robot = bench.robot()
    robot.connect()
    assert robot.read().by_factory_links
    robot.close()


@pytest.mark.nightly
def test_the_shipped_cell_is_calibrated(tmp_path: Path) -> None:
    run = ran(tmp_path, "calibrate", {}, "--cell", "abb", "--machine-seed", "4")
    assert run.end["exit"] == 0
    figures = run.result["validation"]["S1100"]
    assert figures["chosen"]["mean"] < 0.1 * figures["before"]["mean"]


def test_a_run_on_the_shipped_cell_by_either_generation(tmp_path: Path) -> None:
    values = {"robot.options.web_services": "2", "layout.nest_samples": "2"}
    run = ran(tmp_path, "world-frame", values, "--cell", "abb")
    assert run.end["exit"] == 0
