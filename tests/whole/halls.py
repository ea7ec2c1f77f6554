"""Halls that nobody has measured, as processes: commissioned as a person does, judged by the truth.

The truth gives the cell file that would be right, and all that really moved.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomlkit
from scipy.spatial.transform import Rotation

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import convert
from hilcell.cell.surroundings import KeepOut, Surroundings
from hilcell.journal.runs import read_log, read_records
from procedures.commission_places import AIM_S
from tests.whole.announced import unannounced
from tests.whole.bench import HILCELL, Simulation, command, events, hilcell, sim_command

FREE_PORTS = "rail=0,robot=0,tracker=0,control=0"
MOST_QUESTIONS, MOST_MIN = 60, 45.0
LONG_S = 900.0  # of a commissioning or a calibration on a busy machine
READY = "this cell is ready to calibrate: hilcell run --cell "


@dataclass(frozen=True)
class Hall:
    """One running hall: its sheet as a person has it, and what only a test may ask."""

    sheet: Mapping[str, Any]
    simulation: Simulation
    folder: Path  # of the sheet

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


def hall_with(robot_of: str, file: Path) -> Path:
    """Write the cell file about which halls are drawn with the robot of another built-in cell."""
    tables, other = (msgspec.to_builtins(load_cell(each)) for each in ("unknown", robot_of))
    tables |= {"robot": other["robot"], "base_frame": other["base_frame"]}
    tables["simulation"]["machine"] = other["simulation"]["machine"]
    return write_cell(tables, file)


@contextmanager
def unknown_hall(
    folder: Path,
    seed: int = 7,
    *,
    cell: str | Path = "unknown",
    trap: str = "",
    speed: str = "max",
) -> Iterator[Hall]:
    """Run ``hilcell sim --cell unknown`` at free ports, with its truth."""
    words = ["--cell", str(cell), "--seed", str(seed), "--speed", speed, "--truth"]
    words += ["--sheet", str(folder), "--ports", FREE_PORTS]
    words += ["--trap", trap] if trap else []
    with sim_command(*words) as simulation:
        yield Hall(json.loads((folder / "hall.json").read_text("utf-8")), simulation, folder)


def answers(sheet: Mapping[str, Any], folder: Path, teach: str = "none") -> str:
    """Return the lines that a person types, by the sheet of a hall in its folder."""
    lines = [
        "HC-7",
        sheet["control"],
        *(sheet["drivers"][table] for table in ("robot", "rail", "tracker")),
        sheet["reflector"],
        sheet["travel_mm"],
        sheet["room_mm"],
        "35",
        sheet["speed_mm_s"],
        sheet["acceleration_mm_s2"],
        folder / "nests.csv",
        len(sheet["slide"]),
        folder / "volumes.csv",
        teach,
        "",  # the arm's shape
        *["y"] * MOST_QUESTIONS,
    ]
    return "".join(f"{line}\n" for line in lines)


def commission(file: Path, typed: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Commission a cell file; its runs stand beside it."""
    return subprocess.run(
        [*HILCELL, "commission", str(file), "--runs", str(file.parent / "runs"), *words],
        input=typed, capture_output=True, text=True, timeout=LONG_S, check=False,
    )  # fmt: skip


@dataclass(frozen=True)
class Commissioned:
    """One `hilcell commission` in a hall: what it said, how long it took, what is wrong with it."""

    done: subprocess.CompletedProcess[str]
    questions: int
    robot_min: float  # by the clock of the simulated cell: motions, waits, readings
    person_min: float  # that a person needs besides, who puts the beam on nests
    problems: list[str]

    def said(self, step: str) -> str:
        """Return what was printed in a step, all its repetitions."""
        return self.done.stderr.partition(f", {step}: ")[2].partition("\nstep ")[0]


def commissioned(hall: Hall, file: Path, *, ready: bool = True) -> Commissioned:
    """Commission a hall by its sheet, and judge it by its truth; ``ready``: it should get so far.

    Nothing but the first words of a step's question say what may move (`tests.whole.announced`).
    """
    runs = file.parent / "runs"
    began_s = hall.travel()["now_s"]
    done = commission(file, answers(hall.sheet, hall.folder))
    travel = hall.travel()
    questions = int((done.stderr.rpartition(" questions;")[0] or "0").rpartition("\n")[2])
    robot_min = (travel["now_s"] - began_s) / 60.0
    person_min = done.stderr.count("Put the beam on ") * AIM_S / 60.0
    journals = {
        run.name: events(command("watch", run.name, "--runs", runs, "--json").stdout)
        for run in sorted(runs.glob("*-commission-*"))
    }
    problems = [*_unsound(runs)]
    problems += unannounced(done.stderr, journals, travel, _limits(hall.truth()["cell"]))
    for what, found, most in (
        ("questions", questions, MOST_QUESTIONS),
        ("minutes of robot and person", robot_min + person_min, MOST_MIN),
    ):
        if not found <= most:
            problems.append(f"{found:.0f} {what}, at most {most:g}")
    if (done.returncode == 0) != ready or (READY in done.stderr) != ready:
        problems.append(f"exit code {done.returncode}: {last_words(done.stderr)}")
    if ready and done.returncode == 0:
        problems += differences(file, hall)
    return Commissioned(done, questions, robot_min, person_min, problems)


def _unsound(runs: Path) -> Iterator[str]:
    """Yield what `hilcell show --check` says of runs that are not sound."""
    for run in sorted(runs.glob("*/")):
        checked = command("show", run.name, "--check", "--runs", runs)
        if checked.returncode:
            yield f"{run.name}: {last_words(checked.stdout + checked.stderr)}"


@dataclass(frozen=True)
class Calibrated:
    """A calibration of a commissioned cell file, and the programs that it corrects."""

    mean_mm: float
    largest_mm: float
    problems: list[str]


def calibrated(file: Path) -> Calibrated:
    """Run `hilcell run` and `hilcell prepare` on a commissioned cell file."""
    runs = ("--runs", file.parent / "runs")
    ran = hilcell("run", "--cell", file, "--name", "first", *runs, limit_s=LONG_S)
    said = re.search(r"IN TOLERANCE.*mean ([\d.]+).*largest ([\d.]+)", ran.stdout + ran.stderr)
    if ran.returncode or said is None:
        return Calibrated(math.nan, math.nan, [f"run {ran.returncode}: {last_words(ran.stderr)}"])
    drawing, out = file.parent / "hall" / "holes.csv", file.parent / "monday"
    words = ("--cell", file, "--calibration", "first", "-o", out, *runs)
    prepared = hilcell("prepare", drawing, *words)
    problems = [*_unsound(file.parent / "runs")]
    if prepared.returncode or not [*out.glob("*.src"), *out.glob("*.mod")]:
        problems.append(f"prepare {prepared.returncode}: {last_words(prepared.stderr)}")
    return Calibrated(float(said[1]), float(said[2]), problems)


def least_clearance_mm(hall: Hall, run: Path) -> float:
    """Return how near the arm came to what really stands in a hall, where its motions ended."""
    cell = read_log(run).cell
    orders = [
        record.body
        for record in read_records(run)
        if record.kind == "intent" and {"joints_deg", "strip_mm"} <= record.body.keys()
    ]
    postures = np.array([[each["strip_mm"], *np.radians(each["joints_deg"])] for each in orders])
    volumes = [convert(each, KeepOut, "volume") for each in hall.truth()["cell"]["keep_out"]]
    envelope = cell.robot.envelope
    assert envelope is not None
    true = Surroundings(cell.robot.arm(), envelope, cell.layout, volumes)
    return min(true.least_mm(postures).values())


def last_words(said: str) -> str:
    """Return the last lines that a command printed, those of its end."""
    return " / ".join(said.strip().splitlines()[-3:])


def _limits(drawn: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the ends of slide (mm) and axes (deg) of a hall, and the axes' full speeds (deg/s)."""
    behind_mm = 1.5  # the limit switches, and the slide behind them
    rail, joints = drawn["rail"], drawn["robot"]["joint"]
    limits_deg = drawn["simulation"]["sizes"]["controller"]["limits_deg"]
    limits = {"slide": (rail["travel_min_mm"] - behind_mm, rail["travel_max_mm"] + behind_mm)}
    for n, (joint, (low, high)) in enumerate(zip(joints, limits_deg, strict=True), start=1):
        limits |= {f"axis {n}": (low, high), f"axis {n} speed": (0.0, joint["speed_deg_s"])}
    return limits


# Largest differences of a commissioned cell file from the truth: those of steps by eye and of
# robots with errors of a millimetre, not of a calibration.
PLACE_MM, TURN_DEG, STRIP_MM, LIMIT_DEG = 6.0, 0.3, 3.0, 0.01
SCALE_SHARE, SPEED_SHARE = 2e-3, 0.05


def differences(file: Path, hall: Hall) -> list[str]:
    """Return what a cell file says differently from a hall, in words; none for a right one.

    Positions on the rail may have another zero and another direction than the truth has: frames are
    compared where the slide stands now. Nests may have any names: their places count.
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
            yield f"rail.options.{key}: {share:.5f} of {device[key]}"
    if not scales["counts_per_mm"] * scales["strip_counts_per_mm"] > 0.0:
        yield "drive and strip count in opposite directions"
    true_unit = _counts_s(device["speed_unit"], device["counts_per_turn"])
    unit = _counts_s(options.get("speed_unit"), options.get("counts_per_turn"))
    unit = unit or (true_unit if device["states_units"] else 1.0)
    if not abs(unit / true_unit - 1.0) <= SPEED_SHARE:
        yield f"rail.options.speed_unit: {unit:.4g} counts/s, not {true_unit:.4g}"
    low_mm, high_mm = cell.rail.travel_min_mm - STRIP_MM, cell.rail.travel_max_mm + STRIP_MM
    if not low_mm <= rail_mm <= high_mm:
        yield f"the slide stands at {rail_mm:.1f} mm, outside {low_mm:.1f} .. {high_mm:.1f} mm"


def _counts_s(unit: object, counts_per_turn: object) -> float:
    """Return a unit of speed in counts/s; 0 for none."""
    rpm = float(str(counts_per_turn or 0)) / 60.0
    return {"counts/s": 1.0, "0.1 counts/s": 0.1, "rpm": rpm}.get(str(unit), 0.0)


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
    fixed = [
        places[nest["name"]]
        for table in ("floor", "bar")
        for nest in truth["cell"]["layout"][table]
    ]
    for nest in cell.layout.fixed_nests:
        if not (apart_mm := min(math.dist(nest.xyz_mm, each) for each in fixed)) <= PLACE_MM:
            yield f"nest {nest.name}: {apart_mm:.2f} mm from the nearest on the floor"
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
