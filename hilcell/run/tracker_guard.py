"""{W} from the nests on the floor (section 5.1), and the proof that the tracker still stands there.

A tracker that was bumped measures everything beside its place, and every reading looks good. So the
floor nests are measured again at the end of every measuring step, after every pause and after so
many points. Where all of them have moved alike, the tracker has: the points since its last proof
are invalid, {W} is framed again at its new set-up, and the step is performed again. Where they
have moved against each other, they are measured once more: the tracker may have been bumped between
two of them. Where they still differ, a nest has moved, and nothing can be trusted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Any, NoReturn

import numpy as np

from hilcell.calibration.causes import Cause, Suspicion
from hilcell.calibration.frames import world_from_tracker
from hilcell.cell.file import Cell
from hilcell.cell.layout import Nest
from hilcell.geometry.beam_noise import BeamNoise
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import coverage_factor, lengths_mm
from hilcell.journal.log import Log, Point, positions_mm
from hilcell.journal.point_id import LENGTH, PointId
from hilcell.journal.reading_noise import noise_at, run_noise
from hilcell.journal.set_ups import FRAMED_AGAIN, PROOFS, PROVEN, TRACKER_MOVED, world_key
from hilcell.ports import Array, DeviceError
from hilcell.run.run_context import RunContext

SIGMAS = 4.0  # of the readings' noise, were it known, beyond the stated drift
ALIKE = 0.5  # of the farthest motion: less moves no nest of a tracker that was bumped
FLOOR_UM_M_K, UNKNOWN_K = 12.0, 10.0  # concrete's and steel's growth; air that nobody measured
MOST_SET_UPS = 5  # of one run: a tracker that moves oftener stands badly


class BlockLost(Exception):
    """The points since the tracker's last proof are invalid; their act is performed again."""


class TrackerGuard:
    """Frames {W} and proves it; ``measure`` measures a floor nest."""

    def __init__(self, run: RunContext, measure: Callable[[PointId, Nest], Point]) -> None:
        self._run, self._measure = run, measure

    def frame_world(self) -> None:
        """Frame {W} at the tracker's present set-up; where that is done, prove it."""
        cell, log = self._run.cell, self._run.log
        number = log.set_ups.number
        if world_key(number) in log.frames:
            self.prove()
            return
        self._discard_begun(number)
        nests = self._measured(_nest_ids(cell, number))
        measured_mm = positions_mm(nests)
        if not number:
            check_places(cell, measured_mm)
            check_distances(cell, measured_mm)
            self._check_before(nests)
        elif any(self._changes(nests)):
            self._renew(nests, self._controls())
        self._run.frame(world_key(number), world_from_tracker(cell, measured_mm), points=nests)

    def _discard_begun(self, number: int) -> None:
        """Discard nests that an engine before this one measured: the tracker may have moved."""
        ids = _nest_ids(self._run.cell, number)
        if begun := [id.key for id in ids if self._run.log.find(id)]:
            self._run.event(FRAMED_AGAIN, invalid=begun)

    def prove(self) -> None:
        """Prove that the tracker stands where {W} was framed.

        Raises `BlockLost` where it has moved, after {W} was framed again, and `DeviceError`
        where a nest has, or where frames rest on what was measured since the last proof.
        """
        cell, log = self._run.cell, self._run.log
        before = [log.point(id) for id in _nest_ids(cell, log.set_ups.number)]
        now = self._controls()
        stand = self._stand(before, now)
        if not stand and (_some_stand(before, now) or any(self._changes(now))):
            now = self._controls()
            stand = self._stand(before, now)
        if not stand:
            if _some_stand(before, now):
                self._blame(_off_mm(before, now))
            self._renew(before, now)
        self._run.event(PROVEN, off_mm=_off_mm(before, now))

    def prove_new(self) -> None:
        """Prove it where something was measured in {W} since it was last proven."""
        log = self._run.log
        if log.set_ups.open and world_key(log.set_ups.number) in log.frames:
            self.prove()

    def prove_where_doubtful(self) -> None:
        """Prove it after a pause, and after as many points as the plan allows between proofs.

        After a pause also where nothing waits for a proof: the next point would be the first of a
        block to be lost. A reflector that is carried by hand stays where it is; every seat of it
        is a pause.
        """
        cell, log = self._run.cell, self._run.log
        done = log.set_ups
        doubtful = done.interrupted or len(done.unproven) >= cell.plan.prove_every
        if doubtful and not cell.layout.by_hand and world_key(done.number) in log.frames:
            self.prove()

    def _measured(self, ids: list[PointId]) -> list[Point]:
        nests = self._run.cell.layout.floor
        return [self._measure(id, nest) for id, nest in zip(ids, nests, strict=True)]

    def _controls(self) -> list[Point]:
        """Measure all floor nests as control points."""
        log, nests = self._run.log, self._run.cell.layout.floor
        return self._measured([_control_id(log, nest) for nest in nests])

    def _renew(self, before: list[Point], now: list[Point]) -> NoReturn:
        """Frame {W} at a new set-up, of a tracker that stands elsewhere than it did ``before``."""
        for fields in self._changes(now):
            then_mm, at_mm = fields["wanted_mm"], fields["distance_mm"]
            raise _moved(
                f"{' to '.join(fields['nests'])} was {then_mm:.3f} mm, is {at_mm:.3f} mm",
                f"{then_mm:.3f} +-{fields['limit_mm']:.3f} mm",
                "a floor nest or its reflector has moved; fix it, then start a new run",
                fields,
            )
        set_ups = self._run.log.set_ups
        limits_mm = limits_of(self._run.cell, run_noise(self._run.log), before, now)
        facts = {
            "moved_mm": float(_off_mm(before, now).max()),
            "limit_mm": float(limits_mm.min()),
        }
        self._check_renewable(facts)
        number, invalid = set_ups.number + 1, list(set_ups.unproven)
        self._run.event(TRACKER_MOVED, set_up=number, invalid=invalid, **facts)
        self.frame_world()
        raise BlockLost

    def _stand(self, before: Sequence[Point], now: Sequence[Point]) -> bool:
        """Whether all nests are seen where they were."""
        limits_mm = limits_of(self._run.cell, run_noise(self._run.log), before, now)
        return bool(np.all(_off_mm(before, now) <= limits_mm))

    def _changes(self, now: list[Point]) -> Iterator[dict[str, Any]]:
        """Yield the pairs of nests whose distance is not the one that {W} was first framed by."""
        cell, log = self._run.cell, self._run.log
        first = [log.point(id) for id in _nest_ids(cell, 0)]
        limits_mm = distance_limits(cell, run_noise(log), first, now)
        return wrong_distances(cell, positions_mm(first), positions_mm(now), limits_mm)

    def _check_before(self, nests: list[Point]) -> None:
        """Refuse nests that have moved since the cell's current calibration was measured.

        The cell file knows their distances to millimetres, the tracker to hundredths.
        """
        cell, before = self._run.cell, self._run.log.inputs.floor_before
        if before is None:
            return
        then_mm = np.array([before.nests_mm[nest.name] for nest in cell.layout.floor])
        limit_mm = limit_since(cell, run_noise(self._run.log), nests, before.temperature_c)
        for fields in wrong_distances(cell, then_mm, positions_mm(nests), limit_mm):
            raise DeviceError(
                "HC-T32",
                "Tracker",
                "world frame",
                f"{' to '.join(fields['nests'])} is {fields['distance_mm']:.3f} mm",
                wanted=f"{fields['wanted_mm']:.3f} +-{limit_mm:.3f} mm, as in run {before.run}",
                act="a floor nest has moved since that run, or a reflector is not seated; put it "
                "right and resume, or revoke that run's calibration and start a new run",
                fields=fields | {"run": before.run},
            )

    def _blame(self, off_mm: Array) -> NoReturn:
        """Refuse nests of which some stand: one that is lifted out of the plane of three changes
        no distance by as much as would show.
        """
        stands = off_mm <= ALIKE * off_mm.max()
        names = np.array([nest.name for nest in self._run.cell.layout.floor])
        moving, standing = names[~stands].tolist(), names[stands].tolist()
        raise _moved(
            f"{', '.join(moving)} moved by {off_mm.max():.3f} mm, {', '.join(standing)} by "
            f"{off_mm[stands].max():.3f} mm at most",
            "all alike, as of a tracker that was moved",
            "a floor nest or its reflector has moved, or the tracker has tilted; check them, then "
            "start a new run",
            {"nests": moving, "moved_mm": float(off_mm.max()), "standing": standing},
        )

    def _check_renewable(self, facts: dict[str, Any]) -> None:
        """Refuse to go on where frames rest on invalid points, or after too many set-ups."""
        log = self._run.log
        invalid = [log.points[key] for key in log.set_ups.unproven if key in log.points]
        built = next((key for point in invalid if (key := _rests_on(log, point))), "")
        if not built and log.set_ups.number < MOST_SET_UPS:
            return
        act = "fix its stand, then start a new run"
        if built:
            act = f"{built} rests on points measured since it was proven; start a new run"
        suspicion = Suspicion(Cause.TRACKER_MOVED, facts["moved_mm"], "mm", "control points")
        raise _moved(
            f"moved by {facts['moved_mm']:.3f} mm",
            f"<= {facts['limit_mm']:.3f} mm",
            f"the tracker was bumped: {act}",
            facts | suspicion.facts,
        )


def limits_of(cell: Cell, noise: BeamNoise, before: Sequence[Point], now: Sequence[Point]) -> Array:
    """Return by how much each nest (N,) may seem to move: stated drift, and the readings' noise.

    The noise is what all readings of the run so far have shown, at the nest.
    """
    mm2 = noise_at(noise, before) + noise_at(noise, now)
    return _limits(cell, noise, np.trace(mm2, axis1=-2, axis2=-1))


def _limits(cell: Cell, noise: BeamNoise, variances_mm2: Array) -> Array:
    """Return the limits (N,) of lengths by the variances of their noise (N,)."""
    sigmas = coverage_factor(SIGMAS, noise.freedom)
    limits: Array = np.sqrt(3.0) * cell.uncertainty.drift_limit_mm + sigmas * np.sqrt(variances_mm2)
    return limits


def distance_limits(
    cell: Cell, noise: BeamNoise, before: Sequence[Point], now: Sequence[Point]
) -> Array:
    """Return by how much distances between nests (N, N) may seem to change, as `limits_of`.

    Of the readings' noise counts what lies along the line between the two.
    """
    mm2 = noise_at(noise, before) + noise_at(noise, now)
    at_mm = positions_mm(before)
    lines_mm = at_mm[:, None] - at_mm[None]
    along = lines_mm / np.maximum(np.linalg.norm(lines_mm, axis=-1), 1.0)[..., None]
    both_mm2 = np.einsum("ijk,ijkl,ijl->ij", along, mm2[:, None] + mm2[None], along)
    return _limits(cell, noise, both_mm2)


def limit_since(
    cell: Cell, noise: BeamNoise, nests: Sequence[Point], then_c: float | None
) -> float:
    """Return by how much distances of the floor nests may differ from those of an earlier run.

    Besides noise and stated drift both runs have the tracker's limits, and the floor has grown.
    """
    now_c = [point.temperature_c for point in nests if point.temperature_c is not None]
    known = bool(now_c) and then_c is not None
    warmer_k = abs(float(np.mean(now_c)) - (then_c or 0.0)) if known else UNKNOWN_K
    at_mm = positions_mm(nests)
    longest_mm = float(np.linalg.norm(at_mm[:, None] - at_mm[None], axis=-1).max())
    far_mm = float(np.linalg.norm(at_mm, axis=1).max())
    stated = cell.uncertainty
    tracker_mm = 2.0 * (stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * far_mm)
    grown_mm = 1e-6 * FLOOR_UM_M_K * warmer_k * longest_mm
    return float(limits_of(cell, noise, nests, nests).max()) + tracker_mm + grown_mm


def _off_mm(before: Sequence[Point], now: Sequence[Point]) -> Array:
    """Return by how much each nest (N,) seems to have moved."""
    return lengths_mm(positions_mm(now) - positions_mm(before))


def _some_stand(before: Sequence[Point], now: Sequence[Point]) -> bool:
    """Whether some nests are hardly moved beside the others: no motion of a tracker does that."""
    off_mm = _off_mm(before, now)
    return bool(np.any(off_mm <= ALIKE * off_mm.max()))


def check_places(cell: Cell, measured_mm: Array) -> None:
    """Refuse nests that were seen outside the tracker's search for them.

    Distances do not tell that two nests changed places in a symmetric triangle; places do.
    """
    nests, limit_mm = cell.layout.floor, cell.tracker.find_radius_mm
    nominal_mm = np.array([nest.xyz_mm for nest in nests])
    expected_mm = apply(inverse(cell.tracker.pose.matrix()), nominal_mm)
    off_mm = np.linalg.norm(measured_mm[:, None] - expected_mm[None], axis=-1)
    for nest, row_mm, found_mm in zip(nests, off_mm, np.diag(off_mm), strict=True):
        if found_mm <= limit_mm:
            continue
        near = zip(nests, row_mm, strict=True)
        at = [other.name for other, each_mm in near if each_mm <= limit_mm]
        where = f", where {at[0]} is expected" if at else ""
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"{nest.name} was seen {found_mm:.1f} mm from its expected place{where}",
            wanted=f"<= {limit_mm:.1f} mm (tracker.find_radius_mm)",
            act="nests swapped, or the tracker does not stand as tracker.pose says; check, then "
            "resume",
            fields={
                "nest": nest.name,
                "off_mm": float(found_mm),
                "limit_mm": limit_mm,
                "seen_at": at[:1],
            },
        )


def check_distances(cell: Cell, measured_mm: Array) -> None:
    """Refuse nests whose distances are not those of the cell file: swapped, lifted, wrong unit."""
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    limit_mm = 2 * cell.layout.nest_tolerance_mm
    for fields in wrong_distances(cell, nominal_mm, measured_mm, limit_mm):
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"{' to '.join(fields['nests'])} is {fields['distance_mm']:.2f} mm",
            wanted=f"{fields['wanted_mm']:.2f} +-{limit_mm:.1f} mm",
            act="nests swapped, a reflector not seated, or wrong units; check, then resume",
            fields=fields,
        )


def wrong_distances(
    cell: Cell, wanted_mm: Array, found_mm: Array, limits_mm: Array | float
) -> Iterator[dict[str, Any]]:
    """Yield the pairs of floor nests whose distance is not that of ``wanted_mm`` (N, 3).

    ``limits_mm`` is one for all, or (N, N).
    """
    names = [nest.name for nest in cell.layout.floor]
    each_mm = np.broadcast_to(limits_mm, (len(names), len(names)))
    for pair in combinations(range(len(names)), 2):
        then, now = (
            float(np.linalg.norm(at_mm[pair[0]] - at_mm[pair[1]]))
            for at_mm in (wanted_mm, found_mm)
        )
        limit_mm = float(each_mm[pair])
        if not abs(now - then) <= limit_mm:
            yield {
                "nests": [names[n] for n in pair],
                "distance_mm": now,
                "wanted_mm": then,
                "limit_mm": limit_mm,
            }


def _nest_ids(cell: Cell, set_up: int) -> list[PointId]:
    """Return the identities of the points that frame {W} at a set-up."""
    return [PointId("world", number=set_up or None, nest=nest.name) for nest in cell.layout.floor]


def _control_id(log: Log, nest: Nest) -> PointId:
    """Return the identity of the nest's next control point."""
    before = (point for kind in (*PROOFS, LENGTH) for point in log.measured(kind))
    turn = sum(point.id.nest == nest.name for point in before)
    return PointId("control", session=log.session, turn=turn, nest=nest.name)


def _rests_on(log: Log, point: Point) -> str:
    """Return the frame or verdict that was built with a point, if there is one."""
    built = {
        "base": "base",
        "slide": f"station.{point.station}",
        "three": f"three_points.{point.station}",
        "grid": "fit",
        "oriented": "fit",
        "pose": "fit",
        "repeatability": "fit",
    }.get(point.id.kind, "")
    return built if built in log.frames or built in log.verdicts else ""


def _moved(found: str, wanted: str, act: str, fields: dict[str, Any]) -> DeviceError:
    return DeviceError(
        "HC-T33", "Tracker", "control points", found, wanted=wanted, act=act, fields=fields
    )
