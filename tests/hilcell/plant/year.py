"""Journals of years of a plant, made from one run of a simulated cell.

Records that no answer of the plant needs are left out, so that years are written in seconds.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from hilcell.calibration.grid import grid_of
from hilcell.journal.journal import Journal, Record, chain
from hilcell.journal.log import Log
from hilcell.journal.runs import JOURNAL, read_records
from hilcell.ports import Array
from tests.hilcell.verdicts import TRACKER_AXES, plain

KEPT = ("plan", "state", "frame", "verdict", "end")
GROUPS = ("world", "grid", "base")
EARLY, LATE = 4, 3  # records before a fault, or after it
NOISE_MM = 0.02
TURN_RAD = 2e-4  # of the arm about its base, as a collision may leave it
COLLISION = {
    "code": "HC-B23",
    "device": "Robot",
    "operation": "move",
    "found": "collision detection",
    "wanted": "",
    "act": "look at the arm",
    "fields": {},
    "causes": [],
}
Field = Callable[[Array], Array]


@dataclass(frozen=True)
class Run:
    """One run that is to be written: who, when, and how it differs from the model.

    ``moved`` gives the change of the robot's error (N, 3) at places (N, 3), mm in {B}.
    """

    name: str
    cell: str
    serial: str
    began: datetime
    robot: str = "R-1"
    tracker: str = "T-1"
    real: bool = False
    moved: Field = field(default=np.zeros_like)
    base_mm: tuple[float, ...] = (0.0, 0.0, 0.0)  # by which {B} was found elsewhere
    means_mm: dict[str, float] = field(default_factory=dict)
    scale_ppm: float = 0.0
    axes_urad: tuple[float, float, float] | None = None  # of the tracker, as checked
    fault: dict[str, Any] | None = None
    late: bool = False  # the fault came at the very end


class Model:
    """The run that all others are copies of."""

    def __init__(self, folder: Path, *, whole: bool = False) -> None:
        """``whole`` copies have all records."""
        records = read_records(folder)
        self.log = Log(records)
        self.records = [record for record in records if whole or _kept(record)]
        grid = grid_of(self.log.cell)
        self.places_mm = grid.vertices_mm()
        self.R_L_B = self.log.matrix("world")[:3, :3].T @ self.log.matrix("base")[:3, :3]

    def write(self, runs: Path, run: Run) -> Path:
        """Write the journal of a run; return its folder."""
        copied = msgspec.json.decode(msgspec.json.encode(self.records), type=list[Record])
        first = datetime.fromisoformat(copied[0].t)
        moved_mm = run.moved(self.places_mm.reshape(-1, 3)).reshape(self.places_mm.shape)
        rows = []
        whole = len(copied) if run.fault is None else -LATE if run.late else EARLY
        for record in copied[:whole]:
            t = run.began + (datetime.fromisoformat(record.t) - first)
            self._change(record, run, moved_mm)
            if run.axes_urad is not None and record.kind == "end":
                c, i, v = run.axes_urad
                axes = replace(TRACKER_AXES, collimation_urad=c, transit_urad=i, index_urad=v)
                rows.append((t, "verdict", "tracker-axes", plain(replace(axes, holds=True))))
            rows.append((t, record.kind, record.key, record.body))
        if run.fault is not None:
            reason = {"reason": "Robot: move: collision detection", "error": run.fault}
            state = {"machine": "run", "from": "running", "to": "faulted", "trigger": "fault"}
            rows.append((t, "state", "", state | reason))
            end = {"state": "faulted", "exit": 3, "result": {}, "reason": reason["reason"]}
            rows.append((t, "end", "", end))
        return write_journal(runs / run.name, rows)

    def _change(self, record: Record, run: Run, moved_mm: Array) -> None:
        body = record.body
        match record.kind:
            case "plan":
                body["cell"] |= {"name": run.cell, "serial": run.serial}
                if run.real:
                    body["simulated"], body["cell"]["simulation"] = False, None
            case "event" if body["what"] == "connected":
                for device in body["devices"]:
                    device["simulated"] = not run.real
                    serials = {"robot": run.robot, "tracker": run.tracker}
                    device["serial"] = serials.get(device["kind"], device["serial"])
            case "point" if body["group"] == "grid":
                at = tuple(body["id"]["vertex"])
                body["xyz_mm"] = (np.array(body["xyz_mm"]) + self.R_L_B @ moved_mm[at]).tolist()
            case "frame" if record.key == "base":
                for axis in range(3):
                    body["matrix"][axis][3] += run.base_mm[axis]
            case "verdict":
                for length in body.get("lengths", ()):
                    length["found_mm"] += length["wanted_mm"] * run.scale_ppm * 1e-6
                place = record.key.removeprefix("validation.")
                body |= {"mean_mm": run.means_mm[place]} if place in run.means_mm else {}


def _kept(record: Record) -> bool:
    if record.kind == "event":
        return str(record.body["what"]) == "connected"
    return record.kind in KEPT or str(record.body.get("group")) in GROUPS


def write_journal(folder: Path, rows: Sequence[tuple[datetime, Any, str, dict[str, Any]]]) -> Path:
    """Write a journal whose records have times of their own."""
    folder.mkdir(parents=True)
    path = folder / JOURNAL
    Journal(path, folder.name, create=True).close()
    return extend(folder, rows)


def extend(folder: Path, rows: Sequence[tuple[datetime, Any, str, dict[str, Any]]]) -> Path:
    base = sqlite3.connect(folder / JOURNAL)
    seq, before = base.execute("SELECT seq, hash FROM record ORDER BY seq DESC").fetchone() or (
        0,
        b"",
    )
    for n, (t, kind, key, body) in enumerate(rows, start=seq + 1):
        moment = t.astimezone(UTC).isoformat(timespec="milliseconds")
        before = chain(before, Record(n, moment, kind, key, body))
        values = (n, moment, kind, key, msgspec.json.encode(body).decode(), before)
        base.execute("INSERT INTO record VALUES (?, ?, ?, ?, ?, ?)", values)
    base.commit()
    base.close()
    return folder


def revoke(folder: Path, when: datetime) -> None:
    event = {"what": "calibration revoked", "reason": "bumped", "operator": "Ann"}
    extend(folder, [(when, "event", "", event)])


def turned(places_mm: Array, rad: float = TURN_RAD) -> Array:
    """Return how an arm's errors change that has turned about the z axis of its base."""
    moved: Array = np.cross(np.array([0.0, 0.0, rad]), places_mm)
    return moved


def noisy(seed: int, changed: Field, places_mm: Array) -> Array:
    """Return a change with the noise of one calibration."""
    noise_mm = np.random.default_rng(seed).normal(0.0, NOISE_MM, places_mm.shape)
    found: Array = changed(places_mm) + noise_mm
    return found


def year(model: Model, runs: Path, last: datetime, months: int = 12) -> datetime:
    """Write a year of three cells, a collision in the second; return when that was.

    A station of the third gets worse, and its tracker finds lengths too long.
    """
    month = timedelta(days=365.25 / 12)
    crash = last - (months // 2) * month + timedelta(days=3)
    for number, cell in enumerate(("north", "middle", "south")):
        who = partial(Run, cell=cell, serial=f"HC-{number}", robot=f"R-{number}")
        for at in range(months):
            began = last - (months - 1 - at) * month
            hit = cell == "middle" and began > crash
            changed: Field = turned if hit else np.zeros_like
            wear_mm = 0.1 + 0.01 * at + 0.004 * (at % 2) if cell == "south" else 0.1
            model.write(
                runs,
                who(
                    f"{cell}-{at:02d}",
                    began=began,
                    tracker=f"T-{number}",
                    base_mm=tuple(
                        np.random.default_rng(7 * number + at).normal(0.0, 0.01, 3).tolist()
                    ),
                    moved=partial(noisy, 100 * number + at, changed),
                    means_mm={"S300": wear_mm},
                    scale_ppm=120.0 if cell == "south" else 0.0,
                    axes_urad=(2.0 * at + at % 2, -1.0, 3.0),
                ),
            )
    hit_run = Run("middle-hit", "middle", "HC-1", crash, "R-1", "T-1", fault=COLLISION)
    model.write(runs, hit_run)
    return crash
