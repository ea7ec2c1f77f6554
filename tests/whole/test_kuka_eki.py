"""A run whose robot is reached through EthernetKRL: an engine that is killed, the slide as well."""

from __future__ import annotations

import re
import socket
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from hilcell.ports import Array
from tests.whole.bench import Engine, Simulation, command, end_of, sets, simulation
from tests.whole.stations import TOTAL_STATION

EKI = {"robot.driver": "kuka-eki"}
QUICK = EKI | TOTAL_STATION  # in paced time a laser tracker starts for half a minute
MOVE = 1
SLOW = {"robot.speed_percent": "1"}
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
        values = QUICK | SLOW | {"simulation.address": cell.control}
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


def test_the_slide_is_moved_over_the_same_channel(tmp_path: Path) -> None:
    short = {"survey.to_mm": "600.0", "survey.step_mm": "200.0", "survey.repeats": "4"}
    values = EKI | {"rail.driver": "kuka-e1"} | short
    done = command("run", "rail-survey", "--json", "--runs", tmp_path, *sets(values))
    assert end_of(done)["exit"] == 0, done.stderr
    assert '"model":"E1 of #KR210R2700_2 C4 FLR SIMULATED"' in done.stdout
