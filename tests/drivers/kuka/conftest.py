from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest

from drivers import slide, supervision
from drivers.kuka import robot as kuka_robot
from drivers.kuka import robot_c3, robot_eki
from tests.drivers.kuka.kuka_bed import BedRobot, RobotBed
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import Bed, WireTime


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
def bed(time: WireTime) -> Iterator[RobotBed]:
    with KukaPeer() as peer, closing(Bed(peer, time, BedRobot)) as bed:
        yield bed


@pytest.fixture
def robot(bed: RobotBed) -> BedRobot:
    return bed.connect()
