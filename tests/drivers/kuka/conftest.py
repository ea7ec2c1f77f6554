from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from drivers import slide, supervision
from drivers.kuka import robot as kuka_robot
from drivers.kuka import robot_c3, robot_eki
from drivers.kuka.robot_c3 import KukaC3Robot
from hilcell.ports import DeviceError
from tests.drivers.kuka.kuka_bed import Connect, robot_for
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import WireTime


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    time = WireTime()
    for module, name, value in (
        (robot_c3, "REPLY_S", 0.3),
        (robot_eki.EkiChannel, "ANSWER_S", 0.3),
        (robot_eki, "OPEN_S", 0.05),
        (kuka_robot, "STALL_S", 0.3),
        (kuka_robot, "REST_S", 0.1),
        (kuka_robot.KukaRobot, "CATCH_UP_S", 0.2),
        # The peer's slide arrives within three polls.
        (kuka_robot.KukaRobot, "SPEED_OVER_S", 10.0),
        (kuka_robot, "BRAKED_DWELL_S", 0.002),  # in real time: the PC's own clock is stopped
        (kuka_robot, "BRAKED_S", 0.3),
        (slide.SlideMonitor, "SETTLE_S", 0.3),
        (supervision, "time", time),
        (robot_eki, "time", time),
    ):
        monkeypatch.setattr(module, name, value)
    return time


@pytest.fixture
def peer() -> Iterator[KukaPeer]:
    with KukaPeer() as peer:
        yield peer


@pytest.fixture
def connect(peer: KukaPeer, time: WireTime) -> Iterator[Connect]:
    """Connect robots, which are closed behind the test."""
    robots: list[KukaC3Robot] = []

    def connected(**options: Any) -> KukaC3Robot:
        robots.append(robot_for(peer, time, **options))
        robots[-1].connect()
        return robots[-1]

    yield connected
    for robot in robots:
        with suppress(DeviceError):
            robot.close()


@pytest.fixture
def robot(connect: Connect) -> KukaC3Robot:
    return connect()
