"""Traps: one thing in the hall that is not as the cell file, or a hasty person, takes for granted.

A trap changes the cell of the truth, or a setting of a simulated device; no device has a branch for
it. It can be set in a drawn hall, and in any simulated cell whose file is then wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import msgspec

from fakes.canopen.rail_device import RailDevice
from fakes.truth.machine import cell_machine
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, did_you_mean
from hilcell.decoding import typed


@dataclass(frozen=True, slots=True)
class Trap:
    """One line for a person, and the cell of the truth, of that without the trap."""

    text: str
    set_in: Callable[[Cell], Cell]


def rail_device(cell: Cell) -> RailDevice:
    """Return drive and strip of a simulated cell; raises `SettingsError`."""
    values = cell_machine(cell).rail_device
    known = [each.name for each in fields(RailDevice)]
    if unknown := [name for name in values if name not in known]:
        raise SettingsError(
            "simulation.sizes.rail_device",
            [f"unknown setting {name!r}{did_you_mean(name, known)}" for name in unknown],
        )
    return typed(values, RailDevice)


def with_sizes(cell: Cell, **sizes: Any) -> Cell:
    """Return a simulated cell with other values of its machine; tables are merged, one level deep.

    Raises `SettingsError` for a real cell.
    """
    if cell.simulation is None:
        raise SettingsError("simulation", ["missing; a trap is set in a simulated cell only"])
    before = cell.simulation.sizes
    merged = {
        key: {**before.get(key, {}), **value} if isinstance(value, Mapping) else value
        for key, value in sizes.items()
    }
    simulation = msgspec.structs.replace(cell.simulation, sizes={**before, **merged})
    return msgspec.structs.replace(cell, simulation=simulation)


def _scaled(factor: float) -> Callable[[Cell], Cell]:
    def scaled(cell: Cell) -> Cell:
        counts_per_mm = factor * rail_device(cell).counts_per_mm
        return with_sizes(cell, rail_device={"counts_per_mm": counts_per_mm})

    return scaled


def _strip_turned(cell: Cell) -> Cell:
    counts_per_mm = -rail_device(cell).strip_counts_per_mm
    return with_sizes(cell, rail_device={"strip_counts_per_mm": counts_per_mm})


def _speed_in(unit: str) -> Callable[[Cell], Cell]:
    return lambda cell: with_sizes(cell, rail_device={"speed_unit": unit})


def _nodes_exchanged(cell: Cell) -> Cell:
    device = rail_device(cell)
    nodes = {"drive_node": device.strip_node, "strip_node": device.drive_node}
    return with_sizes(cell, rail_device=nodes)


def _heedless(cell: Cell) -> Cell:
    return with_sizes(cell, rail_device={"watchful": False})


def _nests_exchanged(cell: Cell) -> Cell:
    """The second and the third nest on the floor carry each other's names."""
    first, second, third, *more = cell.layout.floor
    renamed = msgspec.structs.replace
    floor = [first, renamed(third, name=second.name), renamed(second, name=third.name), *more]
    layout = msgspec.structs.replace(cell.layout, floor=floor)
    return msgspec.structs.replace(cell, layout=layout)


def _upside_down(cell: Cell) -> Cell:
    pose = cell.tracker.pose
    turned = msgspec.structs.replace(pose, c_deg=pose.c_deg + 180.0)
    return msgspec.structs.replace(cell, tracker=msgspec.structs.replace(cell.tracker, pose=turned))


def _other_reflector(cell: Cell) -> Cell:
    tracker = msgspec.structs.replace(cell.tracker, reflector="SMR 0.5in")
    return msgspec.structs.replace(cell, tracker=tracker)


def coupled(cell: Cell) -> Cell:
    """Return the cell with a joint 3 that is the forearm's angle; the arm stands as before."""
    if cell_machine(cell).coupling:
        return cell
    home_deg = list(cell.robot.home_deg)
    home_deg[2] += home_deg[1]
    robot = msgspec.structs.replace(cell.robot, home_deg=tuple(home_deg))
    return with_sizes(msgspec.structs.replace(cell, robot=robot), coupling=-1.0)


def _wrong_tool(cell: Cell) -> Cell:
    return with_sizes(cell, controller={"tool_off_mm": [40.0, 0.0, -25.0]})


TRAPS: Mapping[str, Trap] = {
    "drive-sign": Trap("the drive counts down where it should count up", _scaled(-1.0)),
    "strip-sign": Trap("the strip counts down where it should count up", _strip_turned),
    "scale-0.9": Trap("the drive counts a tenth less a mm", _scaled(0.9)),
    "scale-10": Trap("the drive counts ten times as much a mm", _scaled(10.0)),
    "speed-rpm": Trap("the drive takes speeds in turns of its motor a minute", _speed_in("rpm")),
    "speed-0.1": Trap("the drive takes speeds in 0.1 counts/s", _speed_in("0.1 counts/s")),
    "no-self-stop": Trap("the drive does not notice that the PC has died", _heedless),
    "nests-exchanged": Trap("two nests on the floor carry each other's names", _nests_exchanged),
    "tracker-upside-down": Trap("the tracker hangs upside down", _upside_down),
    "other-smr": Trap("the reflectors are of 0.5 in", _other_reflector),
    "coupled-axis-3": Trap("joint 3 is the forearm's angle: axis 3 turns with axis 2", coupled),
    "wrong-tool": Trap("$TOOL of the controller is 47 mm off the reflector", _wrong_tool),
    "nodes-exchanged": Trap("drive and strip have each other's node numbers", _nodes_exchanged),
}


def with_trap(cell: Cell, name: str) -> Cell:
    """Return the cell of the truth with a trap; raises `SettingsError` for an unknown one."""
    if name not in TRAPS:
        hint = did_you_mean(name, TRAPS) or f"; known: {', '.join(TRAPS)}"
        raise SettingsError("--trap", [f"unknown trap {name!r}{hint}"])
    return TRAPS[name].set_in(cell)
