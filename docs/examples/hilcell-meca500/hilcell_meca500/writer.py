"""Writes the corrected targets of a station as a program: ``NAME.mxprog``.

Targets are joints, as they were commanded when the cell was calibrated: no frame has a part in
them. The stamp stands above, so that `hilcell compensate` refuses to correct the program again.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from drivers.program_text import ENCODING
from hilcell.clean import clean
from hilcell.compensation.stamp import Stamp
from hilcell.compensation.station_program import StationProgram
from hilcell_meca500.programs import SUFFIX


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
    yield _move(np.radians(program.safe_deg))
    places = zip(
        program.names, program.approach.joints_rad, program.command.joints_rad, strict=True
    )
    for number, (hole, below, at) in enumerate(places, start=1):
        yield _comment(f"{number} of {len(program.names)}: {hole}")
        yield _move(below)
        yield _move(at)
        yield _comment("drill here")
    yield _move(np.radians(program.safe_deg))


def _comment(text: str) -> str:
    return f"// {clean(text)}"


def _move(joints_rad: ArrayLike) -> str:
    return f"MoveJoints({', '.join(f'{each:.6f}' for each in np.degrees(joints_rad))})"
