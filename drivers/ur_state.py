"""The states in every package of a Universal Robots controller, and the registers of its script.

Integer registers 24 .. 27 and float registers 24 .. 30 are those of ``ur_script/hilcell.script``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.rtde import RtdeError, Value
from hilcell.geometry.rotations import from_rotvec
from hilcell.ports import Array

MM = 1000.0
_TOOL = tuple(f"output_double_register_{n}" for n in range(24, 30))
OUTPUTS = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_pose",
    "robot_mode",
    "safety_status",
    "runtime_state",
    "target_speed_fraction",
    "output_int_register_24",
    "output_int_register_25",
    "output_int_register_26",
    "output_int_register_27",
    *_TOOL,
)
_JOINTS = tuple(f"input_double_register_{n}" for n in range(24, 30))
INPUTS = (
    "input_int_register_24",
    "input_int_register_25",
    "input_int_register_26",
    "input_int_register_27",
    *_JOINTS,
    "input_double_register_30",
)
NOTHING, MOVE_JOINTS = 0, 1  # commands
LARGEST = 1e6  # m, rad, rad/s: a finite number beyond is none either


@dataclass(frozen=True, slots=True)
class UrState:
    """One data package. It arrived between ``after_s`` and ``by_s`` (monotonic)."""

    timestamp_s: float  # of the controller's clock
    joints_rad: Array
    speeds_rad_s: Array
    pose: Array  # (4, 4) mm
    robot_mode: int
    safety_status: int
    runtime_state: int
    speed_fraction: float
    acknowledged: int
    error: int
    session: int
    count: int  # of the script's loop
    tool: Array  # (6,) mm and rad
    after_s: float
    by_s: float


@dataclass(frozen=True, slots=True)
class Order:
    """The values of the registers that command the script."""

    sequence: int
    target_rad: Array
    speed_rad_s: float
    stop: bool = False
    command: int = MOVE_JOINTS


def state_from(values: dict[str, Value], after_s: float, by_s: float) -> UrState:
    """Return the state that a data package's values mean; raises `RtdeError`."""
    for name in ("actual_q", "actual_qd", "actual_TCP_pose", *_TOOL):
        if not bool(np.all(np.abs(values[name]) <= LARGEST)):
            raise RtdeError(f"{name} is {values[name]}")
    acknowledged, error, session, count = (
        _whole(values[f"output_int_register_{n}"]) for n in range(24, 28)
    )
    return UrState(
        timestamp_s=_number(values["timestamp"]),
        joints_rad=np.array(values["actual_q"]),
        speeds_rad_s=np.array(values["actual_qd"]),
        pose=_matrix(np.array(values["actual_TCP_pose"])),
        robot_mode=_whole(values["robot_mode"]),
        safety_status=_whole(values["safety_status"]),
        runtime_state=_whole(values["runtime_state"]),
        speed_fraction=_number(values["target_speed_fraction"]),
        acknowledged=acknowledged,
        error=error,
        session=session,
        count=count,
        tool=np.array([_number(values[name]) for name in _TOOL]) * ([MM] * 3 + [1.0] * 3),
        after_s=after_s,
        by_s=by_s,
    )


def registers(order: Order, life: int) -> dict[str, Value]:
    """Return the values of the inputs; another ``life`` is the PC's sign of life."""
    integers = (order.sequence, order.command, life, int(order.stop))
    found: dict[str, Value] = dict(zip(INPUTS[:4], integers, strict=True))
    found |= dict(zip(_JOINTS, order.target_rad.tolist(), strict=True))
    found["input_double_register_30"] = order.speed_rad_s
    return found


def _matrix(pose: Array) -> Array:
    T = np.eye(4)
    T[:3, :3] = from_rotvec(pose[3:])
    T[:3, 3] = pose[:3] * MM
    return T


def _number(value: Value) -> float:
    """Return a value of one component."""
    if isinstance(value, tuple):
        raise RtdeError(f"one number is expected, found {len(value)}")
    return float(value)


def _whole(value: Value) -> int:
    return int(_number(value))
