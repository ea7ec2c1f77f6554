"""Halls that nobody has measured, as processes, and the cell file that would be right for each."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from scipy.spatial.transform import Rotation

from hilcell.cell.file import Cell, load_cell
from tests.whole.bench import Simulation, sim_command

FREE_PORTS = "rail=0,robot=0,tracker=0,control=0"


@dataclass(frozen=True)
class Hall:
    """One running hall: its sheet as a person has it, and what only a test may ask."""

    sheet: Mapping[str, Any]
    simulation: Simulation

    def truth(self) -> dict[str, Any]:
        """Return the truth: frames and reflectors in {W}, and the drawn cell's tables."""
        return self.simulation.ask(do="truth")

    def travel(self) -> dict[str, Any]:
        """Return how far slide and axes went since the last call, and how long they moved."""
        return self.simulation.ask(do="travel")

    def right_cell(self) -> dict[str, Any]:
        """Return the tables of a cell file without an error, in another name.

        Nobody but a test could write it; its addresses are those of the sheet.
        """
        cell: dict[str, Any] = self.truth()["cell"]
        sizes = cell.pop("simulation")["sizes"]
        device, rail = sizes["rail_device"], cell["rail"]
        same = (
            "drive_node", "strip_node", "counts_per_mm", "strip_counts_per_mm", "strip_zero_mm",
            "speed_unit", "counts_per_turn",
        )  # fmt: skip
        rail["options"] = {key: device[key] for key in same} | self.sheet["addresses"]["rail"]
        rail["options"]["homing"] = "absolute" if device["absolute"] else 37
        for table in ("robot", "tracker"):
            cell[table]["options"] |= self.sheet["addresses"][table]
        for joint, (low, high) in zip(
            cell["robot"]["joint"], sizes["controller"]["limits_deg"], strict=True
        ):
            joint["min_deg"], joint["max_deg"] = low, high
        if sizes.get("coupling"):
            cell["robot"]["joint"][2] |= {"coupled_to": 2, "coupling": int(sizes["coupling"])}
            base = cell["base_frame"]
            for pose_deg in (cell["robot"]["safe_deg"], base["axis_1_deg"], base["axis_6_deg"]):
                pose_deg[2] -= sizes["coupling"] * pose_deg[1]
        return cell | {"name": "right", "serial": "HALL-1"}


def write_cell(tables: Mapping[str, Any], file: Path) -> Path:
    """Write a cell file; values that are null are left out, as TOML has none."""
    file.write_text(tomlkit.dumps(_stated(tables)), "utf-8")
    return file


def _stated(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _stated(each) for key, each in value.items() if each is not None}
    return [_stated(each) for each in value] if isinstance(value, list) else value


@contextmanager
def unknown_hall(
    folder: Path, seed: int = 7, *, trap: str = "", speed: str = "max"
) -> Iterator[Hall]:
    """Run ``hilcell sim --cell unknown`` at free ports, with its truth."""
    words = ["--cell", "unknown", "--seed", str(seed), "--speed", speed, "--truth"]
    words += ["--sheet", str(folder), "--ports", FREE_PORTS]
    words += ["--trap", trap] if trap else []
    with sim_command(*words) as simulation:
        yield Hall(json.loads((folder / "hall.json").read_text("utf-8")), simulation)


# Largest differences of a commissioned cell file from the truth: those of steps by eye and of
# robots with errors of a millimetre, not of a calibration.
PLACE_MM, TURN_DEG, SCALE_SHARE, STRIP_MM, LIMIT_DEG = 6.0, 0.3, 2e-3, 3.0, 0.01


def differences(file: Path, hall: Hall) -> list[str]:
    """Return what a cell file says differently from a hall, in words; none for a right one.

    Positions on the rail may have another zero and another direction than the truth has: frames are
    compared where the slide stands now. Nests on the slide may have any names.
    """
    cell, truth = load_cell(str(file)), hall.truth()
    device = truth["cell"]["simulation"]["sizes"]["rail_device"]
    strip_per_mm = float(cell.rail.options.get("strip_counts_per_mm", 100.0))
    rail_mm = (truth["slide_mm"] + device["strip_zero_mm"]) * device["strip_counts_per_mm"]
    rail_mm = rail_mm / strip_per_mm - float(cell.rail.options.get("strip_zero_mm", 0.0))
    return [
        *_of_the_rail(cell, device, strip_per_mm, rail_mm),
        *_of_places(cell, truth, rail_mm),
        *_of_the_robot(cell, truth["cell"]),
    ]


def _of_the_rail(
    cell: Cell, device: Mapping[str, Any], strip_per_mm: float, rail_mm: float
) -> Iterator[str]:
    options = cell.rail.options
    for key, default in (("drive_node", 5), ("strip_node", 6)):
        if options.get(key, default) != device[key]:
            yield f"rail.options.{key}: {options.get(key, default)}, not {device[key]}"
    counts_per_mm = float(options.get("counts_per_mm", 1000.0))
    scales = {
        "counts_per_mm": counts_per_mm / device["counts_per_mm"],
        "strip_counts_per_mm": strip_per_mm / device["strip_counts_per_mm"],
    }
    for key, share in scales.items():
        if not abs(abs(share) - 1.0) <= SCALE_SHARE:
            yield f"rail.options.{key}: not {device[key]}"
    if not scales["counts_per_mm"] * scales["strip_counts_per_mm"] > 0.0:
        yield "drive and strip count in opposite directions"
    stated = device["speed_unit"] if device["states_units"] else "counts/s"
    if (options.get("speed_unit") or stated) != device["speed_unit"]:
        yield f"rail.options.speed_unit: not {device['speed_unit']}"
    low_mm, high_mm = cell.rail.travel_min_mm - STRIP_MM, cell.rail.travel_max_mm + STRIP_MM
    if not low_mm <= rail_mm <= high_mm:
        yield f"the slide stands at {rail_mm:.1f} mm, outside {low_mm:.1f} .. {high_mm:.1f} mm"


def _of_places(cell: Cell, truth: Mapping[str, Any], rail_mm: float) -> Iterator[str]:
    base = cell.layout.nominal_base(rail_mm)
    for name, here, true in (
        ("tracker.pose", cell.tracker.pose.matrix(), np.array(truth["T_W_L"])),
        ("layout.base", base, np.array(truth["T_W_B"])),
    ):
        apart_mm = math.dist(here[:3, 3], true[:3, 3])
        turned = Rotation.from_matrix(here[:3, :3].T @ true[:3, :3])
        turned_deg = float(np.degrees(turned.magnitude()))
        if not (apart_mm <= PLACE_MM and turned_deg <= TURN_DEG):
            yield f"{name}: {apart_mm:.2f} mm and {turned_deg:.3f} deg from the true one"
    places = truth["reflectors_mm"]
    for nest in cell.layout.fixed_nests:
        if not (apart_mm := math.dist(nest.xyz_mm, places[nest.name])) <= PLACE_MM:
            yield f"nest {nest.name}: {apart_mm:.2f} mm from the true one"
    on_slide = [places[nest["name"]] for nest in truth["cell"]["layout"]["slide"]]
    for nest in cell.layout.slide:
        at_mm = (base @ [*nest.xyz_mm, 1.0])[:3]
        if not (apart_mm := min(math.dist(at_mm, each) for each in on_slide)) <= PLACE_MM:
            yield f"nest {nest.name}: {apart_mm:.2f} mm from the nearest on the slide"


def _of_the_robot(cell: Cell, drawn: Mapping[str, Any]) -> Iterator[str]:
    sizes = drawn["simulation"]["sizes"]
    if not (apart_mm := math.dist(cell.robot.smr_mm, drawn["robot"]["smr_mm"])) <= PLACE_MM:
        yield f"robot.smr_mm: {apart_mm:.2f} mm from the true one"
    coupling = float(sizes.get("coupling", 0.0))
    if cell.robot.arm().coupling != coupling:
        yield f"axis 3: coupling {coupling:g} to axis 2 is not stated"
    limits_deg = sizes["controller"]["limits_deg"]
    for n, (joint, (low, high)) in enumerate(zip(cell.robot.joint, limits_deg, strict=True), 1):
        if not low - LIMIT_DEG <= joint.min_deg < joint.max_deg <= high + LIMIT_DEG:
            yield f"axis {n}: {joint.min_deg} .. {joint.max_deg} deg, not within {low} .. {high}"
    if cell.tracker.reflector != drawn["tracker"]["reflector"]:
        yield f"tracker.reflector: {cell.tracker.reflector}, not {drawn['tracker']['reflector']}"
