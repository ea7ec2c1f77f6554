"""Mistakes in measured lists and robot files: each is supposed, and the one that fits is named.

A mistake may be in all rows or in some: each row is read as it fits the robot better that the rows
identify so. They are compared by the likelihood of what it leaves, with long tails (Cauchy's in
three dimensions), so that neither a few slips nor a few telling rows decide alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, islice, pairwise, permutations
from typing import NamedTuple

import numpy as np

from hilcell.fit.measurements import Measurements
from hilcell.fit.placement import rigid
from hilcell.fit.robot_file import Robot
from hilcell.geometry.frames import apply, inverse, motion_levers, rigid_fit
from hilcell.geometry.kinematics import MM, Arm, Array, Bools, Ints, forward
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import HilcellError
from hilcell.sanitize import counted

SURE = 10.0  # of a likelihood's logarithm: two explanations this close are equal
LEFT_MM = 5.0  # in the median: more, and the rows are not explained
LEAST_COUPLED = 3  # revolute joints
LEAST_MM = 0.02  # no tracker tells less

Misses = Callable[[Measurements], Array]  # distances (N,) of rows from a robot
Learn = Callable[[Arm, Measurements], Misses]  # of a robot that the rows identify


class Supposed(NamedTuple):
    """The rows and the robot as they would be without a mistake."""

    says: str
    rows: Measurements
    arm: Arm | None = None  # of another robot file
    factor: float = 1.0  # of measured lengths: their density in the list as it is


@dataclass(frozen=True, slots=True)
class Mistake:
    """The supposition that explains all rows, false if none does; ``tried``: their count."""

    says: str
    tried: int

    def __bool__(self) -> bool:
        return bool(self.says)


class Explained(NamedTuple):
    """A mistake, its log likelihood, and the median of what it leaves."""

    says: str
    likelihood: float
    left_mm: float


def explaining(
    arm: Arm,
    rows: Measurements,
    miss_mm: Array,
    bad: Ints,
    supposed: Iterable[Supposed],
    learn: Learn,
) -> Mistake:
    """Which supposition explains the rows, ``bad`` among them, clearly better than they do as they
    are, missing by ``miss_mm`` (N,). Several that do it equally well are joined by "or".
    """
    most_named = 3
    given_rows = _tried(rows, bad)
    given, own = rows.at(given_rows), None
    as_they_are = _likelihood(miss_mm[given_rows])[0]
    with suppress(HilcellError, np.linalg.LinAlgError):
        own = learn(arm, given)
        as_they_are = max(as_they_are, _likelihood(own(given))[0])
    found, count = list[Explained](), 0
    for says, changed, other, factor in supposed:
        count += 1
        with suppress(HilcellError, np.linalg.LinAlgError):
            if other is not None:
                found.append(Explained(says, *_likelihood(learn(other, given)(given))))
                continue
            without = changed.at(given_rows)
            tried = _Tried(says, given, without, factor, partial(learn, arm))
            if own is not None:
                found += tried.of_some(own, as_they_are)
            found += tried.of_most()
    best = max((each.likelihood for each in found), default=-np.inf)
    if not best > as_they_are + 2.0 * SURE:
        return Mistake("", count)
    # Of suppositions that change the same labels the first is named.
    equal: dict[float, Explained] = {}
    for each in found:
        if each.likelihood > best - SURE:
            equal.setdefault(each.likelihood, each)
    if not all(each.left_mm <= LEFT_MM for each in equal.values()):
        return Mistake("", count)
    named = dict.fromkeys(each.says for each in equal.values())
    return Mistake(", or ".join(islice(named, most_named)), count)


def _tried(rows: Measurements, bad: Ints) -> list[int]:
    """Rows of evenly chosen poses, and bad ones."""
    most, least_poses = 100, 24  # rows of each
    order = list(dict.fromkeys(rows.pose))
    step = max(min(len(rows) // most + 1, len(order) // least_poses), 1)
    chosen = {*order[::step]}
    some = bad[:: len(bad) // most + 1].tolist()
    return sorted({*some, *(n for n, pose in enumerate(rows.pose) if pose in chosen)})


def _likelihood(miss_mm: Array) -> tuple[float, float]:
    """The log likelihood of misses (N,), and their median."""
    if not np.isfinite(miss_mm).all():
        return -np.inf, np.inf
    scale_mm = max(float(np.median(miss_mm)), LEAST_MM)
    tails = float(np.log1p((miss_mm / scale_mm) ** 2).sum())
    return -3.0 * len(miss_mm) * float(np.log(scale_mm)) - 2.0 * tails, scale_mm


@dataclass(frozen=True, eq=False)
class _Tried:
    """A mistake in rows as given, tried at those that may have it; ``changed``: without it."""

    says: str
    given: Measurements
    changed: Measurements
    factor: float
    learn: Callable[[Measurements], Misses]

    def of_some(self, misses: Misses, as_they_are: float) -> Iterator[Explained]:
        """The mistake in a few rows, by the robot of all: yields one or none."""
        changed_mm, given_mm = misses(self.changed), misses(self.given)
        if _likelihood(np.fmin(changed_mm, given_mm))[0] > as_they_are + SURE:
            with suppress(HilcellError, np.linalg.LinAlgError):
                yield from self._settled(misses, np.zeros(len(self.given), dtype=np.bool_))

    def of_most(self) -> Iterator[Explained]:
        """The mistake in all rows or most of them: yields one or none."""
        yield from self._settled(self.learn(self.changed), np.ones(len(self.given), dtype=np.bool_))

    def _settled(self, misses: Misses, mistaken: Bools) -> Iterator[Explained]:
        """Each row read as it fits the robot better that they identify so, until none changes."""
        rounds, no_robot_mm, clearly = 4, 100.0, 3.0
        for _ in range(rounds):
            given_mm, changed_mm = misses(self.given), misses(self.changed)
            likelihood, left_mm = _likelihood(np.fmin(given_mm, changed_mm))
            before, mistaken = mistaken, changed_mm < given_mm
            if not left_mm <= no_robot_mm:
                return
            if (mistaken == before).all():
                break
            misses = self.learn(_mixed(self.given, self.changed, mistaken))
        differs = np.abs(given_mm - changed_mm) > clearly * left_mm
        likelihood += 3.0 * float(np.log(self.factor)) * np.count_nonzero(mistaken)
        says, own = self.says, np.flatnonzero(mistaken & differs)
        if (differs & ~mistaken).any():
            likelihood -= len(own) * float(np.log(len(self.given)))  # which rows they are
            says = f"{says} in {_where(self.given, own.tolist())}"
        if len(own):
            yield Explained(says, likelihood, left_mm)


def _mixed(given: Measurements, changed: Measurements, mistaken: Bools) -> Measurements:
    """The rows as changed where mistaken (N,), and as given elsewhere."""
    if mistaken.all():
        return changed

    def of(a: Sequence[str], b: Sequence[str]) -> list[str]:
        return [b[n] if each else a[n] for n, each in enumerate(mistaken[: len(a)])]

    distance_mm = given.distance_mm
    if distance_mm is not None and changed.distance_mm is not None:
        distance_mm = np.where(mistaken, changed.distance_mm, distance_mm)
    return replace(
        given,
        target=of(given.target, changed.target),
        joints_rad=np.where(mistaken[:, None], changed.joints_rad, given.joints_rad),
        xyz_mm=np.where(mistaken[:, None], changed.xyz_mm, given.xyz_mm),
        anchor=of(given.anchor, changed.anchor),
        distance_mm=distance_mm,
    )


def _where(rows: Measurements, own: list[int]) -> str:
    named = 5
    poses = list(dict.fromkeys(rows.pose[n] for n in own))
    listed = ", ".join(poses[:named]) + ", .." * (len(poses) > named)
    lines = rows.where(own).removeprefix(rows.source)
    return f"{counted(len(poses), 'pose')}: {listed}{f' ({lines.strip()})' if lines else ''}"


def of_training(
    robot: Robot, rows: Measurements, predicted_mm: Array | None = None
) -> Iterator[Supposed]:
    """Yield training rows as they would be without a mistake, the likeliest first.

    ``predicted_mm`` (N, 3): their positions, where known.
    """
    yield from _of_a_list(robot, rows)
    if predicted_mm is not None:
        yield from moved_amid(rows, predicted_mm)
    for says, arm in _of_the_file(robot):
        yield Supposed(says, rows, arm)


def of_test(robot: Robot, rows: Measurements, predicted_mm: Array) -> Iterator[Supposed]:
    """Yield test rows so, whose positions are predicted (N, 3) from training rows."""
    yield from _of_a_list(robot, rows)
    yield from moved_amid(rows, predicted_mm)
    if rows.distance_mm is not None:
        return
    with suppress(HilcellError):
        moved = rigid_fit(predicted_mm, rows.xyz_mm)
        back = replace(rows, xyz_mm=apply(inverse(moved.T), rows.xyz_mm))
        shift_mm = float(np.linalg.norm((rows.xyz_mm - predicted_mm).mean(axis=0)))
        says = f"the tracker or the robot moved between the files, by {shift_mm:.4g} mm there"
        yield Supposed(says, back)


def moved_amid(rows: Measurements, predicted_mm: Array) -> Iterator[Supposed]:
    """Yield rows whose frame changed before one of them, later ones moved back: one or none.

    That row splits them into two small motions from predicted positions (N, 3), by linear least
    squares with weights that fade, so that what they explain is greatest.
    """
    least, share, clearly, size_mm = 8, 0.12, 3.0, 1000.0  # rows of each part, and their share
    if rows.distance_mm is not None or len(rows) < 2 * least:
        return
    J = motion_levers((predicted_mm - predicted_mm.mean(axis=0)) / size_mm)[..., :6]
    missed_mm = left_mm = rows.xyz_mm - predicted_mm
    first = 0
    for _ in range(3):
        lengths = lengths_mm(left_mm)
        weight = 1.0 / (1.0 + (lengths / max(float(np.median(lengths)), LEAST_MM)) ** 2)
        A = np.cumsum(np.einsum("n,nik,nil->nkl", weight, J, J), axis=0)
        b = np.cumsum(np.einsum("n,nik,ni->nk", weight, J, missed_mm), axis=0)
        A, b = np.stack([A[:-1], A[-1] - A[:-1]]), np.stack([b[:-1], b[-1] - b[:-1]])
        motions = np.linalg.solve(A + 1e-6 * np.eye(6), b[..., None])[..., 0]
        explained = np.sum(motions * b, axis=(0, 2))
        first = int(np.argmax(explained[least - 1 : 1 - least])) + least
        part = (np.arange(len(rows)) >= first).astype(int)
        left_mm = missed_mm - np.einsum("nik,nk->ni", J, motions[part, first - 1])
    if min(first, len(rows) - first) < share * len(rows):
        return  # sorted rows end in a corner, where a robot errs in its own way
    later, xyz_mm = slice(first, None), rows.xyz_mm.copy()
    with suppress(HilcellError):
        before = rigid(predicted_mm[:first], xyz_mm[:first])
        after = rigid(predicted_mm[later], xyz_mm[later])
        xyz_mm[later] = apply(before @ inverse(after), xyz_mm[later])
        moved_mm = float(np.median(lengths_mm(xyz_mm - rows.xyz_mm)[later]))
        if moved_mm > clearly * float(np.median(lengths_mm(xyz_mm - apply(before, predicted_mm)))):
            at = f"pose {rows.pose[first]}" + (f" (line {rows.lines[first]})" if rows.lines else "")
            says = f"the tracker or the robot moved by {moved_mm:.3g} mm before {at}"
            yield Supposed(says, replace(rows, xyz_mm=xyz_mm))


def _of_a_list(robot: Robot, rows: Measurements) -> Iterator[Supposed]:
    arm, given_rad = robot.arm, rows.joints_rad
    for says, joints_rad in (
        *_joint_units(arm, given_rad), *_joints(arm, given_rad), *_columns(arm, rows),
        *_out_of_step(rows),
    ):  # fmt: skip
        yield Supposed(says, replace(rows, joints_rad=joints_rad))
    in_rad = next(_joint_units(arm, given_rad))[1]
    what = "positions" if rows.distance_mm is None else "distances"
    for unit, factor in (
        ("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4),
        ("millimetres, not metres", 0.001), ("millimetres, not inches", 1.0 / 25.4),
    ):  # fmt: skip
        scaled = replace(rows, xyz_mm=rows.xyz_mm * factor)
        if rows.distance_mm is not None:
            scaled = replace(rows, distance_mm=rows.distance_mm * factor)
        yield Supposed(f"the {what} are {unit}", scaled, None, factor)
        if unit == "metres":
            both = replace(scaled, joints_rad=in_rad)
            yield Supposed(f"the joints are radians and the {what} are metres", both, None, factor)
    if rows.distance_mm is None:
        says = "xyz are left-handed: one axis is negated or two are exchanged"
        axes = np.eye(3)  # where the base is known, each axis differs
        negated = [np.diag(1.0 - 2.0 * each) for each in axes]
        for mirror in (*negated, *(axes[[*order]] for order in ((1, 0, 2), (2, 1, 0), (0, 2, 1)))):
            yield Supposed(says, replace(rows, xyz_mm=rows.xyz_mm @ mirror))
    for says, target in _exchanged("reflectors", rows.target):
        yield Supposed(says, replace(rows, target=target))
    for says, anchor in _exchanged("anchors", rows.anchor):
        yield Supposed(says, replace(rows, anchor=anchor))


def _joint_units(arm: Arm, joints_rad: Array) -> Iterator[tuple[str, Array]]:
    turns = np.where(arm.turning, 1.0, 0.0)
    for says, factor in (
        ("the joints are radians", np.degrees(1.0)),
        ("the joints are degrees, not radians", np.radians(1.0)),
    ):
        yield says, joints_rad * (turns * factor + 1.0 - turns)
    for row in arm.prismatic:
        for unit, factor in (("metres", 1000.0), ("millimetres", 0.001)):
            own = np.where(np.arange(len(arm)) == row, factor, 1.0)
            yield f"prismatic joint {row + 1} is in {unit}", joints_rad * own


def _joints(arm: Arm, joints_rad: Array) -> Iterator[tuple[str, Array]]:
    count = len(arm)
    if np.count_nonzero(arm.turning) >= LEAST_COUPLED:
        second, third = arm.coupled_rows
        for coupling, how in ((1.0, "with"), (-1.0, "against"), (0.0, "without")):
            if coupling != arm.coupling:
                coupled = joints_rad.copy()
                coupled[:, third] += (coupling - arm.coupling) * joints_rad[:, second]
                says = f"joint {third + 1} turns {how} joint {second + 1} (coupling = {coupling:g})"
                yield says, coupled
    for axis in range(count):
        signs = np.where(np.arange(count) == axis, -1.0, 1.0)
        yield f"joint {axis + 1} turns the other way", joints_rad * signs
    revolute = np.flatnonzero(arm.turning).tolist()
    for before, axis in pairwise(revolute):
        if axis != before + 1 or axis == revolute[2]:  # axis 3: above
            continue
        for how, sign in (("with", 1.0), ("against", -1.0)):  # as if shown to the ground
            coupled = joints_rad.copy()
            coupled[:, axis] += sign * joints_rad[:, before]
            yield f"joint {axis + 1} turns {how} joint {before + 1}", coupled
    for axis in revolute[1:-1]:  # base and reflectors follow the first and the last
        for offset_deg in (90.0, -90.0, 180.0):
            shift = np.where(np.arange(count) == axis, np.radians(offset_deg), 0.0)
            yield f"the zero of joint {axis + 1} is off by {offset_deg:g} deg", joints_rad + shift


class _Columns(NamedTuple):
    """The column of each joint, from 0, and the factor of its values."""

    order: tuple[int, ...]
    factors: tuple[float, ...]

    def read(self, joints_rad: Array) -> Array:
        return joints_rad[:, self.order] * self.factors

    def others(self, turning: Sequence[int]) -> Iterator[_Columns]:
        """Columns that differ by one sign, unit or exchange of revolute joints."""
        for n, given in enumerate(self.factors):
            may_turn = n in turning and abs(given) == 1.0
            for by in (-1.0, np.degrees(1.0), np.radians(1.0)) if may_turn else (-1.0,):
                factors = (*self.factors[:n], float(given * by), *self.factors[n + 1 :])
                yield _Columns(self.order, factors)
        for a, b in combinations(turning, 2):
            other = {self.order[a]: self.order[b], self.order[b]: self.order[a]}
            yield _Columns(tuple(other.get(n, n) for n in self.order), self.factors)

    @property
    def says(self) -> str:
        parts = []
        for n, (column, factor) in enumerate(zip(self.order, self.factors, strict=True)):
            if column != n or factor != 1.0:
                size, turned = abs(factor), " reversed" if factor < 0.0 else ""
                unit = "" if size == 1.0 else f" in {'radians' if size > 1.0 else 'degrees'}"
                parts.append(f"column j{column + 1} is joint {n + 1}{turned}{unit}")
        return ", ".join(sorted(parts))


def _columns(arm: Arm, rows: Measurements) -> Iterator[tuple[str, Array]]:
    """Yield joint columns read with other signs, units and order, several at once.

    Each reading is judged by ``A x + b = f + F p``, linear in base (A, b) and reflectors p, for
    measured positions x and flanges (F, f); the best readings are changed further.
    """
    most_rows, most_changes, width, named, equal = 60, 3, 40, 3, 2.0
    some = rows.at(range(0, len(rows), len(rows) // most_rows + 1))
    targets = sorted(set(some.target))
    of_row, which = np.arange(len(some)), np.array([targets.index(each) for each in some.target])
    design = np.zeros((len(some), 3, 12 + 3 * len(targets)))
    for axis in range(3):
        design[:, axis, 3 * axis : 3 * axis + 3] = some.xyz_mm - some.xyz_mm.mean(axis=0)
        design[:, axis, 9 + axis] = MM
    size = design.shape[2]
    if 3 * len(some) < 2 * size or not np.isfinite(design).all():
        return

    def half_mm(columns: _Columns) -> float:
        flange = forward(arm, columns.read(some.joints_rad))
        for axis in range(3):
            design[of_row, :, 12 + 3 * which + axis] = -MM * flange[:, :3, axis]
        A, b = design.reshape(-1, size), flange[:, :3, 3].ravel()
        x = np.linalg.lstsq(A, b, rcond=1e-9)[0]
        if columns != given and not np.linalg.det(x[:9].reshape(3, 3)) > 0.0:
            return np.inf  # a left-handed frame is supposed of columns as they are
        return float(np.median(lengths_mm((A @ x - b).reshape(-1, 3))))

    turning = np.flatnonzero(arm.turning).tolist()
    given = _Columns(tuple(range(len(arm))), (1.0,) * len(arm))
    left_mm, best, count = {given: half_mm(given)}, [given], {given: 0}
    for changes in range(1, most_changes + 1):
        least_mm = left_mm[best[0]]
        found = {each for columns in best for each in columns.others(turning)} - {*left_mm}
        left_mm |= {columns: half_mm(columns) for columns in sorted(found)}
        count |= dict.fromkeys(found, changes)
        best = sorted(left_mm, key=lambda columns: left_mm[columns])[:width]
        if least_mm <= min(LEFT_MM, equal * left_mm[best[0]]):
            break
    most_mm = min(LEFT_MM, equal * left_mm[best[0]])
    fitting = [columns for columns in best if left_mm[columns] <= most_mm]
    fewest = min((count[columns] for columns in fitting), default=0)
    for columns in [each for each in fitting if count[each] == fewest != 0][:named]:
        yield columns.says, columns.read(rows.joints_rad)


def _exchanged(what: str, labels: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    names = sorted(set(labels))
    for a, b in combinations(names, 2):
        other = {a: b, b: a}
        yield f"{what} {a} and {b} are exchanged", [other.get(each, each) for each in labels]
    most = 4  # names of which all permutations are tried
    for others in permutations(names) if len(names) <= most else ():
        other = {a: b for a, b in zip(names, others, strict=True) if a != b}
        if len(other) > 2:
            swapped = ", ".join(f"{a} is {b}" for a, b in other.items())
            yield f"{what} are exchanged: {swapped}", [other.get(each, each) for each in labels]


def _out_of_step(rows: Measurements) -> Iterator[tuple[str, Array]]:
    order = list(dict.fromkeys(rows.pose))
    number = np.array([order.index(pose) for pose in rows.pose])
    first = rows.joints_rad[[rows.pose.index(pose) for pose in order]]
    yield "each pose has the joints of the pose after it", np.roll(first, 1, axis=0)[number]
    yield "each pose has the joints of the pose before it", np.roll(first, -1, axis=0)[number]
    yield "the poses' joints are in reverse order", first[::-1][number]


def _of_the_file(robot: Robot) -> Iterator[tuple[str, Arm]]:
    """Yield other readings of the robot file."""
    arm, of = robot.arm, "of the robot file"
    yield from _lengths(arm)
    flat_rad = 1.001 * np.radians(np.pi)
    if 0.0 < np.abs(arm.alpha_rad).max() <= flat_rad:
        yield f"alpha {of} is in radians", replace(arm, alpha_rad=np.degrees(arm.alpha_rad))
    if 0.0 < np.abs(arm.offset_rad).max() <= flat_rad:
        yield f"offset {of} is in radians", replace(arm, offset_rad=np.degrees(arm.offset_rad))
    base = robot.base  # of a modified table it has the first a and alpha
    for convention, by, first_a_mm, first_alpha_rad in (
        ("modified-dh", -1, arm.a_mm[1:2], arm.alpha_rad[1:2]),
        ("standard-dh", 1, base[0, 3], np.arctan2(base[2, 1], base[2, 2])),
    ):
        a_mm, alpha_rad = np.roll(arm.a_mm, by), np.roll(arm.alpha_rad, by)
        a_mm[:1], alpha_rad[:1] = first_a_mm, first_alpha_rad
        rolled = replace(arm, a_mm=a_mm, alpha_rad=alpha_rad)
        yield f"the convention {of} is {convention}", rolled


def _lengths(arm: Arm) -> Iterator[tuple[str, Arm]]:
    short_mm, metre_mm = 10.0, 1000.0
    a_mm, d_mm = arm.a_mm, arm.d_mm
    if max(np.abs(a_mm).max(), np.abs(d_mm).max()) < short_mm:
        whole = replace(arm, a_mm=metre_mm * a_mm, d_mm=metre_mm * d_mm)
        yield "all lengths of the robot file are metres", whole
    for row in range(len(arm)):
        by = np.where(np.arange(len(arm)) == row, metre_mm, 1.0)
        for name, length_mm, other in (
            ("a", a_mm[row], replace(arm, a_mm=a_mm * by)),
            ("d", d_mm[row], replace(arm, d_mm=d_mm * by)),
        ):
            if 0.0 < abs(length_mm) < short_mm:
                yield f"{name}{row + 1} of the robot file is in metres", other
