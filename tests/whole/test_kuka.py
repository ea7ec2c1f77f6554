"""Runs with KUKA's other interfaces: the slide as external axis E1, and EthernetKRL."""

from __future__ import annotations

import re
import socket
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from drivers.kuka.robot_c3 import C3Connection
from hilcell.ports import Array
from tests.whole.bench import (
    SMALL,
    TOTAL_STATION,
    Engine,
    Simulation,
    command,
    end_of,
    ran,
    sets,
    simulation,
    sweep,
)

E1 = {"rail.driver": "kuka-e1"}
FEWER = {"grid.size_mm": "[900.0, 450.0, 450.0]", "base_frame.points": "4"}
PACE = 40.0
FAR_MM = 2600.0  # the first motion, the slowest there is: all else is quick in fast paced time
SLOW = E1 | {
    "rail.speed_mm_s": "20.0", "survey.from_mm": f"{FAR_MM}", "survey.to_mm": f"{FAR_MM + 400}"
}  # fmt: skip


@pytest.mark.parametrize(
    ("procedure", "plan"), [("sign-check", SMALL | FEWER), *sweep(("calibrate", SMALL))]
)
@pytest.mark.parametrize(
    ("values", "drive"),
    [(E1, "E1 of "), ({"rail.options.strip.driver": "serial"}, "drive vendor 0x484")],
    ids=["E1", "CANopen and a serial strip"],
)
def test_a_small_calibration_ends_in_tolerance(
    tmp_path: Path, procedure: str, plan: dict[str, str], values: dict[str, str], drive: str
) -> None:
    """By day as far as corrected targets at a station: every act that moves slide or arm."""
    run = ran(tmp_path, procedure, plan | values)
    assert run.end["exit"] == 0, run.done.stderr
    kinds = {each.kind: each.model for each in run.log.assets}
    assert set(kinds) == {"drive", "strip", "robot", "tracker"}
    assert kinds["drive"].startswith(drive)
    assert kinds["strip"] == "MSAC501 simulated"


@pytest.mark.process
def test_a_killed_engine_leaves_a_slide_that_brakes_by_itself(tmp_path: Path) -> None:
    """At this pace it would be on its way for 14 s."""
    with simulation(PACE / 4.0, values=SLOW) as cell:
        words = sets(SLOW | {"simulation.address": cell.control})
        engine = Engine("run", "rail-survey", "--runs", tmp_path, "--unattended", *words)
        engine.until(lambda event: event.get("action") == "rail.move")
        port = int(cell.addresses["robot"]["port"])
        line = C3Connection("127.0.0.1", port, lambda: None)
        before_mm = float(line.read("$AXIS_ACT.E1"))
        while abs(float(line.read("$AXIS_ACT.E1")) - before_mm) < 1.0:
            assert engine.process.poll() is None, engine.rest()[-3:]
        engine.kill()
        while line.read("HC_ERR") != "8":
            pass
        assert line.read("HC_HELD") == "TRUE"
        places = [float(line.read("$AXIS_ACT.E1")), 0.0]
        while abs(places[-1] - places[-2]) > 0.003:  # it dithers
            places.append(float(line.read("$AXIS_ACT.E1")))
        target_mm = float(line.read("HC_TGT").partition("E1 ")[2].partition(",")[0])
        assert abs(target_mm - places[-1]) > 5.0
        line.close()
        again = Engine("resume", engine.run, "--runs", tmp_path, "--unattended")
        again.until(lambda event: event.get("position_mm") == FAR_MM)
        again.kill()


@pytest.mark.wall
def test_a_slide_that_runs_too_fast_is_stopped(tmp_path: Path) -> None:
    """In paced time: in stepped time a poll lets a third of the motion pass."""
    with simulation(PACE, values=SLOW) as cell:
        cell.strike("robot.slide_fast", 8.0, count=0)
        end = ran(tmp_path, "rail-survey", SLOW | {"simulation.address": cell.control}).end
    assert (end["exit"], end["error"]["code"]) == (3, "HC-R33")


EKI = {"robot.driver": "kuka-eki"}
QUICK = EKI | TOTAL_STATION  # in paced time a laser tracker starts for half a minute
MOVE = 1
PLACE = 'Percent="50" Life="%d"><Pos A1="%g" A2="-90" A3="90" A4="0" A5="60" A6="0" E1="0"/>'


def answer(wire: socket.socket, number: int, kind: int = 0) -> dict[str, str]:
    """Return the state that answers a command, nothing where the channel is not free."""
    values = f'Id="{number}" Type="{kind}" {PLACE % (60_000 * kind, 40.0 * kind)}'
    wire.sendall(f"<RobotCommand {values}</RobotCommand>".encode())
    text = b""
    while b"</RobotState>" not in text and (piece := wire.recv(4096)):
        text += piece
    return dict(re.findall(r'(\w+)="([^"]*)"', text.decode()))


def ask(cell: Simulation, number: int, kind: int = 0) -> dict[str, str]:
    """Return a state, as another client sees it, as soon as the channel is free.

    The client of a motion stays until it has ended, since one that goes brakes it.
    """
    robot = cell.addresses["robot"]
    while True:
        with (
            suppress(ConnectionError),
            socket.create_connection((robot["host"], robot["port"])) as wire,
        ):
            found = answer(wire, number, kind)
            while kind and found["Finished_Id"] != str(number):
                found = answer(wire, -1)
            if found:
                return found


def flange_mm(cell: Simulation) -> Array:
    return np.array(cell.ask(do="truth")["flange_mm"])


@pytest.mark.nightly  # by day the slide of the same controller: test_external_axis
@pytest.mark.wall
def test_a_killed_engine_leaves_a_braked_robot_and_resume_goes_on(tmp_path: Path) -> None:
    """The cell is ten times as fast as a real one; the controller's timer counts real time."""
    with simulation(10.0, QUICK, truth=True) as cell:
        ask(cell, 7, MOVE)
        values = QUICK | {"robot.speed_percent": "1", "simulation.address": cell.control}
        begun_mm = flange_mm(cell)
        engine = Engine("run", "home", "--unattended", "--runs", tmp_path, *sets(values))
        engine.until(lambda event: event.get("action") == "robot.park")
        while np.linalg.norm(flange_mm(cell) - begun_mm) < 10.0:
            pass  # the test's time limit bounds the wait
        engine.kill()
        while (found := ask(cell, -2))["Code"] != "9":
            pass  # its connection has ended
        assert (found["Stopped"], found["Finished_Id"]) == ("TRUE", "7")
        assert 0.5 < float(found["A1"]) < 39.9
        done = command("resume", engine.run, "--unattended", "--runs", tmp_path, "--json")
        assert end_of(done)["exit"] == 0, done.stderr
        assert abs(float(ask(cell, -3)["A1"])) < 0.01
