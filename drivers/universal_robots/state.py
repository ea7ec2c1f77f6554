"""The states in every package of a Universal Robots controller, and the registers of its script.

Integer registers 24 .. 27 and float registers 24 .. 30 are those of ``script/hilcell.script``. It
reads no input register 28, which numbers the questions for a fresh state: a state shows what was
written last, so one with the number of a question was taken after it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from drivers.universal_robots.rtde import FORMATS, Numbers, Recipe, RtdeError
from hilcell.geometry.frames import from_rotvec
from hilcell.ports import Array

_TOOL = tuple(f"output_double_register_{n}" for n in range(24, 30))
_SIX = ("actual_q", "actual_qd", "actual_TCP_pose")
ECHO = "input_int_register_28"
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
    ECHO,
)
INPUTS = (
    "input_int_register_24",
    "input_int_register_25",
    "input_int_register_26",
    "input_int_register_27",
    *(f"input_double_register_{n}" for n in range(24, 31)),  # the joints, and the speed
)
NOTHING, MOVE_JOINTS = 0, 1  # commands
GO, BRAKE = 0, 1  # stop; the number of its session also ends a script
LARGEST = 1e6  # m, rad, rad/s: a finite number beyond is none either


@dataclass(frozen=True, slots=True)
class UrState:
    """One data package. It arrived between ``after_s`` and ``by_s`` (monotonic)."""

    numbers: dict[str, Numbers]  # by field
    after_s: float
    by_s: float

    @classmethod
    def checked(cls, numbers: dict[str, Numbers], after_s: float, by_s: float) -> Self:
        """Return the state that a data package's numbers mean; raises `RtdeError`."""
        for name in (*_SIX, *_TOOL):
            if not sum(map(abs, numbers[name])) <= LARGEST:
                raise RtdeError(f"{name} is {', '.join(map(str, numbers[name]))}")
        return cls(numbers, after_s, by_s)

    @property
    def timestamp_s(self) -> float:
        """Return the time by the controller's clock."""
        return self.numbers["timestamp"][0]

    @property
    def joints_rad(self) -> Array:
        """Return the joints (6,)."""
        return np.array(self.numbers["actual_q"])

    @property
    def speeds_rad_s(self) -> Array:
        """Return the joints' speeds (6,)."""
        return np.array(self.numbers["actual_qd"])

    @property
    def pose(self) -> Array:
        """Return the pose of the TCP (4, 4) in mm."""
        tcp = np.array(self.numbers["actual_TCP_pose"])
        T = np.eye(4)
        T[:3, :3] = from_rotvec(tcp[3:])
        T[:3, 3] = tcp[:3] * 1000.0
        return T

    @property
    def robot_mode(self) -> int:
        """Return whether the arm is on."""
        return int(self.numbers["robot_mode"][0])

    @property
    def safety_status(self) -> int:
        """Return what the safety system says."""
        return int(self.numbers["safety_status"][0])

    @property
    def runtime_state(self) -> int:
        """Return whether a program plays."""
        return int(self.numbers["runtime_state"][0])

    @property
    def speed_fraction(self) -> float:
        """Return the place of the speed slider, 0 to 1."""
        return self.numbers["target_speed_fraction"][0]

    @property
    def acknowledged(self) -> int:
        """Return the number of the last motion that has ended."""
        return int(self.numbers["output_int_register_24"][0])

    @property
    def error(self) -> int:
        """Return the script's error of that motion."""
        return int(self.numbers["output_int_register_25"][0])

    @property
    def session(self) -> int:
        """Return the number of the script that plays."""
        return int(self.numbers["output_int_register_26"][0])

    @property
    def count(self) -> int:
        """Return the count of the script's loop."""
        return int(self.numbers["output_int_register_27"][0])

    @property
    def echo(self) -> int:
        """Return the number of the last question that had reached the controller."""
        return int(self.numbers[ECHO][0])

    @property
    def tool(self) -> Array:
        """Return the tool (6,) in mm and rad."""
        return np.array([self.numbers[name][0] for name in _TOOL]) * ([1000.0] * 3 + [1.0] * 3)


@dataclass(frozen=True, slots=True)
class Order:
    """The values of the registers that command the script."""

    sequence: int
    target_rad: Array
    speed_rad_s: float
    stop: int = GO
    command: int = MOVE_JOINTS

    def registers(self, life: int) -> dict[str, Numbers]:
        """Return the numbers of the inputs; another ``life`` is the PC's sign of life."""
        integers = (self.sequence, self.command, life, self.stop)
        floats = (*self.target_rad.tolist(), self.speed_rad_s)
        return {name: (each,) for name, each in zip(INPUTS, (*integers, *floats), strict=True)}


def unlike(recipe: Recipe) -> list[str]:
    """Return the outputs whose type is none of which a state can be read, with their types."""
    fields = zip(recipe.names, recipe.types, strict=True)
    return [
        f"{name} ({kind})"
        for name, kind in fields
        if FORMATS.get(kind) not in (("6d",) if name in _SIX else tuple("?BiIQd"))
    ]
