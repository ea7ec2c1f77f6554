"""A run whose robot is reached through EthernetKRL: faults by name, an engine that is killed."""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.kuka import eki_wire
from drivers.kuka import robot as kuka_robot
from hilcell.alarms import alarms_of
from hilcell.commands.cli import main
from hilcell.journal.runs import read_log
from tests.whole.bench import LOOK_S, Engine, Simulation, command, end_of, sets, simulation
from tests.whole.kuka_faults import KUKA_ENDS

EKI = {"robot.driver": "kuka-eki"}
MOVE = 1
SLOW = {"robot.speed_percent": "1"}
SHORT = {"base_frame.points": "4", "layout.nest_samples": "2", "plan.unattended_wait_s": "0"}
ENDS: dict[str, tuple[str, object]] = {
    **KUKA_ENDS,
    "robot.late_reply": ("HC-B02", 1.0),
    "robot.xml_bomb": ("HC-B49", True),
    "robot.no_end": ("HC-B49", True),
    "robot.vanish": ("HC-B01", True),
}
SURVIVED = ("robot.split_reply", "robot.glued_reply", "robot.stale_position")
PLACE = 'Percent="50" Life="%d"><Pos A1="%g" A2="-90" A3="90" A4="0" A5="60" A6="0" E1="0"/>'


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eki_wire, "ANSWER_S", 0.5)
    monkeypatch.setattr(eki_wire, "OPEN_S", 0.5)
    monkeypatch.setattr(kuka_robot, "STALL_S", 1.0)
    monkeypatch.setattr(kuka_robot, "REST_S", 1.0)


@pytest.fixture
def cell() -> Iterator[Simulation]:
    with simulation(values=EKI) as cell:
        yield cell


def words(cell: Simulation, runs: Path, values: dict[str, str]) -> list[str | Path]:
    address = {"simulation.address": cell.control}
    return ["--unattended", "--runs", runs, *sets(EKI | values | address)]


# By day `test_alarms` strikes these over the other wire: what a controller says is judged by the
# same lines of both drivers.
OF_THE_CONTROLLER = {
    "robot.wrong_identity",
    "robot.stopmess",
    "robot.mode_t1",
    "robot.override_zero",
    "robot.deselected",
    "robot.wrong_tool",
    "robot.wrong_base",
    "robot.softlimit",
    "robot.stops_short",
    "robot.frozen",
}
STRUCK = [
    pytest.param(fault, *end, marks=[pytest.mark.nightly] if fault in OF_THE_CONTROLLER else [])
    for fault, end in ENDS.items()
]


@pytest.mark.parametrize(("fault", "code", "value"), STRUCK)
def test_a_fault_that_ends_a_run_is_named(
    cell: Simulation, tmp_path: Path, fault: str, code: str, value: object
) -> None:
    assert cell.ask(do="fault", name=fault, value=value, count=1000)["ok"]
    run = ["run", "base-frame", "--name", "x", *map(str, words(cell, tmp_path, SHORT))]
    assert main(run) in (2, 3)
    alarms = alarms_of(read_log(tmp_path / "x"), "x", live=False)
    assert alarms[-1].code == code, alarms


@pytest.mark.parametrize("fault", SURVIVED)
def test_habits_of_the_wire_are_survived(cell: Simulation, tmp_path: Path, fault: str) -> None:
    assert cell.ask(do="fault", name=fault, value=True, count=20 if "stale" not in fault else 2)
    done = command("run", "base-frame", "--json", *words(cell, tmp_path, SHORT))
    assert end_of(done)["exit"] == 0, done.stderr


def ask(cell: Simulation, number: int, kind: int = 0, a1_deg: float = 0.0) -> dict[str, str]:
    """Return a state, as another client sees it; the channel may still be taken."""
    robot, end_s = cell.addresses["robot"], time.monotonic() + 10.0
    while time.monotonic() < end_s:
        with (
            suppress(ConnectionError),
            socket.create_connection((robot["host"], robot["port"]), 5.0) as wire,
        ):
            values = f'Id="{number}" Type="{kind}" {PLACE % (60_000 * kind, a1_deg)}'
            wire.sendall(f"<RobotCommand {values}</RobotCommand>".encode())
            text = b""
            while b"</RobotState>" not in text and (piece := wire.recv(4096)):
                text += piece
            if text:
                return dict(re.findall(r'(\w+)="([^"]*)"', text.decode()))
        time.sleep(LOOK_S)
    raise AssertionError("the channel stays taken")


def test_a_killed_engine_leaves_a_braked_robot_and_resume_goes_on(tmp_path: Path) -> None:
    """The cell is ten times as fast as a real one; the controller's timer counts real time."""
    with simulation(10.0, EKI) as cell:
        found = ask(cell, 7, MOVE, 40.0)
        while found["Finished_Id"] != "7":
            time.sleep(LOOK_S)
            found = ask(cell, -1)
        engine = Engine("run", "home", *words(cell, tmp_path, SHORT | SLOW))
        engine.until(lambda event: event.get("action") == "robot.park")
        time.sleep(0.5)  # of the motion, which takes 4 s
        engine.kill()
        killed_s = time.monotonic()
        while (found := ask(cell, -2))["Code"] != "8":
            assert time.monotonic() - killed_s < 2.5, found  # it asks, and gives no sign
            time.sleep(LOOK_S)
        assert (found["Stopped"], found["Finished_Id"]) == ("TRUE", "7")
        assert 0.5 < float(found["A1"]) < 39.5
        done = command("resume", engine.run, "--unattended", "--runs", tmp_path, "--json")
        assert end_of(done)["exit"] == 0, done.stderr
        assert abs(float(ask(cell, -3)["A1"])) < 0.01


def test_the_slide_is_moved_over_the_same_channel(tmp_path: Path) -> None:
    rail = {"rail.driver": "kuka-e1", "survey.to_mm": "600.0", "survey.step_mm": "200.0"}
    done = command(
        "run", "rail-survey", "--json", "--unattended", "--runs", tmp_path, *sets(EKI | rail)
    )
    assert end_of(done)["exit"] == 0, done.stderr
    assert '"model":"E1 of #KR210R2700_2 C4 FLR SIMULATED"' in done.stdout
