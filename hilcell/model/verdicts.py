"""Verdicts of a run: figures, limits and texts.

The fields are the body of its record and of every JSON. Screen, report, alarms and `hilcell run`
use ``figures``, ``words`` and ``why`` of any verdict; one without a type, as of a plug-in, is an
`OtherVerdict`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import ClassVar, Literal, NamedTuple, Self

import msgspec
from msgspec import field

from hilcell.decoding import Json, typed
from hilcell.language import marked, tr
from hilcell.model.outcome import Figure, Outcome
from hilcell.model.point import PointId

# -- suspected causes of unexplained errors -------------------------------------------------------


class Cause(StrEnum):
    """A cause as text."""

    TRACKER_MOVED = "tracker moved"
    MOUNT_SLIPPED = "mount slipped"
    ZERO_LOST = "zero lost"
    MOUNT_OFFSET = "mount offset"
    SCALE = "scale"
    REVERSAL = "reversal"
    TEMPERATURE = "temperature"
    STRIP = "strip"
    NEST_MOVED = "nest moved"
    CHANGED_SINCE = "changed since"
    REPEATABILITY = "repeatability"
    DRIFT = "drift"
    INSTRUMENT = "instrument"
    REFLECTOR = "reflector"
    BASE_MISPLACED = "base misplaced"
    UNKNOWN = "unknown"

    @property
    def advice(self) -> str:
        """Advice on a calibration whose run suspects this cause."""
        if self is Cause.CHANGED_SINCE:
            return "`hilcell revoke` the wrong one of both calibrations."
        return "Do not use this calibration."


class Suspicion(msgspec.Struct, frozen=True):
    """A matching cause, its size, and the comparison that detected it."""

    cause: Cause
    size: float
    unit: str
    noticed_by: str

    @property
    def facts(self) -> Json:
        found: Json = msgspec.to_builtins(self)
        return found

    @property
    def label(self) -> str:
        return f"{self.cause} ({self.size:.4g} {self.unit})"

    @property
    def text(self) -> str:
        return f"{self.label}, noticed by {self.noticed_by}"


def blamed(facts: Json) -> Json:
    """Result of a run that ended with an error; with the cause, where its fields form a
    `Suspicion`.
    """
    try:
        found = typed(facts.get("fields", {}), Suspicion)
    except msgspec.ValidationError:  # it names no cause, or a size that is no number
        return {}
    return {"suspicions": [found.facts]}


def suspected_in(result: Mapping[str, object]) -> list[Suspicion]:
    return typed(result.get("suspicions", []), list[Suspicion])


# -- verdicts -------------------------------------------------------------------------------------


VALIDATION = "validation."  # the key of a verdict on one place is this and the place
OTHERS = "others"  # the place of all stations but the grid's, judged together
RISK = 0.001  # that poses which have not changed are judged to have
UNITS = {
    "mm": " mm", "s": " s", "c": " °C", "k": " K", "deg": "°", "urad": " µrad", "percent": " %",
}  # fmt: skip


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """A judgement; one that fails makes the run's exit code 1.

    ``keys``: of its records, or their prefix where one ends with a dot or a blank. ``title``: its
    subject where the key is not readable.
    """

    keys: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""
    holds: bool

    @property
    def figures(self) -> Sequence[Figure]:
        return ()

    @property
    def suspects(self) -> Sequence[str]:
        return getattr(self, "suspected", ())

    @property
    def outcome(self) -> Outcome:
        return Outcome.ACCEPTED if self.holds else Outcome.REJECTED

    @property
    def figures_text(self) -> str:
        return "; ".join(each.text for each in self.figures)

    @property
    def text(self) -> str:
        return self._text()

    def _text(self) -> str:
        return self.figures_text

    @property
    def why(self) -> str:
        """The causes, else the ``wrong``, else the figures beyond their limit, else all figures."""
        failed = [each.why for each in self.figures if each.outcome is self.outcome]
        wrong: Sequence[str] = getattr(self, "wrong", ())
        return "; ".join(self.suspects or wrong or ([] if self.holds else failed)) or self.text


class OtherVerdict(Verdict, frozen=True, kw_only=True):
    """A verdict of a plug-in, with its facts as they are."""

    facts: Json

    @property
    def suspects(self) -> Sequence[str]:
        return [str(each) for each in self.facts.get("suspected", ())]

    def _text(self) -> str:
        return ", ".join(
            _plain(name, value)
            for name, value in self.facts.items()
            if not isinstance(value, (dict, list, type(None)))
        )


def _plain(name: str, value: object) -> str:
    words, _, last = name.rpartition("_")
    unit = UNITS.get(last, "") if words else ""
    match value:
        case bool():
            text = "yes" if value else "no"
        case float():
            text = f"{value:.4f}"
        case _:
            text = str(value)
    return f"{(words if unit else name).replace('_', ' ')} {text}{unit}"


# -- the robot against stated limits ---------------------------------------------------------------


class Limits(NamedTuple):
    """Limits of mean and largest 3D error (mm) and largest orientation error (deg, None: not
    judged).
    """

    mean_mm: float
    max_mm: float
    max_deg: float | None = None


class OrientationError(NamedTuple):
    """The largest orientation error and its expanded uncertainty, deg."""

    max_deg: float
    U_deg: float


class Judged(Verdict, frozen=True, kw_only=True, omit_defaults=True):
    """Mean and largest error of targets, as in journals and calibration files.

    Orientation has figures where it was judged; NaN is null in JSON and None here. ``decision``: of
    the rule, or of another test that had to accept as well.
    """

    keys: ClassVar[tuple[str, ...]] = (VALIDATION, "targets")
    mean_mm: float
    mean_tolerance_mm: float
    max_mm: float
    max_tolerance_mm: float
    mean_U_mm: float
    max_U_mm: float
    decided: Outcome = field(name="outcome")
    decision: str
    max_deg: float | None = None
    max_tolerance_deg: float | None = None
    max_U_deg: float | None = None

    @property
    def figures(self) -> Sequence[Figure]:
        """Mean and largest error, and the orientation error where it was judged."""
        both = (
            Figure("mean", self.mean_mm, "mm", self.mean_tolerance_mm, self.mean_U_mm),
            Figure("largest error", self.max_mm, "mm", self.max_tolerance_mm, self.max_U_mm),
        )
        if self.max_tolerance_deg is None:
            return both
        name, limit = "largest error of orientation", self.max_tolerance_deg
        return (*both, Figure(name, self.max_deg, "deg", limit, self.max_U_deg))

    @property
    def outcome(self) -> Outcome:
        return self.decided

    def _text(self) -> str:
        return f"{self.figures_text}: {self.decision}"

    @property
    def why(self) -> str:
        failed = [each.why for each in self.figures if each.outcome is self.outcome]
        return ("" if self.holds else "; ".join(failed)) or self.decision

    @property
    def limits(self) -> Limits:
        return Limits(self.mean_tolerance_mm, self.max_tolerance_mm, self.max_tolerance_deg)

    @property
    def orientation(self) -> OrientationError | None:
        """The judged orientation error, None where not judged; an unknown figure is NaN."""
        if self.max_tolerance_deg is None:
            return None
        both = (self.max_deg, self.max_U_deg)
        return OrientationError(*(math.nan if each is None else each for each in both))


class Characteristic(NamedTuple):
    """A characteristic of ISO 9283; ``key`` and ``unit`` are in the names of its figures."""

    key: str
    symbol: str
    title: str
    unit: str
    clause: str

    @property
    def limit(self) -> str:
        return f"{self.key}_limit_{self.unit}"


AP = Characteristic("ap", "AP_p", "pose accuracy", "mm", "7.2.1")
RP = Characteristic("rp", "RP_l", "pose repeatability", "mm", "7.2.2")
AD = Characteristic("ad", "|AD|", "distance accuracy", "mm", "7.3.2")
RD = Characteristic("rd", "RD", "distance repeatability, ±", "mm", "7.3.3")
AP_ANGLES = Characteristic("ap", "AP_abc", "orientation accuracy", "deg", "7.2.1")
RP_ANGLES = Characteristic("rp", "RP_abc", "orientation repeatability, ±", "deg", "7.2.2")
CHARACTERISTICS = (AP, RP, AD, RD, AP_ANGLES, RP_ANGLES)
ISO = "iso9283"  # kind of the points, key of result and verdict


class PoseTested(Verdict, frozen=True, kw_only=True, omit_defaults=True):
    """Characteristics of ISO 9283 with a limit, each at its worst, and U (k = 2). None, not
    measured, fails its limit.
    """

    keys: ClassVar[tuple[str, ...]] = (ISO,)
    title: ClassVar[str] = marked("ISO 9283 test")
    ap_mm: float | None = None
    ap_u95_mm: float | None = None
    ap_limit_mm: float | None = None
    rp_mm: float | None = None
    rp_u95_mm: float | None = None
    rp_limit_mm: float | None = None
    ad_mm: float | None = None
    ad_u95_mm: float | None = None
    ad_limit_mm: float | None = None
    rd_mm: float | None = None
    rd_u95_mm: float | None = None
    rd_limit_mm: float | None = None
    ap_deg: float | None = None
    ap_u95_deg: float | None = None
    ap_limit_deg: float | None = None
    rp_deg: float | None = None
    rp_u95_deg: float | None = None
    rp_limit_deg: float | None = None

    @property
    def figures(self) -> Sequence[Figure]:
        found = []
        for of in CHARACTERISTICS:
            names = (f"{of.key}_{of.unit}", of.limit, f"{of.key}_u95_{of.unit}")
            value, limit, U = (getattr(self, name) for name in names)
            if limit is not None:
                found.append(Figure(of.key.upper(), value, of.unit, limit, U, ".3f"))
        return found


class Oriented(Verdict, frozen=True, kw_only=True):
    """Whether a corrected orientation is better than before, and the reflectors did not move."""

    keys: ClassVar[tuple[str, ...]] = ("orientation",)
    before_mean_deg: float
    mean_deg: float
    reflectors_moved_mm: float

    def _text(self) -> str:
        return (
            f"mean error of orientation {self.before_mean_deg:.4f} deg before, "
            f"{self.mean_deg:.4f} deg corrected; reflectors moved "
            f"{self.reflectors_moved_mm:.3f} mm on the flange"
        )


# -- the correction --------------------------------------------------------------------------------


class CurvesUsed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Whether the sweeps' curves are used, and why: mean error (mm) at poses left out."""

    used: bool
    reason: str
    with_mm: float | None = None
    without_mm: float | None = None


class Fitted(Verdict, frozen=True, kw_only=True, omit_defaults=True):
    """The error model chosen by cross-validation: mean, p95 and max (mm) of each. ``orientation``:
    the use of the tool's orientation, where measured. ``tail``: the largest over the median of the
    errors at poses left out or struck out, each by its uncertainty, of a quick plan.
    """

    keys: ClassVar[tuple[str, ...]] = ("fit",)
    title: ClassVar[str] = marked("choice of the correction")
    method: str
    loocv: dict[str, dict[str, float]]
    reason: str
    refused: dict[str, str]
    curves: CurvesUsed
    outliers: list[PointId]
    orientation: str = ""
    tail: float | None = None

    def _text(self) -> str:
        orientation = f"; orientation {self.orientation}" if self.orientation else ""
        return f"{self.method}, {self.reason}{orientation}"


class SignChecked(Verdict, frozen=True, kw_only=True):
    """The error of one target as sent and corrected: a wrong sign would double it."""

    keys: ClassVar[tuple[str, ...]] = ("sign",)
    title: ClassVar[str] = marked("sign check")
    limit: float
    before_mm: float
    corrected_mm: float
    ratio: float

    def _text(self) -> str:
        return (
            f"error of one target {self.before_mm:.3f} mm as sent, {self.corrected_mm:.3f} mm "
            f"corrected: {100 * self.ratio:.0f} % of it, limit {100 * self.limit:.0f} %"
        )


class Rechecked(Verdict, frozen=True, kw_only=True):
    """Whether the calibration in use is still valid, by a few poses. ``doubt``: explains them as
    well as a moved base does.
    """

    keys: ClassVar[tuple[str, ...]] = ("recheck",)
    title: ClassVar[str] = marked("re-check")
    verdict: Literal["valid", "update", "redo"]
    drift_mm: float
    drift_u_mm: float
    doubt: str

    def _text(self) -> str:
        words = {"valid": "still valid", "update": "base moved, updated", "redo": "calibrate again"}
        drift = f"drift {self.drift_mm:.3f} mm, u {self.drift_u_mm:.3f} mm"
        return "; ".join(filter(None, (f"{words[self.verdict]}: {drift}", self.doubt)))


class Touched(Verdict, frozen=True, kw_only=True):
    """The base was touched at a station."""

    keys: ClassVar[tuple[str, ...]] = ("touch",)
    title: ClassVar[str] = marked("touch poses")
    station: str

    def _text(self) -> str:
        return f"touched at {self.station}"


# -- what may have changed -------------------------------------------------------------------------


class Revisited(Verdict, frozen=True, kw_only=True):
    """Poses against their first visits: chi^2 per degree of freedom of the test nearest
    its limit.
    """

    keys: ClassVar[tuple[str, ...]] = ("revisits", "revisits.closing")
    title: ClassVar[str] = marked("revisited poses")
    ratio: float
    limit: float
    suspicion: Suspicion | None
    suspected: list[str]

    def _text(self) -> str:
        suspected = "".join(f"; suspected: {each}" for each in self.suspected)
        return (
            "differences from the first visits: of the tests of all poses together and of each "
            "cause (chi² per degree of freedom, 1 on average by chance), the nearest to its limit "
            f"has {self.ratio:.2f}; limit {self.limit:.2f}, which chance alone keeps in "
            f"{100 * (1 - RISK):g} % of runs{suspected}"
        )


class LostMotionJudged(Verdict, frozen=True, kw_only=True):
    """Lost motion of axes 1 to 3, by vertices approached from both sides, and its U (k = 2)."""

    keys: ClassVar[tuple[str, ...]] = ("reversal",)
    title: ClassVar[str] = marked("lost motion of axes 1 to 3")
    mean_mm: float
    max_mm: float
    points: int
    lost_urad: list[float]
    U_urad: list[float]
    limit_urad: float

    @property
    def excess_urad(self) -> list[float]:
        """Lost motion of each axis beyond limit and U."""
        both = zip(self.lost_urad, self.U_urad, strict=True)
        return [abs(lost) - U - self.limit_urad for lost, U in both]

    def _text(self) -> str:
        both = zip(self.lost_urad, self.U_urad, strict=True)
        lost = ", ".join(f"A{axis} {lost:.0f} +- {U:.0f}" for axis, (lost, U) in enumerate(both, 1))
        return (
            f"{self.points} vertices from both sides, {self.mean_mm:.3f} mm apart on average, "
            f"{self.max_mm:.3f} mm at most; lost motion {lost} urad (U, k = 2), limit "
            f"{self.limit_urad:g} urad"
        )


class Suspected(Verdict, frozen=True, kw_only=True):
    """The causes that a run suspects of all that it compared."""

    keys: ClassVar[tuple[str, ...]] = ("suspicions",)
    title: ClassVar[str] = marked("suspected causes")
    suspected: list[str]

    def _text(self) -> str:
        return "; ".join(self.suspected) or "nothing is suspected"


class Parameter(msgspec.Struct, frozen=True):
    """A coordinate in {W} in both calibrations; a rotation is relative to the former one, there 0.
    ``limit`` is U of the difference.
    """

    name: str
    unit: str
    then: float
    now: float
    limit: float

    @property
    def holds(self) -> bool:
        return abs(self.now - self.then) <= self.limit

    @property
    def text(self) -> str:
        return (
            f"{self.name} {self.now:.3f} {self.unit}, {self.then:.3f} then, "
            f"limit of the difference {self.limit:.3f}"
        )


class ChangedSince(Verdict, frozen=True, kw_only=True):
    """The parameters that differ from the calibration of run ``before``, which is in use."""

    keys: ClassVar[tuple[str, ...]] = ("since",)
    title: ClassVar[str] = marked("changes since the calibration before")
    before: str
    suspected: list[str]
    beyond: list[Parameter]
    compared: int

    def _text(self) -> str:
        beyond = "; ".join(each.text for each in self.beyond)
        kept = f"all {self.compared} parameters are within their limits"
        return f"against the calibration of run {self.before}: {beyond or kept}"


# -- the instrument --------------------------------------------------------------------------------


class MeasuredLength(msgspec.Struct, frozen=True):
    """A certified length at the air's temperature, as measured, and U (k = 2) of the difference."""

    nests: tuple[str, str]
    wanted_mm: float
    found_mm: float
    U_mm: float

    @property
    def off_ppm(self) -> float:
        return 1e6 * (self.found_mm / self.wanted_mm - 1.0)

    @property
    def share(self) -> float:
        return abs(self.found_mm - self.wanted_mm) / self.U_mm

    @property
    def holds(self) -> bool:
        return self.share <= 1.0

    @property
    def text(self) -> str:
        return (
            f"{' to '.join(self.nests)} was measured {self.found_mm:.3f} mm, certified "
            f"{self.wanted_mm:.3f} mm, U = {self.U_mm:.3f} mm (k = 2): {self.off_ppm:+z.0f} ppm"
        )


class LengthsChecked(Verdict, frozen=True, kw_only=True):
    """Certified lengths against the tracker's scale; ``wrong``: those that differ, as text."""

    keys: ClassVar[tuple[str, ...]] = ("known-length",)
    lengths: list[MeasuredLength]
    wrong: list[str]

    @property
    def within(self) -> int:
        return sum(each.holds for each in self.lengths)

    def _text(self) -> str:
        return "; ".join(each.text for each in self.lengths)


class Faces(msgspec.Struct, frozen=True):
    """Half the difference between both faces at a nest, sideways and downwards, and its limit."""

    nest: str
    across_mm: float
    down_mm: float
    limit_mm: float

    @property
    def off_mm(self) -> float:
        return math.hypot(self.across_mm, self.down_mm)

    @property
    def holds(self) -> bool:
        return self.off_mm <= self.limit_mm


class FacesCompared(Verdict, frozen=True, kw_only=True):
    """Nests measured in both faces of the tracker."""

    keys: ClassVar[tuple[str, ...]] = ("two-face", "two-face.closing")
    title: ClassVar[str] = marked("both faces of the tracker")
    nests: list[Faces]
    summary: str = field(name="words")
    wrong: list[str]

    def _text(self) -> str:
        return self.summary


class MeasuredReflector(msgspec.Struct, frozen=True):
    """A reflector's distance from the others' median, along and across the beam, its limit, and its
    U (k = 2) by the readings.
    """

    place: str
    along_mm: float
    across_mm: float
    limit_mm: float
    U_mm: float

    @property
    def holds(self) -> bool:
        return math.hypot(self.along_mm, self.across_mm) <= self.limit_mm

    @property
    def text(self) -> str:
        return (
            f"the reflector of {self.place} is seen {self.along_mm:+.3f} mm along the beam and "
            f"{self.across_mm:.3f} mm across it from the others, limit {self.limit_mm:.3f} mm"
        )


class ReflectorsCompared(Verdict, frozen=True, kw_only=True):
    """Each reflector in one nest against the others; ``wrong``: those that differ, as text."""

    keys: ClassVar[tuple[str, ...]] = ("reflectors",)
    reflectors: list[MeasuredReflector]
    wrong: list[str]

    @property
    def within(self) -> int:
        return sum(each.holds for each in self.reflectors)

    def _text(self) -> str:
        return "; ".join(self.wrong) or "none differs from the others"


class FaceError(msgspec.Struct, frozen=True):
    """The two-face location error of a nest, halved: sideways and downwards, what the axes' errors
    leave of it, its U (k = 2) in each direction, and its limit. ``height_deg``: of the beam.
    """

    nest: str
    range_mm: float
    height_deg: float
    across_mm: float
    down_mm: float
    left_across_mm: float
    left_down_mm: float
    U_mm: float
    limit_mm: float

    @property
    def figure(self) -> Figure:
        off_mm = math.hypot(self.across_mm, self.down_mm)
        return Figure(f"both faces at {self.nest}", off_mm, "mm", self.limit_mm, self.U_mm)


class AxesJudged(Verdict, frozen=True, kw_only=True):
    """Errors of the tracker's axes by both faces, with U (k = 2), and the two-face error of each
    nest. ``transit_urad`` is None where the nests do not separate it from the collimation.
    """

    keys: ClassVar[tuple[str, ...]] = ("tracker-axes",)
    title: ClassVar[str] = "axes of the tracker"
    nests: list[FaceError]
    collimation_urad: float
    collimation_U_urad: float
    transit_urad: float | None
    transit_U_urad: float | None
    index_urad: float
    index_U_urad: float

    @property
    def axes(self) -> Sequence[Figure]:
        form = ".1f"
        return (
            Figure("collimation", self.collimation_urad, "µrad", U=self.collimation_U_urad,
                   form=form),
            Figure("transit tilt", self.transit_urad, "µrad", U=self.transit_U_urad, form=form),
            Figure("vertical index", self.index_urad, "µrad", U=self.index_U_urad, form=form),
        )  # fmt: skip

    @property
    def figures(self) -> Sequence[Figure]:
        return [*(each.figure for each in self.nests), *self.axes]


class DriftJudged(Verdict, frozen=True, kw_only=True):
    """The trend of a nest over ``minutes``, along the beam, sideways, downwards, with U (k = 2),
    the largest distance of two of its positions, and the noise (1 sigma) of one coordinate of one.
    """

    keys: ClassVar[tuple[str, ...]] = ("tracker-drift",)
    title: ClassVar[str] = "drift of the tracker"
    nest: str
    minutes: float
    points: int
    trend_mm: tuple[float, float, float]
    trend_U_mm: float
    range_mm: float
    noise_mm: float
    limit_mm: float

    @property
    def figures(self) -> Sequence[Figure]:
        trend_mm = math.hypot(*self.trend_mm)
        where = f"of {self.nest} in {self.minutes:g} min"
        return (
            Figure(f"trend {where}", trend_mm, "mm", self.limit_mm, self.trend_U_mm),
            Figure(f"range {where}", self.range_mm),
            Figure(f"noise of a coordinate of {self.nest}", self.noise_mm),
        )


class InstrumentChecked(NamedTuple):
    """The outcome of a check of the instrument: the figures, lengths and reflectors proven beyond
    their limit and the undecided figures, each as text, and the number of those within theirs.
    """

    beyond: list[str]
    undecided: list[str]
    within: int

    @classmethod
    def by(cls, verdicts: Mapping[str, Verdict]) -> Self | None:
        """Return it by the verdicts of a run; None of a run that checked no instrument."""
        every = list(verdicts.values())
        judged = [each for each in every if isinstance(each, AxesJudged | DriftJudged)]
        if not judged:
            return None
        figures = [each for of in judged for each in of.figures if each.limit is not None]
        by = {kind: [each.why for each in figures if each.outcome is kind] for kind in Outcome}
        within = len(by[Outcome.ACCEPTED])
        for each in every:
            if isinstance(each, LengthsChecked | ReflectorsCompared):
                by[Outcome.REJECTED] += each.wrong
                within += each.within
        return cls(by[Outcome.REJECTED], by[Outcome.UNDECIDED], within)

    @property
    def form(self) -> str:
        """The sentence without its `values`, for `tr`."""
        if self.beyond:
            return marked(
                "proven beyond its limit: {beyond}; within theirs: {within}, undecided: {count}"
            )
        if self.undecided:
            return marked(
                "nothing is proven beyond its limit; figures within theirs: {within}, undecided: "
                "{count} ({undecided})"
            )
        return marked("nothing is proven beyond its limit; figures within theirs: all {within}")

    @property
    def values(self) -> dict[str, object]:
        return {
            "beyond": "; ".join(self.beyond),
            "undecided": "; ".join(self.undecided),
            "within": self.within,
            "count": len(self.undecided),
        }

    @property
    def text(self) -> str:
        return self.form.format(**self.values)


# -- the rail and the drivers ----------------------------------------------------------------------


class Within(Verdict, frozen=True, kw_only=True):
    """A length within its limit."""

    of: ClassVar[str]
    found_mm: float
    limit_mm: float

    @property
    def figures(self) -> Sequence[Figure]:
        return [Figure(self.of, self.found_mm, "mm", self.limit_mm)]


class Backlash(Within, frozen=True, kw_only=True):
    """The rail's backlash; fails only where it exceeds its limit by more than U."""

    keys: ClassVar[tuple[str, ...]] = ("backlash",)
    title: ClassVar[str] = marked("backlash of the rail")
    of: ClassVar[str] = "backlash"


class StripRepeats(Within, frozen=True, kw_only=True):
    """The range of positions at which the strip holds the slide."""

    keys: ClassVar[tuple[str, ...]] = ("station-repeatability",)
    title: ClassVar[str] = marked("repeatability of a held station")
    of: ClassVar[str] = "largest range of positions held by the strip"


class DriverConforms(Verdict, frozen=True, kw_only=True):
    """Whether a driver conforms to its port; ``broken``: the broken promises."""

    keys: ClassVar[tuple[str, ...]] = ("conformance ",)
    driver: str
    broken: list[str]

    def _text(self) -> str:
        broken = f": breaks {', '.join(self.broken)}" if self.broken else ""
        return f"driver {self.driver}{broken}"


class Proved(Verdict, frozen=True, kw_only=True, omit_defaults=True):
    """A fact of the cell that commissioning verifies; ``values`` of the cell file, by path, follow
    from it.
    """

    keys: ClassVar[tuple[str, ...]] = ("commissioning.",)
    found: str
    expected: str
    values: Json = field(default_factory=dict)

    def _text(self) -> str:
        return f"{self.found}; expected {self.expected}"


# -- by key ----------------------------------------------------------------------------------------


VERDICTS: dict[str, type[Verdict]] = {
    key: kind for kind in Verdict.__subclasses__() + Within.__subclasses__() for key in kind.keys
}


def verdict_type(key: str) -> type[Verdict] | None:
    """Return the type of a key's verdict, None of a plug-in's."""
    for each, kind in VERDICTS.items():
        if key == each or (each[-1] in ". " and key.startswith(each)):
            return kind
    return None


def decode_verdict(key: str, body: Json) -> Verdict:
    kind = verdict_type(key)
    if kind is not None:
        return typed(body, kind)
    facts: Json = {name: value for name, value in body.items() if name != "holds"}
    return OtherVerdict(holds=typed(body.get("holds"), bool), facts=facts)


def verdict_title(key: str) -> str:
    """The subject of a verdict: *re-check*."""
    kind = verdict_type(key)
    title = (kind.title if kind is not None else "") or key.replace("-", " ")
    return tr("{check} at the end", check=tr(title)) if key.endswith(".closing") else tr(title)
