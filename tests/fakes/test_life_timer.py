"""The simulated robot brakes by itself when the PC gives no sign of life while it moves."""

import threading

import numpy as np
import pytest

from fakes.faults import Faults
from fakes.kuka.controller import KrlController
from fakes.kuka.life_timer import LifeTimer
from fakes.time import PlantTime
from fakes.truth.plant import Plant
from hilcell.cell.file import Cell
from tests.fakes.rail_bench import until

FAR = "{E6AXIS: A1 -60.0, A2 -60.0, A3 60.0, A4 30.0, A5 -60.0, A6 90.0}"


@pytest.fixture
def robot(cell: Cell) -> KrlController:
    """Return a controller in real time that waits 100 ms for a sign."""
    faults = Faults()
    controller = KrlController(cell, Plant(cell, 1, PlantTime(1.0), faults).robot, faults)
    controller.write("HC_LIFE", "100")
    return controller


def go(robot: KrlController) -> None:
    robot.write("HC_TGT", FAR)
    robot.write("HC_VEL", "1")
    robot.write("HC_CMD", "1")
    robot.write("HC_SEQ", str(int(robot.read("HC_SEQ")) + 1))


def lost(robot: KrlController) -> bool:
    return robot.read("HC_ERR") == "8"


def test_without_a_sign_the_robot_brakes_and_latches_until_it_is_taken_back(
    robot: KrlController,
) -> None:
    go(robot)
    until(lambda: lost(robot), "the robot has braked")
    assert robot.read("HC_STOP") == "TRUE"
    until(lambda: not robot._motion.moving, "it stands")
    stands = robot._motion.state().joints_rad
    robot.write("$TIMER[10]", "-100")  # a sign that comes too late changes nothing
    robot.write("HC_STOP", "TRUE")
    assert lost(robot)
    assert robot.read("HC_ACK") == "0"
    robot.write("HC_STOP", "FALSE")
    assert robot.read("HC_ACK") == robot.read("HC_SEQ") == "1"
    np.testing.assert_array_equal(robot._motion.state().joints_rad, stands)  # the command is gone


def test_signs_keep_it_moving(robot: KrlController) -> None:
    robot.write("HC_LIFE", "2000")
    go(robot)
    for _ in range(3):
        robot._timer.set_ms(10)  # it has run out, and the thread has not seen it yet
        robot.write("$TIMER[10]", "-2000")
    robot._timer_ran_out()
    assert (robot.read("HC_ERR"), robot.read("HC_STOP")) == ("0", "FALSE")
    assert robot._motion.moving
    robot.write("HC_STOP", "TRUE")


def test_a_robot_that_stands_needs_no_sign(robot: KrlController) -> None:
    go(robot)
    robot.write("HC_STOP", "TRUE")
    robot.write("HC_STOP", "FALSE")
    robot._timer.set_ms(10)
    robot._timer_ran_out()
    assert (robot.read("HC_ERR"), robot.read("HC_STOP")) == ("9", "FALSE")


def test_a_timer_acts_once_each_time_that_it_is_started() -> None:
    acted = threading.Semaphore(0)
    timer = LifeTimer(acted.release)
    for _ in range(2):
        timer.start(-10)
        assert acted.acquire(timeout=20)
        until(lambda: not timer.ran_out, "it has stopped")
    timer.start(-100_000)
    timer.stop()
    timer.set_ms(10)
    assert not timer.ran_out
    assert not acted.acquire(blocking=False)
