"""The cell as the rules read it: the few settings that they need, of the frozen cell."""

from __future__ import annotations

import msgspec


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
