"""What the core asks of devices: three small Protocols, their readings and their errors.

A driver is one plain class that satisfies one of these; it is built as ``Driver(options, clock)``
with its own checked options (``Driver.Options``, a msgspec Struct) and the clock of the cell.
The trap: a reading is only as good as its age. ``taken_s`` is ``time.monotonic()`` at the moment
the bytes that carry the reading arrived; nobody may use one older than its limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Event
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hilcell.errors import (
    DeviceError,
    DeviceRefused,
    HilcellError,
    NoReading,
    Stopped,
)

__all__ = [
    "Array", "Clock", "DeviceError", "DeviceRefused", "HilcellError", "Identity", "LinkStatistics",
    "NoReading", "Rail", "RailReading", "Robot", "RobotReading", "SimulatedCell", "Stopped",
    "Tracker", "TrackerReading", "says_simulated",
]  # fmt: skip

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answered: every string was cleaned at the driver's edge.

    ``simulated`` is what the device says of itself: see `says_simulated`.
    """

    device: str
    model: str
    serial: str
    address: str
    simulated: bool = False


def says_simulated(name: str) -> bool:
    """Whether a device's own name says that it is no machine: it has the word "simulated"."""
    return "simulated" in name.casefold()


@dataclass(frozen=True, slots=True)
class RailReading:
    """Drive and strip together: ``position_mm`` of the encoder, ``strip_mm`` of the strip.

    ``still`` is the driver's judgement over a dwell: the speed within a window, and drive and
    strip each within a window of position. A speed alone does not say it: a servo that holds a
    position dithers, and a creep is slow. Positions of a slide that stands are medians of at least
    five readings of the drive and of the same five of the strip; ``taken_s`` is when the newest of
    them arrived, which agrees with the others. A slide that moves is told by its newest reading.
    """

    position_mm: float
    strip_mm: float
    velocity_mm_s: float
    still: bool
    powered: bool
    taken_s: float


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """What a wire has carried since connect: whole frames received, and what was lost on it."""

    frames: int = 0
    bad_lines: int = 0  # that the gateway garbled
    refused: int = 0  # frames of ours that the gateway did not take
    malformed: int = 0  # frames too short for what they should carry


@dataclass(frozen=True, slots=True)
class RobotReading:
    """Joints (6,) in rad, pose (4, 4) of {T} in {B} in mm as the controller states it."""

    joints_rad: Array
    pose: Array
    still: bool
    taken_s: float


@dataclass(frozen=True, slots=True)
class TrackerReading:
    """Mean (3,) of ``samples`` readings in the tracker's frame, 1-sigma ``std_mm`` (3,), air."""

    xyz_mm: Array
    std_mm: Array
    samples: int
    reflector: str
    temperature_c: float
    pressure_mbar: float
    humidity_percent: float
    taken_s: float


class Clock(Protocol):
    """The time of the cell; a simulated cell's may run faster. Deadlines on wires are real time."""

    def now_s(self) -> float:
        """Return the cell's time, which never runs back."""

    def wait(self, duration_s: float) -> None:
        """Let cell time pass; raise `Stopped` within 20 ms of a stop."""

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for; to be called in every wait on a wire."""


class Rail(Protocol):
    """A slide on a rail with a drive and an absolute strip. ``stop`` may come from any thread."""

    def connect(self) -> list[Identity]:
        """Open the wire, verify identities, configure the self-stop; nothing moves."""

    def home(self) -> None:
        """Find the drive's reference."""

    def move_to(self, position_mm: float) -> None:
        """Move by the drive's encoder alone; return at standstill; leave the drive holding."""

    def settle(self) -> RailReading:
        """Return a reading at rest; raise `DeviceError` when the slide does not come to rest."""

    def read(self) -> RailReading:
        """Return a reading asked for after this call began."""

    def hold(self) -> None:
        """Take the power to move away: drive disabled, brake closed."""

    def statistics(self) -> LinkStatistics:
        """Return what the wire has carried, also after ``close``; any thread, asks nobody."""

    def stop(self) -> None:
        """Quick stop, without waiting for an answer."""

    def close(self) -> None:
        """Leave the slide held and the wire closed."""


class Robot(Protocol):
    """A six-axis robot that goes to joint angles. ``stop`` may come from any thread."""

    def connect(self) -> list[Identity]:
        """Open the wire, verify identity, mode, tool and base; nothing moves."""

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        """Move all axes (PTP); return the reading at rest, after motion ended."""

    def read(self) -> RobotReading:
        """Return a reading asked for after this call began."""

    def stop(self) -> None:
        """Brake on the path, over a connection of its own, without waiting for an answer."""

    def close(self) -> None:
        """Leave the robot at rest and the wire closed."""


class Tracker(Protocol):
    """A laser tracker: points, finds the reflector, measures. ``stop`` may come from any thread."""

    def connect(self) -> list[Identity]:
        """Open the wire, initialise, set units, mode and reflector; verify them."""

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        """Measure the reflector expected at ``near_mm`` (3,), tracker frame; mean of ``samples``.

        Raises `NoReading` when the beam finds nothing there or the result is not good.
        """

    def stop(self) -> None:
        """Stop measuring, without waiting for an answer."""

    def close(self) -> None:
        """Close the wire."""


class SimulatedCell(Protocol):
    """A simulated cell that runs in a process of its own."""

    options: dict[str, dict[str, object]]  # where each device listens: overrides of its options
    address: str  # of the control channel, HOST:PORT

    def clock(self, stop: Event) -> Clock:
        """Return the cell's clock; its waits end when ``stop`` is set."""

    def close(self) -> None:
        """Let go of the cell; end its process, if it was started here."""
