"""Events of a run: a union with the tag ``what``. An event without a type, as of a plug-in, is an
`OtherEvent`.
"""

from __future__ import annotations

import hashlib
from math import nan, sqrt
from typing import ClassVar, TypeAlias

import msgspec
from msgspec import field, json

from hilcell.decoding import Json
from hilcell.identity import Identity
from hilcell.language import marked

Three: TypeAlias = tuple[float, float, float]
Pair: TypeAlias = tuple[float, float]

NOT_KNOWN = marked("devices were not all connected, and how they stand is not known")
SUBJECTS = ("key", "station", "run")  # fields that say what an event is about
URAD = 1e6


class Event(msgspec.Struct, frozen=True, kw_only=True, tag_field="what"):
    """An event; ``title`` is its name where the tag is not readable; ``says`` a format of its
    fields.
    """

    title: ClassVar[str] = ""
    says: ClassVar[str] = ""

    @property
    def what(self) -> str:
        return str(type(self).__struct_config__.tag)

    @property
    def subject(self) -> str:
        """Its point (by key), station or run; "" for none."""
        return next(
            (getattr(self, name) for name in SUBJECTS if name in self.__struct_fields__), ""
        )

    @property
    def why(self) -> str:
        return str(getattr(self, "reason", ""))

    @property
    def text(self) -> str:
        return self._text()

    def _text(self) -> str:
        if self.says:
            return self.says.format(self)
        words = " ".join(filter(None, (self.title or self.what, self.subject)))
        return words + after(self.why)


class OtherEvent(msgspec.Struct, frozen=True):
    """An event of a plug-in: its tag, and its fields as they are."""

    what: str
    fields: Json

    @property
    def text(self) -> str:
        subject = next((self.fields[name] for name in SUBJECTS if name in self.fields), "")
        words = " ".join(filter(None, (self.what, str(subject))))
        return words + after(str(self.fields.get("reason") or ""))


def after(reason: str) -> str:
    """A reason, formatted to follow a sentence."""
    return f": {reason}" if reason else ""


class OfPoint(Event, frozen=True, kw_only=True):
    """An event about one point."""

    key: str


class Reasoned(Event, frozen=True, kw_only=True):
    """An event with a reason."""

    reason: str


# -- devices ---------------------------------------------------------------------------------------


class Connected(Event, frozen=True, kw_only=True, tag="connected"):
    """All devices answered; ``hilcell`` is the version that connected them."""

    title: ClassVar[str] = "devices connected"
    devices: list[Identity]
    hilcell: str = ""


class DeviceLost(Reasoned, frozen=True, kw_only=True, tag="device lost"):
    """A device stopped answering while the run waits."""

    device: str
    error: Json


class DeviceBack(Event, frozen=True, kw_only=True, tag="device back"):
    """A lost device answers again."""

    says: ClassVar[str] = "device back: {0.device} answers again"
    device: str


class Closing(Event, frozen=True, kw_only=True, omit_defaults=True):
    """All devices were stopped, or closed: ``problems`` and the errors' facts by device."""

    problems: dict[str, str]
    errors: dict[str, Json] = field(default_factory=dict)

    def _text(self) -> str:
        left = f", but check {' and '.join(self.problems)}" if self.problems else ""
        return self.title + left


class SafeStopSent(Closing, frozen=True, kw_only=True, omit_defaults=True, tag="safe stop"):
    """A stop was sent to all devices; ``cause`` is the fault that it follows."""

    title: ClassVar[str] = "a stop was sent to all devices"
    cause: str = ""


class Closed(Closing, frozen=True, kw_only=True, omit_defaults=True, tag="closed"):
    """All devices were closed, in ``took_s``."""

    title: ClassVar[str] = "devices closed"
    took_s: float = nan

    def _text(self) -> str:
        moves = not {"Rail", "Robot"}.isdisjoint(self.problems)
        return super()._text() + (": not seen at rest" if moves else "")


class LinkCounted(Event, frozen=True, kw_only=True, tag="link"):
    """Counts and losses of the rail's wire in one session, or in several together."""

    LOSSY: ClassVar[float] = 0.005  # share of the frames
    BY_SDO: ClassVar[str] = "the drive sent no PDO at the end, SDO confirmed that the slide is held"
    frames: int
    bad_lines: int
    refused: int
    malformed: int
    held_by_sdo: int = 0

    def followed_by(self, later: LinkCounted) -> LinkCounted:
        """Combined counts; the later ones state how the slide was held."""
        counts = ("frames", "bad_lines", "refused", "malformed")
        sums = {name: getattr(self, name) + getattr(later, name) for name in counts}
        return msgspec.structs.replace(later, **sums)

    @property
    def lost(self) -> int:
        return self.bad_lines + self.refused + self.malformed

    @property
    def lost_share(self) -> float:
        return self.lost / max(1, self.frames + self.lost)

    @property
    def warning(self) -> str:
        if self.lost_share < self.LOSSY:
            return ""
        return (
            f"the rail's CAN link loses {100 * self.lost_share:.2f} %, a healthy one less than "
            f"{100 * self.LOSSY:.1f} %: check its plugs, the shield, the two terminators and the "
            "gateway's cable"
        )

    @property
    def counts(self) -> str:
        return (
            f"{self.frames} frames, {self.bad_lines} bad lines, {self.refused} refused, "
            f"{self.malformed} malformed ({100 * self.lost_share:.2f} % lost)"
            f"{f'; {self.BY_SDO}' if self.held_by_sdo else ''}"
        )

    def _text(self) -> str:
        found = [f"{self.lost} of {self.frames} frames lost"] if self.lost else []
        found += [self.BY_SDO] if self.held_by_sdo else []
        return f"rail's wire: {'; '.join(found)}" if found else ""


class FactoryLinks(Event, frozen=True, kw_only=True, tag="factory links"):
    """The controller computes with links measured on this arm in its factory."""

    off_mm: float


# -- the timeline of a run -------------------------------------------------------------------------


class StepBegun(Event, frozen=True, kw_only=True, tag="step"):
    """A step of the procedure begins: number ``number`` of ``of``."""

    says: ClassVar[str] = "step {0.number} of {0.of} begins: {0.name}"
    name: str
    number: int = 0
    of: int = 0


class SessionOrdered(Event, frozen=True, kw_only=True, tag="order"):
    """A session continues: its place in its folder of runs, as in `FolderOrder`."""

    says: ClassVar[str] = "goes on as session {0.number}"
    number: int
    folder: str = ""
    after: str = ""


class Announced(Event, frozen=True, kw_only=True, tag="announced"):
    """A motion that an operator has to confirm."""

    says: ClassVar[str] = "announced: {0.motion}"
    motion: str


class ScreenLost(Event, frozen=True, tag="screen lost"):
    """No screen is connected any more."""


class ScreenBack(Event, frozen=True, tag="screen back"):
    """A screen is connected again."""


class AnswerRefused(Reasoned, frozen=True, kw_only=True, tag="answer refused"):
    """The answer to a prompt was refused."""


class CommandRefused(Event, frozen=True, kw_only=True, tag="command refused"):
    """A command that is not possible in a state of the run."""

    command: str
    state: str = field(name="in")

    @property
    def why(self) -> str:
        return f"{self.command} is not possible while {self.state}"


class AlarmsAcknowledged(Event, frozen=True, kw_only=True, tag="acknowledged"):
    """An operator acknowledged these alarm codes, raised up to record ``until``. An alarm may have
    no record (0).
    """

    title: ClassVar[str] = "alarms acknowledged:"
    codes: list[str]
    until: int

    @property
    def subject(self) -> str:
        return ", ".join(self.codes)

    def refusal(self, newest: int) -> str:
        """Why a run whose newest record is ``newest`` refuses it; "" where it does not."""
        if not self.codes:
            return "acknowledge: expected codes of alarms, got none"
        if not 1 <= self.until <= newest:
            return f"acknowledge: until: expected a record from 1 to {newest}, got {self.until}"
        return ""


class ChangesAccepted(Event, frozen=True, kw_only=True, tag="changes accepted"):
    """An operator, or an option, has accepted changes of devices or cell file."""

    changes: list[str]
    by: str

    def _text(self) -> str:
        return f"{self.what} by {self.by}: {'; '.join(self.changes)}"


class NotificationFailed(Reasoned, frozen=True, kw_only=True, tag="notification failed"):
    """The command of the cell file's [notify] failed at an event of the run."""

    event: str

    def _text(self) -> str:
        return f"notification of {self.event} failed{after(self.reason)}"


class InternalError(Event, frozen=True, kw_only=True, tag="internal error"):
    """A defect of hilcell or of a driver, with its traceback."""

    trace: str


class EarlierRunUnreadable(Reasoned, frozen=True, kw_only=True, tag="earlier run unreadable"):
    """The poses that an earlier run drove are not known."""

    run: str


# -- stations, tracker and ambient temperature -----------------------------------------------------


class ReadingTime(msgspec.Struct, frozen=True, omit_defaults=True):
    """Time of a reading, in s of the PC's monotonic clock, and its age when used. ``ended_s``: the
    end of the preceding motion by the readings. Comparable within one session only.
    """

    taken_s: float
    age_s: float
    ended_s: float | None = None


class StationHeld(Event, frozen=True, kw_only=True, tag="station held"):
    """The slide is held at a station; ``began``: the reading by which it moved there."""

    station: str
    tries: int = 1
    strip_mm: float = nan
    rail_mm: float = nan
    began: ReadingTime | None = None

    def _text(self) -> str:
        which = {1: "1st", 2: "2nd", 3: "3rd"}.get(self.tries, f"{self.tries}th")
        at = f"{self.strip_mm:.2f} mm by the strip, {which} approach"
        return f"rail held at {self.station}: {at}"


class StationAlreadyHeld(Event, frozen=True, kw_only=True, tag="station found held"):
    """The slide of a resumed run is at the station already; in a cell without rail always."""

    title: ClassVar[str] = "rail found held at"
    station: str


class SlideVerified(OfPoint, frozen=True, kw_only=True, tag="slide proven"):
    """A nest on the slide was measured at its place, off by ``off_mm``."""

    says: ClassVar[str] = "slide checked by a nest: off {0.off_mm:.3f} mm"
    off_mm: float
    limit_mm: float


class TrackerVerified(Event, frozen=True, kw_only=True, tag="tracker proven"):
    """The floor nests were measured at their places, each off by ``off_mm``."""

    off_mm: list[float] = field(default_factory=list)

    def _text(self) -> str:
        moved_mm = max(map(abs, self.off_mm), default=0.0)
        return f"floor nests checked: tracker moved {moved_mm:.3f} mm"


class Invalidating(Event, frozen=True, kw_only=True):
    """An event that makes points and streams invalid, by their keys."""

    invalid: list[str]


class TrackerMoved(Invalidating, frozen=True, kw_only=True, tag="tracker moved"):
    """The tracker has moved: set-up number ``set_up`` begins."""

    set_up: int
    moved_mm: float = nan
    limit_mm: float = nan

    def _text(self) -> str:
        lost = len(self.invalid)
        again = f"{lost} point{'s are' if lost != 1 else ' is'} measured again"
        return f"tracker moved by {self.moved_mm:.3f} mm: {again}"


class WorldRemeasured(Invalidating, frozen=True, kw_only=True, tag="world frame begun again"):
    """Another engine measures all floor nests: the one before had measured some of them."""


class AmbientInLimits(Event, frozen=True, tag="room back"):
    """The ambient temperature is within its limits again."""


class StripBack(Event, frozen=True, tag="strip back"):
    """The magnetic strip is readable again."""


# -- points ----------------------------------------------------------------------------------------


class FirstPassBegun(OfPoint, frozen=True, kw_only=True, tag="first pass"):
    """The robot goes slowly to a pose that it has never visited in this cell."""

    title: ClassVar[str] = "first pass of"
    speed_percent: float


class NoReadingOf(OfPoint, frozen=True, kw_only=True, tag="no reading"):
    """A measurement failed, and may be tried again."""

    title: ClassVar[str] = "no reading of"
    tries: int = 1
    reason: str = ""
    error: Json = field(default_factory=dict)


class RemeasureRequested(OfPoint, frozen=True, kw_only=True, tag="retake asked"):
    """An operator, or the ambient temperature, requires that a point is re-measured."""

    title: ClassVar[str] = "re-measurement asked of"


class RemeasureRefused(OfPoint, frozen=True, kw_only=True, tag="retake refused"):
    """The point can no longer be re-measured."""

    title: ClassVar[str] = "not re-measured:"
    reason: str


class OutlierRemeasured(OfPoint, frozen=True, kw_only=True, tag="outlier measured again"):
    """A point is an outlier among its neighbours."""

    title: ClassVar[str] = "outlier, re-measured:"


class VisitedOnceMore(OfPoint, frozen=True, kw_only=True, tag="visited once more"):
    """A pose that differs from its first visit is visited once more."""

    title: ClassVar[str] = "visited once more:"


class ReflectorPlaced(Event, frozen=True, kw_only=True, tag="seated"):
    """A placed reflector: its position in the tracker's frame, and the strip's reading."""

    says: ClassVar[str] = "reflector placed in {0.place}"
    place: str
    xyz_mm: Three
    strip_mm: float = nan


class PlaceTaken(Event, frozen=True, kw_only=True, tag="place taken"):
    """An operator has taken the place of a nest, tracker's frame, in place of the cell file's.

    ``how``: "here", where the tracker pointed, or "wider", by a wider search; ``set_up`` is the
    tracker's, ``off_mm`` the distance from the expected place.
    """

    says: ClassVar[str] = "place of {0.place} taken, {0.off_mm:.1f} mm from the expected one"
    place: str
    how: str
    xyz_mm: Three
    expected_mm: Three
    off_mm: float
    set_up: int = 0


class StreamRecorded(OfPoint, frozen=True, kw_only=True, tag="stream"):
    """A stream of readings during a sweep; ``file`` is in the run's folder of streams.

    The fields below ``form`` describe the sweep of the axis (1 to 6).
    """

    title: ClassVar[str] = "recorded"
    file: str
    sha256: str
    samples: int
    joint_samples: int
    first_device_s: float
    last_device_s: float
    longest_gap_s: float  # between two samples
    set_up: int = 0  # of the tracker
    form: int
    axis: int = 0
    speed_deg_s: float = 0.0
    rate_hz: float = 0.0
    start_deg: list[float] = field(default_factory=list)
    end_deg: list[float] = field(default_factory=list)
    reflector: str = ""
    session: int = 0


class CurveMeasured(Event, frozen=True, kw_only=True, tag="curve"):
    """Transmission error of one axis, 1 to 6.

    ``reason`` is empty where there is a curve. ``amplitude_rad``: cosine and sine of each line of
    ``cycles`` per revolution; the same of the waves of a smooth error, of rms ``smooth_rad`` less a
    straight line; ``covariance_rad2`` of both in this order. ``shown`` is for plots: joint in deg,
    error as measured and by the curve in urad; ``spectrum`` in cycles and urad.
    """

    says: ClassVar[str] = "curve of {0.summary}"
    axis: int
    reason: str
    cycles: list[float]
    amplitude_rad: list[Pair]
    covariance_rad2: list[list[float]]
    shift_rad: float
    shift_sigma_rad: float
    low_rad: float
    high_rad: float
    noise_rad: float
    lag_s: float
    lag_sigma_s: float
    signal_rad: float
    share: float
    differ_rad: float
    lost: int
    shown: list[Three]
    spectrum: list[Pair]
    smooth_cycles: list[float] = field(default_factory=list)
    smooth_amplitude_rad: list[Pair] = field(default_factory=list)
    smooth_rad: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether there is a curve; one without lines means a gear without error."""
        return not self.reason

    @property
    def amplitudes_urad(self) -> list[float]:
        """Amplitude of each line (K,)."""
        return [URAD * sqrt(cosine**2 + sine**2) for cosine, sine in self.amplitude_rad]

    @property
    def summary(self) -> str:
        if not self.holds:
            return f"A{self.axis} not used: {self.reason}"
        sizes = sorted(zip(self.amplitudes_urad, self.cycles, strict=True), reverse=True)
        lines = ", ".join(f"{size:.1f} urad at {cycles:.1f}" for size, cycles in sizes)
        smooth = (
            f", smooth error of {URAD * self.smooth_rad:.1f} urad" if self.smooth_cycles else ""
        )
        return f"A{self.axis}: {lines or 'no line'}{smooth}; lag {self.lag_s * 1e3:.1f} ms"


class AxesNotSwept(Reasoned, frozen=True, kw_only=True, tag="axes not swept"):
    """The procedure's sweeps were left out."""


class PosesChosen(Event, frozen=True, kw_only=True, tag="poses chosen"):
    """The most informative joints (N, 6), and the predicted bound before and after each."""

    joints_deg: list[list[float]]
    bounds_mm: list[float]


class NoPosesChosen(Reasoned, frozen=True, kw_only=True, tag="no poses chosen"):
    """No choice was possible; the run continues without."""

    error: Json


# -- targets and calibrations ----------------------------------------------------------------------


class StationDecided(Event, frozen=True, kw_only=True, tag="station decided"):
    """A station's validation has enough targets; the expanded uncertainties of mean and maximum."""

    title: ClassVar[str] = "enough targets at"
    station: str
    mean_U_mm: float
    max_U_mm: float


class TargetsListed(Event, frozen=True, kw_only=True, tag="targets listed"):
    """The content of a file of targets: names and x, y, z (mm), A, B, C (deg) in {W}."""

    file: str
    names: list[str]
    values: list[list[float]]


class CalibrationUsed(Event, frozen=True, kw_only=True, tag="calibration used"):
    """The calibration that a run uses: of which run, from which file, and its content."""

    run: str = ""
    file: str = ""
    content: Json = field(default_factory=dict)


class ArmCarried(Event, frozen=True, kw_only=True, tag="arm carried"):
    """The calibration whose arm a re-calibration follows: of which run, which file, its content."""

    title: ClassVar[str] = "the arm is carried from"
    run: str = ""
    file: str = ""
    content: Json = field(default_factory=dict)

    @property
    def summary(self) -> Json:
        """The content as it is printed, which is 200 kB: its digest and its sizes."""
        whole = json.encode(self.content, order="sorted")
        model, made = self.content["model"]["parameters"], self.content["provenance"]
        return {
            "sha256": hashlib.sha256(whole).hexdigest(),
            "written": made["written"],
            "points": len(made["points"]),
            "stations": [*self.content["stations"]],
            "parameters": len(model["covariance"]),
        }


class CalibrationRevoked(Reasoned, frozen=True, kw_only=True, tag="calibration revoked"):
    """An operator has revoked the run's own calibration."""

    operator: str = ""


class SlideJogged(OfPoint, frozen=True, kw_only=True, tag="slide jogged"):
    """A jog of the slide, one entry a poll: times, positions of drive and strip, the drive's own
    speed; see `hilcell.ports.RailTrace`.
    """

    says: ClassVar[str] = (
        "slide jogged {0.distance_mm:+g} mm: drive {0.driven_mm:+.3f} mm, "
        "strip {0.moved_mm:+.3f} mm"
    )
    distance_mm: float
    bound_mm: float
    speed_mm_s: float
    stopped_by: str
    taken_s: list[float]
    drive_mm: list[float]
    strip_mm: list[float]
    velocity_mm_s: list[float]

    @property
    def driven_mm(self) -> float:
        return self.drive_mm[-1] - self.drive_mm[0]

    @property
    def moved_mm(self) -> float:
        return self.strip_mm[-1] - self.strip_mm[0]


class PlaceSeen(OfPoint, frozen=True, kw_only=True, tag="place seen"):
    """A reflector whose place was not known: (3,) in the tracker's frame, with the robot's joints
    and the strip's reading.
    """

    says: ClassVar[str] = "{0.key} seen by the tracker"
    xyz_mm: Three
    std_mm: Three
    samples: int
    joints_deg: list[float]
    strip_mm: float


class ControllerRead(Event, frozen=True, kw_only=True, omit_defaults=True, tag="controller read"):
    """The controller's own settings; see `hilcell.ports.RobotSettings`."""

    title: ClassVar[str] = "settings of the controller read"
    joints_deg: list[float]
    model: str = ""
    serial: str = ""
    joint_limits_deg: list[Pair] = field(default_factory=list)
    tool_mm: Three | None = None


class PromiseJudged(Event, frozen=True, kw_only=True, tag="promise"):
    """Whether a driver has kept a promise of its port."""

    says: ClassVar[str] = "promise {0.port} {0.promise} {0.verdict}"
    port: str
    promise: str
    verdict: str
    why: str
    took_s: float = nan
