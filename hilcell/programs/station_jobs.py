"""Corrected holes: for each station a list and a program, and a drilling sheet for all of them.

The sheet gives stations, programs, holes and conditions: one HTML file, offline, without script,
printable on A4.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from operator import itemgetter
from pathlib import Path
from typing import Self

import msgspec
import numpy as np

from hilcell import __version__
from hilcell.arguments import STROKE_MM
from hilcell.atomic_files import NotWritten, is_known, write_together
from hilcell.calibration.influence import NoBound
from hilcell.calibration.lost_motion import straight_path
from hilcell.calibration.tool_point import Tip, tip_named
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.cell.file import Cell
from hilcell.cell.robot import STANDOFF_MORE_MM
from hilcell.cell.settings import SettingsError
from hilcell.compensation.programs import Stroke, Writer, program_writer
from hilcell.compensation.targets import HEADER, as_listed, target_rows
from hilcell.errors import bounded
from hilcell.geometry.frames import poses_from_zyx, zyx_from_pose
from hilcell.geometry.statistics import lengths_mm
from hilcell.language import ENGLISH, Language, date_text, decimal, marked, speaking, spoken, tr
from hilcell.ports import Array
from hilcell.present.renderers import environment
from hilcell.present.table import Column, Table
from hilcell.programs.corrected import Corrected, UsableCalibration, drill_mm_of
from hilcell.programs.drilling import NEAR_SHARE, REACH_MM, Drilling, WorkPiece, station_program
from hilcell.programs.holes import read_holes
from hilcell.programs.plan import HolePlan, StationPlan, Volume
from hilcell.programs.plan import plan as plan_holes
from hilcell.programs.target_jobs import StrokeError, StrokeLimits, check_strokes
from hilcell.run.order import Release
from hilcell.sanitize import counted, harmless

SUMMARY, SHEET = "summary.json", "sheet.html"
TRUE_ANGLE = marked("of the true angle; a measured angle also contains reading noise")
INVALID = marked(
    (
        "a collision, a new mastering, an exchanged motor, gear, drill spindle or reflector mount",
        "the rail, the strip or its head was moved, or the slide misses its strip reading",
        "the part or the floor was moved: {W} is no longer where it was",
        "the calibration was revoked or superseded since: `hilcell runs` says so",
        "a re-check (`hilcell run recheck`) that does not say valid",
        "tool, base, approach or points of a program were changed by hand",
    )
)
# Of each station: name, rail (mm), holes, the largest bound (mm), the list, the program's files.
STATIONS: tuple[Column[tuple[str, float, int, float | None, str, str]], ...] = (
    Column("station", itemgetter(0)),
    Column("rail", itemgetter(1), "mm", ".2f"),
    Column("holes", itemgetter(2), form="d"),
    Column("bound95 max", itemgetter(3), "mm", ".3f"),
    Column("file", itemgetter(4)),
    Column("program", itemgetter(5)),
)


@dataclass(frozen=True, eq=False)
class StationJob:
    """The holes of one station: its plan, and its corrected targets of the tool's tip.

    ``program``: its files by name; ``sent``: the points (N, 6) of each kind in it (holes,
    stand-offs, path to these); ``stroke``: the most that a drill stroke adds. Between holes the tip
    is ``standoff_mm`` in front of the part.
    """

    plan: StationPlan
    targets: Corrected
    stroke: str
    standoff_mm: float
    program: Mapping[str, bytes]
    sent: Sequence[Array]

    @property
    def file(self) -> str:
        return f"{self.plan.station.name}.csv"

    @property
    def files(self) -> dict[str, bytes]:
        rows = list(target_rows(self.plan.holes, self.targets.command))
        return {self.file: self.targets.listed(HEADER, rows), **self.program}

    @property
    def points(self) -> Iterator[tuple[Array, Array]]:
        """Yield the nominal and the corrected points (N, 3) of its list and of its program."""
        moved_mm = (self.targets.command - self.targets.nominal)[:, :3]
        for each in (self.targets.command, *self.sent):
            yield each[:, :3] - moved_mm, each[:, :3]

    @property
    def named(self) -> str:
        """Label of the choice on the controller: the program, or else the list."""
        return next((Path(name).stem for name in self.program), self.file)

    @property
    def largest_mm(self) -> float | None:
        """The largest bound, None where none can be stated."""
        return max(self.targets.bounds95_mm or [], default=None)

    def holes(self, *, bounds: bool, turns: bool) -> Table:
        """Table of its holes for the sheet, in order: nominal positions in {W}, and bounds."""
        nominal_mm, targets = self.plan.poses[:, :3], self.targets
        moved_mm = lengths_mm(targets.command[:, :3] - nominal_mm)
        columns: list[Column[int]] = [
            Column(tr("hole"), self.plan.holes.__getitem__),
            *(Column(axis, nominal_mm[:, n].item, "mm", ".2f") for n, axis in enumerate("xyz")),
            Column(tr("corrected by"), moved_mm.item, "mm", ".3f"),
        ]
        if bounds and targets.bounds95_mm is not None:
            columns.append(Column(tr("95 % bound"), targets.bounds95_mm.__getitem__, "mm", ".3f"))
        if turns and targets.bounds_deg is not None:
            columns.append(Column(tr("95 % bound"), targets.bounds_deg.item, "°", ".4f"))
        return Table(columns, range(len(nominal_mm)))

    @property
    def facts(self) -> dict[str, object]:
        """Its part of the summary; bounds are None where none can be stated."""
        bounds_mm, bounds_deg = self.targets.bounds95_mm, self.targets.bounds_deg
        turned = {} if bounds_deg is None else {"bound95_max_deg": float(bounds_deg.max())}
        return {
            "name": self.plan.station.name,
            "rail_mm": self.plan.station.rail_mm,
            "strip_mm": self.plan.station.strip_mm,
            "file": self.file,
            "program": list(self.program),
            "stamp": self.targets.stamp.text,
            "holes": self.plan.holes,
            "bound95_mm": bounds_mm,
            "travel_mm": self.plan.travel_mm,
            "standoff_mm": self.standoff_mm,
            "bound95_median_mm": None if bounds_mm is None else float(np.median(bounds_mm)),
            "bound95_max_mm": self.largest_mm,
            **turned,
        }


@dataclass(frozen=True, eq=False)
class StationJobs:
    """The stations of a part in order of visit, ``source``: the file of its holes.

    The holes are positions of the ``tip`` of one tool, which keeps ``standoff_mm`` from the part;
    ``twins``: warnings of holes listed twice; ``writer``: of its programs.
    """

    cell: Cell
    released: UsableCalibration
    source: Path
    tip: Tip
    part: WorkPiece
    standoff_mm: float
    whole: HolePlan
    twins: list[str]
    writer: Writer | None
    stations: Sequence[StationJob] = ()

    @classmethod
    def plan(
        cls,
        cell: Cell,
        calibration: str,
        holes: Path,
        release: Release,
        *,
        tool: str,
        standoff_mm: float | None,
        say: Callable[[str], object],
    ) -> Self:
        """Plan holes where the calibration corrects, and correct them; ``say`` takes warnings.
        Raises `HilcellError` where a hole must not be drilled so.
        """
        released = UsableCalibration.named(calibration, release, cell)
        tip = tip_named(cell, tool, cell.robot.options.get("tool"))
        if standoff_mm is None:
            standoff_mm = tip.standoff_mm
        elif not standoff_mm >= tip.least_standoff_mm:
            problem = (
                f"{standoff_mm:g} mm: expected at least {tip.least_standoff_mm:g} mm: the drill of "
                f"{tip.name} and {STANDOFF_MORE_MM:g} mm"
            )
            raise SettingsError("--standoff", [problem])
        writer = program_writer(cell.robot.driver, cell.robot.program)
        found = read_holes(holes, tip.T_D_T)
        released.refuse_corrected(holes, found.names, found.points_mm)
        for warning in found.warnings:
            say(warning)
        whole = plan_holes(cell, found, calibrated=Volume(released.calibration), say=say)
        part = WorkPiece(found.points_mm, found.outward)
        jobs = cls(cell, released, holes, tip, part, standoff_mm, whole, found.twins, writer)
        return replace(jobs, stations=[jobs._job(each) for each in whole.stations])

    def _job(self, plan: StationPlan) -> StationJob:
        """A station's corrected holes; raises `HilcellError` where one must not be drilled."""
        cell, name, calibration = self.cell, plan.station.name, self.released.calibration
        nominal = as_listed(plan.poses)  # as `plan` states them, and `compensate` reads them
        exact = self.released.corrected(name, plan.holes, nominal, self.tip, cell)
        targets = replace(exact, command=as_listed(exact.command))
        stroke = self._stroke(targets)
        if self.writer is None:
            return StationJob(plan, targets, stroke, self.standoff_mm, {}, [])
        T_W_B = calibration.base(name)
        drilling = Drilling(cell, T_W_B, self.tip, self.standoff_mm)
        straight_rad = drilling.straight_rad(plan.holes, targets.command)
        lost = straight_path(calibration.lost_motion, drilling.arm, T_W_B, straight_rad)
        sent = as_listed(targets.command - np.pad(lost.shift_mm, ((0, 0), (0, 3))))
        count = len(plan.holes)
        place = f"{counted(count, 'hole')} at station {name}"
        if cell.has_rail:
            place += f": the strip must read {plan.station.strip_mm:.2f} mm, the slide held"
        remarks = [
            place,
            f"tool {self.tip.name}: points are where its tip is to be, z along the drill",
            *self.standoff_remarks,
            *self.unknown_drill,
            lost.text,
            stroke,
            *["SIMULATED: not for a machine"] * targets.stamp.simulated,
        ]
        drilled = station_program(drilling, name, plan.holes, sent, self.part, remarks)
        return StationJob(
            plan,
            targets,
            "; ".join(filter(None, (stroke, lost.text))),
            self.standoff_mm,
            self.writer(drilled, targets.stamp),
            [each.values for each in (drilled.command, drilled.standoff, drilled.approach)],
        )

    def _stroke(self, targets: Corrected) -> str:
        """Return in words by how far a usual stroke along z of the tool would miss at most."""
        shifts_mm = (STROKE_MM * poses_from_zyx(targets.nominal)[:, :3, 2]).tolist()
        strokes = [Stroke(f"hole {n + 1}", n, tuple(each)) for n, each in enumerate(shifts_mm)]
        words = f"a stroke of {STROKE_MM:g} mm along z of the tool"
        try:
            missed = check_strokes(
                self.released.calibration, targets.stamp.station, targets.nominal, targets.command,
                strokes, StrokeLimits(STROKE_MM, math.inf, ""), self.tip,
            )  # fmt: skip
        except StrokeError:
            return f"{words} ends outside of the calibrated volume at some holes"
        return (
            f"{words} adds at most {missed.across_mm:.3f} mm across (position) and "
            f"{missed.along_mm:.3f} mm along (depth)"
        )

    @property
    def standoff_remarks(self) -> list[str]:
        return [
            tr("stand-off {standoff_mm:g} mm along the outward normal, before and after each hole",
               standoff_mm=self.standoff_mm),
            tr("assumed side: the part lies behind each hole, where z of the tool points, within "
               "{reach_mm:g} mm of a hole; state a larger part as keep_out", reach_mm=REACH_MM),
            tr("depth 0: points are on the part's surface; the drill's feed is the spindle's own"),
        ]  # fmt: skip

    @property
    def unknown_drill(self) -> list[str]:
        """Warning where holes are given for the reflector, so that no drill is known."""
        if self.tip.table is not None:
            return []
        return [
            tr("no [[tool]], so no drill is known: between holes nothing may reach {beyond_mm:g} "
               "mm beyond the reflector", beyond_mm=NEAR_SHARE * self.standoff_mm)
        ]  # fmt: skip

    @property
    def table(self) -> Table:
        rows = [
            (
                each.plan.station.name,
                each.plan.station.rail_mm,
                len(each.plan.holes),
                each.largest_mm,
                each.file,
                " ".join(each.program),
            )
            for each in self.stations
        ]
        return Table(STATIONS, rows)

    @property
    def summary(self) -> dict[str, object]:
        made = self.released.calibration.provenance
        return {
            "calibration": made.latest,
            "cell": made.cell,
            "digest": made.digest,
            "simulated": made.simulated,
            "standing": self.released.status_text,
            "holes": self.source.name,
            "tool": self.tip.name,
            "notes": list(self.released.notes()),
            "warnings": self.twins,
            "sheet": SHEET,
            "stations": [each.facts for each in self.stations],
            "travel_mm": self.whole.travel_mm,
            "bound_mm": self.whole.travel_bound_mm,
        }

    def write(
        self, folder: Path, inputs: Iterable[Path], language: Language = ENGLISH
    ) -> list[str]:
        """Write all into an empty folder, the sheet in a language; return messages.

        Raises `NotWritten`.
        """
        jobs, released = self.stations, self.released
        files = [each for job in jobs for each in job.files.items()]
        counts = Counter(name.lower() for name, _ in files)  # controllers and PCs may ignore case
        if twice := [name for name, count in counts.items() if count > 1]:
            raise NotWritten(
                f"two stations would both write {', '.join(twice)}: name them apart, by letters, "
                "digits and underscores in the first 24 characters"
            )
        summary = msgspec.json.format(msgspec.json.encode(self.summary), indent=1) + b"\n"
        with speaking(language):
            sheet = self.sheet()
        files += [(SUMMARY, summary), (SHEET, sheet.encode())]
        self._make(folder)
        write_together(
            {folder / name: content for name, content in files},
            inputs=[self.source, released.path, *inputs],
        )
        unknown = [
            each for job in jobs for each in released.remember(job.targets.stamp, *job.points)
        ]
        stations = counted(len(jobs), "station")
        driver = self.cell.robot.driver
        programs = f"no programs: {driver} has no writer; state another form, robot.program"
        if any(job.program for job in jobs):
            programs = (
                "one program a station, in the order of the sheet; each holds for its station only"
            )
        floor = f"shop floor in {folder}"
        return [
            *dict.fromkeys(unknown),
            *(f"{job.plan.station.name}: {job.targets.summary}; {job.stroke}" for job in jobs),
            f"files of corrected targets for {stations}, {SUMMARY} and {SHEET} for the {floor}",
            programs,
            *released.notes(),
        ]

    def sheet(self) -> str:
        """The drilling sheet; with bounds where every station has one."""
        made = self.released.calibration.provenance
        count, places = sum(len(each.plan.holes) for each in self.stations), len(self.stations)
        bounds = [each.targets.bounds for each in self.stations]
        no_bounds = next((each.reason for each in bounds if isinstance(each, NoBound)), "")
        within_mm = self.cell.rail.strip_tolerance_mm
        turns = all(each.targets.bounds_deg is not None for each in self.stations)
        page = environment("hilcell.programs").get_template("sheet.html.j2")
        return page.render(
            version=__version__,
            language=spoken().code,
            title=tr(
                "Drilling sheet: {holes} at {stations}",
                holes=_holes(count),
                stations=tr("1 station") if places == 1 else tr("{n} stations", n=places),
            ),
            simulated=made.simulated,
            has_rail=self.cell.has_rail,
            facts=self._facts(),
            checks=self._checks(),
            jobs=[
                (
                    each,
                    each.holes(bounds=not no_bounds, turns=turns),
                    decimal(f"{each.plan.station.strip_mm:.2f} ± {within_mm:.2f}"),
                )
                for each in self.stations
            ],
            no_bounds=no_bounds,
            has_turns=turns,
            warnings=[
                *(note for note in self.released.notes() if "SIMULATED" not in note),
                *self.unknown_drill,
                *bounded(self.twins),
            ],
            invalid=[
                tr("air outside of {range}", range=self._air),
                tr("the time after {day}", day=self._until),
                *map(tr, INVALID),
            ],
            footer=css_text(
                tr(
                    "calibration {calibration}, holes {file}",
                    calibration=made.latest,
                    file=self.source.name,
                )
            ),
        )

    def _facts(self) -> list[tuple[str, str]]:
        cell, tip, released, release = self.cell, self.tip, self.released, self.released.release
        made, validity = released.calibration.provenance, released.calibration.validity
        status = tr("not known to be current")
        if released.status is not None:
            status = released.status.text
        if released.accepted:
            status = tr("{status}; OUT OF TOLERANCE, accepted", status=released.status_text)
        held_at = tip.scope.removeprefix("they hold at ")
        if tip.table is None and (drill_mm := drill_mm_of(cell)) is not None:
            at_mm = " ".join(f"{each:g}" for each in drill_mm)
            held_at = tr("the drill, ({at}) mm from the reflector", at=at_mm)
        number = "" if tip.number is None else tr(", number {number}", number=tip.number)
        values = zyx_from_pose(tip.T_F_D[None])[0] + 0.0
        written = self._written
        frame = decimal(
            " ".join(f"{axis} {each:.3f}" for axis, each in zip("XYZABC", values, strict=True))
        )
        standoff, side, depth = self.standoff_remarks
        now = datetime.now().astimezone()
        facts = [
            (tr("Holes"), self.source.name),
            (
                tr("Cell"),
                tr(
                    "{cell}, serial {serial}, robot {robot}",
                    cell=cell.name,
                    serial=cell.serial,
                    robot=cell.robot.name,
                ),
            ),
            (
                tr("Calibration"),
                tr(
                    "{run}, written {day} {time:%H:%M %Z}",
                    run=made.named,
                    day=date_text(written),
                    time=written,
                ),
            ),
            (tr("Status"), status),
            (
                tr("Use until"),
                tr(
                    "{day}, {days:g} days after it was written",
                    day=self._until,
                    days=release.max_age,
                ),
            ),
            (tr("Air"), self._air),
            (
                tr("Orientation"),
                tr("as calibrated, within {within:g}°", within=validity.orientation_tolerance_deg),
            ),
            (
                tr("Tool"),
                tr(
                    "{tool}{number}; in the flange: {frame} (mm, deg); the controller's must be "
                    "the same",
                    tool=tip.name,
                    number=number,
                    frame=frame,
                ),
            ),
            (tr("Bounds hold at"), held_at),
            (tr("Stand-off"), standoff),
            (tr("Side and depth"), f"{side}; {depth}"),
            (tr("Prepared"), f"{date_text(now)} {now:%H:%M %Z}"),
        ]
        if any(each.targets.bounds_deg is not None for each in self.stations):
            facts.append((tr("Bounds in degrees"), tr(TRUE_ANGLE)))
        return facts

    def _checks(self) -> list[str]:
        checks = [
            tr(
                "The right cell, robot and part; the part clamped, its place in {W} as it was "
                "planned"
            ),
            tr("Tool and drill as in the cell file; the drill is drawn back while the robot moves"),
            tr("Air at the cell {range}", range=self._air),
            tr("Programs copied to the controller as they are, all files of a station together"),
            tr("First hole of each station at reduced speed, a hand at the emergency stop"),
        ]
        if self.cell.has_rail:
            checks.insert(
                3,
                tr(
                    "At each station: robot at its safe pose, slide moved, held, strip within "
                    "{within_mm:g} mm, then the station's own program",
                    within_mm=self.cell.rail.strip_tolerance_mm,
                ),
            )
        return checks

    @property
    def _air(self) -> str:
        validity, now_c = self.released.calibration.validity, self.released.release.temperature
        if validity.temperature_c is None:
            return tr("not measured by the calibration")
        low_c, high_c = validity.temperature_c
        allowed = tr("{low:.1f} to {high:.1f} °C", low=low_c - TEMPERATURE_MARGIN_K,
                     high=high_c + TEMPERATURE_MARGIN_K)  # fmt: skip
        return allowed if now_c is None else tr("{range}, bounds for {now:.1f} °C", range=allowed,
                                                now=now_c)  # fmt: skip

    @property
    def _written(self) -> datetime:
        written = self.released.calibration.provenance.written
        return datetime.strptime(written, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC).astimezone()

    @property
    def _until(self) -> str:
        """The last day of use; days beyond any calendar are no limit."""
        try:
            last = self._written + timedelta(days=self.released.release.max_age)
            return date_text(last.astimezone())
        except OverflowError:
            return tr("any day")

    @staticmethod
    def _make(folder: Path) -> None:
        """Make a folder, or take an empty one: another job's files would be taken for these."""
        if is_known(folder.suffix.lower()) and not folder.exists():
            raise NotWritten(f"{folder} is a file by its name; name a folder, as {folder.stem}")
        if os.path.lexists(folder) and not os.path.isdir(folder):  # noqa: PTH112 - no name raises
            raise NotWritten(f"{folder} is a file; name a folder")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise NotWritten(f"{folder} is not empty; name a new folder")
        except OSError as error:
            raise NotWritten(f"{folder}: cannot be used: {error.strerror or error}") from error


def _holes(count: int) -> str:
    return tr("1 hole") if count == 1 else tr("{n} holes", n=count)


def css_text(text: str) -> str:
    return "".join(
        each if each.isascii() and each.isalnum() else f"\\{ord(each):06x}"
        for each in harmless(text)
    )
