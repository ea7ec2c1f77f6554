"""The bodies of records as the rules read them."""

from __future__ import annotations

import msgspec

from hilcell.model.events import ReadingTime, Three
from hilcell.model.point import Readings
from hilcell.model.records import SeenBefore


class Motion(msgspec.Struct, frozen=True, kw_only=True):
    """A motion that is about to begin."""

    action: str
    session: int
    seen: SeenBefore


class Begun(msgspec.Struct, frozen=True):
    """The point or station at which a motion ended; ``began`` is the reading by which it began."""

    began: ReadingTime | None = None
    readings: Readings | None = None


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """A point, raw."""

    group: str
    station: str
    session: int
    set_up: int = 0
    retaken: bool = False
    xyz_mm: Three
    std_mm: Three
    samples: int
    strip_mm: float
    smr_mm: Three | None = None
    commanded_deg: tuple[float, ...] | None = None
    readings: Readings


class Framed(msgspec.Struct, frozen=True):
    """A frame; ``points`` are the keys of those it was computed from, if of any."""

    points: list[str] | None = None


class Station(msgspec.Struct, frozen=True):
    """A station and what the strip reads there."""

    name: str
    strip_mm: float


class Rail(msgspec.Struct, frozen=True):
    """The slide's tolerance."""

    strip_tolerance_mm: float = 0.01


class Robot(msgspec.Struct, frozen=True):
    """The safe pose."""

    safe_deg: tuple[float, ...] = ()


class Settle(msgspec.Struct, frozen=True):
    """Rest before a measurement, and the greatest age of a reading."""

    robot_s: float = 1.0
    rail_s: float = 2.0
    reading_age_s: float = 0.5


class Layout(msgspec.Struct, frozen=True):
    """Whether reflectors are mounted."""

    reflectors: str = "mounted"


class Uncertainty(msgspec.Struct, frozen=True):
    """The stated drift of the tracker's frame."""

    drift_limit_mm: float = 0.02


class Simulation(msgspec.Struct, frozen=True):
    """A simulated cell."""

    address: str = ""


class CellFacts(msgspec.Struct, frozen=True):
    """The cell as it was frozen, as far as the rules need it."""

    station: list[Station] = []
    rail: Rail = Rail()
    robot: Robot = Robot()
    settle: Settle = Settle()
    layout: Layout = Layout()
    uncertainty: Uncertainty = Uncertainty()
    simulation: Simulation | None = None


class Inputs(msgspec.Struct, frozen=True):
    """The frozen inputs."""

    cell: CellFacts
    speed: float | None = None
    versions: dict[str, str] = {}

    @property
    def time_factor(self) -> float:
        """Return by how much the PC's time is shorter than the cell's; infinite where unknown."""
        if self.cell.simulation is None:
            return 1.0
        return float("inf") if self.speed is None else self.speed
