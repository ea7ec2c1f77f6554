"""Small synthetic journals, written as a run writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from hilcell.cell.file import load_cell
from hilcell.journal.journal import Journal, read_journal
from hilcell.journal.runs import JOURNAL
from hilcell.model.point import PointId
from hilcell.ports import Array
from hilcell.report.facts import Facts, read_facts
from tests.hilcell.verdicts import framed

DEVICES = [{"device": "Robot", "model": "KR 210", "serial": "860112", "address": "127.0.0.1:1"}]
# Errors (mm) whose norms, means and ratios are plain to the eye.
BEFORE_MM = [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 3.0), (0.0, 0.0, 2.0)]
AFTER_MM = [(0.1, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.3), (0.0, 0.0, 0.2)]


class Writer:
    """A journal in the making; {W} is the tracker's frame, so that figures are easy to foretell."""

    def __init__(self, folder: Path, **plan: Any) -> None:
        self.air: dict[str, float | None] = {
            "temperature_c": 22.0, "pressure_mbar": 1013.0, "humidity_percent": 45.0,
        }  # fmt: skip
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.journal = Journal(folder / JOURNAL, folder.name, create=True)
        self.journal.append("plan", "", plan_record() | plan)

    def began(self, devices: list[dict[str, str]] | None = None) -> Writer:
        self.state("run", "checking")
        self.journal.append(
            "event", "", {"what": "connected", "devices": DEVICES if devices is None else devices}
        )
        self.state("run", "running")
        self.frame("world")
        return self

    def state(self, machine: str, to: str, **more: str) -> None:
        self.journal.append("state", "", {"machine": machine, "to": to} | more)

    def event(self, what: str, **facts: Any) -> None:
        self.journal.append("event", "", {"what": what} | facts)

    def step(self, name: str, number: int = 1, of: int = 1) -> None:
        self.event("step", name=name, number=number, of=of)

    def frame(self, key: str, **more: Any) -> None:
        self.journal.append("frame", key, framed(key, **more))

    def point(self, id: PointId, xyz_mm: Any, station: str = "", **more: Any) -> None:
        body = {
            "id": id, "group": id.group, "station": station, "frame": "tracker",
            "reflector": "SMR 1.5in",
            "xyz_mm": tuple(map(float, xyz_mm)), "std_mm": (0.01, 0.01, 0.01), "samples": 1,
            "session": 1,
        }  # fmt: skip
        self.journal.append("point", id.key, body | self.air | more)

    def validated(self, station: str, how: str, errors_mm: Sequence[tuple[float, ...]]) -> Writer:
        for number, error_mm in enumerate(errors_mm):
            nominal_mm = np.array([100.0 * number, 50.0 * number, 900.0 + 70.0 * number])
            self.point(
                PointId("validate", station=station, how=how, number=number),
                nominal_mm + error_mm,
                station,
                nominal_mm=tuple(nominal_mm),
                smr_mm=(0.0, 0.0, 0.0),
                commanded_deg=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
            )
        return self

    def nests_read(self) -> Writer:
        """Measure the three floor nests, which is enough for a budget with {W}."""
        for n, nest in enumerate(("F1", "F2", "F3")):
            self.point(PointId("world", nest=nest), (1000.0 * n, 1000.0 * (n == 1), 0))
        return self

    def visited(self, clouds_mm: list[Array]) -> Writer:
        for place, cloud in enumerate(clouds_mm):
            for visit, xyz_mm in enumerate(cloud):
                id = PointId("repeatability", place=place, number=visit)
                self.point(id, xyz_mm, "S1100", smr_mm=(0.0, 0.0, 0.0))
        return self

    def ended(self, state: str = "finished", code: int = 0, reason: str = "") -> Path:
        self.state("run", state, reason=reason)
        end = {"state": state, "exit": code, "result": {}}
        self.journal.append("end", "", end)
        return self.left()

    def left(self) -> Path:
        """Close the file as a crash would leave it."""
        self.journal.close()
        return self.folder

    def facts(self) -> Facts:
        return read_facts(self.ended())


def plan_record() -> dict[str, Any]:
    cell = load_cell("paper")
    return {
        "procedure": "home", "cell": msgspec.to_builtins(cell), "digest": cell.digest, "seed": 7,
        "machine_seed": 7, "replayed": False, "cell_file": "paper",
        "speed": None, "unattended": True, "operator": "A. Technician", "job": "J-17",
        "simulated": True, "versions": {"hilcell": "0.1.0", "python": "3.11"}, "settings": {},
        "steps": [], "points": 8, "duration_s": 60.0,
    }  # fmt: skip


def validated_run(folder: Path, **plan: Any) -> Writer:
    """Return a run with targets before and after at two stations."""
    writer = Writer(folder, **plan).began()
    for station in ("S1100", "S300"):
        writer.validated(station, "before", BEFORE_MM).validated(station, "chosen", AFTER_MM)
    return writer


def renamed(source: Path, folder: Path, names: Mapping[str, str]) -> Path:
    """Write the journal of a run with other names in all its records, and return its folder."""
    folder.mkdir()
    journal = Journal(folder / JOURNAL, folder.name, create=True)
    for record in read_journal(source / JOURNAL):
        key, body = record.key, msgspec.json.encode(record.body).decode()
        for old, new in names.items():
            key, body = key.replace(old, new), body.replace(old, new)
        journal.append(record.kind, key, msgspec.json.decode(body))
    journal.close()
    return folder
