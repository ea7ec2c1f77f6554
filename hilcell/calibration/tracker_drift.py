"""A tracker that turns or shifts slowly, by less between two proofs than a proof can tell.

Each proof of the floor nests keeps its limit, or {W} is framed again; in between all is measured a
little beside its place. So all readings of the floor nests are fitted with one motion of the
tracker, linear in the run's records, each set-up from a start of its own. A tracker that was bumped
shows no slope within a set-up, and one that wanders is not explained by one slope.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.causes import RISK, SPREAD, Cause, Suspicion
from hilcell.geometry.frames import motion_levers
from hilcell.geometry.statistics import f_quantile, lengths_mm
from hilcell.journal.log import NO_READINGS, Log, Point, positions_mm
from hilcell.journal.reading_noise import noise_at, run_noise
from hilcell.journal.set_ups import PROOFS
from hilcell.ports import Array

NOTICED_BY = "floor nests, in the order of their readings"
LEAST_READINGS = 4  # of each nest
MOST_LEFT = 0.1  # of chi^2, by a slope that is not quite straight; a step leaves a quarter or more
URAD = 1e6
CAUSES = (("mm of the tracker over the run", slice(0, 3), 1.0),
          ("urad of the tracker over the run", slice(3, 6), URAD))  # fmt: skip


def tracker_drift(log: Log) -> Suspicion | None:
    """Return a slow motion of the tracker beyond the drift that the cell states, if there is."""
    return log.once(_tracker_drift, besides=NO_READINGS)


def _tracker_drift(log: Log) -> Suspicion | None:
    nests = [nest.name for nest in log.cell.layout.floor]
    points = [p for kind in PROOFS for p in log.measured(kind) if p.id.nest in nests]
    if len(points) < LEAST_READINGS * len(nests):
        return None
    noise = run_noise(log)
    at_mm, share = positions_mm(points), _shares(log, points)
    off_mm, since = _within(points, at_mm, share)
    J = motion_levers(at_mm)[:, :, :6] * since[:, None, None]
    whitening = np.linalg.inv(np.linalg.cholesky(noise_at(noise, points)))
    white = (whitening @ off_mm[:, :, None]).ravel()
    groups = len({(p.set_up, p.id.nest) for p in points})
    found = []
    for unit, own, factor in CAUSES:
        D = (whitening @ J[:, :, own]).reshape(-1, 3)
        motion = np.linalg.lstsq(D, white, rcond=None)[0]
        left = float(np.square(white - D @ motion).sum())
        explained = float(np.square(white).sum()) - left
        found.append((left, explained, motion, unit, own, factor))
    left, explained, motion, unit, own, factor = min(found, key=lambda each: each[0])
    freedom = 3 * (len(points) - groups) - 3
    sure = explained > 3 * SPREAD * f_quantile(1.0 - RISK / len(CAUSES), 3, noise.freedom)
    chance = freedom * SPREAD * f_quantile(1.0 - RISK, freedom, noise.freedom)
    alone = left <= chance + MOST_LEFT * (explained + left)
    moved_mm = lengths_mm(motion_levers(at_mm)[:, :, own] @ motion).max()
    limit_mm = np.sqrt(3.0) * log.cell.uncertainty.drift_limit_mm
    if not (sure and alone and moved_mm > limit_mm):
        return None
    return Suspicion(Cause.DRIFT, factor * float(np.linalg.norm(motion)), unit, NOTICED_BY)


def _shares(log: Log, points: list[Point]) -> Array:
    """Return which share (N,) of the run's records was over at each point."""
    seen = np.array([log.recorded(point) for point in points], dtype=float)
    shares: Array = (seen - seen.min()) / (seen.max() - seen.min())
    return shares


def _within(points: list[Point], at_mm: Array, share: Array) -> tuple[Array, Array]:
    """Return places (N, 3) and shares (N,) less the mean of the same nest at the same set-up,
    weighted by their readings.
    """
    off_mm, since = at_mm.copy(), share.copy()
    samples = np.array([point.samples for point in points], dtype=float)
    for group in {(p.set_up, p.id.nest) for p in points}:
        rows = [n for n, p in enumerate(points) if (p.set_up, p.id.nest) == group]
        off_mm[rows] -= np.average(at_mm[rows], axis=0, weights=samples[rows])
        since[rows] -= np.average(share[rows], weights=samples[rows])
    return off_mm, since
