"""The kept recordings, `tests/wires`, and the runs that they are of: ``make recordings``."""

from __future__ import annotations

import json
import lzma
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hilcell.journal.runs import read_log
from hilcell.wire.recording import PACKED, SUFFIX, recordings
from tests.whole.bench import command, sets

KEPT = Path(__file__).parent.parent / "wires"
FACTS = "facts.json"
SMALL = {"base_frame.points": "4", "layout.nest_samples": "2"}
STRIP = '{driver = "serial", channel = "socket://127.0.0.1:1", counts_per_mm = 100.0}'
SWEPT = "kuka-c3,leica-emscon,canopen-swept"
PAIRS = {
    "kuka-c3,leica-emscon,canopen": ["--cell", "paper"],
    "kuka-c3,leica-emscon,kuka-e1": ["--cell", "paper", *sets({"rail.driver": "kuka-e1"})],
    "kuka-eki,leica-geocom,kuka-e1": ["--cell", "paper", *sets({
        "robot.driver": "kuka-eki", "tracker.driver": "leica-geocom", "rail.driver": "kuka-e1",
    })],
    "kuka-c3,t2sa,canopen": ["--cell", "paper", *sets({
        "tracker.driver": "t2sa",
        "tracker.options.points": "tests/whole/t2sa_points.csv",
    })],
    "ur-rtde,leica-geocom,canopen-strip": [
        "--cell", "lab", *sets({"rail.options.strip": STRIP})
    ],
}  # fmt: skip
PAIRS[SWEPT] = [*PAIRS["kuka-c3,leica-emscon,canopen"], *sets({"sweeps.axes": "[1]"})]


def played(folder: Path) -> dict[str, str]:
    """Return the values of a cell file that has a recording in place of its devices."""
    return {"simulation.simulator": "recorded", "simulation.data": str(folder)}


def facts(folder: Path) -> dict[str, Any]:
    """Return what a run has journalled: its devices, and its points by their keys."""
    log = read_log(folder)
    (connected,) = (r.body["devices"] for r in log.events if r.body["what"] == "connected")
    devices = [{k: v for k, v in each.items() if k != "address"} for each in connected]
    points = {
        key: {
            "xyz_mm": point.xyz_mm, "std_mm": point.std_mm, "samples": point.samples,
            "commanded_deg": point.commanded_deg, "temperature_c": point.temperature_c,
        }
        for key, point in log.points.items()
    }  # fmt: skip
    found: dict[str, Any] = json.loads(json.dumps({"devices": devices, "points": points}))
    return found


def procedure(pair: str) -> str:
    return "axis-sweeps" if pair == SWEPT else "base-frame"


def curves(folder: Path) -> list[float]:
    """Return the transmission curves: waves, amplitudes in urad and the tracker's lag in ms."""
    return [
        figure
        for curve in read_log(folder).curves.values()
        for figure in (*curve.cycles, *curve.amplitudes_urad, 1e3 * curve.lag_s)
    ]


def places_mm(folder: Path) -> list[float]:
    points = read_log(folder).points
    return [
        mm for point in points.values() for mm in (point.rail_mm, point.strip_mm) if mm is not None
    ]


def joints_deg(folder: Path) -> list[float]:
    points = read_log(folder).points
    return [deg for point in points.values() for deg in point.joints_deg or ()]


def record(pair: str, runs: Path, name: str) -> Path:
    """Run and record; return the folder of the run."""
    wanted: list[str | Path] = [*PAIRS[pair]]
    wanted += [*sets(SMALL), "--unattended", "--record-wire", "--runs", runs, "--name", name]
    done = command("run", procedure(pair), *wanted)
    assert done.returncode == 0, done.stderr
    return runs / name


def keep(run: Path, folder: Path) -> None:
    """Keep the recording of a run, packed, with its facts."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, path in recordings(run).items():
        packed = lzma.compress(path.read_bytes(), preset=9 | lzma.PRESET_EXTREME)
        (folder / f"{name}{SUFFIX}{PACKED}").write_bytes(packed)
    kept = {"facts": facts(run), "joints_deg": joints_deg(run), "places_mm": places_mm(run)}
    kept["curves"] = curves(run)
    (folder / FACTS).write_text(json.dumps(kept, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as runs:
        for number, pair in enumerate(PAIRS):
            keep(record(pair, Path(runs), f"r{number}"), KEPT / pair)
            print(pair)
