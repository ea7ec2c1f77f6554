"""Random disturbances of a run: does a wrong number ever pass for a right one?

A case is a calibration of the small cell, and the same with one disturbance of a random kind, size
and moment. The disturbance matters where it moves the mean error of the corrected targets by more
than `MATTERS_MM`: the mean that the run reports, or the true one. It is noticed where the run ends
with another exit code than 0, or with a suspicion. The undisturbed run must do neither. What comes
after the last point of the robot is beyond what a run can see.
"""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from campaigns.spread import print_table, progress, spread
from campaigns.truth import Truth, machine, true_errors_mm
from fakes.simulator import PaperCell
from hilcell.calibration.diagnosis import CLOSING
from hilcell.cell.file import Cell, load_cell
from hilcell.ports import HilcellError
from tests.whole.bench import SMALL, Simulation, events, judge, performed, sets

COUNT = 300
CELL = SMALL | {"layout.nest_samples": "10"}  # as many as a real cell takes of a nest
PLACES = ("S1100", "others")
MATTERS_MM = 0.03
LEAST_NOTICED = 0.95
MOST_FALSE = 0.01


@dataclass(frozen=True)
class Kind:
    """A fault, its smallest and largest size, and how the machine is after it for good.

    Without ``machine`` only measurements are disturbed: the tool is where it was.
    """

    name: str
    fault: str
    least: float
    most: float
    unit: str
    machine: Callable[[Truth, float], None] | None = None
    signed: bool = True


def _zero(axis: int) -> Kind:
    fault = f"robot.lost_zero_{axis}" if axis > 1 else "robot.lost_zero"
    return Kind(f"zero of axis {axis}", fault, 0.002, 0.2, "deg", partial(_lose_zero, axis))


def _lose_zero(axis: int, truth: Truth, lost_deg: float) -> None:
    truth.cell_truth.lose_zero(math.radians(lost_deg), axis)


def _widen(truth: Truth, lost_urad: float) -> None:
    truth.cell_truth.lose_motion(1e-6 * lost_urad)


def _jump(truth: Truth, jump_mm: float) -> None:
    truth.strip_jump_mm += jump_mm


KINDS = (
    Kind("tracker moved", "tracker.drift_step", 0.03, 5.0, "mm"),
    Kind("tracker's scale", "tracker.scale_ppm", 10.0, 300.0, "ppm"),
    Kind("reflector lifted", "tracker.nest_lifted", 0.03, 5.0, "mm"),
    Kind("mount slipped", "robot.mount_slip", 0.03, 5.0, "mm"),
    *(_zero(axis) for axis in range(1, 6)),
    Kind("slide slipped", "rail.slip", 0.05, 5.0, "mm"),
    Kind("strip jumped", "rail.strip_jump", 0.03, 5.0, "mm", _jump),
    Kind("backlash grown", "rail.backlash", 0.05, 0.5, "mm", signed=False),
    Kind("lost motion of axis 3", "robot.lost_motion", 15.0, 500.0, "urad", _widen, signed=False),
    Kind("transit axis tilted", "tracker.transit", 10.0, 300.0, "urad"),
    Kind("collimation off", "tracker.collimation", 10.0, 300.0, "urad"),
    Kind("tracker turning", "tracker.turning", 10.0, 300.0, "urad"),
    Kind("arm growing", "robot.growing", 3.0, 100.0, "um/m"),
    Kind("brake of axis 2", "robot.brake_slips", 0.001, 0.03, "deg", signed=False),
    Kind("room warmer", "tracker.warmer", 1.0, 10.0, "K"),
)


@dataclass(frozen=True)
class Disturbance:
    """``moment`` is the share of the points up to the robot's last that are measured before it."""

    kind: Kind
    size: float
    moment: float


@dataclass(frozen=True)
class Calibrated:
    """One run: its end event, the keys of its points, and its true mean errors by place."""

    end: dict[str, Any]
    keys: list[str]
    broken: list[str]  # invariants
    true_mm: dict[str, float]

    @property
    def suspicions(self) -> list[str]:
        found = self.end.get("result", {}).get("suspicions", [])
        return [f"{each['cause']} {each['size']:.3g} {each['unit']}" for each in found]

    @property
    def alarmed(self) -> bool:
        return bool(self.end["exit"] != 0 or self.suspicions)

    @property
    def moved(self) -> int:
        """How often the tracker was found to have moved."""
        return int(self.end.get("result", {}).get("tracker", {}).get("moved", 0))

    @property
    def means_mm(self) -> dict[str, float]:
        """The reported mean errors of corrected targets by place, and the true ones.

        The places are those that the run judges: the grid's station, all others together.
        """
        found = self.end.get("result", {}).get("validation", {})
        reported = {place: found[place]["chosen"]["mean"] for place in PLACES if place in found}
        return reported | {f"true {place}": mean for place, mean in self.true_mm.items()}


@dataclass(frozen=True)
class Case:
    """A disturbed run and its undisturbed twin."""

    seed: int
    disturbance: Disturbance
    undisturbed: Calibrated
    disturbed: Calibrated
    at: str  # the last point before

    @property
    def shift_mm(self) -> float:
        """By how much the disturbance moved a mean; infinite where one is missing or no number."""
        wanted, found = self.undisturbed.means_mm, self.disturbed.means_mm
        shifts = [abs(found.get(key, math.nan) - mean) for key, mean in wanted.items()]
        return max(shifts) if shifts and np.isfinite(shifts).all() else math.inf

    @property
    def matters(self) -> bool:
        return not self.shift_mm <= MATTERS_MM

    @property
    def words(self) -> str:
        what, end = self.disturbance, self.disturbed.end
        wanted, found = self.undisturbed.means_mm, self.disturbed.means_mm
        shifts = [
            f"{key} {wanted[key]:.3f} -> {found[key]:.3f}"
            for key in wanted
            if key in found and abs(found[key] - wanted[key]) > MATTERS_MM
        ]
        struck = f"{what.kind.name} {what.size:+.4g} {what.kind.unit} after {self.at}"
        return (
            f"seed {self.seed}: {struck}: "
            f"exit {end['exit']} {self.disturbed.suspicions} {end.get('reason') or ''}, "
            f"{'; '.join(shifts) or 'no shift'}"
        )


def drawn(seed: int, kinds: Sequence[Kind] = KINDS) -> Disturbance:
    """Return the disturbance of a case: kinds in turn, sizes log-uniform, any moment."""
    rng = np.random.default_rng([seed, 2024])
    kind = kinds[seed % len(kinds)]
    size = math.exp(rng.uniform(math.log(kind.least), math.log(kind.most)))
    sign = rng.choice([-1.0, 1.0]) if kind.signed else 1.0
    return Disturbance(kind, size * sign, rng.uniform())


def calibrated(seed: int, disturbance: Disturbance | None = None, after: str = "") -> Calibrated:
    """Calibrate the small cell on the machine of a seed; ``after`` a point it is disturbed."""
    cell = load_cell("paper", CELL)
    simulated = PaperCell(cell, seed=seed)
    control = Simulation(simulated.options, simulated.address)

    waiting = [] if disturbance is None else [disturbance]

    def hear(event: dict[str, Any]) -> None:
        if waiting and event["kind"] == "point" and event["key"] == after:
            struck = waiting.pop()  # once: a point that is re-measured has the same key
            assert control.ask(do="fault", name=struck.kind.fault, value=struck.size)["ok"]

    with tempfile.TemporaryDirectory(prefix="disturbances-") as runs:
        words = ("--unattended", "--name", "run", "--seed", str(seed), "--runs", runs, "--json")
        try:
            settings = sets(CELL | {"simulation.address": simulated.address})
            done = performed("run", *words, *settings, hear=hear)
        finally:
            simulated.close()
        printed = events(done.stdout)
        keys = [event["key"] for event in printed if event["kind"] == "point"]
        file = Path(runs, "run", "calibration.json")
        true_mm = _true_means_mm(file, cell, seed, disturbance) if file.is_file() else {}
    return Calibrated(printed[-1], keys, [str(each) for each in judge(printed)], true_mm)


def _true_means_mm(
    file: Path, cell: Cell, seed: int, disturbance: Disturbance | None
) -> dict[str, float]:
    truth = machine(cell, seed)
    if disturbance is not None and disturbance.kind.machine is not None:
        disturbance.kind.machine(truth, disturbance.size)
    try:
        errors_mm = true_errors_mm(file, cell, truth)
    except HilcellError:  # targets out of the disturbed cube
        return {}
    grids = errors_mm.pop(cell.grid.station)
    return {
        cell.grid.station: float(grids.mean()),
        "others": float(np.concatenate([*errors_mm.values()]).mean()),
    }


def case(seed: int) -> Case:
    disturbance, undisturbed = drawn(seed), calibrated(seed)
    last = max((n for n, key in enumerate(undisturbed.keys) if key.startswith(CLOSING)), default=0)
    keys = undisturbed.keys[:last]
    if not keys:  # the figures list it as a false alarm
        return Case(seed, disturbance, undisturbed, undisturbed, "")
    at = keys[int(disturbance.moment * len(keys))]
    return Case(seed, disturbance, undisturbed, calibrated(seed, disturbance, at), at)


def campaign(seeds: range) -> int:
    """Run the cases and print how many of the disturbances that matter were noticed."""
    cases = []
    for found in spread(case, seeds):
        progress(f"{found.shift_mm:7.3f} mm  {found.words}")
        cases.append(found)
    return 0 if report(cases) else 1


def report(cases: Sequence[Case]) -> bool:
    """Print the figures; return whether they hold."""
    rows = [_row(name, [c for c in cases if c.disturbance.kind.name == name]) for name in _names()]
    head = ("kind", "cases", "matter", "noticed", "silent", "re-measured", "alarm, no matter")
    print_table(head, [*rows, _row("all", cases)])
    silent = [each for each in cases if each.matters and not each.disturbed.alarmed]
    for each in silent:
        print(f"SILENT {each.words}")
    false = [each for each in cases if each.undisturbed.alarmed or each.undisturbed.moved]
    for each in false:
        end = each.undisturbed.end
        said = f"{each.undisturbed.suspicions} {end.get('reason') or ''}"
        print(f"FALSE  seed {each.seed}: exit {end['exit']} {said}".rstrip())
    broken = Counter(text for c in cases for text in c.undisturbed.broken + c.disturbed.broken)
    for text, count in broken.items():
        print(f"BROKEN {count} times: {text}")
    matter = sum(each.matters for each in cases)
    print(
        f"noticed {matter - len(silent)} of {matter} that move a mean by > {MATTERS_MM} mm "
        f"(wanted >= {LEAST_NOTICED:.0%}); false alarms {len(false)} of {len(cases)} "
        f"(wanted <= {MOST_FALSE:.0%})"
    )
    noticed = len(silent) <= (1.0 - LEAST_NOTICED) * matter
    return noticed and len(false) <= MOST_FALSE * len(cases) and not broken


def _names() -> list[str]:
    return [kind.name for kind in KINDS]


def _row(name: str, cases: Sequence[Case]) -> tuple[object, ...]:
    matter = [each for each in cases if each.matters]
    silent = sum(not each.disturbed.alarmed for each in matter)
    right = [each for each in cases if not each.matters]
    mended = sum(bool(each.disturbed.moved) for each in right)
    needless = sum(each.disturbed.alarmed for each in right)
    return name, len(cases), len(matter), len(matter) - silent, silent, mended, needless
