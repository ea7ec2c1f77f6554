"""Differences of a cell from its earlier state, and from the built-in cells.

Name and serial number of a cell separate its runs, locks and calibrations: a real cell copied from
a built-in one with the same values would mix its calibrations with simulated ones.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells
from hilcell.geometry.frames import to_rotvec
from hilcell.ports import RobotSettings


def differences(before: Cell, now: Cell, *, without: str = "") -> str:
    """Return the keys that differ with both values, except in the table ``without``."""
    frozen, given = msgspec.to_builtins(before), msgspec.to_builtins(now)
    for values in (frozen, given):
        values.pop(without, None)
    keys = list(_different(frozen, given))
    most = 3
    more = f", and {len(keys) - most} more" if len(keys) > most else ""
    return ", ".join(keys[:most]) + more


def _different(before: object, now: object, key: str = "") -> Iterator[str]:
    if isinstance(before, dict) and isinstance(now, dict):
        for name in sorted(before.keys() | now.keys()):
            inner = f"{key}.{name}" if key else str(name)
            yield from _different(before.get(name), now.get(name), inner)
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for number, (one, other) in enumerate(zip(before, now, strict=True), 1):
            yield from _different(one, other, f"{key}[{number}]")
    elif before != now:
        one, other = (
            text if len(text) <= 40 else f"{text[:37]}..." for text in (f"{before}", f"{now}")
        )
        yield f"{key} {one} -> {other}"


def controller_differences(cell: Cell, settings: RobotSettings) -> list[str]:
    """Return what a robot's controller has that hinders the cell file's motions or poses.

    That is another tool (more than 1 um or 0.001 deg), and software limits within those of the cell
    file: a controller that allows more hinders nothing. Values that it does not state are omitted.
    """
    robot, found = cell.robot, list[str]()
    if settings.tool is not None:
        turned_deg = np.degrees(np.linalg.norm(to_rotvec(settings.tool[:3, :3])))
        off_mm = float(np.linalg.norm(settings.tool[:3, 3] - robot.smr_mm))
        if not (off_mm <= 1e-3 and turned_deg <= 1e-3):
            place, own = (
                ", ".join(f"{axis} {mm:.3f}" for axis, mm in zip("XYZ", each, strict=True))
                for each in (settings.tool[:3, 3], robot.smr_mm)
            )
            found.append(
                f"the controller's tool is {place}, turned by {turned_deg:.3f} deg; "
                f"robot.smr_mm is {own}, not turned: {off_mm:.3f} mm apart"
            )
    if settings.joint_limits_rad is not None:
        limits = zip(robot.joint, np.degrees(settings.joint_limits_rad), strict=True)
        found += [
            f"A{axis}: the controller allows {low:.3f} to {high:.3f} deg, the cell file "
            f"{joint.min_deg:g} to {joint.max_deg:g} deg"
            for axis, (joint, (low, high)) in enumerate(limits, start=1)
            if not (low <= joint.min_deg + 1e-3 and high >= joint.max_deg - 1e-3)
        ]
    if settings.axis_limits_mm is not None and cell.has_rail:
        low_mm, high_mm = settings.axis_limits_mm
        travel_mm = (cell.rail.travel_min_mm, cell.rail.travel_max_mm)
        if not (low_mm <= travel_mm[0] and high_mm >= travel_mm[1]):
            found.append(
                f"external axis: the controller allows {low_mm:.2f} to {high_mm:.2f} mm, the cell "
                f"file {travel_mm[0]:g} to {travel_mm[1]:g} mm"
            )
    return found


def check_identity(where: str, cell: Cell) -> str:
    """Return a warning for a simulated cell with the name or serial of a built-in one, and for a
    real one with lengths that have no certificate.

    Raises `SettingsError` for a real cell with such a name or serial.
    """
    if where in built_in_cells():
        return ""
    built_in = {name: load_cell(name) for name in built_in_cells()}
    problems = [
        f"{key}: {own!r} is that of the built-in cell {name}; change it"
        for name, other in built_in.items()
        if cell.simulation is None or cell.digest != other.digest
        for key, own, taken in (
            ("name", cell.name, other.name),
            ("serial", cell.serial, other.serial),
        )
        if own == taken
    ]
    simulated = "simulated"  # the certificate of each length in the built-in cells
    if cell.simulation is None:
        if problems:
            raise SettingsError(where, problems)
        problems = [
            f"layout.length {' to '.join(each.nests)}: expected the number of the bar's "
            f"certificate, got {simulated!r}; set its length and u_mm, too"
            for each in cell.layout.length
            if each.certificate == simulated
        ]
    return "\n".join(f"{where}: {problem}" for problem in problems)
