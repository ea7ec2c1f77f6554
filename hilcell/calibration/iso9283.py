"""Pose test of ISO 9283:1998: poses, characteristics, uncertainties and conditions.

Positions (n, 3) in mm, axes of the base; each attained n times. Each U (k = 2) includes the scatter
of n attainments (GUM 4.2.3), that of AP and AD the common errors as well. AP is relative to the
commanded pose in {B}: it includes the uncertainty of {B} where the run measured {B}, else that of
{W}. RP, AD and RD need no frame. RP of angles needs several reflectors; AP of angles also their
positions on the flange, from a calibration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Self

import msgspec
import numpy as np
from msgspec.structs import replace

from hilcell.calibration.lookup import calibration_in
from hilcell.calibration.measurement_budget import (
    CENTRED,
    NOISE,
    WORLD,
    combined_mm,
    expanded_mm,
    measurement_budget,
)
from hilcell.calibration.orientation import last_orientation_errors, orientation_covariances_rad2
from hilcell.calibration.position_errors import Errors, position_errors
from hilcell.cell.file import Cell
from hilcell.compensation.kinematic import Kinematic
from hilcell.geometry.frames import apply, inverse, motion_levers
from hilcell.geometry.statistics import from_mean_mm, repeatability_mm, rms, without_noise
from hilcell.journal.log import Log, variances_mm2
from hilcell.model.outcome import Outcome, outcome_of
from hilcell.model.point import Point
from hilcell.model.verdicts import (
    AD,
    AP,
    AP_ANGLES,
    CHARACTERISTICS,
    ISO,
    RD,
    RP,
    RP_ANGLES,
    Characteristic,
    PoseTested,
)
from hilcell.ports import Array

ANGLES = ("a", "b", "c")  # rotations about x, y, z of the base


class Worst(NamedTuple):
    """A characteristic at its worst: absolute value, U, and the limit if stated."""

    of: Characteristic
    symbol: str
    where: str
    value: float
    U: float
    limit: float | None

    @property
    def outcome(self) -> Outcome | None:
        """Decision by the rule of all results; None without a limit."""
        return None if self.limit is None else outcome_of(self.value, self.limit, self.U)


# -- results, with the names that they have in JSON; lengths in mm, U at 95 % (k = 2) --------------


class Cube(msgspec.Struct, frozen=True):
    """The test cube in {B}, and the plane of the poses by its corners."""

    side_mm: float
    centre_mm: list[float]
    plane: str

    @classmethod
    def largest(cls, cell: Cell) -> Self:
        """Largest cube in the grid's volume, edges parallel to the base (6.8.2)."""
        centre_mm = cell.grid.centre.matrix()[:3, 3].tolist()
        return cls(min(cell.grid.size_mm), centre_mm, "-".join(PLANE))


class Pose(msgspec.Struct, frozen=True):
    """AP and RP of one pose. AP: barycentre of the attained positions less the commanded one."""

    commanded_mm: list[float]
    count: int
    ap_mm: float
    ap_x_mm: float
    ap_y_mm: float
    ap_z_mm: float
    ap_u95_mm: float
    rp_mm: float
    rp_u95_mm: float
    rp_robot_mm: float  # the measurement's noise taken off
    l_mean_mm: float
    s_l_mm: float

    @classmethod
    def of(cls, at: Errors, commanded_mm: Array, shared_mm2: Array, noise_mm2: float) -> Self:
        """AP and RP of positions attained at one commanded position (7.2.1, 7.2.2).

        All attainments share the covariance ``shared_mm2`` (3, 3). ``noise_mm2``: the trace of the
        measurement's covariance. U of RP_l = mean + 3 S is the scatter of both, taken as
        independent.
        """
        attained_mm = at.nominal_mm + at.error_mm
        count, scatter_mm2 = len(attained_mm), np.cov(attained_mm.T)
        ap_mm = attained_mm.mean(axis=0) - at.nominal_mm[0]
        ap_p_mm = float(np.linalg.norm(ap_mm))
        along = ap_mm / ap_p_mm if ap_p_mm > 0.0 else np.eye(3)[0]
        known_mm2 = scatter_mm2 / count + shared_mm2
        l_mm = from_mean_mm(attained_mm)
        rp_mm, s_l_mm = repeatability_mm(l_mm), float(l_mm.std(ddof=1))
        return cls(
            commanded_mm.tolist(),
            count,
            ap_p_mm,
            float(ap_mm[0]),
            float(ap_mm[1]),
            float(ap_mm[2]),
            expanded_mm(math.sqrt(float(along @ known_mm2 @ along))),
            rp_mm,
            expanded_mm(s_l_mm * math.sqrt(1.0 / count + 9.0 / (2.0 * (count - 1)))),
            rp_mm * without_noise(float(np.trace(scatter_mm2)), noise_mm2),
            float(l_mm.mean()),
            s_l_mm,
        )


class Distance(msgspec.Struct, frozen=True):
    """AD and RD of one distance; AD_x, AD_y, AD_z: of the distances along each axis."""

    start: str = msgspec.field(name="from")
    to: str
    commanded_mm: float
    ad_mm: float
    ad_x_mm: float
    ad_y_mm: float
    ad_z_mm: float
    ad_u95_mm: float
    rd_mm: float
    rd_u95_mm: float

    @classmethod
    def of(cls, ends: tuple[Errors, Errors], shared_mm: float) -> Self:
        """AD and RD = +-3 S (7.3.2, 7.3.3); ``shared_mm``: u besides the scatter."""
        one, other = ends
        ways_mm = (one.nominal_mm + one.error_mm) - (other.nominal_mm + other.error_mm)
        commanded_mm = one.nominal_mm[0] - other.nominal_mm[0]
        lengths_mm = np.linalg.norm(ways_mm, axis=1)
        length_mm, count = float(np.linalg.norm(commanded_mm)), len(ways_mm)
        along_mm = np.abs(ways_mm).mean(axis=0) - np.abs(commanded_mm)
        s_d_mm = float(lengths_mm.std(ddof=1))
        return cls(
            *ENDS,
            length_mm,
            float(lengths_mm.mean()) - length_mm,
            float(along_mm[0]),
            float(along_mm[1]),
            float(along_mm[2]),
            expanded_mm(math.hypot(s_d_mm / math.sqrt(count), shared_mm)),
            3.0 * s_d_mm,
            expanded_mm(3.0 * s_d_mm / math.sqrt(2.0 * (count - 1))),
        )


class WorstPoses(msgspec.Struct, frozen=True):
    """AP and RP where each is largest."""

    ap_mm: float
    ap_u95_mm: float
    ap_pose: str
    rp_mm: float
    rp_u95_mm: float
    rp_pose: str


class Angles(msgspec.Struct, frozen=True, omit_defaults=True):
    """AP and RP of the angles a, b, c of one pose; AP where the reflectors' positions are known."""

    count: int
    rp_deg: dict[str, float]
    rp_u95_deg: dict[str, float]
    ap_deg: dict[str, float] = {}
    ap_u95_deg: dict[str, float] = {}

    @classmethod
    def of(cls, turns_rad: Array, shared_rad2: Array | None) -> Self:
        """AP (7.2.1) and RP = +-3 S (7.2.2) of rotation vectors (n, 3), axes of the base.

        The angles of a robot's small errors are the vector's coordinates. ``shared_rad2`` (3, 3):
        common covariance of all attainments; None: AP is unknown.
        """
        s_rad, count = turns_rad.std(axis=0, ddof=1), len(turns_rad)
        rp_rad = 3.0 * s_rad
        rp_u_rad = rp_rad / math.sqrt(2.0 * (count - 1))
        rp = cls._by_angle(rp_rad), cls._by_angle(2.0 * rp_u_rad)
        if shared_rad2 is None:
            return cls(count, *rp)
        u_rad = np.sqrt(s_rad**2 / count + np.diag(shared_rad2))
        ap_rad = turns_rad.mean(axis=0)
        return cls(count, *rp, cls._by_angle(ap_rad), cls._by_angle(2.0 * u_rad))

    @staticmethod
    def _by_angle(values_rad: Array) -> dict[str, float]:
        return dict(zip(ANGLES, np.degrees(values_rad).tolist(), strict=True))

    def figures(self, characteristic: Characteristic) -> tuple[dict[str, float], dict[str, float]]:
        if characteristic is AP_ANGLES:
            return self.ap_deg, self.ap_u95_deg
        return self.rp_deg, self.rp_u95_deg


class PoseTest(msgspec.Struct, frozen=True, kw_only=True):
    """Known conditions of the test (clause 6), and its results by pose."""

    cycles: int
    velocity_percent: float
    load_kg: float | None
    rated_load_kg: float | None
    warm_up_min: float | None
    stabilisation_s: float
    temperature_c: tuple[float, float] | None
    tracker_noise_mm: float
    corrected_by: str
    cube: Cube
    poses: dict[str, Pose]
    distance: Distance
    worst: WorstPoses
    orientation: dict[str, Angles]
    not_measured: list[str]
    deviations: list[str]
    limits: dict[str, float]

    @classmethod
    def of(cls, log: Log) -> Self:
        cell, clouds = log.cell, attained_positions(log)
        used, celsius = calibration_in(log), log.temperatures_c()
        table, corrected_by = cell.iso9283, "" if used is None else used.provenance.latest
        own = _Evaluation(log)
        poses = {
            name: Pose.of(
                at,
                commanded_mm(cell)[name],
                own.shared_mm2(commanded_mm(cell)[name], corrected=bool(corrected_by)),
                float(variances_mm2(own.visits()[name]).sum(axis=1).mean()),
            )
            for name, at in clouds.items()
        }
        at_ap = max(poses, key=lambda name: poses[name].ap_mm)
        at_rp = max(poses, key=lambda name: poses[name].rp_mm)
        ap, rp, orientation = poses[at_ap], poses[at_rp], own.orientation()
        limits = {of.limit: getattr(table, of.limit) for of in CHARACTERISTICS}
        return cls(
            cycles=table.cycles,
            velocity_percent=velocity_percent(cell),
            load_kg=table.load_kg,
            rated_load_kg=table.rated_load_kg,
            warm_up_min=table.warm_up_min,
            stabilisation_s=cell.settle.robot_s,
            temperature_c=(min(celsius), max(celsius)) if celsius else None,
            tracker_noise_mm=rms([point.std_mm for point in log.select(ISO)]),
            corrected_by=corrected_by,
            cube=Cube.largest(cell),
            poses=poses,
            distance=Distance.of(
                (clouds[ENDS[0]], clouds[ENDS[1]]), math.sqrt(2.0) * own.system_mm(framed=False)
            ),
            worst=WorstPoses(ap.ap_mm, ap.ap_u95_mm, at_ap, rp.rp_mm, rp.rp_u95_mm, at_rp),
            orientation=orientation,
            not_measured=[
                f"{of.key.upper()}_{angle}"
                for of in (AP_ANGLES, RP_ANGLES)
                for angle in ANGLES
                if worst_angle(orientation, of) is None
            ],
            deviations=[
                *_deviations(cell, corrected=bool(corrected_by), orientation=orientation),
                *interruptions(log),
            ],
            limits={name: limit for name, limit in limits.items() if limit is not None},
        )

    def figures(self) -> list[Worst]:
        worst, distance = self.worst, self.distance
        ends = f"{distance.start} to {distance.to}"
        characteristics = [
            (AP, AP.symbol, worst.ap_pose, worst.ap_mm, worst.ap_u95_mm),
            (RP, RP.symbol, worst.rp_pose, worst.rp_mm, worst.rp_u95_mm),
            (AD, AD.symbol, ends, abs(distance.ad_mm), distance.ad_u95_mm),
            (RD, RD.symbol, ends, distance.rd_mm, distance.rd_u95_mm),
        ]
        turns = ((of, worst_angle(self.orientation, of)) for of in (AP_ANGLES, RP_ANGLES))
        characteristics += [(of, *angle) for of, angle in turns if angle is not None]
        return [Worst(*each, self.limits.get(each[0].limit)) for each in characteristics]

    def keeps(self, pose: str) -> bool:
        """Whether AP and RP of a pose are within the stated limits; unknown ones are not."""
        at, angles = self.poses[pose], self.orientation.get(pose)
        figures = {AP: [(at.ap_mm, at.ap_u95_mm)], RP: [(at.rp_mm, at.rp_u95_mm)]}
        for of in (AP_ANGLES, RP_ANGLES):
            values, u95_deg = ({}, {}) if angles is None else angles.figures(of)
            figures[of] = [(abs(value), u95_deg[angle]) for angle, value in values.items()]
        return all(
            bool(each) and all(value + U <= self.limits[of.limit] for value, U in each)
            for of, each in figures.items()
            if of.limit in self.limits
        )

    def judgement(self) -> PoseTested | None:
        """Verdict on the cell's limits; unmeasured characteristics fail."""
        if not self.limits:
            return None
        measured = {each.of: each for each in self.figures()}
        facts = {
            name: value
            for of in CHARACTERISTICS
            if of.limit in self.limits and (at := measured.get(of)) is not None
            for name, value in (
                (f"{of.key}_{of.unit}", at.value),
                (f"{of.key}_u95_{of.unit}", at.U),
            )
        }
        verdict = PoseTested(holds=True, **facts, **self.limits)
        holds = all(each.outcome is Outcome.ACCEPTED for each in verdict.figures)
        return replace(verdict, holds=holds)


def worst_angle(
    orientation: Mapping[str, Angles], of: Characteristic
) -> tuple[str, str, float, float] | None:
    """Symbol, pose, value and U (deg) where value + U is largest, if measured."""
    angles = []
    for pose, each in orientation.items():
        values, u95_deg = each.figures(of)
        for angle, value in values.items():
            angles.append((f"{of.key.upper()}_{angle}", pose, abs(value), u95_deg[angle]))
    return max(angles, key=lambda each: np.nan_to_num(each[2] + each[3], nan=np.inf), default=None)


# -- the poses (6.8) -------------------------------------------------------------------------------

# Corners by the signs of x, y, z: C1 to C4 around the cube's top, C5 to C8 below them.
CORNERS = {
    "C1": (-1, -1, 1), "C2": (-1, 1, 1), "C3": (1, 1, 1), "C4": (1, -1, 1),
    "C5": (-1, -1, -1), "C6": (-1, 1, -1), "C7": (1, 1, -1), "C8": (1, -1, -1),
}  # fmt: skip
PLANE = ("C1", "C2", "C7", "C8")  # its diagonals C1-C7 and C2-C8 are the cube's
CYCLE = ("P5", "P4", "P3", "P2", "P1")  # from P1 (table 7)
ENDS = ("P2", "P4")  # of the distance: on one diagonal


def commanded_mm(cell: Cell) -> dict[str, Array]:
    """P1, the cube's centre, and P2 to P5 on diagonals of the plane, (3,) in {B} (6.8.5)."""
    cube = Cube.largest(cell)
    share_of_diagonal = 0.1  # that test poses keep off the cube's corners: (10 +- 2) % (6.8.5)
    reach_mm = (1.0 - 2.0 * share_of_diagonal) * cube.side_mm / 2.0
    centre_mm = np.array(cube.centre_mm)
    corners = {f"P{n}": np.array(CORNERS[name]) for n, name in enumerate(PLANE, start=2)}
    return {"P1": centre_mm} | {
        name: centre_mm + reach_mm * corner for name, corner in corners.items()
    }


def velocity_percent(cell: Cell) -> float:
    stated = cell.iso9283.velocity_percent
    return cell.robot.speed_percent if stated is None else stated


# -- of a run --------------------------------------------------------------------------------------


def attained_positions(log: Log) -> dict[str, Errors]:
    """Attained positions of each pose so far, in {B}, in order of the cycles."""
    T_B_W = inverse(log.matrix("base"))
    errors = {
        name: position_errors(log, points)
        for name, points in _Evaluation(log).visits().items()
        if points
    }
    return {
        name: Errors(apply(T_B_W, each.nominal_mm), each.error_mm @ T_B_W[:3, :3].T)
        for name, each in errors.items()
    }


@dataclass(frozen=True, eq=False)
class _Evaluation:
    log: Log

    def visits(self) -> dict[str, list[Point]]:
        visits: dict[str, list[Point]] = {name: [] for name in sorted(CYCLE)}
        for point in self.log.select(ISO):
            visits[point.id.pose].append(point)
        return visits

    def shared_mm2(self, at_mm: Array, *, corrected: bool) -> Array:
        """Common covariance (3, 3) of all attainments in {B}, at ``at_mm`` (3,)."""
        covariance: Array = self.system_mm(framed=corrected) ** 2 * np.eye(3)
        if not corrected:
            T = self.log.matrix("base")
            base = self.log.frames["base"].C
            J = motion_levers((T[:3, :3] @ at_mm)[None])[0, :, :6]
            covariance += T[:3, :3].T @ (J @ base @ J.T) @ T[:3, :3]
        return covariance

    def system_mm(self, *, framed: bool) -> float:
        """U of one coordinate besides the readings' noise; with {W} if ``framed``."""
        budget = measurement_budget(self.log)
        without = (NOISE,) if framed else (NOISE, WORLD, CENTRED)
        lines = (
            [] if budget is None else [each for each in budget.lines if each.name not in without]
        )
        return combined_mm(lines)

    def orientation(self) -> dict[str, Angles]:
        """AP and RP of the angles by pose, axes of {B}; empty with one reflector.

        AP only with a calibration that states the reflectors' positions on the flange: an error of
        these rotates every attainment alike, and cancels in RP.
        """
        if not self.log.cell.robot.more_smr_mm:
            return {}
        used, seats = calibration_in(self.log), self.log.cell.robot.seats_mm
        model = None if used is None else used.learnt_model()
        known = isinstance(model, Kinematic) and len(model.state.smr_mm) == len(seats)
        if isinstance(model, Kinematic) and known:
            seats = model.state.smr_mm
        angles, R = {}, self.log.matrix("base")[:3, :3]
        for name, points in self.visits().items():
            turned = last_orientation_errors(self.log, points, seats)
            if len(turned) > 1:
                rad2 = (
                    orientation_covariances_rad2(self.log, turned, readings=False).mean(axis=0)
                    if known
                    else None
                )
                angles[name] = Angles.of(
                    turned.error_rad @ R, None if rad2 is None else R.T @ rad2 @ R
                )
        return angles


def _deviations(cell: Cell, *, corrected: bool, orientation: Mapping[str, Angles]) -> Iterator[str]:
    table, speed_percent = cell.iso9283, velocity_percent(cell)
    standard_cycles = 30
    if table.cycles != standard_cycles:
        yield f"{table.cycles} cycles, the standard has {standard_cycles}"
    if speed_percent != 100.0:
        yield f"{speed_percent:g} % of the rated velocity, the standard asks for 100 %"
    if table.load_kg is None or table.rated_load_kg is None:
        yield "the load is not stated (iso9283.load_kg, iso9283.rated_load_kg)"
    elif table.load_kg != table.rated_load_kg:
        yield f"{table.load_kg:g} kg of {table.rated_load_kg:g} kg rated load, expected 100 %"
    if table.warm_up_min is None:
        yield "the warm-up is not stated (iso9283.warm_up_min)"
    if corrected:
        yield "the commanded poses carry a correction: the robot with its calibration is tested"
    yield "distances are taken from the pose cycle, not from a cycle of their own"
    if not orientation:
        yield "orientations were not measured: the test takes the position of one reflector"
    elif worst_angle(orientation, AP_ANGLES) is None:
        yield "AP_a, AP_b and AP_c were not measured: no calibration says where the reflectors are"


def interruptions(log: Log) -> Iterator[str]:
    """Yield interruptions of the cycles: stops and pauses between two visits."""

    def times(count: int) -> str:
        return "once" if count == 1 else f"{count} times"

    visits = log.select(ISO)
    sessions = len({point.session for point in visits})
    if sessions > 1:
        held = "; the slide was held again, its slip is in RP" if log.cell.has_rail else ""
        yield f"the cycles were interrupted {times(sessions - 1)} and resumed{held}"
    places = [log.recorded(point) for point in visits]
    paused = ("paused", "suspended")  # states of a run
    pauses = sum(
        change.to in paused and min(places) < change.seq < max(places) for change in log.life
    )
    if pauses:
        yield f"the cycles were paused {times(pauses)}, the robot at rest meanwhile"
