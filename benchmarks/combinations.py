"""``python -m benchmarks.combinations``: docs/combinations.md, each pair of devices calibrated.

By robot, tracker and rail: the outcome, the mean error before and after correction, the floor that
the instrument's noise sets, and the engine's processor time a point. Drivers are those of the entry
points; robots of Universal Robots work in cell `lab`, those of ABB in `abb`, all others in `paper`.
An axis E1 belongs to a KUKA.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import entry_points
from itertools import product
from pathlib import Path

from benchmarks.words import parser
from tests.whole.bench import HILCELL

CELL_OF = {"abb-egm": "abb", "ur-rtde": "lab"}  # others: paper
RIDDEN = "kuka-e1"
COARSE = {  # tolerances and numbers of samples that fit the instrument (docs/hardware.md)
    "leica-geocom": [
        "tracker.samples=4", "tracker.max_std_mm=3.0", "layout.nest_samples=9",
        "layout.max_tool_std_mm=0.5", "uncertainty.tracker_limit_mm=0.3",
        "uncertainty.tracker_limit_um_m=2.5", "validation.mean_tolerance_mm=1.5",
        "validation.max_tolerance_mm=3.0", "base_frame.points=24",
    ],
    "t2sa": [  # a laser tracker's noise, and the gears' ripple, for it does not stream
        "validation.mean_tolerance_mm=0.2", "validation.max_tolerance_mm=0.6",
    ],
}  # fmt: skip
HEAD = (
    "# Combinations\n\n"
    "Each installed robot driver with each tracker and rail driver, calibrated over the wires of "
    "simulated devices, grid's station. Written by `python -m benchmarks.combinations`, which "
    "names the tolerances that it takes for total stations and trackers that do not stream. Exit 0 "
    "is a calibration within them.\n\n"
    "| cell | robot | tracker | rail | exit | mean before mm | mean after mm | floor mm | points "
    "| engine ms a point |\n|---|---|---|---|---|---|---|---|---|---|"
)
LOOK_S = 0.05


@dataclass(frozen=True, slots=True)
class Combination:
    """One set of drivers in one cell."""

    robot: str
    tracker: str
    rail: str

    @property
    def cell(self) -> str:
        return CELL_OF.get(self.robot, "paper")

    @property
    def settings(self) -> list[str]:
        drivers = [f"{t}.driver={getattr(self, t)}" for t in ("robot", "tracker", "rail")]
        return drivers + (COARSE.get(self.tracker, []) if self.cell != "lab" else [])


def combinations() -> list[Combination]:
    """Return every sensible combination of the installed drivers."""
    robots, trackers, rails = (
        sorted(entry_points(group=f"hilcell.{group}").names)
        for group in ("robots", "trackers", "rails")
    )
    return [
        Combination(*each)
        for each in product(robots, trackers, rails)
        if each[2] != "none" and not (each[2] == RIDDEN and not each[0].startswith("kuka"))
    ]


def row(combination: Combination, runs: str) -> str:
    words = [*HILCELL, "run", "calibrate", "--cell", combination.cell, "--unattended", "--json"]
    words += ["--runs", runs]
    words += [word for each in combination.settings for word in ("--set", each)]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        run = subprocess.Popen(words, stdout=out, stderr=err)
        spent_s = processor_s(run)
        code = run.wait()
        out.seek(0)
        err.seek(0)
        last, said = out.read().splitlines()[-1:], err.read().decode().strip().splitlines()[-1:]
    names = [combination.cell, combination.robot, combination.tracker, combination.rail, str(code)]
    if code not in (0, 1):
        return _line([*names, *[line[:80] for line in said or [""]], "", "", "", ""])
    result = json.loads(last[0])["result"]
    place = next(iter(result["validation"].values()))
    points = sum(result["points"].values())
    figures = [place["before"]["mean"], place["chosen"]["mean"], place.get("floor", {}).get("mean")]
    shown_mm = ["-" if each is None else f"{each:.3f}" for each in figures]
    return _line([*names, *shown_mm, str(points), f"{1e3 * spent_s / points:.1f}"])


def processor_s(run: subprocess.Popen[bytes]) -> float:
    """Return the processor time of a process alone, without its simulated cell, at its end."""
    spent_s = 0.0
    while run.poll() is None:
        with suppress(OSError):
            stat = Path(f"/proc/{run.pid}/stat").read_text("ascii")
            utime, stime = stat.rsplit(")", 1)[1].split()[11:13]
            spent_s = (int(utime) + int(stime)) / os.sysconf("SC_CLK_TCK")
        time.sleep(LOOK_S)
    return spent_s


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser(__doc__).parse_args()
    print(HEAD)
    with tempfile.TemporaryDirectory() as runs:
        for combination in combinations():
            print(row(combination, runs), flush=True)


if __name__ == "__main__":
    main()
