"""The cell file: strict TOML becomes typed, checked objects.

Lengths mm, angles deg in the file; properties give rad. Frames: {W} world (three floor nests),
{B} robot base, {S} slide (its nests are given in nominal {B}: the slide carries the robot).
"""

from __future__ import annotations

import hashlib
import math
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from hilcell.cell.layout import Layout, Nest
from hilcell.cell.robot import Joint, RobotTable, ToolTable, arm_from_joints, tool_problems
from hilcell.cell.settings import (
    SettingsError,
    Unread,
    convert,
    exchanged_drivers,
    override_all,
    refuse,
)
from hilcell.cell.source import (
    built_in_cells,
    cell_folder,
    explain_exchange,
    parsed,
    read_source,
    with_lines,
)
from hilcell.cell.surroundings import KeepOut, Surroundings, keep_out_problems
from hilcell.cell.tables import (
    UNPLACED_MM,
    Angle,
    Count,
    Frozen,
    Length,
    Name,
    Percent,
    Point,
    Pose,
    Six,
    Size,
    Speed,
    Step,
    Sweep,
    Tolerance,
    Turn,
    Wait,
    refuse_descending,
)
from hilcell.cell.uncertainty import UncertaintyTable, with_certificates
from hilcell.decoding import Json

# A cell file without ``[rail]`` gets a rail with the driver `NO_RAIL`, a slide that never moves and
# has no nests, and one station at 0, so that all other code is the same with a rail and without.

NO_RAIL = "none"


def with_rail(values: Json) -> Json:
    """Return a cell file's tables, completed if it has no rail."""
    if "rail" in values:
        return values

    def with_defaults(defaults: Json, table: object) -> object:
        return {**defaults, **table} if isinstance(table, Mapping) else table  # checked later

    name = "BASE"
    stations = values.get("station", [{"name": name}])
    if isinstance(stations, list):
        at_0 = {"rail_mm": 0.0, "strip_mm": 0.0}
        stations = [with_defaults(at_0, station) for station in stations]
        if stations and isinstance(stations[0], Mapping):
            name = stations[0].get("name", name)
    rail = {
        "driver": NO_RAIL,
        "travel_min_mm": 0.0,
        "travel_max_mm": 0.0,
        "speed_mm_s": 1.0,
        "acceleration_mm_s2": 1.0,
    }
    return {
        **values,
        "rail": rail,
        "station": stations,
        "grid": with_defaults({"station": name}, values.get("grid", {})),
        "layout": with_defaults(
            {"rail_direction": [0.0, 0.0, 0.0], "slide": []}, values.get("layout", {})
        ),
        "touch": with_defaults({"poses": 0}, values.get("touch", {})),
    }


Share = Annotated[float, Meta(ge=0.001, le=0.5)]


BLOCK = 8  # targets of a quick plan that are judged together, one in each octant of the volume


class PlanTable(Frozen, frozen=True, kw_only=True):
    """The plan of `calibrate`: full, or quick, as short as the verdict allows.

    ``grid_orientations``: further orientations (A, B, C in {B}) in which all vertices are measured.
    ``calibration``: where a re-calibration starts, a run or its file, or "current"; it measures
    ``known_poses`` in place of the grid.
    """

    quick: bool = False
    accept_risk: Share = 0.05
    reject_risk: Share = 0.05
    share_above_max: Share = 0.1
    most_targets: Annotated[int, Meta(ge=BLOCK, le=1000)] = 96
    bound_mm: Size = 0.06
    least_poses: Annotated[int, Meta(ge=0, le=100)] = 23
    most_poses: Annotated[int, Meta(ge=0, le=100)] = 23
    turn_deg: Annotated[float, Meta(ge=0, le=45)] = 15.0
    tilt_deg: Annotated[float, Meta(ge=0, le=45)] = 0.0
    prove_every: Annotated[int, Meta(ge=10, le=1000)] = 100
    unattended_wait_s: Annotated[float, Meta(ge=0, le=86_400)] = 900.0
    grid_orientations: list[tuple[Angle, Angle, Angle]] = field(default_factory=list)
    tilt_poses: Annotated[int, Meta(ge=4, le=100)] = 24
    calibration: str = ""
    known_poses: Annotated[int, Meta(ge=8, le=100)] = 14

    def samples(self, full: int, quick: int) -> int:
        return min(full, quick) if self.quick else full

    @property
    def turns(self) -> bool:
        return self.tilt_deg > 0.0 or bool(self.grid_orientations)

    @property
    def recalibrates(self) -> bool:
        """Whether the arm is known from an earlier calibration."""
        return bool(self.calibration)

    @property
    def pose_counts(self) -> tuple[int, int]:
        """The least and the most poses that are measured besides the grid's."""
        if self.recalibrates:
            return self.known_poses, self.known_poses
        if self.tilt_deg:
            return self.tilt_poses, self.tilt_poses
        return (self.least_poses, max(self.least_poses, self.most_poses)) if self.quick else (0, 0)


Mass = Annotated[float, Meta(ge=0, le=10_000)]


class Iso9283Table(Frozen, frozen=True, kw_only=True):
    """The test of ISO 9283 and its conditions.

    ``velocity_percent`` of the rated velocity, None for `robot.speed_percent`. ``calibration``: a
    run that corrects the commanded poses, "" for none. Optional limits of AP_p, RP_l, AD and RD,
    and, with several reflectors on the flange, of the largest AP and RP of an angle (deg); AP of
    angles requires a calibration.
    """

    cycles: Annotated[int, Meta(ge=3, le=1000)] = 30
    velocity_percent: Percent | None = None
    load_kg: Mass | None = None
    rated_load_kg: Mass | None = None
    warm_up_min: Annotated[float, Meta(ge=0, le=100_000)] | None = None
    calibration: str = ""
    ap_limit_mm: Tolerance | None = None
    rp_limit_mm: Tolerance | None = None
    ad_limit_mm: Tolerance | None = None
    rd_limit_mm: Tolerance | None = None
    ap_limit_deg: Turn | None = None
    rp_limit_deg: Turn | None = None


class RecheckTable(Frozen, frozen=True, kw_only=True):
    """The re-checked calibration, "" for the current one, and the number of poses."""

    calibration: str = ""
    poses: Annotated[int, Meta(ge=4, le=10)] = 7


class TouchTable(Frozen, frozen=True, kw_only=True):
    """Number of poses that re-measure a station after each stop, 0 for none.

    For the procedure `touch`: the station ("" for the grid's), and the calibration as above.
    """

    poses: Annotated[int, Meta(ge=0, le=100)] = 8
    station: str = ""
    calibration: str = ""


class TargetsTable(Frozen, frozen=True, kw_only=True):
    """Targets to measure: a CSV file, the station ("" for the grid's), the calibration as above."""

    file: str
    station: str = ""
    calibration: str = ""


class SweepsTable(Frozen, frozen=True, kw_only=True):
    """Axis sweeps, over the cube's range of each axis and ``margin_deg`` beyond.

    A quick plan sweeps up to three times as fast. Faster axes excite the arm; axes 4 and 6 hardly
    move the tool point.
    """

    enabled: bool = True
    axes: tuple[Annotated[int, Meta(ge=1, le=6)], ...] = (1, 2, 3, 5)
    speed_deg_s: Annotated[float, Meta(ge=0.1, le=1.0)] = 1.0
    rate_hz: Annotated[float, Meta(ge=10, le=1000)] = 20.0
    margin_deg: Annotated[float, Meta(ge=0, le=30)] = 1.0

    def __post_init__(self) -> None:
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes must differ, got {', '.join(map(str, self.axes))}")


class CertificateTable(Frozen, frozen=True, kw_only=True):
    """Laboratory and customer for the first page and the DCC; "" leaves a line to fill in.

    ``country`` is the laboratory's, two letters (ISO 3166-1).
    """

    laboratory: str = ""
    laboratory_address: str = ""
    laboratory_email: str = ""
    country: Annotated[str, Meta(pattern="^([A-Z]{2})?$")] = ""
    customer: str = ""
    customer_address: str = ""
    customer_email: str = ""


NotifyEvent = Literal["end", "prompt", "suspension", "alarm"]


class NotifyTable(Frozen, frozen=True, kw_only=True):
    """The command that runs at events of a run (`hilcell.run.notify`): a program and its arguments,
    as a list, or as one text that is split as a shell splits it. No shell runs it.
    """

    command: str | list[str]
    events: list[NotifyEvent] = field(
        default_factory=lambda: ["end", "prompt", "suspension", "alarm"]
    )

    def __post_init__(self) -> None:
        words = self.words
        if not words or not words[0]:
            raise ValueError("command: expected a program and its arguments, got none")
        if any("\0" in word for word in words):
            raise ValueError("command: expected no NUL character")

    @property
    def words(self) -> list[str]:
        """The program and its arguments; raises `ValueError` for a quotation without an end."""
        if isinstance(self.command, list):
            return self.command
        try:
            return shlex.split(self.command)
        except ValueError as error:
            raise ValueError(f"command: {error}".replace("No c", "no c")) from None


Kelvin = Annotated[float, Meta(gt=0, le=60)]


class RoomTable(Frozen, frozen=True, kw_only=True):
    """Ambient temperature since the grid's first point: a run is suspended beyond ``range_k``, and
    continues after ``steady_s`` within ``back_k``.
    """

    range_k: Kelvin = 3.0
    back_k: Kelvin = 2.0
    steady_s: Wait = 120.0

    def __post_init__(self) -> None:
        refuse_descending(self, "back_k", "range_k")


__all__ = [
    "Cell", "Joint", "KeepOut", "Nest", "Pose", "Six", "Station", "ToolTable", "arm_from_joints",
    "load_cell",
]  # fmt: skip

MOST_POINTS = 100_000  # of the grid, and of targets in it


class Station(Frozen, frozen=True, kw_only=True):
    """A working position on the rail, defined by its strip reading."""

    name: Name
    rail_mm: Length
    strip_mm: Length


class RailTable(Frozen, frozen=True, kw_only=True):
    """The rail, its drive and its strip."""

    driver: Name
    travel_min_mm: Length
    travel_max_mm: Length
    speed_mm_s: Speed
    acceleration_mm_s2: Annotated[float, Meta(ge=1, le=1e6)]
    back_off_mm: Size = 1.0
    strip_tolerance_mm: Tolerance = 0.01
    slip_limit_mm: Size = 2.0
    max_backlash_mm: Tolerance = 0.4
    max_approaches: Annotated[int, Meta(ge=1, le=20)] = 8
    homing_mm_s: Speed = 100.0
    standstill_dwell_s: Annotated[float, Meta(ge=0.05, le=5)] = 0.4
    options: Json = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.driver != NO_RAIL:
            refuse_descending(self, "travel_min_mm", "travel_max_mm")

    @property
    def is_unplaced(self) -> bool:
        """Whether the travel is a draft's, of a length alone."""
        return self.travel_min_mm < UNPLACED_MM < self.travel_max_mm

    @property
    def hold_limit_mm(self) -> float:
        """Largest deviation of a held slide from its station.

        The approach ends within the tolerance; readings at rest may flicker by one count more.
        """
        return 2.0 * self.strip_tolerance_mm


class TrackerTable(Frozen, frozen=True, kw_only=True):
    """The tracker: its range, its reflector, its approximate pose in {W}."""

    driver: Name
    reflector: str
    pose: Pose
    min_range_mm: Size = 500.0
    max_range_mm: Size = 10_000.0
    max_std_mm: Tolerance = 0.05
    find_radius_mm: Size = 5.0
    samples: Count = 1
    pointing_s: Annotated[float, Meta(ge=0, le=60)] = 1.0
    reading_s: Annotated[float, Meta(ge=0.1, le=100)] = 0.5
    options: Json = field(default_factory=dict)

    def __post_init__(self) -> None:
        refuse_descending(self, "min_range_mm", "max_range_mm")


class GridTable(Frozen, frozen=True, kw_only=True):
    """The measured cube, in nominal {B}, with one tool orientation."""

    station: Name
    centre: Pose
    size_mm: Point
    pitch_mm: Step

    def __post_init__(self) -> None:
        for size in self.size_mm:
            cells = size / self.pitch_mm
            if not (round(cells) >= 1 and abs(cells - round(cells)) < 1e-9):
                raise ValueError(
                    f"size_mm: expected a multiple of the pitch {self.pitch_mm} mm, got {size} mm"
                )
        vertices = math.prod(count + 1 for count in self.cells)
        if not vertices <= MOST_POINTS:
            raise ValueError(f"expected at most {MOST_POINTS} vertices, got {vertices}")

    @property
    def cells(self) -> tuple[int, ...]:
        return tuple(round(size / self.pitch_mm) for size in self.size_mm)


def coarsest_pitch_mm(cells: Sequence[int], pitch_mm: float) -> float:
    """Return the widest pitch that fills a box of ``cells`` (3,), with two along one edge at least:
    cross-validation needs more than one cell.
    """
    shared = math.gcd(*cells)
    halves = 1 if max(cells) // shared > 1 else 2
    return pitch_mm * shared / halves


class BaseFrameTable(Frozen, frozen=True, kw_only=True):
    """Circles of axes 1 and 6 that determine {B} (section 4.2)."""

    axis_1_deg: Six
    axis_1_sweep_deg: Sweep
    axis_6_deg: Six
    axis_6_sweep_deg: Sweep
    points: Annotated[int, Meta(ge=4, le=200)] = 12  # three leave no uncertainty

    def __post_init__(self) -> None:
        sweeps = {"axis_1": self.axis_1_sweep_deg, "axis_6": self.axis_6_sweep_deg}
        least_deg = 10.0
        refuse(
            [
                f"{axis}_sweep_deg: expected an arc of {least_deg} deg, got {begin} .. {end}"
                for axis, (begin, end) in sweeps.items()
                if not abs(end - begin) >= least_deg
            ]
        )


class SurveyTable(Frozen, frozen=True, kw_only=True):
    """The survey of the rail in both directions, and the approaches of a station."""

    from_mm: Length = 0.0
    to_mm: Length = 2000.0
    step_mm: Step = 100.0
    repeats: Annotated[int, Meta(ge=4, le=1000)] = 15

    def __post_init__(self) -> None:
        steps = (self.to_mm - self.from_mm) / self.step_mm
        if not (round(steps) >= 3 and abs(steps - round(steps)) < 1e-9):
            length = f"{self.from_mm} .. {self.to_mm} mm"
            raise ValueError(f"expected three or more steps of {self.step_mm} mm, got {length}")
        if not steps <= 10_000:
            raise ValueError(f"expected at most 10000 steps, got {steps:.0f}")


class ValidationTable(Frozen, frozen=True, kw_only=True):
    """Random targets: per grid cell at the grid's station, in total at the other stations.

    ``max_tolerance_deg`` limits the orientation error of the tool, if given.
    """

    per_cell: Count = 5
    others: Annotated[int, Meta(ge=1, le=100_000)] = 150
    mean_tolerance_mm: Tolerance = 0.15
    max_tolerance_mm: Tolerance = 0.4
    max_tolerance_deg: Turn | None = None


class VolumesTable(Frozen, frozen=True, kw_only=True):
    """Where keep-out volumes come from: a list of boxes, names of those to be taught, and for a
    robot without a rail the ``floor`` up to the floor nests, with the tracker on it.
    """

    file: str = ""
    teach: list[Name] = field(default_factory=list)
    floor: bool = False

    def __post_init__(self) -> None:
        if not (self.file or self.teach or self.floor):
            raise ValueError("expected file, teach or floor, got none")
        if len(set(self.teach)) != len(self.teach):
            raise ValueError(f"teach: names must differ, got {', '.join(self.teach)}")


class CampaignTable(Frozen, frozen=True, kw_only=True):
    """A list of poses, with reflectors and their expected positions."""

    poses: str


class SettleTable(Frozen, frozen=True, kw_only=True):
    """Settling times by the cell's clock, and the largest age of a reading for interlocks.

    On a quick plan robot and slide rest the least of them before a tracker that shows how much its
    reflector moves, and up to ``robot_s`` or ``rail_s`` until a reading spreads by ``spread_mm`` at
    most.
    """

    robot_s: Wait = 1.0
    robot_least_s: Wait = 0.3
    rail_least_s: Wait = 0.5
    spread_mm: Tolerance = 0.03
    rail_s: Wait = 2.0
    reading_age_s: Annotated[float, Meta(ge=0.01, le=10)] = 0.5


class SimulationTable(Frozen, frozen=True, kw_only=True):
    """A simulated cell by its entry point; ``address`` attaches to a running one.

    ``sizes`` replace values of the machine file.
    """

    simulator: Name
    address: str = ""
    data: str = ""
    machine: Annotated[str, Meta(min_length=1)] = "paper"
    sizes: Json = field(default_factory=dict)


class Cell(Frozen, frozen=True, kw_only=True):
    """A whole cell."""

    name: Name
    serial: str
    rail: RailTable
    robot: RobotTable
    tracker: TrackerTable
    layout: Layout
    station: list[Station]
    grid: GridTable
    base_frame: BaseFrameTable
    survey: SurveyTable = field(default_factory=SurveyTable)
    sweeps: SweepsTable = field(default_factory=SweepsTable)
    validation: ValidationTable = field(default_factory=ValidationTable)
    plan: PlanTable = field(default_factory=PlanTable)
    room: RoomTable = field(default_factory=RoomTable)
    touch: TouchTable = field(default_factory=TouchTable)
    settle: SettleTable = field(default_factory=SettleTable)
    keep_out: list[KeepOut] = field(default_factory=list)
    volumes: VolumesTable | None = None
    tool: list[ToolTable] = field(default_factory=list)
    uncertainty: UncertaintyTable = field(default_factory=UncertaintyTable)
    certificate: CertificateTable = field(default_factory=CertificateTable)
    recheck: RecheckTable = field(default_factory=RecheckTable)
    iso9283: Iso9283Table = field(default_factory=Iso9283Table)
    campaign: CampaignTable | None = None
    targets: TargetsTable | None = None
    notify: NotifyTable | None = None
    simulation: SimulationTable | None = None

    # Work done with the cell, its speed, its evaluation and descriptions: no effect on a measured
    # point.
    OUTSIDE_DIGEST = (
        "simulation", "plan", "sweeps", "keep_out", "volumes", "uncertainty", "touch", "recheck",
        "targets", "certificate", "iso9283", "notify", "tool",
        "rail.homing_mm_s", "rail.standstill_dwell_s",
        "robot.ramp_s", "robot.first_pass_percent", "robot.first_pass_pause", "robot.envelope",
        "robot.rp_mm", "robot.program", "tracker.pointing_s", "tracker.reading_s",
        "layout.reflectors", "layout.max_tool_std_mm", "layout.base_tolerance_mm",
        "settle.robot_least_s", "settle.rail_least_s", "settle.spread_mm",
    )  # fmt: skip

    def __post_init__(self) -> None:
        refuse(problem for check in self.checks() for problem in check())

    def checks(self) -> Sequence[Callable[[], Iterable[str]]]:
        """Return the checks across tables; an unread station does not prevent others."""
        try:
            stations = range(len(self.station))
        except Unread:
            stations = range(0)
        return (
            self._bad_names,
            self._bad_grid_station,
            self._bad_fixed,
            *(partial(self._bad_station, n) for n in stations),
            *(partial(self._bad_strip, n) for n in stations),
            self._bad_cell_counts,
            self._bad_others,
            self._bad_survey,
            self._bad_reflectors,
            self._bad_volumes,
            lambda: keep_out_problems(
                self.keep_out, self.robot.envelope, coming=self.volumes is not None
            ),
            lambda: tool_problems(self.tool, self.robot.options.get("tool")),
        )

    def _bad_volumes(self) -> Iterator[str]:
        if self.volumes is not None and self.volumes.floor and self.has_rail:
            yield "volumes.floor: expected false, got true: this arm can reach its rail"

    def _bad_names(self) -> Iterator[str]:
        most = 1000
        if not 1 <= len(self.station) <= most:
            yield f"station: expected 1 .. {most} stations, got {len(self.station)}"
        names = [station.name for station in self.station]
        if len(set(names)) != len(names):
            yield f"station: names must differ, got {', '.join(names)}"

    def _bad_grid_station(self) -> Iterator[str]:
        names = [station.name for station in self.station]
        if self.grid.station not in names:
            yield f"grid.station: expected one of {', '.join(names)}, got {self.grid.station!r}"

    def _bad_fixed(self) -> Iterator[str]:
        """Yield values that need a rail, in a cell without one."""
        if self.has_rail:
            if not self.layout.slide:
                yield "layout.slide: a slide needs nests"
            return
        if len(self.station) > 1:
            yield f"station: expected one station without [rail], got {len(self.station)}"
        for n, station in enumerate(self.station):
            if station.rail_mm or station.strip_mm:
                yield (
                    f"station[{n}].rail_mm: expected 0 without [rail], got {station.rail_mm} of "
                    f"{station.name}"
                )
        if self.layout.slide:
            yield "layout.slide: expected no nests of a slide without [rail]"
        if self.touch.poses:
            yield "touch.poses: expected 0 without [rail]"

    def _bad_station(self, n: int) -> Iterator[str]:
        rail, station = self.rail, self.station[n]
        if not self.has_rail:
            return
        low_mm, high_mm = rail.travel_min_mm + rail.back_off_mm, rail.travel_max_mm
        if not low_mm <= station.rail_mm <= high_mm:
            yield f"station[{n}].rail_mm: expected {low_mm} .. {high_mm}, got {station.rail_mm}"
        if not abs(station.rail_mm - station.strip_mm) <= rail.slip_limit_mm:
            yield (
                f"station[{n}].strip_mm: {station.strip_mm} and rail_mm {station.rail_mm} of "
                f"{station.name} differ by more than rail.slip_limit_mm {rail.slip_limit_mm}"
            )

    def _bad_strip(self, n: int) -> Iterator[str]:
        rail, station = self.rail, self.station[n]
        for other in self.station[:n] if self.has_rail else ():
            if not abs(station.strip_mm - other.strip_mm) > rail.strip_tolerance_mm:
                yield (
                    f"station[{n}].strip_mm: {station.strip_mm} of {station.name} and "
                    f"{other.strip_mm} of {other.name} must differ by more than "
                    f"rail.strip_tolerance_mm {rail.strip_tolerance_mm}"
                )

    def _bad_cell_counts(self) -> Iterator[str]:
        per_cell, cells = self.validation.per_cell, math.prod(self.grid.cells)
        if not per_cell * cells <= MOST_POINTS:
            targets = f"{per_cell} targets in each of {cells} grid cells"
            yield f"validation: expected at most {MOST_POINTS} targets, got {targets}"

    def _bad_others(self) -> Iterator[str]:
        targets, others = self.validation.others, len(self.station) - 1
        if not targets >= others:
            yield f"validation.others: expected one at each of {others} stations, got {targets}"

    def _bad_survey(self) -> Iterator[str]:
        if not self.has_rail:
            return
        low_mm, high_mm = self.rail.travel_min_mm, self.rail.travel_max_mm
        for key, end_mm in (("from_mm", self.survey.from_mm), ("to_mm", self.survey.to_mm)):
            if not low_mm <= end_mm <= high_mm:
                yield f"survey.{key}: {end_mm} mm is outside the travel {low_mm} .. {high_mm} mm"

    @property
    def has_rail(self) -> bool:
        """Whether the robot is on a rail, not on the floor."""
        return self.rail.driver != NO_RAIL

    @property
    def orients(self) -> bool:
        """Whether the tool's orientation is measured, by several reflectors on the flange."""
        return bool(self.robot.more_smr_mm)

    @property
    def pauses_at_first_pass(self) -> bool:
        """Whether an attended run pauses before the robot first leaves the grid's cube.

        By default, except in a simulated cell.
        """
        stated = self.robot.first_pass_pause
        return self.simulation is None if stated is None else stated

    def _bad_reflectors(self) -> Iterator[str]:
        if self.robot.more_smr_mm and self.layout.by_hand:
            yield "robot.more_smr_mm: expected mounted reflectors, got layout.reflectors by_hand"
        if self.validation.max_tolerance_deg is not None and not self.robot.more_smr_mm:
            yield (
                "validation.max_tolerance_deg: one reflector measures no orientation; add the "
                "others on the flange to robot.more_smr_mm, or omit the limit"
            )
        test = self.iso9283
        if not self.robot.more_smr_mm and (test.ap_limit_deg, test.rp_limit_deg) != (None, None):
            yield "iso9283: one reflector measures no angles (ap_limit_deg, rp_limit_deg)"
        elif test.ap_limit_deg is not None and not test.calibration:
            yield (
                "iso9283.ap_limit_deg: requires iso9283.calibration, which has the positions of "
                "the reflectors on the flange"
            )

    @cached_property
    def surroundings(self) -> Surroundings | None:
        """The volumes that the arm must avoid; None without them."""
        envelope = self.robot.envelope
        if envelope is None or not self.keep_out:
            return None
        return Surroundings(self.robot.arm(), envelope, self.layout, self.keep_out)

    @property
    def verification_samples(self) -> int:
        return self.plan.samples(self.layout.nest_samples, quick=self.tracker.samples)

    @property
    def nest_samples(self) -> int:
        return self.plan.samples(self.layout.nest_samples, quick=2 * self.tracker.samples)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the cell's canonical JSON, without `OUTSIDE_DIGEST`."""
        values = msgspec.to_builtins(self)
        for path in self.OUTSIDE_DIGEST:
            table, _, key = path.rpartition(".")
            (values[table] if table else values).pop(key)
        if not self.robot.more_smr_mm:  # as in files without this key
            values["robot"].pop("more_smr_mm")
        for joint in values["robot"]["joint"]:
            if joint["coupled_to"] is None:
                del joint["coupled_to"], joint["coupling"]
        if self.validation.max_tolerance_deg is None:
            values["validation"].pop("max_tolerance_deg")
        return hashlib.sha256(msgspec.json.encode(values, order="sorted")).hexdigest()

    @property
    def reference(self) -> Station:
        """The grid's station, at which the robot's error is measured."""
        return self.station_named(self.grid.station)

    def station_named(self, name: str) -> Station:
        """Return the station called ``name``; raises `SettingsError`."""
        for station in self.station:
            if station.name == name:
                return station
        known = ", ".join(station.name for station in self.station)
        raise SettingsError(self.name, [f"unknown station {name!r}; known: {known}"])


def load_cell(where: str, overrides: Mapping[str, str] | None = None) -> Cell:
    """Read a built-in cell by name or a TOML file, with ``key.path = value`` overrides."""
    changed = overrides or {}
    text = read_source(where)
    values = parsed(text, where)
    override_all(values, changed)
    try:
        cell = convert(with_rail(values), Cell, where)
        uncertainty = with_certificates(cell.uncertainty, cell_folder(where))
        return msgspec.structs.replace(cell, uncertainty=uncertainty)
    except SettingsError as error:
        raise located(where, error.problems, changed) from None


def states(where: str, overrides: Mapping[str, str], key: str) -> bool:
    """Whether a cell file or the overrides state ``key``, ``table.name``, valid or not."""
    values = parsed(read_source(where), where)
    override_all(values, overrides)
    table, _, name = key.partition(".")
    of = values.get(table)
    return isinstance(of, Mapping) and name in of


def located(where: str, problems: Iterable[str], overrides: Mapping[str, str]) -> SettingsError:
    """Return the problems of a cell file with their lines, where known.

    Options of a driver that an override replaced are not in the file.
    """
    exchanged = exchanged_drivers(parsed(read_source(where), where), overrides)
    problems = [explain_exchange(each, exchanged) for each in problems]
    overrides = {**overrides, **{f"{table}.options": "" for table in exchanged}}
    if where in built_in_cells():
        return SettingsError(where, list(problems))
    return SettingsError(where, with_lines(problems, read_source(where), where, overrides))


def driver_names(where: str, overrides: Mapping[str, str]) -> dict[str, str]:
    """Return the driver of each table of a cell file, valid or not."""
    values = parsed(read_source(where), where)
    override_all(values, overrides)
    tables = {name: table for name, table in values.items() if isinstance(table, dict)}
    drivers = {name: table.get("driver") for name, table in tables.items()}
    return {name: driver for name, driver in drivers.items() if isinstance(driver, str)}
