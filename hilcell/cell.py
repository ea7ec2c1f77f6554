"""What stands in the cell: a strict TOML file becomes typed, checked objects.

Lengths mm, angles deg in the file; properties give rad. Frames: {W} world (three floor nests),
{B} robot base, {S} slide (its nests are given in nominal {B}: the slide carries the robot).
"""

from __future__ import annotations

import hashlib
import math
import tomllib
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import resources
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, field
from scipy.spatial.transform import Rotation

from hilcell.geometry.kinematics import Arm, Array
from hilcell.settings import SettingsError, convert, refuse

MOST_POINTS = 100_000  # of the grid, and of targets in it
MOST_STEPS = 10_000
MOST_NESTS = 100
MOST_STATIONS = 1000
LEAST_ARC_DEG = 10.0
APART_MM = 20.0  # nests closer than this are one nest, or their reflectors touch

Length = Annotated[float, Meta(ge=-1e6, le=1e6)]
Size = Annotated[float, Meta(gt=0, le=1e6)]
Step = Annotated[float, Meta(ge=0.01, le=1e6)]
Angle = Annotated[float, Meta(ge=-3600, le=3600)]
Speed = Annotated[float, Meta(ge=0.1, le=1e5)]
Acceleration = Annotated[float, Meta(ge=1, le=1e6)]
Wait = Annotated[float, Meta(ge=0, le=3600)]
Percent = Annotated[float, Meta(gt=0, le=100)]
Count = Annotated[int, Meta(ge=1, le=1000)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.\- ]{0,63}$")]
Point = tuple[Length, Length, Length]
Sweep = tuple[Angle, Angle]
Six = tuple[Angle, Angle, Angle, Angle, Angle, Angle]


class Frozen(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """A table of the cell file."""


def _refuse_descending(table: Frozen, low: str, high: str) -> None:
    least, most = getattr(table, low), getattr(table, high)
    if not least < most:
        raise ValueError(f"{low} {least} must be below {high} {most}")


class Pose(Frozen, frozen=True, kw_only=True):
    """A frame: position in mm and Z-Y-X angles in deg."""

    x_mm: Length
    y_mm: Length
    z_mm: Length
    a_deg: Angle = 0.0
    b_deg: Angle = 0.0
    c_deg: Angle = 0.0

    def matrix(self) -> Array:
        """Return the homogeneous matrix (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler(
            "ZYX", (self.a_deg, self.b_deg, self.c_deg), degrees=True
        ).as_matrix()
        T[:3, 3] = (self.x_mm, self.y_mm, self.z_mm)
        return T


class Station(Frozen, frozen=True, kw_only=True):
    """A place on the rail where the robot works: the strip's recorded reading defines it."""

    name: Name
    rail_mm: Length
    strip_mm: Length


class RailTable(Frozen, frozen=True, kw_only=True):
    """The rail, its drive and its strip."""

    driver: Name
    travel_min_mm: Length
    travel_max_mm: Length
    speed_mm_s: Speed
    acceleration_mm_s2: Acceleration
    back_off_mm: Size = 1.0
    strip_tolerance_mm: Size = 0.01
    slip_limit_mm: Size = 2.0
    max_approaches: Annotated[int, Meta(ge=1, le=20)] = 8
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _refuse_descending(self, "travel_min_mm", "travel_max_mm")


class Joint(Frozen, frozen=True, kw_only=True):
    """One DH row, ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``, with its software limits."""

    a_mm: Length
    alpha_deg: Angle
    d_mm: Length
    offset_deg: Angle
    sign: Annotated[int, Meta(ge=-1, le=1)] = 1
    min_deg: Angle = -180.0
    max_deg: Angle = 180.0
    speed_deg_s: Speed = 100.0

    def __post_init__(self) -> None:
        if not self.sign:
            raise ValueError("sign must be 1 or -1")
        _refuse_descending(self, "min_deg", "max_deg")


class RobotTable(Frozen, frozen=True, kw_only=True):
    """The robot: nominal kinematics, where the reflector sits, how it moves."""

    driver: Name
    name: str
    joint: list[Joint]
    smr_mm: Point
    home_deg: Six
    safe_deg: Six
    status: Annotated[int, Meta(ge=0, le=7)]
    speed_percent: Percent = 30.0
    approach_deg: Annotated[float, Meta(gt=0, le=90)] = 0.5
    joint_margin_deg: Annotated[float, Meta(ge=0, le=90)] = 2.0
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.joint) != 6:
            raise ValueError(f"six joints are wanted, found {len(self.joint)}")
        refuse(
            [
                f"{key}: A{n} at {deg} deg is outside its limits "
                f"{joint.min_deg} .. {joint.max_deg} deg"
                for key in ("home_deg", "safe_deg")
                for n, (joint, deg) in enumerate(
                    zip(self.joint, getattr(self, key), strict=True), 1
                )
                if not joint.min_deg <= deg <= joint.max_deg
            ]
        )

    def arm(self) -> Arm:
        """Return the nominal arm; its tool point is the reflector's centre."""
        tool = np.eye(4)
        tool[:3, 3] = self.smr_mm
        return arm_from_joints(self.joint, tool)

    @property
    def margin_limits_rad(self) -> Array:
        """Return the limits (2, 6), lower and upper, less the margin."""
        margin_deg = self.joint_margin_deg
        low_deg = [joint.min_deg + margin_deg for joint in self.joint]
        return np.radians([low_deg, [joint.max_deg - margin_deg for joint in self.joint]])


def arm_from_joints(joints: list[Joint], tool: Array) -> Arm:
    """Return the arm of six DH rows with the tool frame (4, 4) on the flange."""
    return Arm(
        a_mm=np.array([j.a_mm for j in joints]),
        alpha_rad=np.radians([j.alpha_deg for j in joints]),
        d_mm=np.array([j.d_mm for j in joints]),
        offset_rad=np.radians([j.offset_deg for j in joints]),
        sign=np.array([float(j.sign) for j in joints]),
        tool=tool,
    )


class TrackerTable(Frozen, frozen=True, kw_only=True):
    """The tracker: its range, its reflector, where it roughly stands in {W}."""

    driver: Name
    reflector: str
    pose: Pose
    min_range_mm: Size = 500.0
    max_range_mm: Size = 10_000.0
    max_std_mm: Size = 0.05
    find_radius_mm: Size = 5.0
    samples: Count = 1
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _refuse_descending(self, "min_range_mm", "max_range_mm")


class Nest(Frozen, frozen=True, kw_only=True):
    """A magnet nest that carries a reflector: on the floor in {W}, on the slide in nominal {B}."""

    name: Name
    x_mm: Length
    y_mm: Length
    z_mm: Length

    @property
    def xyz_mm(self) -> Array:
        """Return the position (3,)."""
        return np.array([self.x_mm, self.y_mm, self.z_mm])


class Layout(Frozen, frozen=True, kw_only=True):
    """Where the rail stands: nominal {B} in {W} at rail 0, the rail's direction in {W}."""

    base: Pose
    rail_direction: Point
    floor: list[Nest]
    slide: list[Nest]
    nest_tolerance_mm: Size = 5.0
    nest_samples: Count = 10

    def __post_init__(self) -> None:
        if not abs(np.linalg.norm(self.rail_direction) - 1) < 1e-6:
            raise ValueError("rail_direction must have length 1")
        for nests in (self.floor, self.slide):
            if not 3 <= len(nests) <= MOST_NESTS:
                raise ValueError(f"3 .. {MOST_NESTS} nests are needed, found {len(nests)}")
        names = [nest.name for nest in (*self.floor, *self.slide)]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"nest names must differ, found {name} twice")
        for nests in (self.floor, self.slide):
            _refuse_collinear(nests[:3])  # they make the frame's axes
            _refuse_collinear(nests)
            _refuse_close(nests)

    def nominal_base(self, rail_mm: float) -> Array:
        """Return nominal {B} in {W} (4, 4) with the slide at ``rail_mm``."""
        T = self.base.matrix()
        T[:3, 3] += rail_mm * np.array(self.rail_direction)
        return T


def _refuse_close(nests: list[Nest]) -> None:
    for one, other in combinations(nests, 2):
        apart_mm = float(np.linalg.norm(one.xyz_mm - other.xyz_mm))
        if not apart_mm >= APART_MM:
            raise ValueError(
                f"nests {one.name} and {other.name} are {apart_mm:.1f} mm apart, "
                f"wanted at least {APART_MM} mm"
            )


def _refuse_collinear(nests: list[Nest]) -> None:
    points = np.array([nest.xyz_mm for nest in nests])
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not spread[1] > 0.02 * spread[0]:
        names = ", ".join(nest.name for nest in nests)
        raise ValueError(
            f"nests {names} lie on one line (spread {spread[0]:.1f} mm along it, "
            f"{spread[1]:.3f} mm across): a frame needs a triangle; move one nest aside"
        )


class GridTable(Frozen, frozen=True, kw_only=True):
    """The cube that is measured, in nominal {B}, with one tool orientation."""

    station: Name
    centre: Pose
    size_mm: Point
    pitch_mm: Step

    def __post_init__(self) -> None:
        for size in self.size_mm:
            cells = size / self.pitch_mm
            if not (round(cells) >= 1 and abs(cells - round(cells)) < 1e-9):
                raise ValueError(
                    f"size {size} mm is not a whole number of pitches {self.pitch_mm} mm"
                )
        vertices = math.prod(count + 1 for count in self.cells)
        if not vertices <= MOST_POINTS:
            raise ValueError(f"{vertices} vertices, at most {MOST_POINTS} are measured")

    @property
    def cells(self) -> tuple[int, ...]:
        """Return the number of grid cells along x, y and z."""
        return tuple(round(size / self.pitch_mm) for size in self.size_mm)


class BaseFrameTable(Frozen, frozen=True, kw_only=True):
    """How {B} is found from circles of axes 1 and 6 (section 4.2)."""

    axis_1_deg: Six
    axis_1_sweep_deg: Sweep
    axis_6_deg: Six
    axis_6_sweep_deg: Sweep
    points: Annotated[int, Meta(ge=3, le=200)] = 12

    def __post_init__(self) -> None:
        sweeps = {"axis_1": self.axis_1_sweep_deg, "axis_6": self.axis_6_sweep_deg}
        refuse(
            [
                f"{axis}_sweep_deg: {begin} .. {end} deg is no arc; sweep at least {LEAST_ARC_DEG}"
                for axis, (begin, end) in sweeps.items()
                if not abs(end - begin) >= LEAST_ARC_DEG
            ]
        )


class SurveyTable(Frozen, frozen=True, kw_only=True):
    """How the rail is surveyed there and back, and how often a station is approached."""

    from_mm: Length = 0.0
    to_mm: Length = 2000.0
    step_mm: Step = 100.0
    repeats: Annotated[int, Meta(ge=4, le=1000)] = 15

    def __post_init__(self) -> None:
        steps = (self.to_mm - self.from_mm) / self.step_mm
        if not (round(steps) >= 3 and abs(steps - round(steps)) < 1e-9):
            raise ValueError(
                f"{self.from_mm} .. {self.to_mm} mm is not three or more steps of {self.step_mm} mm"
            )
        if not steps <= MOST_STEPS:
            raise ValueError(f"{steps:.0f} steps, at most {MOST_STEPS} are driven")


class ValidationTable(Frozen, frozen=True, kw_only=True):
    """Random targets: per grid cell at the grid's station, in all at the other stations."""

    per_cell: Count = 5
    others: Annotated[int, Meta(ge=1, le=100_000)] = 150
    mean_tolerance_mm: Size = 0.2
    max_tolerance_mm: Size = 1.0


class CampaignTable(Frozen, frozen=True, kw_only=True):
    """A list of poses to drive, with the reflectors and where the tracker expects them."""

    poses: str


class SettleTable(Frozen, frozen=True, kw_only=True):
    """Times in the cell's clock, and the oldest reading that an interlock believes."""

    robot_s: Wait = 1.0
    rail_s: Wait = 2.0
    reading_age_s: Annotated[float, Meta(ge=0.01, le=10)] = 0.5


class SimulationTable(Frozen, frozen=True, kw_only=True):
    """A simulated cell: found by its entry point; ``address`` attaches to one already running."""

    simulator: Name
    address: str = ""
    data: str = ""


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
    validation: ValidationTable = field(default_factory=ValidationTable)
    settle: SettleTable = field(default_factory=SettleTable)
    campaign: CampaignTable | None = None
    simulation: SimulationTable | None = None

    def __post_init__(self) -> None:
        if not 1 <= len(self.station) <= MOST_STATIONS:
            raise ValueError(f"1 .. {MOST_STATIONS} stations are needed, found {len(self.station)}")
        names = [station.name for station in self.station]
        if len(set(names)) != len(names):
            raise ValueError(f"station names must differ, found {', '.join(names)}")
        if self.grid.station not in names:
            raise ValueError(f"grid.station {self.grid.station!r} is none of {', '.join(names)}")
        refuse([*self._bad_stations(), *self._bad_counts(), *self._bad_survey()])

    def _bad_stations(self) -> Iterator[str]:
        rail = self.rail
        low_mm, high_mm = rail.travel_min_mm + rail.back_off_mm, rail.travel_max_mm
        for n, station in enumerate(self.station):
            if not low_mm <= station.rail_mm <= high_mm:
                yield (
                    f"station {station.name}: rail_mm {station.rail_mm} is outside "
                    f"{low_mm} .. {high_mm}"
                )
            if not abs(station.rail_mm - station.strip_mm) <= rail.slip_limit_mm:
                yield (
                    f"station {station.name}: strip_mm {station.strip_mm} and rail_mm "
                    f"{station.rail_mm} differ by more than rail.slip_limit_mm {rail.slip_limit_mm}"
                )
            for other in self.station[:n]:
                if not abs(station.strip_mm - other.strip_mm) > rail.strip_tolerance_mm:
                    yield (
                        f"station {station.name}: strip_mm {station.strip_mm} is also that of "
                        f"station {other.name} ({other.strip_mm} mm); they must differ by more "
                        f"than {rail.strip_tolerance_mm} mm"
                    )

    def _bad_counts(self) -> Iterator[str]:
        per_cell, cells = self.validation.per_cell, math.prod(self.grid.cells)
        if not per_cell * cells <= MOST_POINTS:
            yield (
                f"validation: {per_cell} targets in each of {cells} grid cells are "
                f"{per_cell * cells}, at most {MOST_POINTS}"
            )

    def _bad_survey(self) -> Iterator[str]:
        for end_mm in (self.survey.from_mm, self.survey.to_mm):
            if not self.rail.travel_min_mm <= end_mm <= self.rail.travel_max_mm:
                yield (
                    f"survey: {end_mm} mm is outside the travel {self.rail.travel_min_mm} .. "
                    f"{self.rail.travel_max_mm} mm"
                )

    @cached_property
    def digest(self) -> str:
        """Return SHA-256 over the canonical JSON of everything but the simulation."""
        values = msgspec.to_builtins(self)
        values.pop("simulation")
        return hashlib.sha256(msgspec.json.encode(values, order="sorted")).hexdigest()

    def station_named(self, name: str) -> Station:
        """Return the station called ``name``; raises `SettingsError`."""
        for station in self.station:
            if station.name == name:
                return station
        known = ", ".join(station.name for station in self.station)
        raise SettingsError(self.name, [f"station {name!r} is unknown; known here: {known}"])


def load_cell(where: str, overrides: Mapping[str, str] | None = None) -> Cell:
    """Read a built-in cell by name or a TOML file, with ``key.path = value`` overrides."""
    values = _read(where)
    for key, text in (overrides or {}).items():
        _override(values, key, text)
    return convert(values, Cell, where)


def _read(where: str) -> dict[str, Any]:
    if where in built_in_cells():
        text = (resources.files("hilcell.cells") / f"{where}.toml").read_text("utf-8")
    else:
        path = Path(where)
        try:
            text = path.read_text("utf-8-sig")  # editors of Windows write a mark
        except FileNotFoundError:
            known = ", ".join(built_in_cells())
            raise SettingsError(
                where, [f"no such file, and no built-in cell of that name; built in: {known}"]
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise SettingsError(where, [f"cannot be read: {error}"]) from error
    return _parsed(text, where)


def _parsed(text: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise SettingsError(where, ["nested too deeply"]) from None
    except ValueError as error:  # also an integer of more digits than Python reads
        raise SettingsError(where, [f"not valid TOML: {error}"]) from error


def built_in_cells() -> list[str]:
    """Return the names of the cells that come with hilcell."""
    folder = resources.files("hilcell.cells")
    return sorted(
        p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")
    )


def _override(values: dict[str, Any], key: str, text: str) -> None:
    """Set ``a.b.c`` to a TOML value, or to the bare text where it is not one."""
    if "\n" in text:  # it could set other keys
        raise SettingsError("--set", [f"{key}: a value on one line is wanted, found {text!r}"])
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except RecursionError:
        raise SettingsError("--set", [f"{key}: nested too deeply"]) from None
    except ValueError:
        value = text
    *path, last = key.split(".")
    table: Any = values
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise SettingsError("--set", [f"{key}: {part} is not a table"])
    table[last] = value
