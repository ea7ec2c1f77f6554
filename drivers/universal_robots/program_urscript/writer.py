"""Writes the corrected targets of a station as a URScript program: ``NAME.script``.

Targets are joints of the cell's arm, as they were commanded when the cell was calibrated: the
joints of a pose would be computed by the controller's own kinematics, which its factory has
calibrated. The stamp stands below ``def``, so that `compensate` refuses the program.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from drivers.program_text import ASCII, ENCODING, module_name, plain
from drivers.universal_robots.program_urscript.files import SUFFIX
from hilcell.compensation.programs import StationProgram
from hilcell.compensation.provenance import Stamp
from hilcell.geometry.frames import from_zyx, to_rotvec
from hilcell.sanitize import clean

DECIMALS = 7  # of rad and m


def write_station(program: StationProgram, stamp: Stamp) -> dict[str, bytes]:
    """Return the file of a station by its name."""
    name = module_name(program.station)
    text = "".join(f"{line}\n" for line in _lines(name, program, stamp))
    return {f"{name}{SUFFIX}": text.encode(ENCODING)}


def _lines(name: str, program: StationProgram, stamp: Stamp) -> Iterator[str]:
    full_rad_s = 1.05  # of the joint that moves farthest, the usual speed of movej
    how = f"a=0.7, v={full_rad_s * program.speed_percent / 100.0:.4f}"  # rad/s^2, rad/s
    safe = _joints(np.radians(program.safe_deg))
    yield f"def {name}():"
    yield _comment(stamp.text)
    yield from map(_comment, program.remarks)
    yield _comment("joints as calibrated: base and TCP have a part in the straight ways alone")
    tcp = [*(program.tool[:3] / 1000.0), *to_rotvec(from_zyx(program.tool[3:]))]
    yield f"  set_tcp(p{_joints(tcp)})"
    yield f"  movej({safe}, {how})"
    yield _comment("slide held, strip as the sheet says, drill drawn back: Continue goes on")
    yield '  popup("slide held, strip read, drill drawn back?", "hilcell", blocking=True)'
    straight = "a=0.5, v=0.1"  # m/s^2 and m/s: in to a hole and out of it
    ways = (program.approach, program.standoff, program.command)
    places = zip(program.names, *(each.joints_rad for each in ways), strict=True)
    for number, (hole, below, off, at) in enumerate(places, start=1):
        yield _comment(f"{number} of {len(program.names)}: {hole}")
        for stop in program.via[number - 1].joints_rad:
            yield f"  movej({_joints(stop)}, {how})"
        yield f"  movej({_joints(below)}, {how})"
        yield f"  movej({_joints(off)}, {how})"
        yield f"  movel({_joints(at)}, {straight})"
        yield _comment("drill here")
        yield f"  movel({_joints(off)}, {straight})"
    for stop in program.via[-1].joints_rad:
        yield f"  movej({_joints(stop)}, {how})"
    yield f"  movej({safe}, {how})"
    yield "end"


def _comment(text: str) -> str:
    return f"  # {plain(clean(text), ASCII)}"


def _joints(joints_rad: ArrayLike) -> str:
    return f"[{', '.join(f'{each:.{DECIMALS}f}' for each in np.asarray(joints_rad))}]"
