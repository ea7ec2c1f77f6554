"""How well each method predicts measured targets.

Figures are of rows not learnt from: the test rows, or each fifth of the training poses in sequence.
Rows of one pose (equal joints) share their errors and are left out together. Training outliers are
named and left out by all methods; too many, or one too large for any robot, are refused. The rows'
order has no effect.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from typing import NamedTuple, Self, TypedDict

import numpy as np

from hilcell.compensation.interpolation import Idw
from hilcell.compensation.model import LearntModel, Measured, StaticPoses
from hilcell.compensation.model_choice import MODELS, NOMINAL, choose, listed
from hilcell.fit.measurements import Measurements
from hilcell.fit.orientations import mounted, points_of, refuse_misread, scatter_rad
from hilcell.fit.placement import FitError, Placement, place, place_roughly, refuse_unknown_targets
from hilcell.fit.ranges import Anchors
from hilcell.fit.refusals import (
    no_positions,
    rare_target,
    refuse_another_robot,
    refuse_contradicting,
    refuse_few_poses,
    refuse_gross,
    refuse_many,
    refuse_mistaken,
    refuse_mistaken_test,
    refuse_unidentified,
    refuse_unplaced,
    undetermined,
    untrained,
)
from hilcell.fit.repeats import averaged, lacking_mm2
from hilcell.fit.robot_file import Robot
from hilcell.fit.suppositions import Misses, Mistake, explaining, moved_amid, of_test, of_training
from hilcell.geometry import statistics
from hilcell.geometry.frames import FrameError
from hilcell.geometry.kinematics import Arm, Array, Bools, Ints
from hilcell.geometry.statistics import Figures
from hilcell.identification.estimate import (
    GROSS,
    LEAST_POSES,
    Estimate,
    identify,
    identify_trusted,
    observability,
    robust,
)
from hilcell.identification.joint_error import WithJointErrors, with_joint_errors
from hilcell.identification.kinematics import Kinematics, Placed
from hilcell.identification.measured_poses import (
    FOLDS,
    IdentificationError,
    ManyContradict,
    Noise,
    Readings,
    count_poses,
    places_of,
    pose_folds,
    turn_middles,
)
from hilcell.present.table import Column, Table
from hilcell.sanitize import counted

WEIGHTS = {"mean": 2.0, "p95": 1.0}  # the largest miss changes with the folds more than methods do
RESIDUAL = "gp"
RIGID = "mdh"  # link parameters alone
TERMS: Mapping[str, tuple[bool, bool]] = {  # elastic joints, a tool's weight
    RIGID: (False, False),
    "elastic": (True, False),
    "tool": (True, True),
}


class Outlier(TypedDict):
    """A row that contradicts the training rows, and its distance from their prediction.

    ``anchor``: of a distance, else "".
    """

    pose: str
    target: str
    anchor: str
    miss_mm: float


class Undetermined(TypedDict):
    """A test row that the training rows do not determine, and its 95 % bound."""

    pose: str
    target: str
    bound_mm: float


class Coverage(TypedDict):
    """Share of test rows within their predicted 95 % bounds, and the bounds' mean."""

    share: float
    bound_mm: float


class LeftOut(NamedTuple):
    """Rows predicted without those of their fold: measured minus predicted (N, 3), and its
    covariance (N, 3, 3). NaN for rows that were not learnt from.
    """

    miss_mm: Array
    covariance_mm2: Array

    def seen_by(self, rows: Measurements) -> LeftOut:
        """Return what the rows tell: of distances, the part along them."""
        return LeftOut(rows.seen_mm(self.miss_mm), rows.seen_mm2(self.covariance_mm2))

    def at(self, rows: Bools) -> LeftOut:
        """Return some of the rows, as far as they were learnt from."""
        known = rows & np.isfinite(self.miss_mm).all(axis=1)
        return LeftOut(self.miss_mm[known], self.covariance_mm2[known])

    @property
    def figures(self) -> Figures:
        return figures_of(self.miss_mm)

    @property
    def doubt(self) -> float:
        """Factor, at least 1, by which the bounds of these rows understate."""
        bounds_mm = statistics.bounds95_mm(self.covariance_mm2)
        scores = statistics.lengths_mm(self.miss_mm) / bounds_mm
        return max(1.0, statistics.conformal_factor(scores))


class IdentifiedModel(TypedDict):
    """The identified robot: value, standard deviation, and the latter over the prior's, by
    parameter.

    Also noise, the number of directions of the parameters that the poses determine, and their
    condition number.
    """

    method: str
    names: list[str]
    values: list[float]
    sigma: list[float]
    sigma_over_prior: list[float]
    reading_mm: float
    pose_mm: float
    joint_rad: list[float]
    directions: int
    condition: float


class FitResult(TypedDict):
    """Output of ``fit --json``; ``rows`` counts the training rows, ``train`` those learnt from, and
    ``test`` those judged: kept training rows, or determined test rows.

    ``methods``: distances of predicted from measured positions; ``refused``: why others could not
    learn; ``test_outliers``: judged test rows far beyond their bounds; ``coverage``: of methods
    with bounds, empty without test rows; ``coverage95``: that of the chosen method, or None;
    ``model``: None where no robot was identified.
    """

    methods: dict[str, dict[str, float]]
    chosen: str
    reason: str
    refused: dict[str, str]
    outliers: list[Outlier]
    test_outliers: list[Outlier]
    coverage: dict[str, Coverage]
    coverage95: float | None
    model: IdentifiedModel | None
    rows: int
    train: int
    test: int
    undetermined: list[Undetermined]
    undetermined_mm: float
    seconds: float


@dataclass(frozen=True, eq=False)
class AtPoints:
    """Nominal positions and predicted errors there, by reflector.

    Each reflector has its own model: nominal poses in {B}, errors with the tracker's axes.
    ``doubt``: factor of the standard deviations that the models understate; ``lacking_mm2``: the
    variance that a coordinate has beyond one of the means that were learnt from.
    """

    placement: Placement
    models: Mapping[str, LearntModel]
    doubt: float = 1.0
    lacking_mm2: float = 0.0

    @classmethod
    def learn(cls, placement: Placement, rows: Measurements, model: type[LearntModel]) -> Self:
        error_mm, of_row = rows.xyz_mm - placement.predicted_mm(rows), np.array(rows.target)
        unknown_mm2 = np.full((len(rows), 3, 3), np.nan)
        poses = StaticPoses.of(rows.joints_rad, placement.nominal(rows), error_mm, unknown_mm2)
        models = {}
        for target in placement.smr_mm:
            models[target] = model.learn(Measured(poses.at(of_row == target)))
        return cls(placement, models)

    @property
    def base(self) -> Array:
        """The base in the tracker's frame (4, 4)."""
        return self.placement.T_L_B

    @property
    def smr_mm(self) -> Mapping[str, Array]:
        """Reflectors (3,) on the flange."""
        return self.placement.smr_mm

    def predict(self, rows: Measurements) -> tuple[Array, Array]:
        """Positions (N, 3) in the tracker's frame and covariances (N, 3, 3)."""
        poses, found_mm = self.placement.nominal(rows), self.placement.predicted_mm(rows)
        covariance_mm2 = np.empty((len(rows), 3, 3))
        of_row = np.array(rows.target)
        for target, model in self.models.items():
            own = of_row == target
            prediction = model.predict(poses[own])
            found_mm[own] += prediction.error_mm
            covariance_mm2[own] = prediction.covariance_mm2
        return found_mm, self.doubt**2 * covariance_mm2 + self.lacking_mm2 * np.eye(3)


@dataclass(frozen=True, eq=False)
class Poses:
    """Rows by pose and reflector: ``at`` (N, 2) is the place of each row in the readings."""

    readings: Readings
    at: Ints

    @classmethod
    def of(cls, rows: Measurements, targets: list[str]) -> Self:
        refuse_unknown_targets(rows, targets)
        seen: dict[tuple[str, bytes, str], int] = {}
        numbers: dict[tuple[str, bytes, int], int] = {}
        at = np.empty((len(rows), 2), dtype=np.int_)
        for n, (pose, target) in enumerate(zip(rows.pose, rows.target, strict=True)):
            joints = rows.joints_rad[n].tobytes()
            again = seen.get((pose, joints, target), 0)
            seen[pose, joints, target] = again + 1
            number = numbers.setdefault((pose, joints, again), len(numbers))
            at[n] = number, targets.index(target)
        joints_rad = np.empty((len(numbers), rows.joints_rad.shape[1]))
        joints_rad[at[:, 0]] = rows.joints_rad
        xyz_mm: Array = np.full((len(numbers), len(targets), 3), np.nan)
        xyz_mm[at[:, 0], at[:, 1]] = rows.xyz_mm
        covariance_mm2 = np.zeros((*xyz_mm.shape, 3))
        if rows.covariance_mm2 is not None:
            covariance_mm2[at[:, 0], at[:, 1]] = rows.covariance_mm2
        return cls(Readings(joints_rad, xyz_mm, covariance_mm2), at)

    def by_row(self, values: Array) -> Array:
        return values[self.at[:, 0], self.at[:, 1]]


@dataclass(frozen=True, eq=False)
class FittedArm:
    """An identified robot and the rows that it was learnt from.

    ``middles_rad`` (n,): of the turns of its joints; ``doubt``, ``lacking_mm2``: as of `AtPoints`.
    """

    estimate: Estimate
    poses: Poses
    targets: list[str]
    middles_rad: Array
    joint_errors: WithJointErrors | None = None
    doubt: float = 1.0
    lacking_mm2: float = 0.0

    @classmethod
    def learn(
        cls, placement: Placement, rows: Measurements, method: str, *, trusted: bool = True
    ) -> Self:
        """The robot identified by one of `TERMS`; rows not ``trusted`` may be outliers. Raises
        `IdentificationError`, also for less than `LEAST_POSES` different poses.

        Behind the reflectors are the points of orientations, in the order of names, x's first.
        """
        different = count_poses(rows.joints_rad)
        if different < LEAST_POSES:
            raise IdentificationError(
                f"kinematics: {counted(different, 'pose')} of different joints, expected at least "
                f"{LEAST_POSES}; measure more"
            )
        points, places_mm = mounted(placement, rows)
        places_mm |= placement.smr_mm
        arm = cls._identified(placement, rows.joined(points), places_mm, method, trusted)
        if len(points) and rows.u_rad is None:
            points = points_of(rows, scatter_rad(arm.missed_mm[len(rows) :]))
            arm = cls._identified(placement, rows.joined(points), places_mm, method, trusted)
        return replace(arm, poses=replace(arm.poses, at=arm.poses.at[: len(rows)]))

    @classmethod
    def _identified(
        cls, placement: Placement, rows: Measurements, places_mm: Mapping[str, Array], method: str,
        trusted: bool,
    ) -> Self:  # fmt: skip
        """The robot by rows of reflectors and of other points on the flange, behind them."""
        targets = sorted(placement.smr_mm)
        names = [*targets, *sorted({*places_mm} - {*targets})]
        elastic, tool = TERMS[method]
        ranges, T = rows.along is not None, placement.T_L_B
        assumed = Placed(base_rad=1e-6) if ranges else Placed()  # no distance tells of a rotation
        kinematics = Kinematics(
            placement.arm, len(names), gravity=elastic, waves=elastic, tool=tool, assumed=assumed
        )
        smr_mm = np.array([places_mm[each] for each in names])
        start = kinematics.start(np.eye(4) if ranges else T, smr_mm)
        by = identify_trusted if trusted else identify
        noise = Noise.of_poses(len(targets), len(placement.arm))
        middles_rad = turn_middles(rows.joints_rad, placement.arm.turning != 0.0)
        poses = Poses.of(rows.within_turns(middles_rad), names)
        return cls(by(kinematics, poses.readings, start, noise), poses, targets, middles_rad)

    @property
    def missed_mm(self) -> Array:
        """Measured minus predicted (N, 3) of the rows learnt from."""
        readings = self.poses.readings
        return self.poses.by_row(readings.xyz_mm - self.estimate.predict(readings.joints_rad)[0])

    def with_joint_errors(self) -> Self:
        return replace(self, joint_errors=with_joint_errors(self.estimate))

    @property
    def base(self) -> Array:
        return self.found.state.T

    @property
    def smr_mm(self) -> Mapping[str, Array]:
        return dict(zip(self.targets, self.found.state.smr_mm, strict=False))

    @property
    def outliers(self) -> Bools:
        return self.estimate.outliers[self.poses.at[:, 0], self.poses.at[:, 1]]

    def predict(self, rows: Measurements) -> tuple[Array, Array]:
        """Positions (N, 3) in the tracker's frame, and covariances (N, 3, 3) of readings there."""
        poses = Poses.of(rows.within_turns(self.middles_rad), self.targets)
        at_mm, covariance_mm2 = self.found.predict(poses.readings.joints_rad)
        covariance_mm2 = self.doubt**2 * poses.by_row(covariance_mm2)
        return poses.by_row(at_mm), covariance_mm2 + self.lacking_mm2 * np.eye(3)

    def left_out(self, fold: Ints) -> LeftOut:
        """Each row as predicted from the other folds (N,)."""
        of_pose = np.empty(len(self.poses.readings), dtype=np.int_)
        of_pose[self.poses.at[:, 0]] = fold
        folds = [np.flatnonzero(of_pose == each).astype(np.int_) for each in np.unique(fold)]
        return LeftOut(*map(self.poses.by_row, self.found.left_out(folds)))

    def identified(self, name: str) -> IdentifiedModel:
        found, kinematics = self.found, self.estimate.kinematics
        known = observability(kinematics, found.covariance)
        return IdentifiedModel(
            method=name,
            names=kinematics.names,
            values=kinematics.flat(found.state).tolist(),
            sigma=np.sqrt(np.diag(found.covariance)).tolist(),
            sigma_over_prior=known.ratio.tolist(),
            reading_mm=found.noise.reading_mm,
            pose_mm=found.noise.pose_mm,
            joint_rad=found.noise.joint_rad.tolist(),
            directions=known.directions,
            condition=known.condition,
        )

    @property
    def found(self) -> Estimate | WithJointErrors:
        return self.joint_errors or self.estimate


Method = AtPoints | FittedArm


class Predicted(NamedTuple):
    """Predicted positions of reflectors: ``xyz_mm`` (N, 3) in the tracker's frame.

    ``covariance_mm2`` (N, 3, 3); ``bound95_mm`` (N,) bounds 95 % of 3D differences to a reading
    (`hilcell.geometry.statistics.bounds95_mm`).
    """

    xyz_mm: Array
    covariance_mm2: Array
    bound95_mm: Array

    @classmethod
    def by(cls, method: Method, rows: Measurements) -> Self:
        """Positions of the rows' reflectors by a method; raises `FitError`."""
        at_mm, covariance_mm2 = method.predict(rows)
        if rows.covariance_mm2 is not None:
            covariance_mm2 += rows.covariance_mm2
        covariance_mm2 = rows.seen_mm2(covariance_mm2)
        return cls(at_mm, covariance_mm2, statistics.bounds95_mm(covariance_mm2))


@dataclass(frozen=True, eq=False)
class RobotFit:
    """A robot and the rows that its errors were learnt from.

    ``result``: the output of ``fit --json``; ``methods``: each method as learnt; ``validated``: its
    figures at training poses left out in sequence.
    """

    robot: Robot
    train: Measurements
    result: FitResult
    methods: Mapping[str, Method]
    validated: Mapping[str, Figures]

    @property
    def chosen(self) -> str:
        return self.result["chosen"]

    def predict(self, joints_rad: Array, target: str) -> Predicted:
        """Positions of a reflector at commanded joints (N, n) by the chosen method. Raises
        `FitError` for a reflector that was not measured.
        """
        rows = Measurements.unmeasured(np.asarray(joints_rad, dtype=float), target)
        return Predicted.by(self.methods[self.chosen], rows)


def fit_robot(robot: Robot, train: Measurements, test: Measurements | None = None) -> RobotFit:
    """Learn a robot's errors from measured positions, and choose the method that predicts best.

    Every method of `hilcell fit` learns from ``train`` and is judged on ``test``, or without it by
    cross-validation. The choice is made by cross-validation in both cases: test rows judge, they
    do not choose. The robot's base and its reflectors are estimated with the errors. Raises
    `FitError` for rows that cannot be learnt from.

    Examples:
        >>> fit = fit_robot(read_robot("irb120.toml"), read_measurements("train.csv"))
        >>> fit.chosen in fit.result["methods"], sorted(fit.result["methods"])
        (True, ['elastic', 'gp', 'idw', 'mdh', 'nominal', 'tool'])
    """
    start_s = time.perf_counter()
    arm = robot.arm
    refuse_few_poses(train)
    middles_rad = turn_middles(train.joints_rad, arm.turning != 0.0)
    anchors = _anchored(robot, train, test)
    if anchors is not None:
        train, test = anchors.located(train), None if test is None else anchors.located(test)
    placement = _placed(robot, train)
    one_mm2 = lacking_mm2(placement, train, middles_rad)
    as_given = averaged(placement, train, middles_rad)
    train = as_given.within_turns(middles_rad)
    order = _order(train)
    rows = train.at(order)
    bad, refused = _contradicting(robot, placement, train, as_given, order, anchors)
    kept = rows.at(np.flatnonzero(~bad))
    refuse_few_poses(kept, int(bad.sum()))
    placement, elsewhere = place(arm, kept), _elsewhere(kept)
    arms = {} if refused else _arms(placement, kept, refused)
    models = scattered()
    if rare := rare_target(kept) or no_positions(kept):
        refused[Idw.name] = rare
        del models[Idw.name]
    fold = pose_folds(kept.joints_rad)
    left_out = cross_validate(arm, kept, models)
    left_out |= {name: each.left_out(fold) for name, each in arms.items()}
    left_out = {name: each.seen_by(kept).at(elsewhere) for name, each in left_out.items()}
    validated = {name: each.figures for name, each in left_out.items()}
    chosen = choose(validated, WEIGHTS)
    methods: dict[str, Method] = {
        name: AtPoints.learn(placement, kept, model) for name, model in models.items()
    }
    methods |= arms
    methods = {
        name: replace(each, doubt=left_out[name].doubt, lacking_mm2=one_mm2)
        for name, each in methods.items()
    }
    judged, coverage, reason = validated, dict[str, Coverage](), ""
    best = min(arms, key=lambda name: validated[name].mean, default=None)
    limit_mm = _limit_mm(validated[NOMINAL], arms.get(best or ""))
    unknown, far = list[Undetermined](), list[Outlier]()
    if test is not None:
        judged, coverage, unknown, far = _tested(
            robot, methods, kept, test, best, chosen, limit_mm, anchors
        )
        if reason := worse_than_nominal(chosen, judged):
            chosen = NOMINAL
    struck = train.at(sorted(order[bad]))
    why = "least mean and p95 of misses at training poses left out"
    if chosen == NOMINAL:
        why = "no method beats nominal positions at poses left out"
    result: FitResult = {
        "methods": {name: in_mm(figures) for name, figures in judged.items()},
        "chosen": chosen,
        "reason": reason or f"{why}: {listed(validated, WEIGHTS)}",
        "refused": refused,
        "outliers": _outliers(struck, _missed_mm(methods[best or NOMINAL], struck)),
        "test_outliers": far,
        "coverage": coverage,
        "coverage95": coverage[chosen]["share"] if chosen in coverage else None,
        "model": None if best is None else arms[best].identified(best),
        "rows": len(train),
        "train": len(kept),
        "test": int(elsewhere.sum()) if test is None else len(test) - len(unknown),
        "undetermined": unknown,
        "undetermined_mm": limit_mm,
        "seconds": time.perf_counter() - start_s,
    }
    return RobotFit(robot, train, result, methods, validated)


def _anchored(robot: Robot, train: Measurements, test: Measurements | None) -> Anchors | None:
    """The anchors of distances; raises `FitError`, naming the mistake in rows that define none."""
    if test is not None and (train.distance_mm is None) != (test.distance_mm is None):
        raise FitError(
            f"{test.source}: expected the training rows' kind, positions or distances, in both"
        )
    if train.distance_mm is None:
        return None
    try:
        return Anchors.of(robot.arm, train)
    except FitError as error:
        refuse_unplaced(train, error, _supposed(robot, train))


def _supposed(robot: Robot, train: Measurements) -> Mistake:
    """Which mistake explains rows that no robot explains."""
    every, far_mm = np.arange(len(train)), np.full(len(train), np.inf)
    return explaining(robot.arm, train, far_mm, every, of_training(robot, train), _learnt)


def _placed(robot: Robot, train: Measurements) -> Placement:
    """Base and reflectors; raises `FitError`, naming the mistake in rows that define none."""
    try:
        return place(robot.arm, train)
    except (FrameError, FitError) as error:
        refuse_unplaced(train, error, _supposed(robot, train))


def scattered() -> dict[str, type[LearntModel]]:
    """Error models that learn from arbitrary poses, by name."""
    return {name: model for name, model in MODELS.items() if model.scattered}


def cross_validate(
    arm: Arm, rows: Measurements, models: Mapping[str, type[LearntModel]]
) -> dict[str, LeftOut]:
    """Rows by each model, a fifth of the poses left out; NaN for reflectors that no other fifth
    shows.
    """
    fold, elsewhere, size = pose_folds(rows.joints_rad), _elsewhere(rows), len(rows)
    found = {
        name: LeftOut(*(np.full((size, *of), np.nan) for of in ((3,), (3, 3)))) for name in models
    }
    for left_out in range(FOLDS):
        known = rows.at(np.flatnonzero(fold != left_out))
        own = np.flatnonzero((fold == left_out) & elsewhere)
        asked, placement = rows.at(own), place(arm, known)
        for name, each in found.items():
            predicted = Predicted.by(AtPoints.learn(placement, known, models[name]), asked)
            each.miss_mm[own] = asked.xyz_mm - predicted.xyz_mm
            each.covariance_mm2[own] = predicted.covariance_mm2
    return found


def _elsewhere(rows: Measurements) -> Bools:
    """Rows (N,) whose reflector other fifths of the poses show too."""
    fold = pose_folds(rows.joints_rad)
    seen = {target: len(np.unique(fold[rows.of(target)])) for target in set(rows.target)}
    return np.array([seen[target] > 1 for target in rows.target])


def _arms(
    placement: Placement, rows: Measurements, refused: dict[str, str]
) -> dict[str, FittedArm]:
    arms: dict[str, FittedArm] = {}
    for name in TERMS:
        try:
            arms[name] = FittedArm.learn(placement, rows, name)
        except IdentificationError as error:
            refused[name] = str(error)
    if arms:
        arms[RESIDUAL] = arms[max(arms, key=_terms)].with_joint_errors()
    return arms


def _terms(name: str) -> int:
    return sum(TERMS[name])


def figures_of(miss_mm: Array) -> Figures:
    return statistics.figures_of(statistics.lengths_mm(miss_mm))


def in_mm(figures: Figures) -> dict[str, float]:
    return {f"{name}_mm": value for name, value in figures._asdict().items()}


def methods_table(methods: Mapping[str, Mapping[str, float]]) -> Table:
    names = Figures._fields
    columns: list[Column[Mapping[str, str | float]]] = [
        Column("method", itemgetter("method")),
        *(Column(name, itemgetter(f"{name}_mm"), "mm", ".4f") for name in names),
    ]
    rows: list[Mapping[str, str | float]] = [
        {"method": name, **each} for name, each in methods.items()
    ]
    return Table(columns, rows)


def _contradicting(
    robot: Robot, placement: Placement, train: Measurements, as_given: Measurements, order: Ints,
    anchors: Anchors | None,
) -> tuple[Bools, dict[str, str]]:  # fmt: skip
    """Which rows (N,), in an order, contradict the others, and why no robot is identified.

    ``as_given``: with their whole turns, which tell of mistaken units.
    """
    rows = train.at(order)

    def mistake(bad: Ints) -> Mistake:  # in the file's order: it may name a shift in it
        supposed = of_training(robot, as_given, predicted_mm)
        learn = _learnt if anchors is None else lambda *_: anchors.misses
        return explaining(robot.arm, as_given, miss_mm, bad, supposed, learn)

    back = np.argsort(order)
    miss_mm, predicted_mm = placement.miss_mm(train), placement.predicted_mm(train)
    nominal_mm = miss_mm
    try:
        found = FittedArm.learn(placement, rows, max(TERMS, key=_terms), trusted=False)
    except IdentificationError as error:
        refuse_another_robot(train, nominal_mm, mistake)
        refuse_gross(train, nominal_mm, mistake)
        refuse_misread(placement, train)
        if isinstance(error, ManyContradict):
            miss_mm = _learnt(robot.arm, train)(train)
            refuse_many(train, miss_mm > GROSS * np.median(miss_mm), miss_mm, mistake)
        refuse_unidentified(train, nominal_mm, error, mistake)
        return np.zeros(len(rows), dtype=np.bool_), dict.fromkeys((*TERMS, RESIDUAL), str(error))
    predicted_mm = found.predict(rows)[0][back]
    miss_mm = statistics.lengths_mm(train.seen_mm(train.xyz_mm - predicted_mm))
    bad = found.outliers[back]
    refuse_misread(placement, train)
    refuse_gross(train, np.where(bad, miss_mm, 0.0), mistake)
    refuse_many(train, bad, miss_mm, mistake)
    moved = any(moved_amid(train, predicted_mm))
    refuse_mistaken(train, bad, miss_mm, found.estimate, mistake, moved=moved)
    return found.outliers, {}


def _learnt(arm: Arm, rows: Measurements) -> Misses:
    """How far rows are from a robot identified of some, or else from nominal positions."""
    if rows.distance_mm is not None:
        return Anchors.roughly(arm, rows).misses
    placement = place_roughly(arm, rows)
    few, no_robot_mm = count_poses(rows.joints_rad) < LEAST_POSES, 30.0
    if few or not np.median(placement.miss_mm(rows)) <= no_robot_mm:
        return placement.miss_mm
    targets = sorted(placement.smr_mm)
    kinematics = Kinematics(arm, len(targets), gravity=False, waves=False)
    readings = Poses.of(rows, targets).readings
    smr_mm = np.array([placement.smr_mm[target] for target in targets])
    state, _ = robust(kinematics, readings, kinematics.start(placement.T_L_B, smr_mm))

    def misses(asked: Measurements) -> Array:
        poses = Poses.of(asked, targets)
        at_mm = poses.by_row(kinematics.positions_mm(state, poses.readings.joints_rad))
        return statistics.lengths_mm(asked.seen_mm(asked.xyz_mm - at_mm))

    return misses


def _missed_mm(method: Method, rows: Measurements) -> Array:
    """Distances (N,) of rows from a method's predictions."""
    if not len(rows):
        return np.zeros(0)
    return statistics.lengths_mm(rows.seen_mm(rows.xyz_mm - method.predict(rows)[0]))


def _limit_mm(nominal: Figures, arm: FittedArm | None) -> float:
    """Bound (95 %) beyond which the training rows do not determine a position: it exceeds twice
    what nominal positions miss by, and what the instrument alone explains.
    """
    of_nominal, of_readings, bound95 = 2.0, 20.0, 2.8  # bound95: of unit noise in 3D
    reading_mm = 0.0 if arm is None else arm.estimate.noise.reading_mm
    return max(of_nominal * nominal.p95, of_readings * bound95 * reading_mm)


def _tested(
    robot: Robot,
    methods: Mapping[str, Method],
    train: Measurements,
    test: Measurements,
    best: str | None,
    chosen: str,
    limit_mm: float,
    anchors: Anchors | None,
) -> tuple[dict[str, Figures], dict[str, Coverage], list[Undetermined], list[Outlier]]:
    """Figures and coverage of the determined test rows by method, the other rows, and outliers."""
    finite = {
        name: each if np.isfinite(each.doubt) else replace(each, doubt=1.0)
        for name, each in methods.items()
    }
    predicted = {name: Predicted.by(each, test) for name, each in finite.items()}
    method, by_best = finite[best or NOMINAL], predicted[best or NOMINAL]
    rigid = replace(method, joint_errors=None) if isinstance(method, FittedArm) else method

    def mistake(bad: Ints) -> Mistake:
        supposed = of_test(robot, test, by_best.xyz_mm)
        misses = anchors.misses if anchors is not None else partial(_missed_mm, rigid)
        return explaining(robot.arm, test, miss_mm, bad, supposed, lambda *_: misses)

    miss_mm = statistics.lengths_mm(test.seen_mm(test.xyz_mm - by_best.xyz_mm))
    beyond = 3.0  # bounds, 8 standard deviations
    refuse_gross(test, np.where(miss_mm <= beyond * by_best.bound95_mm, 0.0, miss_mm), mistake)
    middles_rad = turn_middles(train.joints_rad, robot.arm.turning != 0.0)
    outside = untrained(robot, train, test.within_turns(middles_rad))
    unknown = undetermined(test, by_best.bound95_mm, limit_mm if best else np.inf, outside)
    known = np.setdiff1d(np.arange(len(test)), unknown)
    far = known[~(miss_mm[known] <= beyond * by_best.bound95_mm[known])]
    refuse_mistaken_test(test, far, miss_mm, mistake)
    figures, coverage = {}, {}
    for name, each in predicted.items():
        left_mm = statistics.lengths_mm(test.seen_mm(test.xyz_mm - each.xyz_mm))[known]
        bound_mm = each.bound95_mm[known]
        figures[name] = statistics.figures_of(left_mm)
        if np.isfinite(methods[name].doubt):  # else too few poses for a bound
            share = float((left_mm <= bound_mm).mean())
            coverage[name] = Coverage(share=share, bound_mm=float(bound_mm.mean()))
    if inside := coverage.get(chosen):
        share, bound95_mm = inside["share"], inside["bound_mm"]
        mean_mm = figures[chosen].mean
        refuse_contradicting(test, chosen, share, bound95_mm, mean_mm, mistake, outside)
    named = [
        Undetermined(
            pose=test.pose[n], target=test.target[n], bound_mm=float(by_best.bound95_mm[n])
        )
        for n in unknown
    ]
    return figures, coverage, named, _outliers(test.at(far), miss_mm[far])


def worse_than_nominal(chosen: str, judged: Mapping[str, Figures]) -> str:
    """Why nominal positions are used: the choice predicts the test rows worse; "" otherwise."""
    mean_mm, nominal_mm = judged[chosen].mean, judged[NOMINAL].mean
    if chosen == NOMINAL or mean_mm < nominal_mm:
        return ""
    return (
        f"{chosen} has the least misses at training poses left out, but misses the test rows by "
        f"{mean_mm:.4f} mm in the mean, nominal positions by {nominal_mm:.4f} mm: nominal is kept"
    )


def _outliers(rows: Measurements, miss_mm: Array) -> list[Outlier]:
    anchors = rows.anchor or [""] * len(rows)
    return [
        Outlier(pose=pose, target=target, anchor=anchor, miss_mm=float(miss))
        for pose, target, anchor, miss in zip(rows.pose, rows.target, anchors, miss_mm, strict=True)
    ]


def _order(rows: Measurements) -> Ints:
    """An order of the rows (N,); a re-measured target is grouped by its own rows only."""
    joints, target = rows.joints_rad, np.array(rows.target)
    pose = np.array(rows.pose)
    return np.lexsort((target, pose, *joints.T[::-1], places_of(joints)))
