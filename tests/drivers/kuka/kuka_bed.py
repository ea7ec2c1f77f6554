"""KUKA's drivers at their peers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.kuka.robot_c3 import KukaC3Robot
from hilcell.cell.file import Joint
from hilcell.ports import Clock
from tests.drivers.kuka.kuka_peer import KukaPeer

Connect = Callable[..., KukaC3Robot]
JOINTS = [Joint(a_mm=0.0, alpha_deg=0.0, d_mm=0.0, offset_deg=0.0, speed_deg_s=100.0)] * 6
TARGET_RAD = np.radians([10.0, -80.0, 95.5, -12.25, 33.3, 170.0])
ALARMS = {
    "$TRAFONAME[]": "HC-B05", "$TOOL": "HC-B06", "$BASE": "HC-B06", "$ACT_TOOL": "HC-B07",
    "$ACT_BASE": "HC-B07", "$ALARM_STOP": "HC-B10", "$USER_SAF": "HC-B11", "$MODE_OP": "HC-B12",
    "$PERI_RDY": "HC-B13", "$STOPMESS": "HC-B14", "$PRO_STATE1": "HC-B15", "$OV_PRO": "HC-B16",
    "HC_VER": "HC-B17", "HC_ACK": "HC-B25",
}  # fmt: skip


def robot_for(peer: KukaPeer, clock: Clock, **options: Any) -> KukaC3Robot:
    values: dict[str, Any] = {
        "host": "127.0.0.1",
        "port": peer.server.port,
        "smr_mm": (98.0, 0.0, 127.0),
        "joint": JOINTS,
    }
    return KukaC3Robot(KukaC3Robot.Options(**(values | options)), clock)
