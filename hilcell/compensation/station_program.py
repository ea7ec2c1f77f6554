"""Corrected targets of one station, as a writer of a robot's language needs them.

A writer is a function from a `StationProgram` and a stamp to files by name. The entry point group
``hilcell.program_writers`` names it by the robot's driver: ``my-robot = "package.module:write"``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points

from hilcell.cell.devices import load_entry
from hilcell.compensation.stamp import Stamp
from hilcell.geometry.kinematics import Ints
from hilcell.ports import Array
from hilcell.typed import Json


@dataclass(frozen=True, eq=False)
class Places:
    """N poses of a tool's tip in {W}, ``values`` (N, 6): x, y, z in mm, Z-Y-X angles in deg; and
    how the nominal arm stands there: ``joints_rad`` (N, 6), ``status`` (N,).
    """

    values: Array
    joints_rad: Array
    status: Ints


@dataclass(frozen=True, eq=False)
class StationProgram:
    """N targets in order of visit, by ``names``: ``command`` is where the tool's tip is sent.

    From the hole before, or the safe pose, the robot goes by joints through ``via`` (N + 1, the
    last before the safe pose at the end; each may have no places) to ``approach``, from there to
    ``standoff``, in front of the target, so that every axis comes from below, as the calibration
    came to its poses; then straight to ``command``, and straight back to ``standoff``. ``base``
    (6,) is {W} in {B}; ``tool`` (6,) is the tip in the flange, ``tool_name`` the tool's name in the
    cell file, ``tool_number`` its number in the controller, None where the cell file has none.
    The program begins and ends at ``safe_deg`` (6,). ``options`` are those of the robot's driver,
    ``remarks`` comments for its head.
    """

    station: str
    names: Sequence[str]
    command: Places
    standoff: Places
    approach: Places
    via: Sequence[Places]
    base: Array
    tool: Array
    tool_name: str
    tool_number: int | None
    safe_deg: Sequence[float]
    speed_percent: float
    options: Json
    remarks: Sequence[str]


Writer = Callable[[StationProgram, Stamp], Mapping[str, bytes]]


def writer_of(driver: str) -> Writer | None:
    """Return the writer for a robot's driver, None where none is installed."""
    group = "program_writers"
    if driver not in entry_points(group=f"hilcell.{group}").names:
        return None
    writer: Writer = load_entry(group, driver)
    return writer
