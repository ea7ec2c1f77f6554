"""``python -m benchmarks.plant_year [FOLDER]``: a year of three simulated cells, really calibrated.

Each cell is one machine that lives for the whole year behind its wires; every month the engine
calibrates it with a small plan. In the second cell the arm collides in the seventh month: a run
ends with a stop of the controller, and from then on axis 1 is off by a sixtieth of a degree. In the
third, axis 3 wears by a little each month. Nothing of that is said to the engine. Only the dates
are set: the records of a run that took seconds are moved into their month. Then all is shipped to
an office's database, `hilcell plant show` prints what it finds, and this command fails where it
does not name the collision, or names another.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime, timedelta
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.words import parser
from hilcell.calibration.file import read_calibration, write_calibration
from hilcell.commands.cli import main as hilcell
from hilcell.journal.runs import CALIBRATION, read_records
from tests.hilcell.plant.year import write_journal
from tests.whole.bench import SMALL, Simulation, command, sets, simulation

CELLS = ("north", "middle", "south")
HIT, WORN = "middle", "south"
ROBOTS = 860200
MONTHS, CRASH = 12, 7
MONTH = timedelta(days=365.25 / 12)
LOST_DEG, WEAR_DEG = 1 / 60, 0.0008


def live(folder: Path, cell: str) -> float:
    """Calibrate a cell every month of a year; return the seconds of processor that it took."""
    began_s = time.process_time()
    number = CELLS.index(cell) + 1
    values = {"name": cell, "serial": f"HC-{number}"} | SMALL
    values["simulation.machine"] = str(machine_file(folder, number))
    with simulation(values=values, seed=number) as machine:
        order = partial(calibrate, folder, values | {"simulation.address": machine.control})
        for month in range(1, MONTHS + 1):
            if cell == HIT and month == CRASH:
                fault(machine, "robot.stopmess", True, after=300)
                order(f"{cell}-hit", month, wanted=3)
                machine.ask(do="clear")
                fault(machine, "robot.lost_zero", LOST_DEG)
            if cell == WORN:
                fault(machine, "robot.lost_zero_3", WEAR_DEG)
            order(f"{cell}-{month:02d}", month, wanted=0)
    return time.process_time() - began_s


def machine_file(folder: Path, number: int) -> Path:
    """Return the description of the cell's machine: the paper's, with a robot of its own."""
    text = (resources.files("fakes.truth.machines") / "paper.toml").read_text("utf-8")
    place = folder / f"machine-{number}.toml"
    folder.mkdir(parents=True, exist_ok=True)
    own = re.sub(r"^serial = \d+$", f"serial = {ROBOTS + number}", text, count=1, flags=re.M)
    assert own != text
    place.write_text(own, "utf-8")
    return place


def fault(machine: Simulation, name: str, value: object, after: int = 0) -> None:
    answer = machine.ask(do="fault", name=name, value=value, after=after, count=1)
    assert answer["ok"], answer


def calibrate(folder: Path, values: dict[str, str], name: str, month: int, wanted: int) -> None:
    """Perform one calibration, and move its records into their month."""
    words = ("--name", name, "--seed", str(month), "--unattended", "--json")
    done = command("run", "--runs", folder / "measured", *words, *sets(values))
    assert done.returncode == wanted, f"{name}: exit code {done.returncode}\n{done.stderr}"
    days = MONTH * (MONTHS - month) + timedelta(days=20 if wanted == 0 else 30)
    dated(folder / "measured" / name, folder / "runs" / name, datetime.now(UTC) - days)


def dated(source: Path, place: Path, began: datetime) -> None:
    """Copy a run as if it had begun at another time."""
    records = read_records(source)
    later = began - datetime.fromisoformat(records[0].t)
    rows = [
        (datetime.fromisoformat(each.t) + later, each.kind, each.key, each.body) for each in records
    ]
    write_journal(place, rows)
    if (source / CALIBRATION).exists():
        found = read_calibration(source / CALIBRATION)
        provenance = msgspec.structs.replace(found.provenance, written=rows[-1][0].isoformat())
        moved = msgspec.structs.replace(found, provenance=provenance)
        write_calibration(moved, place / CALIBRATION)


def shown(url: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(command("plant", "show", "--from", url, "--json").stdout)
    return found


def mistakes(found: dict[str, Any]) -> list[str]:
    """Return what the records do not show of such a year, or show without a cause."""
    steps = [(each["cell"], step) for each in found["robots"] for step in each["changes"]]
    places = {(cell, step["after"], step["before"]) for cell, step in steps}
    wanted = {(HIT, f"{HIT}-hit", f"{HIT}-{CRASH:02d}")}  # it ended after its grid was measured
    said = {words for _, step in steps for words in step["said"] if f"({HIT}-hit)" in words}
    drifting = {
        each["cell"] for each in found["robots"] if any(it["drifts"] for it in each["drift"])
    }
    return [
        *([f"steps at {sorted(places)}, expected {sorted(wanted)}"] if places != wanted else []),
        *([] if said else ["no alarm of the collision beside the step"]),
        *([f"drifting: {sorted(drifting)}, expected {WORN}"] if drifting != {WORN} else []),
    ]


def main() -> int:
    line = parser(__doc__)
    line.add_argument("folder", type=Path, nargs="?", metavar="FOLDER")
    given = line.parse_args().folder
    with tempfile.TemporaryDirectory() as temporary:
        folder = given or Path(temporary)
        began_s = time.monotonic()
        count = min(len(CELLS), os.cpu_count() or 1)
        # Not a Pool: it ends its workers by SIGTERM, which a process that ran a cell only notes.
        with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
            taken_s = list(pool.map(partial(live, folder), CELLS))
        url = f"sqlite:///{folder / 'plant.db'}"
        for words in (["init", "--to", url], ["ship", str(folder / "runs"), "--to", url]):
            assert hilcell(["plant", *words]) == 0
        assert hilcell(["plant", "show", "--from", url]) == 0
        wrong = mistakes(shown(url))
    runs = len(CELLS) * MONTHS + 1
    print(
        f"{runs} runs really measured in {time.monotonic() - began_s:.0f} s, "
        f"{sum(taken_s):.0f} s of processor; {'; '.join(wrong) or 'the collision is named'}"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
