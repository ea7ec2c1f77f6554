"""The simulated robot brakes by itself when the PC gives no sign of life while it moves."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from fakes.kuka.controller import KrlController
from fakes.site import Site
from fakes.time import WatchdogTimer
from hilcell.cell.file import Cell
from tests.fakes.conftest import DeviceTime, simulated_site
from tests.fakes.rail_bench import until

FAR = "{E6AXIS: A1 -60.0, A2 -60.0, A3 60.0, A4 30.0, A5 -60.0, A6 90.0}"


@pytest.fixture
def site(cell: Cell) -> Site:
    """Return one in real time, in which the motion lasts."""
    return simulated_site(cell, 1.0)[0]


@pytest.fixture
def robot(site: Site, device_time: DeviceTime) -> Iterator[KrlController]:
    """Return a controller under way that waits 2 s for a sign."""
    controller = KrlController(site)
    for name, value in (("LIFE", "2000"), ("TGT", FAR), ("VEL", "1"), ("CMD", "1"), ("SEQ", "1")):
        controller.write(f"HC_{name}", value)
    yield controller
    controller.restore()


def lost(robot: KrlController) -> bool:
    return robot.read("HC_ERR") == "8"


def test_without_a_sign_the_robot_brakes_and_latches_until_it_is_taken_back(
    robot: KrlController, site: Site, device_time: DeviceTime
) -> None:
    device_time.at_s = 2.1
    until(lambda: lost(robot))
    assert robot.read("HC_STOP") == "TRUE"
    until(lambda: not site.truth.robot.moving)
    stands = robot.read("$AXIS_ACT")
    robot.write("$TIMER[10]", "-100")  # a sign that comes too late changes nothing
    robot.write("HC_STOP", "TRUE")
    assert lost(robot)
    assert robot.read("HC_ACK") == "0"
    robot.write("HC_STOP", "FALSE")
    assert robot.read("HC_ACK") == robot.read("HC_SEQ") == "1"
    assert robot.read("$AXIS_ACT") == stands  # the command is gone


def test_signs_keep_it_moving(robot: KrlController, site: Site, device_time: DeviceTime) -> None:
    for _ in range(3):
        device_time.at_s += 1.9
        robot.write("$TIMER[10]", "-2000")
    assert (robot.read("HC_ERR"), robot.read("HC_STOP")) == ("0", "FALSE")
    assert site.truth.robot.moving


def test_a_robot_that_stands_needs_no_sign(robot: KrlController, device_time: DeviceTime) -> None:
    robot.write("HC_STOP", "TRUE")
    robot.write("HC_STOP", "FALSE")
    device_time.at_s = 100.0
    assert (robot.read("HC_ERR"), robot.read("HC_STOP")) == ("9", "FALSE")


def test_a_timer_acts_once_each_time_that_it_is_started(device_time: DeviceTime) -> None:
    acted = threading.Semaphore(0)
    timer = WatchdogTimer(acted.release)
    for _ in range(2):
        timer.start(-10)
        device_time.at_s += 0.02
        acted.acquire()
        until(lambda: not timer.expired)
    timer.start(-100_000)
    timer.stop()
    device_time.at_s += 1000.0
    assert not timer.expired
    assert not acted.acquire(blocking=False)
