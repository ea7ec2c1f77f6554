"""KUKA's drivers at their peers, in time that passes by their waits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from drivers import standstill, supervision
from drivers.kuka import robot as kuka_robot
from drivers.kuka import robot_c3, robot_eki
from drivers.kuka.robot_c3 import KukaC3Robot
from hilcell.cell.file import Joint
from hilcell.ports import Clock
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import WireTime

JOINTS = [Joint(a_mm=0.0, alpha_deg=0.0, d_mm=0.0, offset_deg=0.0, speed_deg_s=100.0)] * 6
TARGET_RAD = np.radians([10.0, -80.0, 95.5, -12.25, 33.3, 170.0])
ALARMS = {
    "$TRAFONAME[]": "HC-B05", "$TOOL": "HC-B06", "$BASE": "HC-B06", "$ACT_TOOL": "HC-B07",
    "$ACT_BASE": "HC-B07", "$ALARM_STOP": "HC-B10", "$USER_SAF": "HC-B11", "$MODE_OP": "HC-B12",
    "$PERI_RDY": "HC-B13", "$STOPMESS": "HC-B14", "$PRO_STATE1": "HC-B15", "$OV_PRO": "HC-B16",
    "HC_VER": "HC-B17", "HC_ACK": "HC-B25",
}  # fmt: skip


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
        # The peer's slide is there within three looks.
        (kuka_robot.KukaRobot, "SPEED_OVER_S", 10.0),
        (kuka_robot, "BRAKED_DWELL_S", 0.002),  # in real time: the PC's own clock is stopped
        (kuka_robot, "BRAKED_S", 0.3),
        (standstill.Standing, "SETTLE_S", 0.3),
        (supervision, "time", time),
        (robot_eki, "time", time),
    ):
        monkeypatch.setattr(module, name, value)
    return time


def robot_for(peer: KukaPeer, clock: Clock, **options: Any) -> KukaC3Robot:
    values: dict[str, Any] = {
        "host": "127.0.0.1",
        "port": peer.server.port,
        "smr_mm": (98.0, 0.0, 127.0),
        "joint": JOINTS,
    }
    return KukaC3Robot(KukaC3Robot.Options(**(values | options)), clock)


@pytest.fixture
def peer() -> Iterator[KukaPeer]:
    with KukaPeer() as peer:
        yield peer


@pytest.fixture
def robot(peer: KukaPeer, time: WireTime) -> Iterator[KukaC3Robot]:
    robot = robot_for(peer, time)
    robot.connect()
    yield robot
    robot.close()
