"""KUKA's drivers at their peers."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.kuka.robot_c3 import KukaC3Robot
from hilcell.cell.file import Joint
from tests.drivers.kuka.kuka_peer import KukaPeer
from tests.drivers.peers import Bed, WireTime

JOINTS = [Joint(a_mm=0.0, alpha_deg=0.0, d_mm=0.0, offset_deg=0.0, speed_deg_s=100.0)] * 6
TARGET_RAD = np.radians([10.0, -80.0, 95.5, -12.25, 33.3, 170.0])
ALARMS = {
    "$TRAFONAME[]": "HC-B05", "$TOOL": "HC-B06", "$BASE": "HC-B06", "$ACT_TOOL": "HC-B07",
    "$ACT_BASE": "HC-B07", "$ALARM_STOP": "HC-B10", "$USER_SAF": "HC-B11", "$MODE_OP": "HC-B12",
    "$PERI_RDY": "HC-B13", "$STOPMESS": "HC-B14", "$PRO_STATE1": "HC-B15", "$OV_PRO": "HC-B16",
    "HC_VER": "HC-B17", "HC_ACK": "HC-B25",
}  # fmt: skip


class BedRobot(KukaC3Robot):
    """A robot at its peer."""

    def __init__(self, peer: KukaPeer, time: WireTime, **options: Any) -> None:
        values: dict[str, Any] = {
            "host": "127.0.0.1",
            "port": peer.server.port,
            "smr_mm": (98.0, 0.0, 127.0),
            "joint": JOINTS,
        }
        super().__init__(self.Options(**(values | options)), time)
        self.peer, self.time = peer, time


RobotBed = Bed[KukaPeer, BedRobot]
