"""A tracker or a robot that changes slowly during a run: no comparison alone is beyond its limit.

The tracker: each proof of the floor nests keeps its limit, or {W} is framed again. So all readings
of the floor nests are fitted with one motion of the tracker, linear in the run's records, each
set-up from a start of its own. A tracker that was bumped or wanders is not explained by one slope.

The robot, an arm that grows with its warm motors, say: no pose differs by more than visits do, but
all poses, less what the calibration's model expects, show a slope in the order of their records.
Each cause of a changed robot is fitted linear in the run's progress, beside what else moves poses:
a shift and turn of {B} at each hold of the slide, the arm's growth with the room, and smooth errors
of the model. A slope counts where chance does not explain it, and where over the run it moves the
poses by more than one visit scatters.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from hilcell.calibration.causes import PENALTY, RISK, SPREAD, Pattern, patterns
from hilcell.calibration.file import learnt_so_far
from hilcell.calibration.form import Calibration
from hilcell.calibration.frames import base_covariance, hold_covariance, world_covariance
from hilcell.calibration.influence import no_less_than_nought
from hilcell.calibration.position_errors import visit_noise, visit_scatter
from hilcell.geometry.frames import apply, inverse, motion_levers
from hilcell.geometry.kinematics import Arm, forward
from hilcell.geometry.statistics import f_quantile, lengths_mm, rectangular_variance, rms
from hilcell.journal.log import (
    PROOFS,
    Log,
    commanded_rad,
    noise_at,
    of_measured,
    positions_mm,
    run_noise,
)
from hilcell.model.events import URAD
from hilcell.model.point import Point
from hilcell.model.suspicion import Cause, Suspicion
from hilcell.ports import Array, HilcellError

# -- the tracker -----------------------------------------------------------------------------------


@of_measured
def tracker_drift(log: Log) -> Suspicion | None:
    """Return a slow motion of the tracker beyond the drift that the cell states, if there is."""
    nests = [nest.name for nest in log.cell.layout.floor]
    points = [p for kind in PROOFS for p in log.measured(kind) if p.id.nest in nests]
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
    found = []
    causes = (("mm of the tracker over the run", slice(0, 3), 1.0),
              ("urad of the tracker over the run", slice(3, 6), URAD))  # fmt: skip
    for unit, own, factor in causes:
        D = (whitening @ J[:, :, own]).reshape(-1, 3)
        motion = np.linalg.lstsq(D, white, rcond=None)[0]
        left = float(np.square(white - D @ motion).sum())
        explained = float(np.square(white).sum()) - left
        found.append((left, explained, motion, unit, own, factor))
    left, explained, motion, unit, own, factor = min(found, key=lambda each: each[0])
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
    """Return which share (N,) of the run's records was over at each point."""
    seen = np.array([log.recorded(point) for point in points], dtype=float)
    return np.asarray((seen - seen.min()) / (seen.max() - seen.min()))


def _within(points: list[Point], at_mm: Array, share: Array) -> tuple[Array, Array]:
    """Return places (N, 3) and shares (N,) less the weighted mean of their nest and set-up."""
    off_mm, since = at_mm.copy(), share.copy()
    samples = np.array([point.samples for point in points], dtype=float)
    for group in {(p.set_up, p.id.nest) for p in points}:
        rows = [n for n, p in enumerate(points) if (p.set_up, p.id.nest) == group]
        off_mm[rows] -= np.average(at_mm[rows], axis=0, weights=samples[rows])
        since[rows] -= np.average(share[rows], weights=samples[rows])
    return off_mm, since


# -- the robot -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Series:
    """N poses of a run in their order, in {B}: their offsets (N, 3) from the model and covariances
    (N, 3, 3), joints (N, 6), the share (N,) of the run that was over, how much warmer the room was
    (N,), the number (N,) of the hold.

    ``holds`` (H, 6, 6) are the covariances of {B} at each hold, ``growth_per_k`` the arm's most,
    ``freedom`` that of the scatter's estimate, ``floor_mm`` the scatter of one visit.
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

    def nuisances(self, arm: Arm) -> tuple[Array, Array]:
        """Return what else moves the poses, columns (N, 3, K), and its covariance (K, K)."""
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


@of_measured
def robot_drift(log: Log) -> Suspicion | None:
    """Return the cause that changes the robot slowly, if one does."""
    series = pose_series(log)
    return None if series is None else drift_cause(series, log.cell.robot.arm())


def drift_cause(series: Series, arm: Arm) -> Suspicion | None:
    """Return the cause whose slope explains most, if chance does not and it matters."""
    causes = patterns(arm, series.joints_rad)
    whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(series.covariance_mm2)), dtype=float)
    white = (whitening @ series.off_mm[:, :, None]).ravel()

    def whitened(columns: Array) -> Array:
        return np.asarray((whitening @ columns).reshape(-1, columns.shape[-1]))

    moves, known = series.nuisances(arm)
    left = _of_model(forward(arm, series.joints_rad)[:, :3, 3], causes)
    B = whitened(np.dstack([moves, left]))
    prior = np.eye(B.shape[1])
    prior[: len(known), : len(known)] = known
    kept = np.linalg.solve(np.eye(len(prior)) + prior @ B.T @ B, prior)
    found = []
    for cause in causes:
        moved = cause.columns.reshape(len(series.share), 3, -1) * series.share[:, None, None]
        D = whitened(moved)
        across = B.T @ D
        information = D.T @ D - across.T @ kept @ across
        pull = D.T @ white - across.T @ kept @ (B.T @ white)
        slopes = np.array(np.linalg.solve(information, pull), dtype=float)
        explained, count = float(pull @ slopes), len(slopes)
        limit = f_quantile(1.0 - RISK / len(causes), count, series.freedom)
        moved_mm = rms(np.linalg.norm((cause.columns @ slopes).reshape(-1, 3), axis=1))
        if explained > count * limit and moved_mm > series.floor_mm:
            found.append((explained - PENALTY * count, cause, slopes))
    if not found:
        return None
    _, cause, slopes = max(found, key=lambda each: each[0])
    size = float(slopes[0]) if len(slopes) == 1 else float(np.linalg.norm(slopes))
    unit = f"{cause.unit} over the run, as of {cause.cause}"
    poses_in_order = "all poses of the run, in their order"
    return Suspicion(Cause.DRIFT, cause.factor * size, unit, poses_in_order)


def _of_model(at_mm: Array, causes: list[Pattern]) -> Array:
    """Return smooth errors that the model may have left, columns (N, 3, K) of 0.05 mm each: the
    causes' own patterns, alike everywhere, and growing along x and along z.

    Poses are visited in an order, so that such an error would look like a slope.
    """
    alike = np.dstack([cause.columns.reshape(len(at_mm), 3, -1) for cause in causes])
    along = (at_mm - at_mm.mean(axis=0))[:, None, [0, 2]] / np.ptp(at_mm, axis=0).max()
    found = np.dstack([alike, alike * along[:, :, :1], alike * along[:, :, 1:]])
    sizes = np.sqrt(np.square(found).sum(axis=1).mean(axis=0))
    model_mm = 0.05  # root mean square over the poses
    return np.asarray(model_mm * found / sizes)


def pose_series(log: Log) -> Series | None:
    """Return the poses of a run; None where no model was fitted, or too few were measured."""
    calibration = learnt_so_far(log)
    if calibration is None or calibration.uncertainty.missing:
        return None
    placed = sorted((p for p in log.points.values() if p.station), key=log.recorded)
    runs = groupby(placed, key=lambda point: (point.station, point.set_up))
    holds = [[p for p in points if _counts(p)] for _, points in runs]
    holds = [points for points in holds if points]
    points = [point for hold in holds for point in hold]
    least_poses = 30
    if len(points) < least_poses:
        return None
    try:
        repeats = Counter(map(_place, points))
        rows = [_hold(log, calibration, hold, repeats) for hold in holds]
    except HilcellError:  # a model that knows nothing of a pose beside its grid
        return None
    off_mm, covariance_mm2, priors = zip(*rows, strict=True)
    share = _shares(log, points)
    scatter_mm2, visits, places = visit_scatter(log, np.eye(3))
    stated = log.cell.uncertainty
    return Series(
        np.concatenate(off_mm),
        np.concatenate(covariance_mm2),
        commanded_rad(points),
        share,
        _warmer_k(points, share * stated.air_range_k),
        np.repeat(np.arange(len(holds), dtype=float), [len(hold) for hold in holds]),
        np.array(priors),
        stated.arm_growth_um_m_k * 1e-6,
        3.0 * (visits - places),
        float(np.sqrt(np.trace(scatter_mm2))),
    )


def _warmer_k(points: list[Point], unknown_k: Array) -> Array:
    """Return the room's warming (N,) since the first; ``unknown_k`` without a weather station."""
    celsius = [p.temperature_c for p in points if p.temperature_c is not None]
    return unknown_k if len(celsius) < len(points) else np.array(celsius) - celsius[0]


def _counts(point: Point) -> bool:
    """Whether a point is the tool point's at a pose that came from below."""
    # Visits of three places alone are left out: the model's errors there are no noise.
    kinds = ("grid", "revisit", "touch", "validate", "closing")
    own = point.id.kind in kinds and point.id.seat is None and not point.id.side
    return own and not point.id.axis and point.commanded_deg is not None


def _place(point: Point) -> tuple[object, ...]:
    """Return what poses have in common that are sent to one place, where the model errs alike."""
    id = point.id
    return ("vertex", id.vertex) if id.vertex else (id.kind, id.station, id.number)


def _hold(
    log: Log,
    calibration: Calibration,
    points: list[Point],
    repeats: Mapping[tuple[object, ...], int],
) -> tuple[Array, Array, Array]:
    """Return offsets (N, 3) in {B} at a hold, covariances (N, 3, 3), and that of {B} (6, 6)."""
    station = log.cell.station_named(points[0].station)
    T_W_B = calibration.base(station.name)
    T_B_L = inverse(T_W_B) @ log.matrix("world")
    poses = forward(log.cell.robot.arm(), commanded_rad(points))
    found = calibration.error_model().predict(poses)
    off_mm = apply(T_B_L, positions_mm(points)) - poses[:, :3, 3] - found.error_mm
    R = T_B_L[:3, :3]
    noise_mm2 = visit_noise(log).covariances(points, R)
    model_mm2 = no_less_than_nought(found.covariance_mm2 - R @ visit_noise(log).robot_mm2 @ R.T)
    shared = np.array([repeats[_place(point)] for point in points], dtype=float)
    covariance_mm2 = noise_mm2 + shared[:, None, None] * model_mm2
    return off_mm, covariance_mm2, _placed(log, T_W_B, points[0])


def _placed(log: Log, T_W_B: Array, point: Point) -> Array:
    """Return how well {B} is known at a hold, (6, 6) in {B}: strip, station frame, tracker."""
    cell, at_mm = log.cell, T_W_B[:3, 3]
    drift_mm2 = rectangular_variance(cell.uncertainty.drift_limit_mm)
    found = base_covariance(log, cell.station_named(point.station))
    found[:3, :3] += hold_covariance(cell)
    found += world_covariance(log, at_mm, drift_mm2) * (2.0 if point.set_up else 1.0)
    turn = np.kron(np.eye(2), T_W_B[:3, :3].T)
    return np.asarray(turn @ found @ turn.T)
