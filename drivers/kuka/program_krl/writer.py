"""Writes the corrected targets of a station as a KRL program: ``NAME.src`` and ``NAME.dat``.

Points are E6POS with S and T, in the base {W} as calibrated. They state no external axes: one that
the controller has keeps its place. The stamp stands below DEF and DEFDAT, so that `compensate`
refuses to correct the program once more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.kuka.krl import POSE
from drivers.kuka.program_krl.program import DATA, SOURCE, USUAL_TOOL, turn_of
from drivers.program_text import ENCODING, module_name, plain
from hilcell.cell.robot import REFLECTOR
from hilcell.cell.settings import SettingsError
from hilcell.compensation.programs import Places, StationProgram
from hilcell.compensation.provenance import Stamp
from hilcell.ports import Array
from hilcell.sanitize import clean


def write_station(program: StationProgram, stamp: Stamp) -> dict[str, bytes]:
    """Return the files of a station by name."""
    name = module_name(program.station)
    texts = {
        f"{name}{SOURCE}": _source(name, program, stamp),
        f"{name}{DATA}": _data(name, program, stamp),
    }
    return {
        file: "".join(f"{line}\r\n" for line in lines).encode(ENCODING)
        for file, lines in texts.items()
    }


def comment(text: str) -> str:
    """Return a line of comment, which `ENCODING` can write."""
    return f"; {plain(clean(text))}"


def _source(name: str, program: StationProgram, stamp: Stamp) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEF {name}( )")
    yield f"; {plain(stamp.text)}"
    yield from map(comment, program.remarks)
    yield "BAS (#INITMOV,0 )"
    yield f"BAS (#TOOL,{_tool_number(program)} )"
    yield f"BAS (#VEL_PTP,{max(1, round(program.speed_percent))} )"
    yield "BAS (#ACC_PTP,50 )"
    yield "BAS (#VEL_CP,0.1 )"  # m/s, in to a hole and out of it
    yield comment("{W} as calibrated, in the robot's root")
    yield f"$BASE={_frame(program.base)}"
    yield "PTP XHOME"
    yield comment("slide held, strip as the sheet says, drill drawn back: start goes on")
    yield "HALT"
    for number, hole in enumerate(program.names, start=1):
        yield comment(f"{number} of {len(program.names)}: {hole}")
        yield from (f"PTP {name}" for name in _via(program, number))
        yield f"PTP XA{number}"
        yield f"PTP XS{number}"
        yield f"LIN XP{number}"
        yield comment("drill here")
        yield f"LIN XS{number}"
    yield from (f"PTP {name}" for name in _via(program, len(program.names) + 1))
    yield "PTP XHOME"
    yield "END"


def _tool_number(program: StationProgram) -> int:
    """Return the number of the program's tool in the controller's table.

    Raises `SettingsError` for a tool that has none, or that of the reflector: the program would
    move another tip than it is written for.
    """
    reflector: int = program.options.get("tool", USUAL_TOOL)
    if program.tool_name == REFLECTOR:
        return reflector
    if program.tool_number is not None and program.tool_number != reflector:
        return program.tool_number
    problem = (
        "missing: a KRL program selects its tool by the controller's number"
        if program.tool_number is None
        else f"{reflector} is the reflector's in the controller (robot.options.tool, "
        f"{USUAL_TOOL} without): expected another one"
    )
    raise SettingsError(f"tool {program.tool_name}", [f"number: {problem}"])


def _data(name: str, program: StationProgram, stamp: Stamp) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEFDAT  {name}", f"; {plain(stamp.text)}")
    safe = ",".join(f"A{axis} {deg:.6f}" for axis, deg in enumerate(program.safe_deg, start=1))
    yield f"DECL E6AXIS XHOME={{{safe}}}"
    places = (program.approach, program.standoff, program.command)
    for number, points in enumerate(zip(*map(_points, places), strict=True), start=1):
        for letter, point in zip("ASP", points, strict=True):
            yield f"DECL E6POS X{letter}{number}={point}"
    for number, places_of in enumerate(program.via, start=1):
        for name, point in zip(_via(program, number), _points(places_of), strict=True):
            yield f"DECL E6POS {name}={point}"
    yield "ENDDAT"


def _via(program: StationProgram, number: int) -> list[str]:
    """Return the names of the points on the way to a hole, counted from 1, or to the safe pose."""
    count = len(program.via[number - 1].values)
    return [f"XV{number}_{n}" for n in range(1, count + 1)]


def _points(places: Places) -> Iterator[str]:
    """Yield the points; one with an axis at zero leaves out S and T, whose bit rounding turns."""
    turns = turn_of(places.joints_rad)
    sure = np.abs(places.joints_rad).min(axis=1) >= 1e-4  # rad
    for values, status, turn, is_sure in zip(
        places.values, places.status, turns, sure, strict=True
    ):
        posture = f",S {status},T {turn}" if is_sure else ""
        yield f"{_frame(values)[:-1]}{posture}}}"


def _frame(values: Array | Sequence[float]) -> str:
    """Return a structure with as many decimals as lists have."""
    decimals = (4, 4, 4, 6, 6, 6)
    parts = zip(POSE, values, decimals, strict=True)
    return "{" + ",".join(f"{axis} {value:.{places}f}" for axis, value, places in parts) + "}"
