"""Diagnosis of a run: causes suspected from its own comparisons.

Drift of the tracker: all readings of the floor nests are fitted with one motion, linear in the
run's records, with an offset for each set-up, because slow drift stays within the limit of each
check. A tracker that was bumped or wanders is not explained by one slope.

Drift of the robot (as of an arm that warms up): offsets of all poses from the model show a slope in
the order of their records. Each cause is fitted linear in the run's progress, beside what else
moves poses: a motion of {B} at each stop of the slide, the arm's growth with the ambient
temperature, smooth errors of the model. A slope counts where chance does not explain it, and where
over the run it moves poses by more than the scatter of one visit.

Scatter (as of a brake that slips at each stop): deviations e of corrected targets from their mean
at each station are compared with their covariance C, by the mean of ``e' C^-1 e / 3``, and along
the column a of each large axis by that of ``(a' C^-1 e)^2 / a' C^-1 a``. Both are 1 where the
validation's budget is true, and are judged as F. Scatter from the first point on is in the visits
too, which are compared with the stated RP.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain, groupby, permutations
from typing import NamedTuple, Self

import numpy as np
from msgspec.structs import replace

from hilcell.calibration.budget import growth_since
from hilcell.calibration.causes import (
    LARGE_AXES,
    PENALTY,
    RISK,
    SPREAD,
    Change,
    Differences,
    Pattern,
    patterns,
    zero_columns,
)
from hilcell.calibration.changes import risen_nest, since_before
from hilcell.calibration.file import Calibration
from hilcell.calibration.frames import (
    axis_6_height_mm,
    axis_circle,
    base_covariance,
    hold_covariance,
    world_covariance,
)
from hilcell.calibration.from_run import learnt_so_far, learnt_targets
from hilcell.calibration.influence import SIZE, NoBound, motion, nearest_semidefinite
from hilcell.calibration.instrument import axis_off, scale
from hilcell.calibration.known_arm import slipped_mount
from hilcell.calibration.lost_motion import lost_too_much
from hilcell.calibration.measurement_budget import systematic_mm2
from hilcell.calibration.position_errors import (
    block_diagonal,
    position_errors,
    visit_noise,
    visit_scatter,
)
from hilcell.geometry.frames import (
    apply,
    base_frame_covariance,
    from_rotvec,
    inverse,
    matrix,
    motion_levers,
    reading_covariance,
)
from hilcell.geometry.kinematics import Arm, forward
from hilcell.geometry.statistics import (
    bounds95_mm,
    chance_of_at_most,
    chi2_quantile,
    f_quantile,
    lengths_mm,
    rectangular_variance,
    rms,
    trace_freedom,
)
from hilcell.journal.log import (
    VERIFICATION_KINDS,
    Log,
    commanded_rad,
    covariances_mm2,
    noise_at,
    positions_mm,
    repeated_visits,
    run_noise,
    variances_mm2,
)
from hilcell.model.events import URAD
from hilcell.model.frame import MeasuredBase
from hilcell.model.point import CHECKS, CONTROL, Point
from hilcell.model.verdicts import Cause, Fitted, Revisited, Suspicion
from hilcell.ports import Array, HilcellError

# -- drift of the tracker --------------------------------------------------------------------------


def tracker_drift(log: Log) -> Suspicion | None:
    """Slow motion of the tracker beyond the stated drift, if any."""
    nests = [nest.name for nest in log.cell.layout.floor]
    points = [p for kind in VERIFICATION_KINDS for p in log.measured(kind) if p.id.nest in nests]
    least_readings = 4  # of each nest
    if len(points) < least_readings * len(nests):
        return None
    noise = run_noise(log)
    at_mm, share = positions_mm(points), _shares(log, points)
    off_mm, since = _within(points, at_mm, share)
    J = motion_levers(at_mm)[:, :, :6] * since[:, None, None]
    whitening = np.linalg.inv(np.linalg.cholesky(noise_at(noise, points)))
    white = (whitening @ off_mm[:, :, None]).ravel()
    groups = len({(p.set_up, p.id.nest) for p in points})
    fits = []
    causes = (("mm of the tracker over the run", slice(0, 3), 1.0),
              ("urad of the tracker over the run", slice(3, 6), URAD))  # fmt: skip
    for unit, own, factor in causes:
        D = (whitening @ J[:, :, own]).reshape(-1, 3)
        motion = np.linalg.lstsq(D, white, rcond=None)[0]
        left = float(np.square(white - D @ motion).sum())
        explained = float(np.square(white).sum()) - left
        fits.append((left, explained, motion, unit, own, factor))
    left, explained, motion, unit, own, factor = min(fits, key=lambda each: each[0])
    freedom = 3 * (len(points) - groups) - 3
    sure = explained > 3 * SPREAD * f_quantile(1.0 - RISK / len(causes), 3, noise.freedom)
    chance = freedom * SPREAD * f_quantile(1.0 - RISK, freedom, noise.freedom)
    # of chi^2, by a slope that is not quite straight; a step leaves a quarter or more
    most_left = 0.1
    alone = left <= chance + most_left * (explained + left)
    moved_mm = lengths_mm(motion_levers(at_mm)[:, :, own] @ motion).max()
    limit_mm = np.sqrt(3.0) * log.cell.uncertainty.drift_limit_mm
    if not (sure and alone and moved_mm > limit_mm):
        return None
    nests_in_order = "floor nests, in the order of their readings"
    return Suspicion(Cause.DRIFT, factor * float(np.linalg.norm(motion)), unit, nests_in_order)


def _shares(log: Log, points: list[Point]) -> Array:
    """Progress (N,) of the run, in share of its records, at each point."""
    seen = np.array([log.recorded(point) for point in points], dtype=float)
    return np.asarray((seen - seen.min()) / (seen.max() - seen.min()))


def _within(points: list[Point], at_mm: Array, share: Array) -> tuple[Array, Array]:
    """Positions (N, 3) and shares (N,) less the weighted mean of their nest and set-up."""
    off_mm, since = at_mm.copy(), share.copy()
    samples = np.array([point.samples for point in points], dtype=float)
    for group in {(p.set_up, p.id.nest) for p in points}:
        rows = [n for n, p in enumerate(points) if (p.set_up, p.id.nest) == group]
        off_mm[rows] -= np.average(at_mm[rows], axis=0, weights=samples[rows])
        since[rows] -= np.average(share[rows], weights=samples[rows])
    return off_mm, since


# -- drift of the robot ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PoseSeries:
    """N poses of a run in order, in {B}: offsets (N, 3) from the model, covariances (N, 3, 3).

    Also joints (N, 6), progress (N,), warming (N,), number (N,) of the stop of the slide. ``holds``
    (H, 6, 6): covariances of {B} at each stop; ``growth_per_k``: the arm's largest; ``freedom``:
    that of the scatter's estimate; ``floor_mm``: scatter of one visit.
    """

    off_mm: Array
    covariance_mm2: Array
    joints_rad: Array
    share: Array
    warm_k: Array
    hold: Array
    holds: Array
    growth_per_k: float
    freedom: float
    floor_mm: float

    @classmethod
    def of(cls, log: Log) -> Self | None:
        """The poses of a run; None without a model, or with too few poses."""
        calibration = learnt_so_far(log)
        if calibration is None or calibration.uncertainty.missing:
            return None
        placed = sorted((p for p in log.points.values() if p.station), key=log.recorded)
        runs = groupby(placed, key=lambda point: (point.station, point.set_up))
        holds = [[p for p in points if cls._belongs(p)] for _, points in runs]
        holds = [points for points in holds if points]
        points = [point for hold in holds for point in hold]
        least_poses = 30
        if len(points) < least_poses:
            return None
        try:
            repeats = Counter(map(cls._place, points))
            rows = [cls._hold(log, calibration, hold, repeats) for hold in holds]
        except HilcellError:  # a model that knows nothing of a pose beside its grid
            return None
        off_mm, covariance_mm2, priors = zip(*rows, strict=True)
        share = _shares(log, points)
        scatter_mm2, visits, places = visit_scatter(log, np.eye(3))
        stated = log.cell.uncertainty
        celsius = [p.temperature_c for p in points if p.temperature_c is not None]
        warm_k = share * stated.air_range_k  # unknown without a weather station
        if len(celsius) == len(points):
            warm_k = np.array(celsius) - celsius[0]
        return cls(
            np.concatenate(off_mm),
            np.concatenate(covariance_mm2),
            commanded_rad(points),
            share,
            warm_k,
            np.repeat(np.arange(len(holds), dtype=float), [len(hold) for hold in holds]),
            np.array(priors),
            stated.arm_growth_um_m_k * 1e-6,
            3.0 * (visits - places),
            float(np.sqrt(np.trace(scatter_mm2))),
        )

    @classmethod
    def _hold(
        cls,
        log: Log,
        calibration: Calibration,
        points: list[Point],
        repeats: Mapping[tuple[object, ...], int],
    ) -> tuple[Array, Array, Array]:
        """Offsets (N, 3) in {B} at one stop, covariances (N, 3, 3), and that of {B} (6, 6)."""
        station = log.cell.station_named(points[0].station)
        T_W_B = calibration.base(station.name)
        T_B_L = inverse(T_W_B) @ log.matrix("world")
        poses = forward(log.cell.robot.arm(), commanded_rad(points))
        predicted = calibration.error_model().predict(poses)
        off_mm = apply(T_B_L, positions_mm(points)) - poses[:, :3, 3] - predicted.error_mm
        R = T_B_L[:3, :3]
        noise = visit_noise(log)
        noise_mm2 = noise.covariances(points, R)
        model_mm2 = nearest_semidefinite(predicted.covariance_mm2 - R @ noise.robot_mm2 @ R.T)
        shared = np.array([repeats[cls._place(point)] for point in points], dtype=float)
        covariance_mm2 = noise_mm2 + shared[:, None, None] * model_mm2
        return off_mm, covariance_mm2, cls._base_covariance(log, T_W_B, points[0])

    @staticmethod
    def _belongs(point: Point) -> bool:
        """Whether a point is the tool point's at a pose approached from below."""
        # Visits of three places alone are left out: the model's errors there are no noise.
        kinds = ("grid", "revisit", "touch", "validate", "closing")
        own = point.id.kind in kinds and point.id.seat is None and not point.id.side
        return own and not point.id.axis and point.commanded_deg is not None

    @staticmethod
    def _place(point: Point) -> tuple[object, ...]:
        """Key of the commanded place, where the model's error is the same."""
        id = point.id
        return ("vertex", id.vertex) if id.vertex else (id.kind, id.station, id.number)

    @staticmethod
    def _base_covariance(log: Log, T_W_B: Array, point: Point) -> Array:
        """Uncertainty of {B} at one stop, (6, 6) in {B}: strip, station frame, tracker."""
        cell, at_mm = log.cell, T_W_B[:3, 3]
        drift_mm2 = rectangular_variance(cell.uncertainty.drift_limit_mm)
        covariance = base_covariance(log, cell.station_named(point.station))
        covariance[:3, :3] += hold_covariance(cell)
        covariance += world_covariance(log, at_mm, drift_mm2) * (2.0 if point.set_up else 1.0)
        turn = np.kron(np.eye(2), T_W_B[:3, :3].T)
        return np.asarray(turn @ covariance @ turn.T)

    def nuisances(self, arm: Arm) -> tuple[Array, Array]:
        """Other motions of the poses, columns (N, 3, K), and their covariance (K, K)."""
        at_mm = forward(arm, self.joints_rad)[:, :3, 3]
        J, count = motion_levers(at_mm), len(self.holds)
        motion = 6  # of {B} at a hold: shift, rotation vector
        columns = np.zeros((len(at_mm), 3, motion * count + 1))
        prior = np.zeros((columns.shape[2], columns.shape[2]))
        for number, covariance in enumerate(self.holds):
            own = slice(motion * number, motion * (number + 1))
            columns[:, :, own] = J[:, :, :motion] * (self.hold == number)[:, None, None]
            prior[own, own] = covariance
        columns[:, :, -1] = J[:, :, motion] * self.warm_k[:, None]
        prior[-1, -1] = rectangular_variance(self.growth_per_k)
        return columns, prior

    def drift_cause(self, arm: Arm) -> Suspicion | None:
        """The cause whose slope explains most, if significant and large enough."""
        causes = patterns(arm, self.joints_rad)
        whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance_mm2)), dtype=float)
        white = (whitening @ self.off_mm[:, :, None]).ravel()

        def whitened(columns: Array) -> Array:
            return np.asarray((whitening @ columns).reshape(-1, columns.shape[-1]))

        moves, known = self.nuisances(arm)
        left = self._of_model(forward(arm, self.joints_rad)[:, :3, 3], causes)
        B = whitened(np.dstack([moves, left]))
        prior = np.eye(B.shape[1])
        prior[: len(known), : len(known)] = known
        kept = np.linalg.solve(np.eye(len(prior)) + prior @ B.T @ B, prior)
        candidates = []
        for cause in causes:
            moved = cause.columns.reshape(len(self.share), 3, -1) * self.share[:, None, None]
            D = whitened(moved)
            across = B.T @ D
            information = D.T @ D - across.T @ kept @ across
            pull = D.T @ white - across.T @ kept @ (B.T @ white)
            slopes = np.array(np.linalg.solve(information, pull), dtype=float)
            explained, count = float(pull @ slopes), len(slopes)
            limit = f_quantile(1.0 - RISK / len(causes), count, self.freedom)
            moved_mm = rms(np.linalg.norm((cause.columns @ slopes).reshape(-1, 3), axis=1))
            if explained > count * limit and moved_mm > self.floor_mm:
                candidates.append((explained - PENALTY * count, cause, slopes))
        if not candidates:
            return None
        _, cause, slopes = max(candidates, key=lambda each: each[0])
        size = float(slopes[0]) if len(slopes) == 1 else float(np.linalg.norm(slopes))
        unit = f"{cause.unit} over the run, as of {cause.cause}"
        poses_in_order = "all poses of the run, in their order"
        return Suspicion(Cause.DRIFT, cause.factor * size, unit, poses_in_order)

    @staticmethod
    def _of_model(at_mm: Array, causes: list[Pattern]) -> Array:
        """Possible smooth errors of the model, columns (N, 3, K) of 0.05 mm each.

        The causes' patterns, constant, and growing along x and z: poses are visited in an order, so
        such an error resembles a slope.
        """
        alike = np.dstack([cause.columns.reshape(len(at_mm), 3, -1) for cause in causes])
        along = (at_mm - at_mm.mean(axis=0))[:, None, [0, 2]] / np.ptp(at_mm, axis=0).max()
        errors_mm = np.dstack([alike, alike * along[:, :, :1], alike * along[:, :, 1:]])
        sizes = np.sqrt(np.square(errors_mm).sum(axis=1).mean(axis=0))
        model_mm = 0.05  # root mean square over the poses
        return np.asarray(model_mm * errors_mm / sizes)


# -- ambient temperature ---------------------------------------------------------------------------

NOTICED_BY = "weather station"


def reference_c(log: Log) -> float | None:
    """Temperature at the grid's first point, or before that at the run's first."""
    points = chain(log.measured("grid"), log.points.values())
    return next((p.temperature_c for p in points if p.temperature_c is not None), None)


def temperature_change(log: Log) -> Suspicion | None:
    """Change of ambient temperature beyond its limit, at points other than the controls."""
    then_c = reference_c(log)
    if then_c is None:
        return None
    points = (p for p in log.points.values() if p.id.group != CONTROL)
    off_k = [p.temperature_c - then_c for p in points if p.temperature_c is not None]
    worst_k = max(off_k, key=abs, default=0.0)
    if abs(worst_k) <= log.cell.room.range_k:
        return None
    return Suspicion(Cause.TEMPERATURE, worst_k, "K", NOTICED_BY)


# -- the robot's base where it was measured, against where the cell file has it --------------------

# Floor nests are known to each other: reflectors of another size in all of them leave their
# distances as they are, and lift {W} with all that is measured in it. The base has not
# moved, so its measured height changes by the difference of the radii.


def misplaced_base(log: Log) -> Suspicion | None:
    cell = log.cell
    if not isinstance(log.frames.get("base"), MeasuredBase):
        return None
    station = cell.reference
    stated_mm = cell.layout.nominal_base(station.rail_mm)[:3, 3]
    off_mm = log.matrix("base")[:3, 3] - stated_mm
    size_mm = float(np.linalg.norm(off_mm))
    if size_mm <= cell.layout.base_tolerance_mm:
        return None
    bases_place = "the base's place in the cell file"
    if balls := _balls(off_mm):
        return Suspicion(
            Cause.REFLECTOR, float(off_mm[2]), f"mm along z of {{W}}, as of {balls}", bases_place
        )
    return Suspicion(Cause.BASE_MISPLACED, size_mm, "mm", bases_place)


def _balls(off_mm: Array) -> str:
    """Reflectors in all floor nests that explain a base's offset (3,); "" for none."""
    inch_mm = 25.4
    balls_in = (0.5, 0.875, 1.5)  # diameters of reflectors as sold
    same_mm = 3.0  # by which a base that is bolted as usual may be elsewhere
    for seated, expected in permutations(balls_in, 2):
        higher_mm = (expected - seated) * inch_mm / 2.0
        if float(np.linalg.norm(off_mm - [0.0, 0.0, higher_mm])) <= same_mm:
            return f"{seated:g} in reflectors in floor nests for {expected:g} in"
    return ""


# -- the mount -------------------------------------------------------------------------------------

# Both are compared with what links, zeros and a mount measured by hand explain, and with what the
# instrument itself does: a rotation of {B} about z, that axis 6's small circle leaves open,
# resembles a reflector that is mounted sideways.


def mount_offset(log: Log) -> Suspicion | None:
    frame, arm = log.frames.get("base"), log.cell.robot.arm()
    of_base, radius_mm2 = np.zeros((6, 6)), 0.0
    sigmas = 3.0
    most_radius_mm = 2.0  # 3 sigma: a mount to +-1 mm as measured by hand, an arm's links to 0.4 mm
    if isinstance(frame, MeasuredBase):
        of_base, radius_mm2 = _by_circles(log)
        turn = from_rotvec(np.array([arm.alpha_rad[5], 0.0, 0.0]))
        last = matrix(turn, np.array([arm.a_mm[5], 0.0, 0.0])) @ arm.tool
        off_mm = abs(frame.radius_mm[1] - float(np.hypot(last[0, 3], last[1, 3])))
        if not off_mm <= np.hypot(most_radius_mm, sigmas * np.sqrt(radius_mm2)):
            return Suspicion(Cause.MOUNT_OFFSET, off_mm, "mm", "circle of axis 6")
    points = log.select("grid")
    if not points:
        return None
    R = log.matrix("base")[:3, :3] @ forward(arm, commanded_rad(points))[:, :3, :3]
    errors = position_errors(log, points)
    off = np.einsum("nji,nj->ni", R, errors.error_mm).mean(axis=0)
    levers = motion_levers(errors.nominal_mm - log.matrix("base")[:3, 3])[:, :, :6]
    J = (np.swapaxes(R, 1, 2) @ levers).mean(axis=0)
    systematic = systematic_mm2(log.cell.uncertainty, positions_mm(points)).mean()
    most_constant_mm = 3.0  # 3 sigma of the uncorrected error, that links and zeros explain
    mount_mm2 = (most_constant_mm / sigmas) ** 2
    covariance = (mount_mm2 + systematic) * np.eye(3) + J @ of_base @ J.T
    if off @ np.linalg.solve(covariance, off) <= sigmas**2:
        return None
    noticed_by = "constant error in the tool's frame"
    return Suspicion(Cause.MOUNT_OFFSET, float(np.linalg.norm(off)), "mm", noticed_by)


def _by_circles(log: Log) -> tuple[Array, float]:
    """Covariances of {B} (6, 6) and of axis 6's radius by the readings of both circles."""
    circles, covariances = [], []
    for axis in (1, 6):
        points = log.select("base", axis=axis)
        circle = axis_circle(log.cell, log, axis, points)
        at_mm = apply(log.matrix("world"), positions_mm(points))
        limits = systematic_mm2(log.cell.uncertainty, positions_mm(points))
        noise = covariances_mm2(points, log.matrix("world")[:3, :3])
        covariances.append(
            reading_covariance(circle, at_mm, (noise + limits[:, None, None] * np.eye(3)))
        )
        circles.append(dataclasses.replace(circle, covariance=covariances[-1][:6, :6]))
    axis_1, axis_6 = circles
    of_base = base_frame_covariance(axis_1, axis_6, axis_6_height_mm(log.cell))
    return of_base, float(covariances[-1][6, 6])


# -- poses that were visited again, and corrected targets ------------------------------------------

REVISIT, CLOSING = "revisit", "closing"  # kinds of points: after the grid, and in the end


@dataclass(frozen=True, eq=False)
class SecondVisits:
    """Poses visited again, points of one ``kind``, compared with their first visits."""

    log: Log
    kind: str

    @property
    def verdict_key(self) -> str:
        return {REVISIT: "revisits", CLOSING: "revisits.closing"}[self.kind]

    @property
    def recorded_cause(self) -> Suspicion | None:
        """Cause shown by earlier re-visits: points in between are of a changed robot."""
        kept = self.log.verdict(Revisited, self.verdict_key)
        return None if kept is None else kept.suspicion

    @property
    def cause(self) -> Suspicion | None:
        return (self.recorded_cause or self.change().suspicion) if self.points else None

    @property
    def points(self) -> list[Point]:
        """In the order of their first readings. A pose whose first reading was replaced later
        counts only after another visit.
        """
        recorded = self.log.recorded
        points = [p for p in self.log.select(self.kind) if self._first(p) < recorded(p)]
        return sorted(points, key=self._first)

    def is_overtaken(self, point: Point) -> bool:
        """Whether anything was measured after the visit of a pose that is to verify it. At the end,
        anything except verifications; after the grid, the pose's first reading.
        """
        if self.kind != CLOSING:
            return self._first(point) > self.log.recorded(point)
        others = self.log.last_recorded(besides=(CLOSING, *VERIFICATION_KINDS, *CHECKS))
        return others > self.log.recorded(point)

    def _first(self, point: Point) -> int:
        return self.log.recorded(self._before(point))

    def _before(self, point: Point) -> Point:
        first = "grid" if point.id.vertex else "pose"
        return self.log.point(replace(point.id, kind="base" if point.id.axis else first))

    def change(self) -> Change:
        names = {REVISIT: "re-visited poses", CLOSING: "vertices re-visited at the end"}
        return self._differences().change(self.log.cell.robot.arm(), names[self.kind])

    def _differences(self) -> Differences:
        log, now = self.log, self.points
        before = [self._before(point) for point in now]
        T_B_W = inverse(log.matrix("base"))
        T_B_L = T_B_W @ log.matrix("world")
        at_mm = apply(T_B_L, positions_mm(now))
        _, visits, places = visit_scatter(log, T_B_L[:3, :3])
        noise = visit_noise(log)
        visits_mm2 = [noise.covariances(points, T_B_L[:3, :3]) for points in (before, now)]
        common = np.array(motion(rectangular_variance(log.cell.uncertainty.drift_limit_mm)))
        grown = growth_since(log, before, now, "the first visits")
        if grown is not None:
            common += grown.covariance
        R = T_B_W[:3, :3]
        if self.kind == CLOSING:  # the slide has left the station, and come back
            common += np.array(motion(R @ hold_covariance(log.cell) @ R.T))
        J = motion_levers(at_mm).reshape(-1, SIZE)
        covariance_mm2 = block_diagonal(np.sum(visits_mm2, axis=0)) + J @ common @ J.T
        elsewhere = np.repeat([p.set_up != q.set_up for p, q in zip(before, now, strict=True)], 3)
        if elsewhere.any():
            framed = J * elsewhere[:, None]
            covariance_mm2 += framed @ self._framed_again(R) @ framed.T
        return Differences(
            at_mm - apply(T_B_L, positions_mm(before)),
            covariance_mm2,
            commanded_rad(now),
            3.0 * (visits - places),
            R @ np.array(log.cell.layout.rail_direction),
            [len(now)] if self.kind == CLOSING else self._moments(before),
        )

    @staticmethod
    def _moments(before: list[Point]) -> list[int]:
        """Candidate moments of a change, as numbers of first visits before it.

        A few over the grid, the first right after the base frame: each adds a chance of a false
        alarm, and neighbours hardly differ.
        """
        of_base = sum(point.id.kind == "base" for point in before)
        moments = 5  # of the grid at which a change may have come
        return [*np.unique(np.linspace(max(of_base, 1), len(before), moments).astype(int)).tolist()]

    def _framed_again(self, R: Array) -> Array:
        """Covariance (7, 7) in {B} of one set-up's {W} in another's; ``R`` (3, 3) rotates from {W}.
        Both rest on readings of the floor nests, of a tracker that drifts.
        """
        drift_mm2 = rectangular_variance(self.log.cell.uncertainty.drift_limit_mm)
        turn = np.kron(np.eye(2), R)
        covariance = np.zeros((SIZE, SIZE))
        at_mm = self.log.matrix("base")[:3, 3]
        covariance[:6, :6] = 2.0 * turn @ world_covariance(self.log, at_mm, drift_mm2) @ turn.T
        return covariance


def uncovered_targets(log: Log) -> list[Suspicion]:
    """Stations whose corrected targets are too often outside of their bounds."""
    fitted = log.verdict(Fitted)
    if fitted is None:
        return []
    least_inside = 0.82  # of corrected targets, within bounds that 95 % should keep
    least_without_curves = 0.6  # where the gears' ripple is not known: 0.73 was seen
    least = least_inside if fitted.curves.used else least_without_curves
    suspicions = []
    validation = "validation"
    for validated in learnt_targets(log):
        name = validated.station
        try:
            coverage = validated.coverage
        except NoBound:  # the report states why
            return []
        if coverage is None:
            continue
        # Of few targets some lie outside by chance: the same risk as of the re-visits.
        if chance_of_at_most(coverage.inside, len(coverage), least) > RISK:
            continue
        points = validated.points
        R = validated.calibration.base(name)[:3, :3]
        sigmas_mm = np.repeat(coverage.bounds_mm / bounds95_mm(np.eye(3)[None])[0], 3)
        differences = Differences(
            validated.errors.error_mm @ R,
            np.diag(np.square(sigmas_mm)),
            commanded_rad(points),
            float(len(points)),
            R.T @ np.array(log.cell.layout.rail_direction),
            [len(points)],
        )
        place = f"{validation} at {name}: {coverage.share:.0%} within their bounds"
        suspicions.append(differences.likeliest(log.cell.robot.arm(), place))
    return suspicions


# -- scatter, and all comparisons together ---------------------------------------------------------


class TargetDeviations(NamedTuple):
    """Deviations (N, 3) of targets from their station's mean, in {W}, and covariances (N, 3, 3).
    Columns (N, 3, K) of axes in mm / rad, and the covariances' degrees of freedom.
    """

    off_mm: Array
    covariance_mm2: Array
    columns: Array
    freedom: float

    @classmethod
    def of(cls, log: Log) -> Self | None:
        """Deviations of the corrected targets; None without targets or bound."""
        parts, arm = [], log.cell.robot.arm()
        for validated in learnt_targets(log):
            if len(validated.points) < 2:
                continue
            try:
                bounds, error_mm = validated.bounds, validated.errors.error_mm
            except NoBound:  # the report states why
                return None
            R = validated.calibration.base(validated.station)[:3, :3]
            J = zero_columns(arm, commanded_rad(validated.points))
            off_mm, freedom = error_mm - error_mm.mean(axis=0), float(bounds.freedom.min())
            parts.append(cls(off_mm, bounds.covariance_mm2, R @ J[:, :, :LARGE_AXES], freedom))
        if not parts:
            return None
        offs_mm, covariances_mm2, columns, freedoms = zip(*parts, strict=True)
        return cls(
            np.concatenate(offs_mm), np.concatenate(covariances_mm2), np.concatenate(columns),
            float(min(freedoms)),
        )  # fmt: skip

    def worst_scatter(self) -> Suspicion | None:
        """Result of the test farthest beyond its limit; None where chance explains all."""
        off_mm, columns = self.off_mm, self.columns
        weighted = np.linalg.solve(self.covariance_mm2, np.dstack([off_mm, columns]))
        count, axes = len(off_mm), columns.shape[2]
        limit = SPREAD * f_quantile(1.0 - RISK, 3 * count, self.freedom)
        ratio = float(np.einsum("ni,ni->", off_mm, weighted[:, :, 0])) / (3 * count)
        tests = [(ratio, limit, rms(np.linalg.norm(off_mm, axis=1)), "mm")]
        along = np.einsum("nik,ni->nk", columns, weighted[:, :, 0])
        information = np.einsum("nik,nik->nk", columns, weighted[:, :, 1:])
        directions = 3  # of a covariance: one of them has a third of its degrees of freedom
        limit = SPREAD * f_quantile(1.0 - RISK / axes, count, self.freedom / directions)
        for axis in range(axes):
            known = information[:, axis] > 0.0
            ratio = float(np.mean(along[known, axis] ** 2 / information[known, axis]))
            excess_rad = np.sqrt(max(0.0, ratio - 1.0) / information[known, axis].mean())
            tests.append((ratio, limit, float(np.degrees(excess_rad)), f"deg of axis {axis + 1}"))
        ratio, limit, size, unit = max(tests, key=lambda test: test[0] / test[1])
        if ratio <= limit:
            return None
        return Suspicion(Cause.REPEATABILITY, size, unit, "scatter of the corrected targets")


def worse_than_stated(log: Log) -> Suspicion | None:
    """A repeatability worse than stated, shown by repeated visits. By the least ratio of RP to the
    rms distance, with the readings' noise added.
    """
    stated_mm, visits = log.cell.robot.rp_mm, repeated_visits(log)
    if stated_mm is None or not visits:
        return None
    covariance_mm2, count, places = visit_scatter(log, np.eye(3))
    noise_mm2 = float(variances_mm2([*chain(*visits)]).sum(axis=1).mean())
    freedom = trace_freedom(covariance_mm2, count - places)
    most = SPREAD * chi2_quantile(1.0 - RISK, freedom) / freedom
    seen_mm2 = float(np.trace(covariance_mm2))
    # RP = l + 3 S_l over rms distance, scatter alike in all directions; more else
    isotropic = 2.088
    if seen_mm2 <= most * ((stated_mm / isotropic) ** 2 + noise_mm2):
        return None
    size_mm = isotropic * float(np.sqrt(seen_mm2 - noise_mm2))
    noticed_by = f"repeated visits, RP {stated_mm:g} mm stated"
    return Suspicion(Cause.REPEATABILITY, size_mm, "mm", noticed_by)


def suspected_causes(log: Log) -> list[Suspicion]:
    """Causes that a run's journal suspects.

    A correction learnt from a changed robot adds no cause of its own. Slow and small changes count
    where nothing larger has changed, or nothing with a known cause. They depend on the measurements
    and on the verdicts before them, not on those that name them.
    """
    before = (r.seq for key, r in log.verdict_records.items() if key not in ("suspicions", "since"))
    return [*log.once_measured(_suspected_causes, *before)]


def _suspected_causes(log: Log, *_: int) -> list[Suspicion]:
    nest = risen_nest(log)
    alone = [
        scale(log),
        axis_off(log),
        temperature_change(log),
        misplaced_base(log),
        nest,
        since_before(log, with_base=nest is None),
        worse_than_stated(log),
    ]
    changed = SecondVisits(log, REVISIT).cause or SecondVisits(log, CLOSING).cause
    large = [
        mount_offset(log),
        slipped_mount(log),
        lost_too_much(log),
        *([changed] if changed else uncovered_targets(log)),
    ]
    slow = None
    if all(each is None or each.cause is Cause.UNKNOWN for each in large):
        slow = tracker_drift(log) or _scatter(log) or _robot_drift(log)
    return [each for each in (*alone, *large, slow) if each is not None]


def _scatter(log: Log) -> Suspicion | None:
    """A repeatability worse than the run's own, shown by the corrected targets."""
    deviations = TargetDeviations.of(log)
    return None if deviations is None else deviations.worst_scatter()


def _robot_drift(log: Log) -> Suspicion | None:
    series = PoseSeries.of(log)
    return None if series is None else series.drift_cause(log.cell.robot.arm())
