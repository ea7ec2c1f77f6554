"""Writes the corrected targets of a station as a program: ``NAME.mxprog``.

Stand-offs are joints, as poses were commanded when the cell was calibrated; from there the tool
goes straight to its target, a pose in the robot's base, and back. The stamp stands above, so that
`hilcell compensate` refuses to correct the program again.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from drivers.program_text import ENCODING
from hilcell.compensation.programs import StationProgram
from hilcell.compensation.targets import Stamp
from hilcell.geometry.frames import poses_from_zyx
from hilcell.ports import Array
from hilcell.sanitize import clean
from hilcell_meca500.euler import angles
from hilcell_meca500.programs import DECIMALS, SUFFIX

STRAIGHT_MM_S = 100.0  # in to a hole and out of it


def write_station(program: StationProgram, stamp: Stamp) -> dict[str, bytes]:
    """Return the file of a station by its name."""
    name = re.sub(r"\W", "_", program.station, flags=re.ASCII)
    text = "".join(f"{line}\n" for line in _lines(program, stamp))
    return {f"{name}{SUFFIX}": text.encode(ENCODING, "replace")}


def _lines(program: StationProgram, stamp: Stamp) -> Iterator[str]:
    yield _comment(stamp.text)
    yield from map(_comment, program.remarks)
    yield _comment("start only when the slide is held, the strip read and the drill drawn back")
    yield "SetBlending(0)"
    yield f"SetJointVel({program.speed_percent:g})"
    yield f"SetCartLinVel({STRAIGHT_MM_S:g})"
    yield "SetWrf(0, 0, 0, 0, 0, 0)"
    yield _pose("SetTrf", poses_from_zyx(program.tool[None])[0])
    yield _move(np.radians(program.safe_deg))
    T_B_W = poses_from_zyx(program.base[None])[0]
    off, at = (T_B_W @ poses_from_zyx(each.values) for each in (program.standoff, program.command))
    ways = (program.approach.joints_rad, program.standoff.joints_rad)
    for number, hole in enumerate(program.names):
        yield _comment(f"{number + 1} of {len(program.names)}: {hole}")
        yield from map(_move, program.via[number].joints_rad)
        yield from (_move(joints_rad[number]) for joints_rad in ways)
        yield _pose("MoveLin", at[number])
        yield _comment("drill here")
        yield _pose("MoveLin", off[number])
    yield from map(_move, program.via[-1].joints_rad)
    yield _move(np.radians(program.safe_deg))


def _pose(command: str, T: Array) -> str:
    numbers = np.array([*T[:3, 3], *angles(T[:3, :3])]).round(DECIMALS) + 0.0  # no -0
    return f"{command}({', '.join(f'{each:.{DECIMALS}f}' for each in numbers)})"


def _comment(text: str) -> str:
    return f"// {clean(text)}"


def _move(joints_rad: ArrayLike) -> str:
    return f"MoveJoints({', '.join(f'{each:.6f}' for each in np.degrees(joints_rad))})"
