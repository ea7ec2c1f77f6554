"""The holes of one station, as ``prepare`` corrects them: list, bounds, program."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hilcell.arguments import STROKE_MM
from hilcell.calibration.file import compensate_targets
from hilcell.calibration.form import Calibration
from hilcell.calibration.influence import NoBound
from hilcell.calibration.lost_motion import straight_way
from hilcell.calibration.part import REACH_MM, Part
from hilcell.calibration.prepared import NEAR_SHARE, Drilling, station_program
from hilcell.calibration.programs import StrokeError, StrokeLimits, check_strokes
from hilcell.calibration.tip import Tip
from hilcell.cell.file import Cell
from hilcell.commands.bounds import TURN, Found, bounds_of_targets, turns_of_targets
from hilcell.commands.files import drill_mm_of
from hilcell.commands.orders import Prepare
from hilcell.commands.released import Released
from hilcell.compensation.programs import Stroke
from hilcell.compensation.stamp import Stamp
from hilcell.compensation.station_program import writer_of
from hilcell.compensation.targets import BOUND, HEADER, as_listed, csv_of, target_rows
from hilcell.geometry.frames import poses_from_zyx
from hilcell.planning.plan import StationPlan
from hilcell.ports import Array


@dataclass(frozen=True, eq=False)
class Prepared:
    """The holes of one station: its plan, commands (N, 6) in {W}, bounds, stamp, program files.

    Poses are those of the tool's tip. ``turns_deg`` (N,) are the bounds of orientation, where it is
    corrected; ``stroke`` says in words what a drill stroke adds at most; between holes the tip is
    ``standoff_mm`` in front of the part. ``written`` are the points (N, 6) of each kind in the
    program: at the holes, at the stand-offs, on the way to these.
    """

    plan: StationPlan
    command: Array
    bounds: Found
    stamp: Stamp
    program: Mapping[str, bytes]
    turns_deg: Array | None
    stroke: str
    standoff_mm: float
    written: Sequence[Array] = ()

    @property
    def file(self) -> str:
        """Return the name of its list."""
        return f"{self.plan.station.name}.csv"

    @cached_property
    def bounds95_mm(self) -> list[float] | None:
        """Return the 95 % bound of each hole, None where none can be stated."""
        return None if isinstance(self.bounds, NoBound) else self.bounds.radii_mm.tolist()

    @property
    def content(self) -> bytes:
        """Return its list: corrected targets in the order of visit, each with bound and stamp."""
        header, rows = [*HEADER], list(target_rows(self.plan.holes, self.command))
        if self.bounds95_mm is not None:
            header.append(BOUND)
            for row, bound_mm in zip(rows, self.bounds95_mm, strict=True):
                row.append(f"{bound_mm:.4f}")
        if self.turns_deg is not None:
            header.append(TURN)
            for row, bound_deg in zip(rows, self.turns_deg, strict=True):
                row.append(f"{bound_deg:.5f}")
        return csv_of(header, rows, self.stamp)

    @property
    def facts(self) -> dict[str, object]:
        """Return its part of the summary; bounds are None where none can be stated."""
        bounds_mm, turns_deg = self.bounds95_mm, self.turns_deg
        turned = {} if turns_deg is None else {"bound95_max_deg": float(turns_deg.max())}
        return {
            "name": self.plan.station.name,
            "rail_mm": self.plan.station.rail_mm,
            "strip_mm": self.plan.station.strip_mm,
            "file": self.file,
            "program": list(self.program),
            "stamp": self.stamp.text,
            "holes": self.plan.holes,
            "bound95_mm": bounds_mm,
            "travel_mm": self.plan.travel_mm,
            "standoff_mm": self.standoff_mm,
            "bound95_median_mm": None if bounds_mm is None else float(np.median(bounds_mm)),
            "bound95_max_mm": None if bounds_mm is None else max(bounds_mm),
            **turned,
        }


@dataclass(frozen=True, eq=False)
class Job:
    """The common facts of all stations of a job: the tool's tip, the part, and the stand-off."""

    tip: Tip
    part: Part
    standoff_mm: float


def prepared(args: Prepare, cell: Cell, found: Released, job: Job, each: StationPlan) -> Prepared:
    """Return a station's holes, corrected; raises `HilcellError` where one must not be."""
    name, calibration, tip = each.station.name, found.calibration, job.tip
    nominal = as_listed(each.poses)  # as `plan` states them, and `compensate` reads them
    command = as_listed(compensate_targets(calibration, name, nominal, each.holes, tip))
    bounds = bounds_of_targets(
        calibration, name, nominal, args.release.temperature, tip, drill_mm_of(cell)
    )
    stroke = _stroke(calibration, name, nominal, command, tip)
    stamp, writer = found.stamp(name), writer_of(cell.robot.driver)
    program: Mapping[str, bytes] = {}
    straight, written = "", list[Array]()
    if writer is not None:
        drilling = Drilling(cell, np.array(calibration.stations[name].T_W_B), tip, job.standoff_mm)
        lost = straight_way(
            calibration.lost_motion,
            drilling.arm,
            drilling.T_W_B,
            drilling.straight_rad(each.holes, command),
        )
        straight = lost.words
        sent = as_listed(command - np.pad(lost.shift_mm, ((0, 0), (0, 3))))
        remarks = [
            _place(cell, each),
            f"tool {tip.name}: points are where its tip is to be, z along the drill",
            *standoff_remarks(job.standoff_mm),
            *unknown_drill(job),
            straight,
            stroke,
            *["SIMULATED: not for a machine"] * stamp.simulated,
        ]
        drilled = station_program(drilling, name, each.holes, sent, job.part, remarks)
        program = writer(drilled, stamp)
        written = [one.values for one in (drilled.command, drilled.standoff, drilled.approach)]
    turns_deg = turns_of_targets(calibration, name, nominal, tip)
    words = "; ".join(filter(None, (stroke, straight)))
    return Prepared(
        each, command, bounds, stamp, program, turns_deg, words, job.standoff_mm, written
    )


def standoff_remarks(standoff_mm: float) -> list[str]:
    """Return in words how far off the tip is kept, on which side, and how deep the points are."""
    side = "assumed side: the part lies behind each hole, where z of the tool points"
    return [
        f"stand-off {standoff_mm:g} mm along the outward normal, before and after each hole",
        f"{side}, within {REACH_MM:g} mm of a hole; state a larger part as keep_out",
        "depth 0: points are on the part's surface; the drill's feed is the spindle's own",
    ]


def unknown_drill(job: Job) -> list[str]:
    """Return a warning where holes are given for the reflector, so that no drill is known."""
    if job.tip.table is not None:
        return []
    beyond = f"{NEAR_SHARE * job.standoff_mm:g} mm beyond the reflector"
    return [f"no [[tool]], so no drill is known: between holes nothing may reach {beyond}"]


def _stroke(
    calibration: Calibration, station: str, nominal: Array, command: Array, tip: Tip
) -> str:
    """Return in words by how far a usual stroke along z of the tool would miss at most."""
    shifts_mm = (STROKE_MM * poses_from_zyx(nominal)[:, :3, 2]).tolist()
    strokes = [Stroke(f"hole {n + 1}", n, tuple(each)) for n, each in enumerate(shifts_mm)]
    words = f"a stroke of {STROKE_MM:g} mm along z of the tool"
    limits = StrokeLimits(STROKE_MM, math.inf, "")
    try:
        missed = check_strokes(calibration, station, nominal, command, strokes, limits, tip)
    except StrokeError:
        return f"{words} ends outside of the calibrated volume at some holes"
    return (
        f"{words} adds at most {missed.across_mm:.3f} mm across (position) and "
        f"{missed.along_mm:.3f} mm along (depth)"
    )


def _place(cell: Cell, each: StationPlan) -> str:
    """Return in words where the robot must stand for a program."""
    holes = f"{len(each.holes)} hole{'s' * (len(each.holes) != 1)}"
    count = f"{holes} at station {each.station.name}"
    if not cell.has_rail:
        return count
    return f"{count}: the strip must read {each.station.strip_mm:.2f} mm, the slide held"
