"""The ports: small Protocols that devices satisfy, their readings and their errors.

Every rail, robot and tracker satisfies one of three. A tracker with two faces satisfies
`TwoFaces` as well, one that can stream `Streams`, a robot that can move one axis slowly and report
its joints meanwhile `Sweeps`. The last two hand out a flyer: prepared by ``with``, started by
``kickoff``, read by ``collect``, ended by ``complete``, and restored to its earlier state on every
exit of the ``with``.

A driver is one plain class that satisfies one of these; it is built as ``Driver(options, clock)``
with its own checked options (``Driver.Options``, a msgspec Struct) and the clock of the cell. A
reading is only as good as its age: ``taken_s`` is ``clock.pc_s()`` at the moment the bytes that
carry the reading arrived; a reading older than its limit must not be used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import astuple, dataclass, field
from threading import Event
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hilcell.errors import DeviceError, DeviceRefused, HilcellError, NoReading, Stopped, StripLost
from hilcell.identity import Identity

if TYPE_CHECKING:
    from hilcell.cell.file import Cell

__all__ = [
    "Ability", "Aims", "Air", "Array", "AxisReading", "Candidate", "Clock", "ControllerFile",
    "ControllerSide", "DeviceError", "DeviceRefused", "Discovers", "Exercise", "ExternalAxis",
    "HilcellError", "Identity", "InProcessCell", "Inspects", "Jogs", "JointSample",
    "LinkStatistics", "NeedsFiles", "NoReading", "Rail", "RailReading", "RailTrace",
    "RecordingEnded", "RepeatsRun", "Robot", "RobotDrivenRail", "RobotReading", "RobotSettings",
    "Searches", "SimulatedCell", "StatesSettings", "Stopped", "Stream", "StreamBlock", "Streams",
    "StripLost", "Sweep", "Sweeps", "Tracker", "TrackerReading", "Training", "TwoFaces",
    "is_simulated_name",
]  # fmt: skip

Array = NDArray[np.float64]


def is_simulated_name(name: str) -> bool:
    """Whether a device's own name contains the word "simulated"."""
    return "simulated" in name.casefold()


@dataclass(frozen=True, slots=True)
class RailReading:
    """Drive and strip together: ``position_mm`` of the encoder, ``strip_mm`` of the strip.

    ``still`` is the driver's judgement over a dwell: the speed within a window, and drive and strip
    each within a window of position. A speed alone does not suffice: a servo that holds a position
    dithers, and a creep is slow. Positions of a slide at rest are medians of at least five
    readings of the drive and of the same five of the strip; ``taken_s`` is when the newest of them
    arrived, which agrees with the others. For a slide that moves it is the newest. ``ended_s`` is
    when the end of the last motion was detected; None for none since connect.
    """

    position_mm: float
    strip_mm: float
    velocity_mm_s: float
    still: bool
    powered: bool
    taken_s: float
    ended_s: float | None = None


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """Counts of a wire since connect: whole frames received, and losses."""

    frames: int = 0
    bad_lines: int = 0  # that the gateway garbled
    refused: int = 0  # frames of ours that the gateway did not take
    malformed: int = 0  # frames too short for their contents
    held_by_sdo: int = 0  # 1: at the end no PDO came, and SDO confirmed that the slide is held

    def __add__(self, other: LinkStatistics) -> LinkStatistics:
        counts = zip(astuple(self), astuple(other), strict=True)
        return LinkStatistics(*(ours + theirs for ours, theirs in counts))


@dataclass(frozen=True, slots=True)
class RobotReading:
    """Joints (6,) in rad, pose (4, 4) of {T} in {B} in mm as the controller states it.

    ``ended_s`` is when the end of the last motion was detected; None for none since connect.
    ``by_factory_links``: the controller computes with links that its maker has measured on this
    very arm, so the pose may be millimetres off that of the nominal ones.
    """

    joints_rad: Array
    pose: Array
    still: bool
    taken_s: float
    ended_s: float | None = None
    by_factory_links: bool = False


@dataclass(frozen=True, slots=True)
class AxisReading:
    """A robot's external axis; ``held``: its controller refuses to move it."""

    position_mm: float
    held: bool
    taken_s: float


@dataclass(frozen=True, slots=True)
class Air:
    """The air at the tracker, by its weather station."""

    temperature_c: float
    pressure_mbar: float
    humidity_percent: float


@dataclass(frozen=True, slots=True)
class TrackerReading:
    """Mean (3,) of ``samples`` readings in the tracker's frame, 1-sigma ``std_mm`` (3,).

    ``air`` is None where the tracker has no weather station.
    """

    xyz_mm: Array
    std_mm: Array
    samples: int
    reflector: str
    air: Air | None
    taken_s: float


@dataclass(frozen=True, slots=True)
class StreamBlock:
    """Samples of a tracker: times (N,) of its own clock, positions (N, 3) in its frame.

    They arrived between two times of the cell's clock. They were taken before; how long before is
    known from many blocks only.
    """

    device_s: Array
    xyz_mm: Array
    arrived_after_s: float
    arrived_by_s: float


@dataclass(frozen=True, slots=True)
class JointSample:
    """Joints (6,) of a moving robot, read between two times of the cell's clock.

    ``device_s`` is when the controller took them, by its own clock; NaN where it has none.
    """

    joints_rad: Array
    before_s: float
    after_s: float
    device_s: float = math.nan


class Clock(Protocol):
    """The time of the cell; a simulated cell's may run faster. Deadlines on wires are real time."""

    def now_s(self) -> float:
        """Return the cell's time, which never runs back."""

    def wait(self, duration_s: float) -> None:
        """Let cell time pass; raise `Stopped` within 20 ms of a stop."""

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for; to be called in every wait on a wire."""

    def pc_s(self) -> float:
        """Return this PC's time, by which readings age and the PC is late; it never runs back.

        It is real time, except where a simulated cell waits for its PC: there it only counts, so
        that readings have an order and no age.
        """


class Rail(Protocol):
    """A slide on a rail with a drive and an absolute strip. ``stop`` may come from any thread.

    Motions and ``hold`` need the drive alone; readings raise `StripLost` without the strip.
    """

    def connect(self) -> list[Identity]:
        """Open the wire, verify identities, configure the self-stop; nothing moves."""

    def home(self) -> None:
        """Find the drive's reference."""

    def move_to(self, position_mm: float) -> None:
        """Move by the drive's encoder alone; return at standstill; leave the drive holding."""

    def settle(self) -> RailReading:
        """Return a reading at rest; raise `DeviceError` when the slide does not come to rest.

        Raises `StripLost` when it is at rest and the strip has no valid position.
        """

    def read(self) -> RailReading:
        """Return a reading asked for after this call began."""

    def hold(self) -> None:
        """Take the power to move away: drive disabled, brake closed."""

    def statistics(self) -> LinkStatistics:
        """Return the wire's counts, also after ``close``; any thread, without I/O."""

    def stop(self) -> None:
        """Quick stop, without waiting for an answer."""

    def close(self) -> None:
        """Leave the slide held and the wire closed."""


class Robot(Protocol):
    """A six-axis robot that moves to joint angles. ``stop`` may come from any thread."""

    def connect(self) -> list[Identity]:
        """Open the wire, verify identity, mode, tool and base; nothing moves."""

    def move_to(self, joints_rad: Array, speed_percent: float) -> RobotReading:
        """Move all axes in step (synchronous PTP); return the reading at rest, after the motion.

        ``speed_percent``, 1 to 100, is of the axes' full speeds, ``robot.joint.speed_deg_s`` of the
        cell file, at the full override: the axis that would take longest moves at this share of its
        own, the others keep step. A controller with whole percents takes the nearest.
        Raises `DeviceError` for any other value, before anything moves.
        """

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


class Stream(Protocol):
    """A tracker that follows its reflector and samples by its own clock."""

    rate_hz: float  # that the tracker really has

    def kickoff(self) -> None:
        """Start; returns when the tracker has acknowledged."""

    def collect(self) -> list[StreamBlock]:
        """Return arrived blocks, without waiting; raises `NoReading` when the beam broke."""

    def complete(self) -> list[StreamBlock]:
        """End the stream and return the rest of it."""


class Sweep(Protocol):
    """A robot that moves one axis at constant speed, with its joints read meanwhile."""

    speed_rad_s: float  # that the controller is set to
    ended: bool  # the controller has acknowledged the end of the motion

    def kickoff(self) -> None:
        """Start the motion."""

    def collect(self) -> JointSample:
        """Read the joints once; check the state and whether the motion has ended."""

    def complete(self) -> RobotReading:
        """Wait for the end of the motion; return the reading at rest."""


@runtime_checkable
class Streams(Protocol):
    """A tracker that streams: it follows a reflector that moves, so that `Tracker.measure` has to
    point at it only where it was measured elsewhere before.
    """

    def stream(
        self, near_mm: Array, reflector: str, rate_hz: float
    ) -> AbstractContextManager[Stream]:
        """Prepare a stream of the reflector that is now at ``near_mm`` (3,), tracker's frame."""


@runtime_checkable
class TwoFaces(Protocol):
    """A tracker that measures the same reflector in its second face, the back sight.

    Errors of its axes have the other sign there: collimation, transit tilt, index.
    """

    def measure_back(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        """Measure as `Tracker.measure` in the second face; leave the tracker in the first."""


@runtime_checkable
class Searches(Protocol):
    """A tracker that can search more widely than within the radius of its options.

    A `NoReading` of a search or a measurement that found no reflector there has ``searched_mm`` in
    its fields, the radius, and ``beam`` (3,) where the tracker tells: the direction in which it
    looked, a unit vector in its frame.
    """

    def search(
        self, near_mm: Array, reflector: str, samples: int, radius_mm: float
    ) -> TrackerReading:
        """Measure as `Tracker.measure`, in a search of ``radius_mm`` around ``near_mm`` (3,).

        Later measurements search within the radius of the options again.
        """


@runtime_checkable
class Aims(Searches, Protocol):
    """A tracker whose beam a person can put on a reflector, also one whose place nobody knows."""

    def release_beam(self) -> None:
        """Let go of the reflector, so that a person can put the beam on another one."""

    def measure_aimed(self, reflector: str, samples: int) -> TrackerReading:
        """Measure the reflector that the beam is on now, wherever it is; mean of ``samples``.

        Raises `NoReading` where the beam is on none.
        """


# -- commissioning ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Ability:
    """One thing that a driver needs of its device; ``note``: its value, or what replaces it."""

    device: str
    feature: str
    state: Literal["has", "read only", "has not"]
    needed: Literal["mandatory", "optional"]
    note: str = ""


@runtime_checkable
class Inspects(Protocol):
    """A driver, not connected, that lists the abilities of its device."""

    def inspect(self) -> list[Ability]:
        """Open the wire, read, close it; nothing is changed, powered or moved.

        A value may be written back as it was read, to a device without power, to show that it can.
        """


@dataclass(frozen=True, slots=True)
class Candidate:
    """A device that answers: a line for a person, options of its driver, its identities, and the
    names of the reflectors that a tracker knows, none where it does not tell them.
    """

    title: str
    options: dict[str, object]
    identities: list[Identity]
    reflectors: list[str] = field(default_factory=list)


@runtime_checkable
class Discovers(Protocol):
    """A driver's class that finds its devices."""

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the devices that answer, by listening and reading only.

        ``known`` are options that a person gave, such as a channel or a host.
        """


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """Settings as a controller reports them; None where it does not report one.

    ``joint_limits_rad`` (6, 2), lower and upper; ``tool`` (4, 4), {T} in the flange;
    ``axis_limits_mm`` of the external axis.
    """

    model: str | None
    serial: str | None
    joint_limits_rad: Array | None
    tool: Array | None
    axis_limits_mm: tuple[float, float] | None


@runtime_checkable
class StatesSettings(Protocol):
    """A robot whose controller states its settings."""

    def settings(self) -> RobotSettings:
        """Return the settings, read after this call began; nothing is written or moved.

        A robot that is not connected is opened for this and closed again: `Robot.connect` refuses a
        tool that is not the cell file's, so the cell file may be written first.
        """


@dataclass(frozen=True, slots=True)
class RailTrace:
    """A jog: times, positions of drive and strip, and the drive's own speed (N,), a row a poll.

    ``stopped_by``: "bound" or "stop" for a quick stop, "lost" for a link that was lost before the
    end, "" where the drive ended the motion.
    """

    taken_s: Array
    drive_mm: Array
    strip_mm: Array
    velocity_mm_s: Array
    stopped_by: Literal["", "bound", "stop", "lost"]


@runtime_checkable
class Jogs(Protocol):
    """A connected rail that moves a little while scale, sign and units are not proved."""

    def jog(
        self,
        distance_mm: float,
        *,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> RailTrace:
        """Move by ``distance_mm`` as the drive counts; return at rest, with the slide held.

        Drive or strip further than ``bound_mm`` from the start cause a quick stop, as do
        ``stop_after_mm`` on purpose. The bound replaces the guards that compare drive and strip.
        """

    def rescaled(self, drive: float, strip: float, speed: float) -> dict[str, object]:
        """Return the driver's options with which positions of drive and strip, and the drive's
        speeds, are multiplied by these factors; negative ones change the sign.
        """


class AfterLoss(NamedTuple):
    """How a device stands that answers again after its link was lost; ``text``: its own state."""

    stopped: bool  # at rest, without power
    text: str


@runtime_checkable
class StopsItself(Protocol):
    """A connected rail that must stop by itself where the link to the PC is lost."""

    own_stop_s: float  # of its class: the longest time from the PC's last sign until it brakes

    def jog_until_lost(
        self, distance_mm: float, *, bound_mm: float, speed_mm_s: float
    ) -> RailTrace:
        """Jog as `Jogs.jog`. Where the link is lost meanwhile, send no stop and fall silent; the
        trace then ends with the last poll. The slide counts as not held until `regain`.
        """

    def regain(self) -> AfterLoss:
        """Read how the device stands, before anything is written to it, then connect as usual.

        Raises `DeviceError` while it does not answer, or had no time to stop.
        """


@dataclass(frozen=True, slots=True)
class ControllerFile:
    """A file for a device's controller: its name, the folder it is copied to, and its contents."""

    name: str
    folder: str  # on the controller; "" for a file that only documents
    contents: bytes


@dataclass(frozen=True, slots=True)
class ControllerSide:
    """All that a driver needs on its device's controller, and the steps of the person there."""

    title: str
    version: str
    files: Sequence[ControllerFile]
    steps: Sequence[str]  # one paragraph each, in Markdown
    lacks: Sequence[str] = ()  # values that a person must fill into the files, for want of options


@runtime_checkable
class NeedsFiles(Protocol):
    """A driver's class whose device needs programs or settings of its own."""

    @classmethod
    def controller_side(cls, options: Mapping[str, object]) -> ControllerSide:
        """Return files and steps for these options; those that are missing have their defaults."""


@runtime_checkable
class StatesAccuracy(Protocol):
    """Options of a tracker's driver that state the accuracy class of the instrument."""

    def accuracy(self, range_m: float) -> tuple[float, float]:
        """Return 1 sigma of one reading: along the beam, mm, and of the angles across it, rad."""


@runtime_checkable
class Sweeps(Protocol):
    """A robot that moves one axis slowly."""

    def sweep(self, axis: int, end_rad: float, speed_rad_s: float) -> AbstractContextManager[Sweep]:
        """Prepare a motion of ``axis`` (0 to 5) alone, from where the robot is.

        Its speed is the next one that the controller has, not above ``speed_rad_s``.
        """


@runtime_checkable
class ExternalAxis(Protocol):
    """A robot whose controller moves the slide, too, over the robot's one connection.

    The arm's own motions carry the slide's held value: the slide is at rest meanwhile. ``connect``,
    ``stop`` and ``close`` of the robot are those of the slide.
    """

    def verify_axis(self) -> Identity:
        """Verify that the axis is ready to move; raises `DeviceError`. Nothing moves."""

    def read_axis(self) -> AxisReading:
        """Return a reading asked for after this call began."""

    def move_axis(
        self,
        position_mm: float,
        speed_mm_s: float,
        full_mm_s: float,
        attend: Callable[[float], object],
    ) -> None:
        """Move the slide alone; return when it is at rest there; it may move again.

        ``full_mm_s`` is the axis' speed at 100 %; raises `DeviceError` where it runs faster.
        ``attend`` takes the slide's position, mm, at each poll; its errors end the motion.
        """

    def hold_axis(self) -> None:
        """Have the controller refuse every motion of the slide until the next `move_axis`."""

    def brake_axis(self, attend: Callable[[float], object]) -> None:
        """Brake a motion of the slide that ``attend`` has ended; return when it is at rest, held.

        The session goes on: the next `move_axis` moves it again. ``attend`` as in `move_axis`.
        """

    def stop(self) -> None:
        """Brake arm and slide; any thread."""


@runtime_checkable
class RobotDrivenRail(Protocol):
    """A rail whose drive is its robot's external axis; the robot is opened before it."""

    def attach_robot(self, robot: ExternalAxis) -> None:
        """Take the robot, once, before ``connect``."""


class SimulatedCell(Protocol):
    """A simulated cell that runs in a process of its own; its class is a simulator."""

    options: dict[str, dict[str, object]]  # where each device listens: overrides of its options
    address: str  # of the control channel, HOST:PORT

    @classmethod
    def check(cls, cell: Cell) -> None:
        """Refuse a cell that cannot be simulated; raises `SettingsError`. Nothing is started."""

    def clock(self, stop: Event) -> Clock:
        """Return the cell's clock; its waits end when ``stop`` is set."""

    def close(self) -> None:
        """Let go of the cell; end its process, if it was started here."""


@runtime_checkable
class HasPerson(Protocol):
    """A simulated cell with a person in it, who does what a real person is asked to do."""

    def pull_cable(self, device: str) -> None:
        """Let the person pull the cable of ``rail`` while it moves next, and plug it in again."""

    def carry_reflector(self, near_mm: Sequence[float]) -> None:
        """Let the person seat the only reflector of a cell in the nest nearest to (3,), tracker's
        frame, on the floor, the slide or the flange.
        """


@runtime_checkable
class RepeatsRun(Protocol):
    """A simulated cell that repeats one recorded run; its class takes ``session``, from 1 on."""

    @classmethod
    def check_run(cls, cell: Cell, procedure: str, seed: int) -> None:
        """Refuse another procedure, seed or cell than was recorded; raises `SettingsError`."""


class RecordingEnded(HilcellError):
    """A run has come to the end of the recording that it repeats: no device was reached."""

    code = "HC-C26"


class InProcessCell(Protocol):
    """A simulated cell without wires, built of a cell and the seeds of machine and run.

    Time is event time. A run uses devices and clock alone; `true_places` is for those who judge it
    afterwards.
    """

    rail: Rail
    robot: Robot
    tracker: Tracker
    clock: Clock

    def true_places(self, taken_s: Sequence[float]) -> tuple[Array, Array]:
        """Return the places (N, 3), mm, of the reflectors at readings taken at times (N,), and
        those of the cell file's floor nests, where they really are, in one frame.
        """


@dataclass(frozen=True, slots=True)
class Exercise:
    """A fault for training: its title, and the code of the alarm that a run raises."""

    title: str
    alarm: str


@runtime_checkable
class HasSheet(Protocol):
    """A simulated cell of which only a sheet is known, as of a hall that nobody has measured."""

    @property
    def sheet(self) -> Mapping[str, str]:
        """Return the sheet as files by name; the first is text for a person."""


@runtime_checkable
class SetsTraps(Protocol):
    """Of the class of a simulated cell that takes ``trap``, a name or ""."""

    @property
    def traps(self) -> Mapping[str, str]:
        """Return what each trap makes wrong in the truth, one line, by name."""


@runtime_checkable
class Training(Protocol):
    """A simulated cell in which faults strike when they are asked for."""

    @property
    def exercises(self) -> Sequence[Exercise]:
        """Return the faults to choose from."""

    def strike(self, exercise: Exercise) -> None:
        """Let a fault strike at its next occasion."""

    def heal(self) -> None:
        """Put right what struck, as a person at the cell would."""
