"""Results of steps that several packages read, with their names in JSON."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
from msgspec import field

from hilcell.model.events import Pair
from hilcell.model.frame import Matrix
from hilcell.model.outcome import Outcome
from hilcell.model.point import Sent
from hilcell.model.verdicts import Suspicion


class StepResult(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Figures of a step; None is omitted from JSON."""


# -- validation ------------------------------------------------------------------------------------


class OrientationFigures(StepResult, frozen=True, kw_only=True):
    """Orientation errors, deg."""

    mean_deg: float
    p95_deg: float
    max_deg: float


class SentErrors(StepResult, frozen=True, kw_only=True):
    """3D errors (mm) of targets sent alike, their mean 95 % bound, and the share within its own
    bound.
    """

    mean: float
    p95: float
    max: float
    orientation: OrientationFigures | None = None
    bound95_mean: float | None = None
    covered: float | None = None


class Floor(StepResult, frozen=True, kw_only=True):
    """Errors (mm) that a perfect correction leaves."""

    mean: float
    p95: float


class OrientationBounds(StepResult, frozen=True, kw_only=True):
    """95 % bounds of corrected orientations, deg, and the share of targets within them."""

    coverage: float
    mean_deg: float
    max_deg: float


class TargetBounds(StepResult, frozen=True, kw_only=True):
    """95 % bounds of corrected targets, mm, and the share of targets within them."""

    coverage: float
    mean_mm: float
    max_mm: float
    orientation: OrientationBounds | None = None


class Decided(StepResult, frozen=True, kw_only=True):
    """Decision of a quick plan, the number of targets at each station, and its risks.

    ``rule``: for which errors its test holds, and why.
    """

    outcome: Outcome
    targets: list[int]
    text: str
    rule: str
    accept_risk: float
    reject_risk: float
    share_above_max: float


class Place(StepResult, frozen=True, kw_only=True):
    """The targets of one station, or of several together: corrected ones, and all by `Sent`.

    A quick plan sends none by the paper's method.
    """

    points: int
    points_sent: dict[Sent, int]
    before: SentErrors
    idw: SentErrors | None = None
    chosen: SentErrors
    decision: Decided | None = None
    floor: Floor | None = None
    bounds: TargetBounds | None = None

    @property
    def sent(self) -> Mapping[Sent, SentErrors]:
        errors = {Sent.BEFORE: self.before, Sent.IDW: self.idw, Sent.CHOSEN: self.chosen}
        return {how: each for how, each in errors.items() if each is not None}


class Repeated(StepResult, frozen=True, kw_only=True):
    """Repeated visits, mm; ``robot``: the tracker's noise taken off.

    RP is that of ISO 9283 (7.2.2) at the place where it is largest. The pooled radius is the RP
    that very many visits would give: places together, free of the scatter of their few visits'
    means. ``floor_mm`` is the mean distance of one visit.
    """

    rp_mm: float
    rp_robot_mm: float
    pooled_radius_mm: float
    pooled_radius_robot_mm: float
    floor_mm: float


class FramedStation(StepResult, frozen=True, kw_only=True):
    """{S} of a station as in `MeasuredStation`."""

    strip_mm: float
    matrix: Matrix = field(name="T_W_S")
    rms_mm: float
    tool_uncertainty_mm: float
    cube_uncertainty_mm: float
    left_out: list[str]


class Calibrated(StepResult, frozen=True, kw_only=True):
    """The result of a calibration, as far as others read it."""

    points: dict[str, int]
    repeatability: Repeated
    stations: dict[str, FramedStation]
    method: str
    validation: dict[str, Place]
    suspicions: list[Suspicion] = []


# -- the rail --------------------------------------------------------------------------------------


class WithU(StepResult, frozen=True, kw_only=True):
    """A value and its standard uncertainty (k = 1), in one unit."""

    value: float
    u: float


class SurveyedRail(StepResult, frozen=True, kw_only=True):
    """The rail's error (mm) over its nominal position (mm), ``forth`` and ``back``, and its
    components. Straightness is peak to peak; angles (mrad) are relative to the first stop.
    """

    curve: dict[str, list[Pair]]
    max_error_mm: float
    backlash_mm: WithU
    scale_ppm: WithU
    straightness_mm: dict[str, float]
    angles_mrad: dict[str, list[float]]


class FramesRepeated(StepResult, frozen=True, kw_only=True):
    """Distances of slide points from their reference by station, in base and station frame. Also
    the ratio of both root mean squares, and its 95 % interval.
    """

    base: dict[str, list[float]]
    station: dict[str, list[float]]
    rms_mm: dict[str, float]
    ratio: float
    ratio_interval: Pair


class PaperRow(StepResult, frozen=True, kw_only=True):
    """A figure of the paper beside the run's own. ``fails``: the mistake that fails it; ``set``:
    determined by cell file or simulated machine, cannot fail.
    """

    row: str
    paper: float | None
    here: float
    chosen: float | None
    unit: str
    holds: bool
    set: bool
    criterion: str
    fails: str

    @property
    def verdict(self) -> str:
        return "set" if self.set else "holds" if self.holds else "does not hold"

    @property
    def shown(self) -> float | str:
        """The run's figure, rounded: the digits of round-off differ between PCs."""
        round_off = 1e-9  # below it a figure is zero but for the arithmetic
        return f"< {round_off:g}" if 0.0 < abs(self.here) < round_off else self.here
