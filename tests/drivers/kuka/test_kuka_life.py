"""While a motion is under way the driver gives the controller's program signs of life."""

from __future__ import annotations

import threading

import pytest

from drivers.kuka import robot as kuka_robot
from drivers.kuka.robot_c3 import C3Controller, KukaC3Robot
from drivers.supervision import LATE_S, LIFE_S
from tests.drivers.kuka.kuka_bed import TARGET_RAD, peer, robot, robot_for, time
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import WireTime, refusal

__all__ = ["peer", "robot", "time"]

SIGN = "write $TIMER[10]"


def test_each_motion_gets_signs_and_a_standing_robot_none(
    robot: KukaC3Robot, peer: KukaPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(C3Controller, "SIGN_S", 0.0)
    robot.move_to(TARGET_RAD, 30.0)
    assert peer.requests.count(SIGN) == 3  # one a look
    assert peer.variables["$TIMER[10]"] == "-1500"
    assert peer.variables["HC_LIFE"] == "1500"
    assert peer.requests.index("write HC_LIFE") < peer.requests.index("write HC_SEQ")
    robot.read()
    assert peer.requests.count(SIGN) == 3
    with robot.sweep(0, float(TARGET_RAD[0]) + 0.1, 0.01) as sweep:
        sweep.kickoff()
        sweep.collect()
        sweep.complete()
    assert peer.requests.count(SIGN) == 6


def test_signs_cost_five_exchanges_a_second() -> None:
    """A PC that is late reports that itself before the robot brakes."""
    assert C3Controller.SIGN_S == 0.2
    assert LIFE_S > LATE_S + C3Controller.SIGN_S


def test_a_robot_that_has_braked_by_itself_says_why(robot: KukaC3Robot, peer: KukaPeer) -> None:
    peer.frozen = True
    peer.variables["HC_ERR"] = "8"
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B43"


def test_a_motion_that_a_dead_engine_left_brakes_and_is_taken_back(
    peer: KukaPeer, time: WireTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its timer runs out while the next connect waits for its end."""
    peer.variables["HC_SEQ"] = "8"
    looks, original = iter(["FALSE", "FALSE", "TRUE"]), peer._read

    def read(name: str) -> str | None:
        return next(looks, "TRUE") if name == "HC_STOP" else original(name)

    monkeypatch.setattr(peer, "_read", read)  # a stop that comes by itself
    robot = robot_for(peer, time)
    robot.connect()
    assert peer.variables["HC_ACK"] == "8"
    assert peer.requests.count("write HC_STOP") == 1
    robot.close()


def test_a_stop_from_another_thread_ends_the_motion_as_such(
    robot: KukaC3Robot, peer: KukaPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kuka_robot, "STALL_S", 1e6)
    peer.frozen = True
    original, stops = peer._read, list[threading.Thread]()

    def read(name: str) -> str | None:
        if name == "$AXIS_ACT":
            stops.append(threading.Thread(target=robot.stop))
            stops[-1].start()
        return original(name)

    monkeypatch.setattr(peer, "_read", read)
    assert refusal(lambda: robot.move_to(TARGET_RAD, 30.0)).code == "HC-B21"
    peer.stopped.wait()
    for each in stops:  # before the robot is closed under them
        each.join()
