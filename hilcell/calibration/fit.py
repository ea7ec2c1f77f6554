"""How well each method predicts measured targets: base and reflectors are found, errors learnt.

A method learns from training rows and predicts positions of other rows. Figures come from rows
that were not learnt from: the test rows, or each fifth of the training poses in turn.
Rows of one pose share their errors, so a pose is left out as a whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypedDict

import numpy as np

from hilcell.calibration.robot_file import Measurements, Robot
from hilcell.compensation.model import Prediction
from hilcell.compensation.scattered import FOLDS, NEIGHBOURS, NearestPoses, Nominal
from hilcell.geometry import statistics
from hilcell.geometry.frames import apply, cross_matrix, matrix, rigid_fit
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.geometry.rotations import from_rotvec
from hilcell.ports import HilcellError

BAD_ROW_MM = 1.0  # rows that miss by more count less (soft L1), so one bad row moves nothing
ABSURD_MM = 20.0  # a miss beyond this is no robot's error
NAMED = 5  # rows that one message names
ITERATIONS = 100
CONVERGED = 1e-9


class FitError(HilcellError):
    """Measurements that cannot be learnt from."""

    code = "HC-C22"


class FitResult(TypedDict):
    """The output of ``fit --json``; ``train`` and ``test`` count rows.

    ``methods`` has the figures of what each leaves, distances of predicted from measured positions.
    """

    methods: dict[str, dict[str, float]]
    chosen: str
    train: int
    test: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the robot stands and carries its reflectors, found with nominal kinematics.

    ``T_L_B`` (4, 4): base in the tracker's frame; ``smr_mm``: reflectors (3,) on the flange.
    """

    arm: Arm
    T_L_B: Array
    smr_mm: Mapping[str, Array]

    def in_base_mm(self, rows: Measurements) -> Array:
        """Return the rows' nominal positions (N, 3) in {B}."""
        return _on_flange(forward(self.arm, rows.joints_rad), self._offsets(rows))

    def predicted_mm(self, rows: Measurements) -> Array:
        """Return the rows' nominal positions (N, 3) in the tracker's frame."""
        return apply(self.T_L_B, self.in_base_mm(rows))

    def _offsets(self, rows: Measurements) -> Array:
        unknown = sorted(set(rows.target) - set(self.smr_mm))
        if unknown:
            raise FitError(f"no training row measures target {', '.join(unknown)}")
        return np.array([self.smr_mm[target] for target in rows.target])


def place(arm: Arm, rows: Measurements) -> Placement:
    """Find base and reflectors by Gauss-Newton on soft-L1 weighted rows.

    Raises `FitError` where the rows do not determine them or the robot is plainly another.
    """
    targets = sorted(set(rows.target))
    if not 3 * len(rows) > 6 + 3 * len(targets):
        raise FitError(f"{len(rows)} rows do not place a base and {len(targets)} reflectors")
    which = np.array([targets.index(target) for target in rows.target])
    flange = forward(arm, rows.joints_rad)
    T, smr = rigid_fit(flange[:, :3, 3], rows.xyz_mm).T, np.zeros((len(targets), 3))
    step = np.inf
    for _ in range(ITERATIONS):
        T, smr, step = _improved(T, smr, flange, which, rows.xyz_mm)
        if step <= CONVERGED:
            break
    placement = Placement(arm, T, dict(zip(targets, smr, strict=True)))
    _refuse_another_robot(placement, rows, "the training set")
    if not step <= CONVERGED:
        raise FitError(
            f"base and reflectors do not settle: the last of {ITERATIONS} steps is {step:.3g}, "
            f"wanted <= {CONVERGED}: measure more poses with other orientations"
        )
    return placement


def _refuse_another_robot(placement: Placement, rows: Measurements, which: str) -> None:
    """Refuse rows half of which miss absurdly: their robot, joint signs or units are others."""
    half_mm = np.median(_miss_mm(placement, rows))
    if not half_mm <= ABSURD_MM:
        raise FitError(
            f"{which}: nominal kinematics miss half of the measured targets by {half_mm:.4g} mm "
            f"or more, wanted <= {ABSURD_MM:g} mm: check the robot file, joint signs and units"
        )


def _refuse_gross(placement: Placement, rows: Measurements) -> None:
    """Refuse single absurd rows: they hardly move the base, but spoil what is learnt near them."""
    miss_mm = _miss_mm(placement, rows)
    bad = np.flatnonzero(~(miss_mm <= ABSURD_MM))
    if len(bad):
        named = ", ".join(
            f"pose {rows.pose[n]} target {rows.target[n]} by {miss_mm[n]:.4g} mm"
            for n in bad[:NAMED]
        )
        raise FitError(
            f"{len(bad)} of {len(rows)} training rows miss grossly, wanted <= {ABSURD_MM:g} mm: "
            f"{named}{', ...' if len(bad) > NAMED else ''}; mend or remove them"
        )


def _miss_mm(placement: Placement, rows: Measurements) -> Array:
    return statistics.lengths_mm(rows.xyz_mm - placement.predicted_mm(rows))


class PointModel(Protocol):
    """Predicts errors at nominal positions (N, 3), in whatever orientation."""

    def predict(self, targets_mm: Array) -> Prediction:
        """Return the errors."""


METHODS: Mapping[str, Callable[[Array, Array], PointModel]] = {
    "nominal": Nominal.learn,
    "idw": NearestPoses.learn,
}


def predicted_mm(
    method: str, placement: Placement, train: Measurements, test: Measurements
) -> Array:
    """Predict test rows (N, 3) in the tracker's frame: nominal position and the model's error.

    Each target has a model of its own, learnt from its own rows at their nominal positions in
    {B}. Raises `FitError` where a target has too few to interpolate from.
    """
    error_mm = train.xyz_mm - placement.predicted_mm(train)
    there_mm, here_mm = placement.in_base_mm(train), placement.in_base_mm(test)
    found_mm = placement.predicted_mm(test)
    train_target, test_target = np.array(train.target), np.array(test.target)
    for target in placement.smr_mm:
        known, asked = train_target == target, test_target == target
        if np.count_nonzero(known) < NEIGHBOURS:
            raise FitError(
                f"target {target}: {np.count_nonzero(known)} training rows, "
                f"wanted at least {NEIGHBOURS} to interpolate from"
            )
        model = METHODS[method](there_mm[known], error_mm[known])
        found_mm[asked] += model.predict(here_mm[asked]).error_mm
    return found_mm


def fit(robot: Robot, train: Measurements, test: Measurements | None = None) -> FitResult:
    """Learn from ``train`` and judge every method on ``test``, or by cross-validation.

    The choice is made by cross-validation in both cases: test rows judge, they do not choose.
    Raises `FitError`, and `FrameError` for mirrored or collinear rows.
    """
    start_s = time.perf_counter()
    arm = robot.arm()
    placement = place(arm, train)
    _refuse_gross(placement, train)
    if test is not None:
        _refuse_another_robot(placement, test, "the test set")
    validated = {name: figures_of(miss) for name, miss in cross_validate(arm, train).items()}
    methods = validated
    if test is not None:
        methods = {
            name: figures_of(test.xyz_mm - predicted_mm(name, placement, train, test))
            for name in METHODS
        }
    return {
        "methods": methods,
        "chosen": min(validated, key=lambda name: validated[name]["mean_mm"]),
        "train": len(train),
        "test": len(train if test is None else test),
        "seconds": time.perf_counter() - start_s,
    }


def cross_validate(arm: Arm, rows: Measurements) -> dict[str, Array]:
    """Return measured minus predicted (N, 3) by method, each row predicted from other poses.

    Every `FOLDS`-th pose, in order of first appearance, is left out together.
    """
    order = list(dict.fromkeys(rows.pose))
    if len(order) < FOLDS:
        raise FitError(f"{len(order)} poses, wanted at least {FOLDS} to cross-validate")
    fold = np.array([order.index(pose) % FOLDS for pose in rows.pose])
    miss_mm = {name: np.empty((len(rows), 3)) for name in METHODS}
    for left_out in range(FOLDS):
        known = rows.at(np.flatnonzero(fold != left_out))
        asked = rows.at(np.flatnonzero(fold == left_out))
        placement = place(arm, known)
        for name, miss in miss_mm.items():
            miss[fold == left_out] = asked.xyz_mm - predicted_mm(name, placement, known, asked)
    return miss_mm


def figures_of(miss_mm: Array) -> dict[str, float]:
    """Return the figures of misses (N, 3)."""
    figures = statistics.figures_of(statistics.lengths_mm(miss_mm))._asdict()
    return {f"{name}_mm": value for name, value in figures.items()}


def methods_table(methods: Mapping[str, Mapping[str, float]]) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows of the figures of each method."""
    names = statistics.Figures._fields
    rows = [[name, *(f"{each[f'{n}_mm']:.4f}" for n in names)] for name, each in methods.items()]
    return ["method", *(f"{name} mm" for name in names)], rows


def _improved(
    T: Array, smr: Array, flange: Array, which: Array, measured: Array
) -> tuple[Array, Array, float]:
    """Return base (4, 4), reflectors (K, 3) and the step's size after one Gauss-Newton step."""
    found = apply(T, _on_flange(flange, smr[which]))
    middle = found.mean(axis=0)
    left = measured - found
    weight = (1.0 + np.sum((left / BAD_ROW_MM) ** 2, axis=1)) ** -0.25  # squared in the sum
    J = np.zeros((len(found), 3, 6 + smr.size))
    J[:, :, :3], J[:, :, 3:6] = np.eye(3), -cross_matrix(found - middle)
    turned = T[:3, :3] @ flange[:, :3, :3]
    for number in range(len(smr)):
        own = which == number
        J[own, :, 6 + 3 * number : 9 + 3 * number] = turned[own]
    rows = (weight[:, None, None] * J).reshape(-1, J.shape[2])
    # With one tool orientation base and reflector shift each other: the least step is taken.
    step = np.linalg.lstsq(rows, (weight[:, None] * left).ravel(), rcond=1e-10)[0]
    R = from_rotvec(step[3:6])
    moved = matrix(R, middle + step[:3] - R @ middle) @ T
    return moved, smr + step[6:].reshape(-1, 3), float(np.abs(step).max())


def _on_flange(flange: Array, offsets_mm: Array) -> Array:
    """Return points (N, 3) given on flanges (N, 4, 4)."""
    carried: Array = flange[:, :3, 3] + np.einsum("nij,nj->ni", flange[:, :3, :3], offsets_mm)
    return carried
