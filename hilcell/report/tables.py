"""The tables of a report: each column is defined once, with its unit in the header."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from operator import attrgetter
from typing import TypeVar

import numpy as np

from hilcell.calibration.orientation import (
    OrientationErrors,
    repeated_orientation_errors,
    seats_of,
    validated_orientation_errors,
)
from hilcell.calibration.position_errors import (
    Errors,
    counting,
    places,
    position_errors,
    reduction,
    targets,
    validation,
)
from hilcell.cell.file import Station
from hilcell.cell.tables import Pose
from hilcell.geometry.frames import apply, zyx_from_pose
from hilcell.geometry.statistics import Figures
from hilcell.identity import Identity
from hilcell.journal.labels import verdict_label
from hilcell.model.events import (
    URAD,
    CurveMeasured,
    Invalidating,
    OutlierRemeasured,
    RemeasureRequested,
    VisitedOnceMore,
)
from hilcell.model.frame import MeasuredBase, MeasuredStation, TouchedBase
from hilcell.model.outcome import Outcome
from hilcell.model.point import BOTH, Point, Sent
from hilcell.model.results import PaperRow, Repeated
from hilcell.model.verdicts import Fitted, Verdict
from hilcell.ports import Array
from hilcell.present.table import Column, Table, Value, listed, vector
from hilcell.report.budgets import TargetBudget, place_label
from hilcell.report.facts import Facts

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Validated:
    """Targets of one place sent in one way; ``before`` are the same without a correction."""

    place: str
    way: Sent
    how: str  # the way in words
    errors: Errors
    before: Errors | None

    def removed_percent(self, figure: str) -> float | None:
        if self.before is None or self.before is self.errors:
            return None
        before, after = (getattr(each.figures, figure) for each in (self.before, self.errors))
        return 100 * reduction(before, after)


ACCURACY: tuple[Column[Validated], ...] = (
    Column("station", attrgetter("place")),
    Column("error", attrgetter("how")),
    Column("targets", lambda row: len(row.errors), form="d"),
    *(Column(name, attrgetter(f"errors.figures.{name}"), "mm", ".3f") for name in Figures._fields),
    Column("removed by means", lambda row: row.removed_percent("mean"), "%", ".1f"),
    Column("removed by maxima", lambda row: row.removed_percent("max"), "%", ".1f"),
)


@dataclass(frozen=True, eq=False)
class Tables:
    """The tables of one run."""

    facts: Facts

    def validated_rows(self) -> list[Validated]:
        return [
            Validated(
                place_label(place),
                how,
                self.facts.series_name(how),
                errors,
                series.get(Sent.BEFORE),
            )
            for place, stations in places(self.facts.cell).items()
            for series in (validation(self.facts.log, stations),)
            for how, errors in series.items()
        ]

    def accuracy(self) -> Table:
        """Return the errors before and after per place, and both ratios of the paper's abstract."""
        rows, last = [], ""
        for row in self.validated_rows():
            rows.append(replace(row, place="") if row.place == last else row)
            last = row.place
        repeated = self.facts.part("repeatability", Repeated)
        note = "Removed: 1 − after / before. Every figure is of targets really sent and measured"
        if self.facts.cell.plan.quick:
            note += "; before is the error of the poses that were commanded to them"
        note += "."
        if repeated is not None:
            note += (
                " Repeatability and tracker noise alone would leave "
                f"{repeated.floor_mm:.3f} mm (mean). Tracker noise taken off: RP of the robot "
                f"(ISO 9283, 7.2.2) {repeated.rp_robot_mm:.3f} mm at the worst of the places that "
                f"were visited again; pooled radius, the RP of very many visits, "
                f"{repeated.pooled_radius_robot_mm:.3f} mm."
            )
        return Table(ACCURACY, rows, "Before and after", note)

    def touches(self) -> Table:
        note = (
            "By how much the base was moved for the commands of that visit, at the grid's centre. "
            "u: tool point, 3D, 1 σ. Measured / expected: the motion, relative to what the "
            "uncertainty before lets expect. Targets stay where the station frame has them."
        )
        # A station, and the record of the last visit on which its base was touched.
        columns: tuple[Column[tuple[Station, TouchedBase]], ...] = (
            Column("station", lambda row: row[0].name),
            Column("poses", lambda row: row[1].poses, form="d"),
            Column("along the rail", lambda row: row[1].along_rail_mm, "mm", "+.4f"),
            Column("shift", lambda row: float(np.linalg.norm(row[1].shift_mm)), "mm", ".4f"),
            Column("turn", lambda row: float(np.linalg.norm(row[1].turn_urad)), "µrad", ".1f"),
            Column("u before", lambda row: row[1].u_before_mm, "mm", ".4f"),
            Column("u after", lambda row: row[1].u_after_mm, "mm", ".4f"),
            Column("measured / expected", lambda row: row[1].pull, form=".1f"),
        )
        return Table(columns, self._framed("touch", TouchedBase), "Touch poses", note)

    def _framed(self, name: str, kind: type[T]) -> list[tuple[Station, T]]:
        """Return the stations that have a frame of a kind, with it: measured, not adopted."""
        frames = self.facts.log.frames
        pairs = ((each, frames.get(f"{name}.{each.name}")) for each in self.facts.cell.station)
        return [(station, frame) for station, frame in pairs if isinstance(frame, kind)]

    def stations(self) -> Table:
        """Return the quality of each station's frame that this run measured, of no adopted one."""
        if not self.facts.cell.has_rail:
            return Table((), ())
        note = (
            "Tool point: the grid's centre as the station frame carries it, 3D, 1 σ. Left out: "
            "nests whose distances to the others changed since the grid's station."
        )
        return Table(STATIONS, self._framed("station", MeasuredStation), "Stations", note)

    def posed(self) -> list[Posed]:
        matrices = {name: self.facts.log.matrix(name) for name in self.facts.log.frames}
        return [Posed(name, matrix, zyx_from_pose(matrix)) for name, matrix in matrices.items()]

    def frames(self) -> Table:
        note, log = "In {W}; “world” is the tracker in {W}. Angles Z-Y-X.", self.facts.log
        if "world" in log.frames:
            note += f" For the cell file: tracker.pose = {Pose.of(log.matrix('world')).toml}."
        named = Column[Posed]("frame", lambda row: row.name.replace("_", " ").replace(".", ", "))
        return Table((named, *FRAMES[1:]), self.posed(), "Frames", note)

    def circles(self) -> Table:
        """Return how round the circles of axes 1 and 6 were."""
        base = self.facts.log.frames.get("base")
        if not isinstance(base, MeasuredBase):
            return Table((), ())
        rows = zip(("axis 1", "axis 6"), base.radius_mm, base.circle_rms_mm, strict=True)
        columns = listed("circle", ("radius", "mm", ".4f"), ("residual rms", "mm", ".4f"))
        return Table(columns, rows, "Base frame: circles")

    def air(self) -> dict[str, tuple[str, Array]]:
        """Return the air at the tracker over all points by its name; empty where not measured.

        Each has its unit and its values (N,).
        """
        measured = [point.air for point in self.facts.log.points.values() if point.air]
        quantities = {
            "air temperature": ("°C", "temperature_c"),
            "air pressure": ("mbar", "pressure_mbar"),
            "relative humidity": ("%", "humidity_percent"),
        }
        return {
            name: (unit, np.array([getattr(each, field) for each in measured]))
            for name, (unit, field) in quantities.items() if measured
        }  # fmt: skip

    def conditions(self) -> Table:
        columns = listed("quantity", *((name, "", ".1f") for name in ("least", "most", "mean")))
        rows = [
            (f"{name} {unit}", values.min(), values.max(), values.mean())
            for name, (unit, values) in self.air().items()
        ]
        return Table(columns, rows, "Air at the tracker")

    def devices(self) -> Table:
        link = self.facts.log.link
        note = f"CAN link: {link.counts}." if link is not None else ""
        if link is not None and link.warning:
            note += f" Warning: {link.warning}."
        columns: tuple[Column[Identity], ...] = tuple(
            Column(name, attrgetter(name))
            for name in ("kind", "maker", "model", "serial", "firmware", "address")
        )
        return Table(columns, self.facts.log.assets, "Devices", note)

    def software(self) -> Table:
        versions = self.facts.inputs.versions.items()
        return Table(listed("package", "version"), versions, "Software that measured")

    def groups(self) -> Table:
        """Return how many points of each kind were measured, in the order of the run."""
        counts = Counter(point.id.counted_with for point in self.facts.log.points.values())
        return Table(listed("kind", ("points", "", "d")), counts.items(), "Points")

    def paper_rows(self) -> Table:
        """Return the paper's figures beside this run's, where the procedure compares them."""
        rows = self.facts.part("rows", list[PaperRow]) or []
        note = (
            "Set: brought about by the cell file or the simulated machine, so that it cannot fail."
        )
        columns: tuple[Column[PaperRow], ...] = (
            Column("figure of the paper", attrgetter("row")),
            Column("fails when", attrgetter("fails")),
            Column("paper", attrgetter("paper"), form=".4g"),
            Column("here", attrgetter("shown"), form=".4g"),
            Column("chosen", attrgetter("chosen"), form=".4g"),
            Column("unit", attrgetter("unit")),
            Column("holds if", attrgetter("criterion")),
            Column("verdict", attrgetter("verdict")),
        )
        return Table(columns, rows, "The paper, row by row", note)

    def own_table(self) -> Table:
        procedure, result = self.facts.procedure, self.facts.result
        if not result:
            return Table((), ())
        table = procedure.table(result)
        table.title, table.note = procedure.summary.capitalize(), procedure.words(result)
        return table

    def remeasured(self) -> Table:
        """Return the points that were measured more than once, with both values."""
        repeats = self.repeats()
        turned = any(each.again_deg is not None for each in repeats)
        what = "error of position and that of orientation count" if turned else "error counts"
        note = (
            f"Every value stays in the journal. Of a target the larger {what}, whatever the "
            "reason; of other points the later value. Once more: hilcell resume RUN --retake KEY; "
            "hilcell export RUN --csv lists every key."
        )
        turns: tuple[Column[Repeat], ...] = (
            Column("turned first", attrgetter("first_deg"), "°", ".4f"),
            Column("turned again", attrgetter("again_deg"), "°", ".4f"),
        )
        keys = Column[Repeat]("key", attrgetter("again.key"), small=True)
        columns = (*REPEATS, *turns, keys) if turned else (*REPEATS, keys)
        return Table(columns, repeats, "Points measured more than once", note)

    def repeats(self) -> list[Repeat]:
        """Return each two successive measurements of a point, in the order of the later ones."""
        before, reasons, repeats = dict[str, Point](), dict[str, str](), list[Repeat]()
        seats, times = seats_of(self.facts.log), Counter[str]()
        for record in self.facts.records:
            match record.fact:
                case RemeasureRequested() | OutlierRemeasured() | VisitedOnceMore() as event:
                    reasons[event.key] = REASONS[event.what]
                case Invalidating(invalid=invalid):
                    reasons |= dict.fromkeys(invalid, "measured before the tracker was found moved")
            if record.kind != "point":
                continue
            again, key = self.facts.log.read(record), record.key
            if (first := before.get(key)) is not None:
                turns_deg = self._turns_deg(key, seats)[times[key] :][:2]
                times[key] += 1
                repeats.append(Repeat(
                    first, again, reasons.pop(key, "the run was resumed"),
                    self._error_mm(first), self._error_mm(again), self._counts(first, again),
                    *(turns_deg if len(turns_deg) == 2 else ()),
                ))  # fmt: skip
            before[key] = again
        return repeats

    def _turns_deg(self, key: str, seats: Array | None) -> list[float]:
        """Return by how much a target's tool was turned, each time that it was measured."""
        point = self.facts.log.points.get(key)
        if seats is None or point is None or point.id.kind != "validate":
            return []
        tool = self.facts.log.find(point.id.at_seat(1))
        return (
            repeated_orientation_errors(self.facts.log, tool, seats).angles_deg.tolist()
            if tool
            else []
        )

    def _counts(self, first: Point, again: Point) -> str:
        """Return which of both measurements of a point counts: a target's by the larger error."""
        kept = self.facts.log.points.get(again.key)
        if kept is not None and kept.id.kind == "validate" and self._error_mm(kept) is not None:
            kept = counting(self.facts.log, kept)
        named = {"again": again, "first": first}
        return next(
            (name for name, at in named.items() if kept and at.xyz_mm == kept.xyz_mm), "neither"
        )

    def _error_mm(self, point: Point) -> float | None:
        if point.nominal_mm is None or "world" not in self.facts.log.frames:
            return None
        return float(position_errors(self.facts.log, [point]).norms_mm[0])

    def oriented(self) -> Iterator[tuple[str, Sent, OrientationErrors]]:
        """Yield place, way of sending and errors of each series of targets with an orientation."""
        for place, stations in places(self.facts.cell).items():
            for how, turned in validated_orientation_errors(self.facts.log, stations).items():
                yield place_label(place), how, turned

    def orientation(self) -> Table:
        """Return by how much the tool was turned from its nominal orientation, before and after."""
        rows, last, noise_deg = list[tuple[str | int | float, ...]](), "", 0.0
        for name, how, turned in self.oriented():
            noise_deg = max(noise_deg, turned.noise_deg)
            figures = (getattr(turned.figures, f"{each}_deg") for each in Figures._fields)
            shown = "" if name == last else name
            rows.append((shown, self.facts.series_name(how), len(turned), *figures))
            last = name
        note = (
            "The tool's pose is the rigid fit of its reflectors, where they were found on the "
            "flange; about axis 6 it counts from the controller's zero. Error: the angle of one "
            "rotation; of a target measured again the larger one counts. The angles are measured: "
            f"they have the readings' noise in, up to {noise_deg:.4f}° (root mean square). The "
            "95 % bound of a target in use is of the true angle, without that noise."
        )
        fit = self.facts.log.verdict(Fitted)
        if fit is not None and fit.orientation:
            note += f" Orientation {fit.orientation}."
        figures = ((name, "°", ".4f") for name in Figures._fields)
        columns = listed("station", "error", ("targets", "", "d"), *figures)
        return Table(columns, rows, "Orientation", note)

    def orientation_text(self) -> str:
        """Return the figures at the grid's station in a sentence; "" where none were measured."""
        here = self.facts.cell.grid.station
        turns = validated_orientation_errors(self.facts.log, [here])
        if not set(BOTH) <= turns.keys():
            return ""
        before, after = (turns[how].figures for how in BOTH)
        means, most = (
            f"{one:.4f}° before and {other:.4f}° after"
            for one, other in ((before.mean_deg, after.mean_deg), (before.max_deg, after.max_deg))
        )
        count = len(turns[Sent.CHOSEN])
        return (
            f"The tool was turned from its nominal orientation by {means} in the mean, at most "
            f"{most} ({count} targets at {here})."
        )

    def worst(self, budget: TargetBudget) -> Table:
        """Return the corrected targets with the largest errors: places and errors in {W}.

        Of a target that was measured again, both errors.
        """
        log = self.facts.log
        if "world" not in log.frames:
            return Table((), ())
        stations, most = [station.name for station in log.cell.station], 10
        points = [point for name in stations for point in targets(log, name, Sent.CHOSEN)]
        order = np.argsort(-position_errors(log, points).norms_mm, kind="stable")[:most]
        before = {
            (point.station, point.id.number or 0): self._error_mm(point)
            for name in stations
            for point in targets(log, name, Sent.BEFORE)
        }
        rows = list[tuple[Value, ...]]()
        for rank, n in enumerate(order, start=1):
            point, errors = points[n], position_errors(log, [points[n]])
            place = point.station, point.id.number or 0
            norm_mm, bound_mm = float(errors.norms_mm[0]), budget.points_mm.get(point.key)
            others = [p for p in (*log.repeated.get(point.key, ()), log.points[point.key])
                      if p.xyz_mm != point.xyz_mm]  # fmt: skip
            rows.append((
                str(rank),
                f"{place[1] + 1} at {place[0]}".replace(" ", "\N{NO-BREAK SPACE}"),
                *errors.nominal_mm[0].tolist(),
                before.get(place),
                *errors.error_mm[0].tolist(),
                norm_mm,
                float(position_errors(log, others).norms_mm.max()) if others else None,
                bound_mm,
                None if bound_mm is None else norm_mm / bound_mm,
            ))  # fmt: skip
        note = (
            "Places and errors in {W}. After ÷ bound above 1: beyond the own bound, which 5 % of "
            "targets are expected to be. Where a target was measured again, the larger value "
            "counts."
        )
        if rows:
            key = points[order[0]].key
            note += f" Key of the first: {key}; hilcell export RUN --csv lists every key."
        title = "The ten worst targets" if len(rows) == most else "The worst targets"
        shown = (
            ("rank", "", ""), ("target", "", ""), *((axis, "mm", ".0f") for axis in "xyz"),
            ("before", "mm", ".3f"), *((f"e{axis}", "mm", "+.3f") for axis in "xyz"),
            ("3-D", "mm", ".3f"), ("again", "mm", ".3f"), ("95 % bound", "mm", ".3f"),
            ("after ÷ bound", "", ".2f"),
        )  # fmt: skip
        return Table(listed(*shown), rows, title, note)

    def volume(self) -> Table:
        """Return the extent in {W} of the calibrated volume at each station."""
        cell = self.facts.cell
        centre, half = cell.grid.centre.matrix()[:3, 3], np.array(cell.grid.size_mm) / 2
        cube_mm = centre + np.array([*product((-1.0, 1.0), repeat=3)]) * half
        bases = [cell.layout.nominal_base(station.rail_mm) for station in cell.station]
        corners_mm = np.array([apply(base, cube_mm) for base in bases])  # (stations, 8, 3)
        far_m = np.linalg.norm(corners_mm - self.facts.tracker_mm, axis=2) / 1000
        note = f"Tracker to corners: {far_m.min():.1f} to {far_m.max():.1f} m."
        lows, highs = corners_mm.min(axis=1), corners_mm.max(axis=1)
        extents = list[tuple[str, float, float]]()
        most_stations = 4  # one by one
        same_mm = 0.5
        for n, axis in enumerate("xyz"):
            low, high = lows[:, n], highs[:, n]
            same = max(np.ptp(low), np.ptp(high)) <= same_mm
            if same or len(bases) > most_stations:
                words = axis if same else f"{axis}, {len(bases)} stations"
                extents.append((words, float(low.min()), float(high.max())))
            else:
                ends = zip(cell.station, low.tolist(), high.tolist(), strict=True)
                extents += [(f"{axis}, {at.name}", least, most) for at, least, most in ends]
        columns = listed("in {W}, mm", ("from", "", ".0f"), ("to", "", ".0f"))
        return Table(columns, extents, "Calibrated volume", note)

    def verdicts(self) -> Table:
        def word(verdict: Verdict) -> str:
            if verdict.holds:
                return "passes"
            return "undecided" if verdict.outcome is Outcome.UNDECIDED else "fails"

        columns: tuple[Column[tuple[str, Verdict]], ...] = (
            Column("judged", lambda row: verdict_label(row[0])),
            Column("verdict", lambda row: word(row[1])),
            Column("by", lambda row: typeset(row[1].text)),
        )
        return Table(columns, self.facts.log.verdicts.items(), "Verdicts")

    def curves(self) -> Table:
        def lines(record: CurveMeasured) -> str:
            pairs = zip(record.cycles, record.amplitudes_urad, strict=True)
            return ", ".join(f"{cycles:.1f}: {size:.1f}" for cycles, size in pairs) or "none"

        note = (
            "Found by slow sweeps in both directions: lines in cycles per revolution of the joint. "
            "Smooth: rms of the error below them, less a straight line. Lag: how much older the "
            "joints' readings are than the tracker's. Noise: of one sample. Signal: share of the "
            "variance that lines and smooth error explain."
        )
        columns: tuple[Column[CurveMeasured], ...] = (
            Column("axis", lambda row: f"A{row.axis}"),
            Column("cycles: amplitude", lines, "µrad"),
            Column("used", lambda row: "yes" if row.holds else f"no: {row.reason}"),
            Column("smooth", lambda row: row.smooth_rad * URAD, "µrad", ".1f"),
            Column("from", lambda row: float(np.degrees(row.low_rad)), "°", ".1f"),
            Column("to", lambda row: float(np.degrees(row.high_rad)), "°", ".1f"),
            Column("lag", lambda row: row.lag_s * 1e3, "ms", ".2f"),
            Column("lag u", lambda row: row.lag_sigma_s * 1e3, "ms", ".2f"),
            Column("noise", lambda row: row.noise_rad * URAD, "µrad", ".1f"),
            Column("signal", lambda row: 100 * row.share, "%", ".0f"),
            Column("samples lost", attrgetter("lost"), form="d"),
        )
        return Table(columns, self.facts.log.curves.values(), "Transmission errors", note)

    def models(self) -> Table:
        """Return how far each model misses poses left out, which one was chosen, and why."""
        fit = self.facts.log.verdict(Fitted)
        columns = listed("model", *((name, "mm", ".3f") for name in Figures._fields))
        if fit is None:
            return Table(columns, (), "Choice of the correction")
        rows = [
            (f"{name}, chosen" if name == fit.method else name, *map(figures.get, Figures._fields))
            for name, figures in fit.loocv.items()
        ]
        reasons = [f"Chosen: {fit.reason}."]
        reasons += [f"No {name} model: {why}." for name, why in fit.refused.items()]
        reasons += [f"Curves of the axis sweeps: {fit.curves.reason}."] if fit.curves.reason else []
        unswept = self.facts.result.get("sweeps", {}).get("left_out", "")
        reasons += [f"Axes not swept: {unswept}."] if unswept else []
        return Table(columns, rows, "Choice of the correction", " ".join(reasons))


def typeset(words: str) -> str:
    signs = {"<=": "≤", r"\+-": "±", r" deg\b": "°", r"\burad\b": "µrad"}
    for written, shown in signs.items():
        words = re.sub(written, shown, words)
    return words


# A station, and its frame's record.
STATIONS: tuple[Column[tuple[Station, MeasuredStation]], ...] = (
    Column("station", lambda row: row[0].name),
    Column("rail", lambda row: row[0].rail_mm, "mm", ".3f"),
    Column("strip, nominal", lambda row: row[0].strip_mm, "mm", ".3f"),
    Column("strip, measured", lambda row: row[1].strip_mm, "mm", ".3f"),
    Column("fit rms", lambda row: row[1].rms_mm, "mm", ".3f"),
    Column("tool point u", lambda row: row[1].tool_uncertainty_mm, "mm", ".4f"),
    Column("worst corner u", lambda row: row[1].cube_uncertainty_mm, "mm", ".4f"),
    Column("nests left out", lambda row: ", ".join(row[1].left_out) or "none"),
)


@dataclass(frozen=True, slots=True)
class Posed:
    """A measured frame: its name, its matrix (4, 4) in {W}, its x, y, z, A, B, C (6,)."""

    name: str
    matrix: Array
    zyx: Array


FRAMES: tuple[Column[Posed], ...] = (
    Column("frame", attrgetter("name")),
    *vector("", "xyz", "mm", "zyx", ".3f"),
    *vector("", "ABC", "°", "zyx", ".4f", first=3),
)


# -- points measured more than once: both values, why, and which counts ----------------------------

# Of a target the larger error counts, of position
# (`hilcell.calibration.position_errors.counting`) and of orientation
# (`hilcell.calibration.orientation.largest_orientation_errors`) alike: to re-measure only large
# errors would make the figures smaller than the robot is. Of every other point the later does.

REASONS = {
    "retake asked": "the operator asked for it",
    "outlier measured again": "its error stood out from the others",
    "visited once more": "visited once more",
}


@dataclass(frozen=True, eq=False)
class Repeat:
    """Two measurements of one point, one after the other, and why there are two.

    Errors |e| in mm are None where the point has no nominal place, the tool's turns in deg where
    its orientation was not measured.
    """

    first: Point
    again: Point
    why: str
    first_mm: float | None
    again_mm: float | None
    counts: str
    first_deg: float | None = None
    again_deg: float | None = None

    @property
    def apart_mm(self) -> float:
        return float(np.linalg.norm(np.subtract(self.again.xyz_mm, self.first.xyz_mm)))


REPEATS: tuple[Column[Repeat], ...] = (
    Column("point", lambda row: row.again.id.text(row.again.station)),
    Column("why", attrgetter("why")),
    Column("counts", attrgetter("counts")),
    Column("error first", attrgetter("first_mm"), "mm", ".4f"),
    Column("error again", attrgetter("again_mm"), "mm", ".4f"),
    Column("apart", attrgetter("apart_mm"), "mm", ".4f"),
)
