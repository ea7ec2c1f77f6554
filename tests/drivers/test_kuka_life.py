"""While a motion is under way the driver gives the controller's program signs of life."""

import threading

import numpy as np
import pytest

from drivers.kuka import life as kuka_life
from drivers.kuka import robot as kuka_robot
from drivers.supervision import LATE_S
from hilcell.ports import DeviceError
from tests.drivers.kuka_peer import KukaPeer
from tests.drivers.test_robot_kuka_c3 import TARGET_RAD, robot_for

SIGN = "write $TIMER[10]"


def signs(peer: KukaPeer) -> int:
    return peer.requests.count(SIGN)


def test_each_motion_gets_signs_and_a_standing_robot_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kuka_life, "EVERY_S", 0.0)
    with KukaPeer() as peer:
        robot = robot_for(peer)
        (identity,) = robot.connect()
        assert identity.firmware == "hilcell.src 4"
        robot.move_to(TARGET_RAD, 30.0)
        assert signs(peer) == 3  # one a look
        assert peer.variables["$TIMER[10]"] == "-1500"
        assert peer.variables["HC_LIFE"] == "1500"
        assert peer.requests.index("write HC_LIFE") < peer.requests.index("write HC_SEQ")
        robot.read()
        assert signs(peer) == 3
        with robot.sweep(0, float(TARGET_RAD[0]) + 0.1, 0.01) as sweep:
            sweep.kickoff()
            sweep.collect()
            sweep.complete()
        assert signs(peer) == 6
        robot.close()


def test_signs_cost_five_exchanges_a_second() -> None:
    """A PC that is late reports that itself before the robot brakes."""
    assert kuka_life.EVERY_S == 0.2
    assert kuka_life.LIFE_S > LATE_S + kuka_life.EVERY_S


def test_a_robot_that_has_braked_by_itself_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kuka_robot, "STALL_S", 0.2)
    with KukaPeer() as peer:
        robot = robot_for(peer)
        robot.connect()
        peer.frozen = True
        peer.moved = lambda: None
        peer.variables["HC_ERR"] = "8"
        with pytest.raises(DeviceError, match="life sign was late") as caught:
            robot.move_to(np.array(TARGET_RAD), 30.0)
        assert caught.value.code == "HC-B43"
        robot.close()


def test_a_motion_that_a_dead_engine_left_brakes_and_is_taken_back() -> None:
    """Its timer runs out while the next connect waits for its end."""
    with KukaPeer(HC_SEQ="8") as peer:
        looks = iter(["FALSE", "FALSE", "TRUE"])

        def read(name: str, real=peer._read):  # type: ignore[no-untyped-def]  # of the peer
            return next(looks, "TRUE") if name == "HC_STOP" else real(name)

        peer._read = read  # type: ignore[method-assign]  # a stop that comes by itself
        robot = robot_for(peer)
        robot.connect()
        assert peer.variables["HC_ACK"] == "8"
        assert peer.requests.count("write HC_STOP") == 1
        robot.close()


def test_a_stop_from_another_thread_ends_the_motion_as_such() -> None:
    with KukaPeer() as peer:
        robot = robot_for(peer)
        robot.connect()
        peer.frozen = True
        original = peer._read

        def read(name: str) -> str | None:
            if name == "$AXIS_ACT":
                threading.Thread(target=robot.stop).start()
            return original(name)

        peer._read = read  # type: ignore[method-assign]  # of this peer alone
        with pytest.raises(DeviceError, match="the robot was stopped") as caught:
            robot.move_to(TARGET_RAD, 30.0)
        assert caught.value.code == "HC-B21"
        assert peer.stopped.wait(5)
        robot.close()
