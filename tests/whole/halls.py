"""Halls that nobody has measured, as processes, and the cell file that would be right for each."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

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
