"""What stands in the cell: a strict TOML file becomes typed, checked objects.

Lengths mm, angles deg in the file; properties give rad. Frames: {W} world (three floor nests),
{B} robot base, {S} slide (its nests are given in nominal {B}: the slide carries the robot).
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, field
from scipy.spatial.transform import Rotation

from hilcell.geometry.kinematics import Arm, Array
from hilcell.settings import SettingsError, convert

Positive = Annotated[float, Meta(gt=0)]
Percent = Annotated[float, Meta(gt=0, le=100)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.\- ]{0,63}$")]
Point = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


class Frozen(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """A table of the cell file."""


class Pose(Frozen, frozen=True, kw_only=True):
    """A frame: position in mm and KUKA Z-Y-X angles in deg."""

    x_mm: float
    y_mm: float
    z_mm: float
    a_deg: float = 0.0
    b_deg: float = 0.0
    c_deg: float = 0.0

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
    rail_mm: float
    strip_mm: float


class RailTable(Frozen, frozen=True, kw_only=True):
    """The rail, its drive and its strip."""

    driver: Name
    travel_min_mm: float
    travel_max_mm: float
    speed_mm_s: Positive
    acceleration_mm_s2: Positive
    back_off_mm: Positive = 1.0
    strip_tolerance_mm: Positive = 0.01
    slip_limit_mm: Positive = 2.0
    max_approaches: Annotated[int, Meta(ge=1, le=20)] = 8
    options: dict[str, Any] = field(default_factory=dict)


class Joint(Frozen, frozen=True, kw_only=True):
    """One DH row, ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``, with its software limits."""

    a_mm: float
    alpha_deg: float
    d_mm: float
    offset_deg: float
    sign: Annotated[int, Meta(ge=-1, le=1)] = 1
    min_deg: float = -180.0
    max_deg: float = 180.0
    speed_deg_s: Positive = 100.0

    def __post_init__(self) -> None:
        if not self.sign:
            raise ValueError("sign must be 1 or -1")
        if not self.min_deg < self.max_deg:
            raise ValueError(f"min_deg {self.min_deg} must be below max_deg {self.max_deg}")


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
    approach_deg: Positive = 0.5
    joint_margin_deg: Annotated[float, Meta(ge=0)] = 2.0
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.joint) != 6:
            raise ValueError(f"six joints are wanted, found {len(self.joint)}")

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
    min_range_mm: Positive = 500.0
    max_range_mm: Positive = 10_000.0
    max_std_mm: Positive = 0.05
    find_radius_mm: Positive = 5.0
    samples: Annotated[int, Meta(ge=1, le=1000)] = 1
    options: dict[str, Any] = field(default_factory=dict)


class Nest(Frozen, frozen=True, kw_only=True):
    """A magnet nest that carries a reflector: on the floor in {W}, on the slide in nominal {B}."""

    name: Name
    x_mm: float
    y_mm: float
    z_mm: float

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
    nest_tolerance_mm: Positive = 5.0
    nest_samples: Annotated[int, Meta(ge=1, le=1000)] = 10

    def __post_init__(self) -> None:
        if not abs(np.linalg.norm(self.rail_direction) - 1) < 1e-6:
            raise ValueError("rail_direction must have length 1")
        for nests, least in ((self.floor, 3), (self.slide, 3)):
            if len(nests) < least:
                raise ValueError(f"at least {least} nests are needed, found {len(nests)}")
            _refuse_collinear(nests)

    def nominal_base(self, rail_mm: float) -> Array:
        """Return nominal {B} in {W} (4, 4) with the slide at ``rail_mm``."""
        T = self.base.matrix()
        T[:3, 3] += rail_mm * np.array(self.rail_direction)
        return T


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
    pitch_mm: Positive

    def __post_init__(self) -> None:
        for size in self.size_mm:
            cells = size / self.pitch_mm
            if not (round(cells) >= 1 and abs(cells - round(cells)) < 1e-9):
                raise ValueError(
                    f"size {size} mm is not a whole number of pitches {self.pitch_mm} mm"
                )


class BaseFrameTable(Frozen, frozen=True, kw_only=True):
    """How {B} is found from circles of axes 1 and 6 (section 4.2)."""

    axis_1_deg: Six
    axis_1_sweep_deg: tuple[float, float]
    axis_6_deg: Six
    axis_6_sweep_deg: tuple[float, float]
    points: Annotated[int, Meta(ge=3, le=200)] = 12


class SurveyTable(Frozen, frozen=True, kw_only=True):
    """How the rail is surveyed there and back, and how often a station is approached."""

    from_mm: float = 0.0
    to_mm: float = 2000.0
    step_mm: Positive = 100.0
    repeats: Annotated[int, Meta(ge=4, le=1000)] = 15

    def __post_init__(self) -> None:
        steps = (self.to_mm - self.from_mm) / self.step_mm
        if not (round(steps) >= 3 and abs(steps - round(steps)) < 1e-9):
            raise ValueError(
                f"{self.from_mm} .. {self.to_mm} mm is not three or more steps of {self.step_mm} mm"
            )


class ValidationTable(Frozen, frozen=True, kw_only=True):
    """Random targets: per grid cell at the grid's station, in all at the other stations."""

    per_cell: Annotated[int, Meta(ge=1)] = 5
    others: Annotated[int, Meta(ge=1)] = 150
    mean_tolerance_mm: Positive = 0.2
    max_tolerance_mm: Positive = 1.0


class CampaignTable(Frozen, frozen=True, kw_only=True):
    """A list of poses to drive, with the reflectors and where the tracker expects them."""

    poses: str


class SettleTable(Frozen, frozen=True, kw_only=True):
    """Times in the cell's clock, and the oldest reading that an interlock believes."""

    robot_s: Annotated[float, Meta(ge=0)] = 1.0
    rail_s: Annotated[float, Meta(ge=0)] = 2.0
    reading_age_s: Positive = 0.5


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
        names = [station.name for station in self.station]
        if len(set(names)) != len(names):
            raise ValueError(f"station names must differ, found {', '.join(names)}")
        if self.grid.station not in names:
            raise ValueError(f"grid.station {self.grid.station!r} is none of {', '.join(names)}")
        for station in self.station:
            low, high = self.rail.travel_min_mm + self.rail.back_off_mm, self.rail.travel_max_mm
            if not low <= station.rail_mm <= high:
                raise ValueError(
                    f"station {station.name}: rail_mm {station.rail_mm} is outside {low} .. {high}"
                )
        for end_mm in (self.survey.from_mm, self.survey.to_mm):
            if not self.rail.travel_min_mm <= end_mm <= self.rail.travel_max_mm:
                raise ValueError(
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
            text = path.read_text("utf-8")
        except FileNotFoundError:
            known = ", ".join(built_in_cells())
            raise SettingsError(
                where, [f"no such file, and no built-in cell of that name; built in: {known}"]
            ) from None
        except (OSError, UnicodeDecodeError) as error:
            raise SettingsError(where, [f"cannot be read: {error}"]) from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(where, [f"not valid TOML: {error}"]) from error


def built_in_cells() -> list[str]:
    """Return the names of the cells that come with hilcell."""
    folder = resources.files("hilcell.cells")
    return sorted(
        p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")
    )


def _override(values: dict[str, Any], key: str, text: str) -> None:
    """Set ``a.b.c`` to a TOML value, or to the bare text where it is not one."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    *path, last = key.split(".")
    table: Any = values
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise SettingsError("--set", [f"{key}: {part} is not a table"])
    table[last] = value
