"""{S} at every station from nests on the slide, and a comparison with {B}'s repeatability.

Section 4.2, eqs 14-17, Figs 7 and 8. Best fit of all nests, averaged: the lever arm to the tool
multiplies every angle. The noise of both frames, the station's and the reference's, counts.

Distances between nests depend on no frame: a nest that has moved against the others shows in them,
and is left out. A symmetry of the body keeps every distance, so distances identify a body only
together with rough expected positions. Both use the noise of all readings of the run: the spread of
a few says little.

To compare the frames, six slide points are measured apart from those that build them, and expressed
at every station in the base frame and in the station frame built there: both should give their
positions at the reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from operator import itemgetter

import numpy as np

from hilcell.calibration.frames import frame_of_sweeps
from hilcell.cell.file import Cell, Nest, Station
from hilcell.decoding import typed
from hilcell.geometry.frames import (
    RigidFit,
    apply,
    inverse,
    point_uncertainty,
    rigid_fit,
    three_point_frame,
)
from hilcell.geometry.statistics import CONFIDENCE, coverage_factor, f_quantile, lengths_mm, rms
from hilcell.journal.log import Log, noise_at, positions_mm, run_noise
from hilcell.model.frame import Frame, MeasuredStation
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import Point, PointId
from hilcell.model.results import FramedStation, FramesRepeated
from hilcell.ports import Array, DeviceError, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures import plan
from procedures.base_frame import check_circles, points_on_arc, sweep, sweeps

THREE, FEW = "three_points", 3
THREE_SAMPLES = 3  # the paper does not state how many readings it took of each


class StationFrames:
    """Holds each station and measures all slide nests, averaged, before the robot works there.

    The paper's own frame, from three points, is taken beside it for comparison.
    """

    name = "station-frames"
    needs = "the world frame, reflectors in the slide nests"
    moves = "the slide from station to station"
    measures = "every slide nest at every station"
    yields = "the slide in {W} at every station, with the tool point's uncertainty"

    def __init__(self, *, validated: bool = False) -> None:
        """``validated``: all stations are validated afterwards, on a quick plan framed then."""
        self._validated = validated

    def announced(self, cell: Cell) -> str:
        return self.moves if cell.has_rail else "nothing"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse nests out of the tracker's range at any station."""
        if not cell.has_rail:
            return PlannedStep(self.name, 0, 0.0, note="the robot stands on the floor")
        nests_mm = np.array([nest.xyz_mm for nest in cell.layout.slide])
        for station in cell.station:
            world_mm = apply(cell.layout.nominal_base(station.rail_mm), nests_mm)
            plan.check_range(cell, world_mm, f"slide nests at {station.name}")
        here = cell.reference
        spans = [Span("park", 0, plan.park_s(cell))]
        stations = self._stations(cell)
        for station in stations:
            spans += frame_spans(cell, here, station)
            here = station
        return PlannedStep.of_spans(self.name, len(stations) * nest_points(cell), spans)

    def perform(self, session: CellSession) -> None:
        for station in self._stations(session.cell):
            frame_station(session, station)
        session.reach("frame_stations")

    def _stations(self, cell: Cell) -> list[Station]:
        later = self._validated and cell.plan.quick
        return [cell.reference] if later else plan.stations_in_order(cell)

    def result(self, log: Log) -> Result:
        names = [station.name for station in log.cell.station]
        frames = {name: log.frame(MeasuredStation, f"station.{name}") for name in names}
        return {
            "stations": {
                name: typed(frame, FramedStation, from_attributes=True)
                for name, frame in frames.items()
            }
        }

    @staticmethod
    def table(result: Result) -> Table:
        return Table(
            [
                Column("station", itemgetter(0)),
                Column("strip", lambda row: row[1].strip_mm, "mm", ".2f"),
                Column("fit rms", lambda row: row[1].rms_mm, "mm", ".4f"),
                Column("tool point u", lambda row: row[1].tool_uncertainty_mm, "mm", ".4f"),
                Column("worst corner u", lambda row: row[1].cube_uncertainty_mm, "mm", ".4f"),
                Column("left out", lambda row: ", ".join(row[1].left_out) or "none"),
            ],
            typed(result["stations"], dict[str, FramedStation]).items(),
        )


def nest_points(cell: Cell) -> int:
    return len(cell.layout.slide) + (0 if cell.plan.quick else FEW)


def frame_spans(cell: Cell, here: Station, there: Station, *, verifies: bool = True) -> list[Span]:
    nests = plan.readings(cell, len(cell.layout.slide), cell.nest_samples)
    few = [] if cell.plan.quick else [plan.readings(cell, FEW, THREE_SAMPLES)]
    proofs = plan.closing(cell, carried=True) if verifies else []
    return [*plan.leg(cell, here, there), nests, *few, *proofs]


def frame_station(session: CellSession, station: Station, *, verifies: bool = True) -> None:
    """Measure the nests at a station; ``verifies``: the tracker at once, not with later points."""
    if f"station.{station.name}" in session.log.frames:
        return
    cell = session.cell
    if not cell.has_rail:
        _frame_fixed(session, station)
        return
    session.hold_station(station)
    session.park_robot()
    for number, nest in enumerate(cell.layout.slide):
        id = slide_id(station, nest)
        session.slide_point(id, station, nest, samples=cell.nest_samples)
        if cell.layout.by_hand and number < FEW and not cell.plan.quick:
            three_point(session, station, nest)  # while the reflector is there
    few = [] if cell.plan.quick else cell.layout.slide[:FEW]
    three = [three_point(session, station, nest) for nest in few]
    if verifies:
        session.close_step(carried=True)
    if three:
        three_mm = apply(session.log.matrix("world"), positions_mm(three))
        T, keys = three_point_frame(*three_mm), [point.key for point in three]
        session.frame(f"{THREE}.{station.name}", Frame(matrix=T.tolist(), points=keys))
    moved = moved_nests(session.log, station)
    left_out = moved.checked(cell, station)
    fit = station_fit(session.log, station)
    cube_mm = check_accepted(cell, station, fit)
    points = session.log.select("slide", station.name)
    if (strip_mm := points[-1].strip_mm) is None:
        raise LookupError(f"{points[-1].key} has no reading of the strip")
    framed = MeasuredStation(
        matrix=fit.T.tolist(),
        points=[point.key for point in points],
        covariance=fit.covariance.tolist(),
        rms_mm=fit.rms_mm,
        strip_mm=strip_mm,
        tool_uncertainty_mm=tool_uncertainty_mm(cell, fit),
        cube_uncertainty_mm=cube_mm,
        left_out=left_out,
    )
    session.frame(f"station.{station.name}", framed)


def _frame_fixed(session: CellSession, station: Station) -> None:
    """Journal {B} as {S}, by both methods: without a rail nothing moves it."""
    base = session.log.frames["base"]
    three = Frame(matrix=base.matrix, points=base.points)
    session.frame(f"{THREE}.{station.name}", three)
    framed = MeasuredStation(
        matrix=base.matrix,
        points=base.points,
        covariance=np.zeros((6, 6)).tolist(),
        rms_mm=0.0,
        strip_mm=station.strip_mm,
        tool_uncertainty_mm=0.0,
        cube_uncertainty_mm=0.0,
        left_out=[],
    )
    session.frame(f"station.{station.name}", framed)


def three_point(session: CellSession, station: Station, nest: Nest) -> Point:
    """Return a slide nest's point for the paper's own frame, measured once."""
    id = PointId("three", station=station.name, nest=nest.name)
    return session.slide_point(id, station, nest, samples=THREE_SAMPLES)


def slide_id(station: Station, nest: Nest) -> PointId:
    return PointId("slide", station=station.name, nest=nest.name)


def slide_points(log: Log, station: Station) -> list[Point]:
    return [log.point(slide_id(station, nest)) for nest in log.cell.layout.slide]


def slide_in_world_mm(log: Log, station: Station) -> Array:
    """Return the slide nests (N, 3) in {W} as measured at ``station``."""
    return apply(log.matrix("world"), positions_mm(slide_points(log, station)))


def station_fit(log: Log, station: Station) -> RigidFit:
    """Fit of T_W_S. At the reference eqs 14-16 on its first three nests define {S}; elsewhere {S}
    is the best fit of all unmoved nests to their positions in the reference's {S}.
    """
    at_reference_mm = slide_in_world_mm(log, log.cell.reference)
    T_S_W = inverse(three_point_frame(*at_reference_mm[:3]))
    kept = list(moved_nests(log, station).kept)
    return rigid_fit(
        apply(T_S_W, at_reference_mm)[kept],
        slide_in_world_mm(log, station)[kept],
        weights=pair_noise_mm2(log, station)[kept],
    )


def moved_nests(log: Log, station: Station) -> Moved:
    """Return which nests have moved on the slide between the reference and ``station``."""
    return moved_points(
        slide_in_world_mm(log, log.cell.reference),
        slide_in_world_mm(log, station),
        pair_noise_mm2(log, station),
        coverage_factor(SIGMAS, run_noise(log).freedom),
    )


def check_accepted(cell: Cell, station: Station, fit: RigidFit) -> float:
    """Return the tool point's uncertainty at the cube's worst corner; refuse one too large."""
    found_mm, limit_mm = cube_uncertainty_mm(cell, fit), cell.layout.max_tool_std_mm
    if not found_mm <= limit_mm:
        raise DeviceError(
            "HC-T62",
            "Tracker",
            f"station frame {station.name}",
            f"the tool point would be uncertain by {found_mm:.3f} mm (3-D, 1 sigma) at the cube's "
            "worst corner",
            expected=f"<= {limit_mm:.3f} mm (layout.max_tool_std_mm)",
            act="clean and tighten nests and reflectors, take more readings (layout.nest_samples) "
            "or nests further apart, then start a new run",
            fields={
                "station": station.name,
                "found_mm": found_mm,
                "limit_mm": limit_mm,
                "rms_mm": fit.rms_mm,
            },
        )
    return found_mm


def pair_noise_mm2(log: Log, station: Station) -> Array:
    """Return the covariances (N, 3, 3) in {W} of each nest at the station less at the reference."""
    R, noise = log.matrix("world")[:3, :3], run_noise(log)  # of all readings of the run so far
    there_mm2, here_mm2 = (
        R @ noise_at(noise, slide_points(log, each)) @ R.T for each in (station, log.cell.reference)
    )
    return there_mm2 + here_mm2


def tool_uncertainty_mm(cell: Cell, fit: RigidFit) -> float:
    """Return the 1-sigma uncertainty of the grid's centre as carried by the station frame."""
    return point_uncertainty(fit, _in_slide_mm(cell, cell.grid.centre.matrix()[None, :3, 3])[0])


def cube_uncertainty_mm(cell: Cell, fit: RigidFit) -> float:
    """The same at the worst corner of the cube, its maximum over the cube."""
    signs = np.array(list(product((-0.5, 0.5), repeat=3)))
    corners_mm = cell.grid.centre.matrix()[:3, 3] + signs * np.array(cell.grid.size_mm)
    return max(point_uncertainty(fit, corner) for corner in _in_slide_mm(cell, corners_mm))


def _in_slide_mm(cell: Cell, points_mm: Array) -> Array:
    """Return points (N, 3) of {B} in {S}, both nominal."""
    nests_mm = np.array([nest.xyz_mm for nest in cell.layout.slide])
    return apply(inverse(three_point_frame(*nests_mm[:3])), points_mm)


# -- which frame repeats better ----------------------------------------------------------------


SIX = 6
MORE_READINGS = 4  # than for a frame, so that the points' own noise does not hide the frames'


class FrameRepeatability:
    """Builds the base frame at every station and measures six slide points again."""

    name = "frame-repeatability"
    needs = "the stations framed"
    moves = "the slide from station to station, axes 1 and 6 at each"
    measures = "circles of axes 1 and 6, six slide points at every station"
    yields = "how much better the station frame repeats, with an interval"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a cell with one station: frames are compared between stations."""
        if len(cell.station) < 2:
            raise HilcellError(
                "one station, expected two or more: frames are compared between them", code="HC-C10"
            )
        here, spans = plan.other_stations(cell)[-1], []  # where the last step left the slide
        six = plan.readings(cell, SIX, MORE_READINGS * cell.nest_samples)
        for station in cell.station:
            check_circles(cell, station)
            spans += [*plan.leg(cell, here, station), six, sweeps(cell), *plan.closing(cell)]
            here = station
        return PlannedStep.of_spans(
            self.name, len(cell.station) * (2 * points_on_arc(cell) + SIX), spans
        )

    def perform(self, session: CellSession) -> None:
        for station in session.cell.station:
            if f"base.{station.name}" not in session.log.frames:
                self._frame(session, station)

    def _frame(self, session: CellSession, station: Station) -> None:
        samples = MORE_READINGS * session.cell.nest_samples
        for nest in session.cell.layout.slide[-SIX:]:
            id = PointId("six", station=station.name, nest=nest.name)
            session.slide_point(id, station, nest, samples=samples)
        for axis in (1, 6):
            for number, joints in enumerate(sweep(session.cell, axis)):
                id = PointId("frames", station=station.name, axis=axis, number=number)
                session.flange_point(id, station, joints)
        session.close_step()
        circles = [session.log.select("frames", station.name, axis=axis) for axis in (1, 6)]
        T_W_B = frame_of_sweeps(session.cell, session.log, *circles)[0]
        keys = [point.key for point in (*circles[0], *circles[1])]
        session.frame(f"base.{station.name}", Frame(matrix=T_W_B.tolist(), points=keys))

    def result(self, log: Log) -> Result:
        """Return the distances in both frames, and the ratio of their root mean squares.

        Its interval is that of an F distribution with six degrees of freedom for every station
        compared: the errors of one frame move all six points together.
        """
        base, station = self._moved_mm(log, "base"), self._moved_mm(log, "station")
        rms_mm = {"base": rms([*base.values()]), "station": rms([*station.values()])}
        ratio, freedoms = rms_mm["base"] / rms_mm["station"], 6 * len(base)
        spread = float(np.sqrt(f_quantile(0.5 + CONFIDENCE / 2, freedoms, freedoms)))
        found = FramesRepeated(
            base=base,
            station=station,
            rms_mm=rms_mm,
            ratio=ratio,
            ratio_interval=(ratio / spread, ratio * spread),
        )
        return {"frame_repeatability": found}

    @staticmethod
    def _moved_mm(log: Log, kind: str) -> dict[str, list[float]]:
        """Distances of the six points from their places at the reference (mm) by station, in
        ``kind``, "base" or "station".
        """
        reference_mm = FrameRepeatability._seen_from(log, kind, log.cell.reference)
        return {
            station.name: lengths_mm(
                FrameRepeatability._seen_from(log, kind, station) - reference_mm
            ).tolist()
            for station in plan.other_stations(log.cell)
        }

    @staticmethod
    def _seen_from(log: Log, kind: str, station: Station) -> Array:
        """Return the six points (6, 3) in the base or station frame of ``station``."""
        world_mm = apply(log.matrix("world"), positions_mm(log.select("six", station.name)))
        return apply(inverse(log.matrix(f"{kind}.{station.name}")), world_mm)

    @staticmethod
    def table(result: Result) -> Table:
        found = typed(result["frame_repeatability"], FramesRepeated)
        rows: list[tuple[str, float | None, float | None]] = [
            (f"{name}, point {n}", *both)
            for name, in_base_mm in found.base.items()
            for n, both in enumerate(zip(in_base_mm, found.station[name], strict=True), 1)
        ]
        low, high = found.ratio_interval
        rows.append(("rms", found.rms_mm["base"], found.rms_mm["station"]))
        rows.append((f"ratio {found.ratio:.1f} (95 %: {low:.1f} .. {high:.1f})", None, None))
        return Table(
            [
                Column("moved against the reference", itemgetter(0)),
                Column("base frame", itemgetter(1), "mm", ".4f"),
                Column("station frame", itemgetter(2), "mm", ".4f"),
            ],
            rows,
        )


SIGMAS = 4.0  # known ones. 28 pairs of 8 nests at 3 stations: by chance one in a hundred runs


@dataclass(frozen=True, slots=True)
class Moved:
    """Points (by number) that moved against those ``kept``; the worst distance and its limit."""

    moved: tuple[int, ...]
    kept: tuple[int, ...]
    worst_mm: float
    limit_mm: float

    def checked(self, cell: Cell, station: Station) -> list[str]:
        """Return the names of nests to be left out; refuse a station where too few remain."""
        names = [cell.layout.slide[n].name for n in self.moved]
        least = 4  # with three, the moved one is ambiguous
        if names and len(self.kept) < least:
            raise DeviceError(
                "HC-T61",
                "Tracker",
                f"station frame {station.name}",
                f"slide nests {', '.join(names)} have moved against the others: a distance changed "
                f"by {self.worst_mm:.3f} mm",
                expected=f"<= {self.limit_mm:.3f} mm, or {least} nests that agree",
                act="see that every reflector sits in its own nest and is clean, that no nest is "
                "loose; then start a new run",
                fields={
                    "station": station.name,
                    "nests": names,
                    "moved_mm": self.worst_mm,
                    "limit_mm": self.limit_mm,
                    "kept": len(self.kept),
                },
            )
        return names


def moved_points(a_mm: Array, b_mm: Array, covariances_mm2: Array, sigmas: float = SIGMAS) -> Moved:
    """Which of the points (N, 3), measured as ``a`` and later as ``b``, moved on their body.

    ``covariances_mm2`` (N, 3, 3): of each pair's difference, axes of b. Where they are estimates,
    ``sigmas`` is the factor of the same risk (`coverage_factor`). The point with the most excess in
    its distances to the others is removed until all distances agree.
    """

    def apart_mm(points_mm: Array) -> Array:
        return np.asarray(np.linalg.norm(points_mm[:, None] - points_mm[None], axis=-1))

    change_mm = apart_mm(b_mm) - apart_mm(a_mm)
    # by which each pair may differ besides: a reflector taken out and put back
    by_seating_mm = 0.005
    limit_mm = sigmas * np.sqrt(_variances(b_mm, covariances_mm2) + by_seating_mm**2)
    ratio = np.abs(change_mm) / limit_mm
    np.fill_diagonal(ratio, 0.0)
    ratio[~np.isfinite(ratio)] = np.inf  # not a number agrees with nothing
    kept, moved = list(range(len(a_mm))), []
    while True:
        excess = ratio[np.ix_(kept, kept)]
        bad = ~(excess <= 1.0)
        if not bad.any():
            break
        worst = kept[int(np.argmax(np.where(bad, np.minimum(excess, 1e6) ** 2, 0.0).sum(axis=1)))]
        kept.remove(worst)
        moved.append(worst)
    first, second = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    return Moved(
        tuple(sorted(moved)),
        tuple(kept),
        float(np.abs(change_mm[first, second])),
        float(limit_mm[first, second]),
    )


def _variances(points_mm: Array, covariances_mm2: Array) -> Array:
    """Return the variances (N, N) of distances between points (N, 3) along their directions."""
    between = points_mm[:, None] - points_mm[None]
    length = np.linalg.norm(between, axis=-1, keepdims=True)
    direction = np.divide(between, length, out=np.zeros_like(between), where=length > 0)
    pairs = covariances_mm2[:, None] + covariances_mm2[None]
    variances: Array = np.einsum("mni,mnij,mnj->mn", direction, pairs, direction)
    return variances
