"""Mistakes in lists are named, wrong ones never, and no row that shows one is struck out."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from hilcell.fit.measurements import Measurements
from hilcell.fit.methods import fit_robot
from hilcell.fit.placement import FitError
from hilcell.fit.robot_file import Robot
from hilcell.fit.suppositions import moved_amid
from hilcell.geometry.frames import apply, pose_from_zyx
from hilcell.geometry.kinematics import Arm
from tests.hilcell.fit.test_fit import IRB120, measured, measured_at, turned_alike
from tests.hilcell.fit.test_serial_chains import CHAINS

Spoil = Callable[[Measurements], Measurements]


def joints(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return lambda rows: replace(rows, joints_rad=change(rows.joints_rad.copy()))


def xyz(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    return lambda rows: replace(rows, xyz_mm=change(rows.xyz_mm.copy()))


def coupled(axis: int, sign: float) -> Spoil:
    """Shown as if joint axis + 1 counted the one before it too."""
    return joints(
        lambda q: q + sign * np.eye(6)[axis] * np.roll(q, 1, axis=1) * (np.arange(6) == axis)
    )


def exchanged(poses: int) -> Spoil:
    def spoil(rows: Measurements) -> Measurements:
        of = set(list(dict.fromkeys(rows.pose))[3 : 3 + poses])
        other = {"SMR1": "SMR2", "SMR2": "SMR1"}
        target = [
            other[name] if pose in of else name
            for pose, name in zip(rows.pose, rows.target, strict=True)
        ]
        return replace(rows, target=target)

    return spoil


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (joints(np.degrees), "the joints are degrees, not radians"),
        (xyz(lambda x: x / 25.4), "the positions are inches"),
        (xyz(lambda x: x * 1000.0), "the positions are millimetres, not metres:"),
        (joints(lambda q: q * [1, -1, 1, 1, 1, 1]), "joint 2 turns the other way"),
        (coupled(2, -1.0), "joint 3 turns with joint 2"),
        (coupled(4, 1.0), "joint 5 turns against joint 4"),
        (joints(lambda q: q + np.radians([0, 0, 90, 0, 0, 0])), "joint 3 is off by -90 deg"),
        (xyz(lambda x: x[:, [1, 0, 2]]), "xyz are left-handed"),
        (exchanged(1), "SMR1 and SMR2 are exchanged in 1 pose"),
        (exchanged(10), "SMR1 and SMR2 are exchanged in 10 pose"),
    ],
)
def test_the_mistake_that_explains_the_rows_is_named(spoil: Spoil, named: str) -> None:
    rows = measured(1, 24, ["SMR1", "SMR2"])
    with pytest.raises(FitError, match=f"they fit if .*{named}") as refused:
        fit_robot(IRB120, spoil(rows))
    assert ", or " not in str(refused.value)


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (joints(lambda q: q[:, [0, 2, 1, 3, 4, 5]]), "column j2 is joint 3, column j3 is joint 2"),
        (
            joints(lambda q: q * [1, -1, -1, 1, -1, 1]),
            ", ".join(f"column j{n} is joint {n} reversed" for n in (2, 3, 5)),
        ),
        (joints(lambda q: q * [1, 1, np.pi / 180, 1, 1, 1]), "column j3 is joint 3 in radians"),
        (
            joints(lambda q: q[:, [0, 1, 2, 3, 5, 4]] * [1, 1, 1, -1, 1, 1]),
            "column j4 is joint 4 reversed, column j5 is joint 6, column j6 is joint 5",
        ),
    ],
)
def test_columns_of_joints_that_are_mixed_up_are_named(spoil: Spoil, named: str) -> None:
    rows, test = measured(1, 40, ["SMR1", "SMR2"]), measured(2, 24, ["SMR1", "SMR2"])
    with pytest.raises(FitError, match=f"they fit if {named}:"):
        fit_robot(IRB120, spoil(rows))
    with pytest.raises(FitError, match=f"they fit if {named}:"):
        fit_robot(IRB120, rows, spoil(test))


@pytest.mark.parametrize(("poses", "factor"), [(14, 1.0), (25, 1.0), (35, 1.0), (25, 200.0)])
def test_a_tracker_that_moved_amid_the_rows_is_named_with_the_row(
    poses: int, factor: float
) -> None:
    rows = replace(measured(1, 40, ["SMR1", "SMR2"]), lines=range(2, 82))
    moved = pose_from_zyx(1.2 * factor, -1.0 * factor, 1.0 * factor, 0.02, 0.01 * factor, 0.0)
    middle = rows.xyz_mm.mean(axis=0)
    rows.xyz_mm[2 * poses :] = apply(moved, rows.xyz_mm[2 * poses :] - middle) + middle
    named = f"moved by .* mm before pose {1000 + poses} .line {2 + 2 * poses}.:"
    with pytest.raises(FitError, match=f"they fit if the tracker or the robot {named}"):
        fit_robot(IRB120, rows)


def test_a_few_rows_far_from_the_others_are_no_moved_tracker() -> None:
    rows = measured(1, 96, ["SMR1"])
    predicted_mm = rows.xyz_mm.copy()
    rows.xyz_mm[88:] += [1.0, -1.0, 1.0]
    assert not list(moved_amid(rows, predicted_mm + 0.02))
    rows.xyz_mm[80:88] += [1.0, -1.0, 1.0]
    assert len(list(moved_amid(rows, predicted_mm + 0.02))) == 1


def some(change: Spoil, of: Sequence[int]) -> Spoil:
    """A mistake in few rows."""

    def spoil(rows: Measurements) -> Measurements:
        changed = change(rows)
        for n in of:
            rows.joints_rad[n], rows.xyz_mm[n] = changed.joints_rad[n], changed.xyz_mm[n]
        return rows

    return spoil


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (some(xyz(lambda x: x / 1000.0), [3, 9, 20]), "the positions are metres in 3 poses"),
        (some(xyz(lambda x: x * 25.4), [3, 9, 20]), "millimetres, not inches in 3 poses"),
        (some(joints(np.radians), [3, 9, 20]), "the joints are radians in 3 poses"),
        (some(xyz(lambda x: x * [1, -1, 1]), [3, 9, 20]), "left-handed: .* in 3 poses"),
        (some(xyz(lambda x: x[:, [0, 2, 1]]), [3, 9, 20]), "left-handed: .* in 3 poses"),
        (some(coupled(2, -1.0), [3, 9, 20]), r"\(coupling = 1\) in 3 poses"),
        (some(joints(lambda q: np.roll(q, 1, axis=0)), range(9, 21)), "before it in 11 poses"),
        (some(xyz(lambda x: x / 1000.0), range(21)), "the positions are metres in 21 poses"),
    ],
)
def test_a_mistake_in_some_rows_is_named_with_them(spoil: Spoil, named: str) -> None:
    rows, test = measured(1, 24, ["SMR1"]), measured(2, 24, ["SMR1"])
    first = 1000 if "21" in named else 1009 if "11" in named else 1003
    with pytest.raises(FitError, match=f"they fit if .*{named}: {first}, ") as refused:
        fit_robot(IRB120, spoil(rows))
    assert ", or " not in str(refused.value)
    if "3 poses" in named:
        with pytest.raises(FitError, match=f"they fit if .*{named}: 2003, 2009, 2020:"):
            fit_robot(IRB120, measured(1, 24, ["SMR1"]), spoil(test))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda arm: replace(arm, a_mm=arm.a_mm * [1, 0.001, 1, 1, 1, 1]), "a2 of the robot"),
        (lambda arm: replace(arm, d_mm=arm.d_mm * [1, 1, 1, 0.001, 1, 1]), "d4 of the robot"),
        (lambda arm: replace(arm, a_mm=arm.a_mm / 1e3, d_mm=arm.d_mm / 1e3), "all lengths"),
        (lambda arm: replace(arm, alpha_rad=np.radians(arm.alpha_rad)), "alpha of the robot"),
        (lambda arm: replace(arm, coupling=1.0), "coupling = 0"),
        (lambda arm: replace(arm, coupling=-1.0), "coupling = 0"),
        (
            lambda arm: replace(
                arm, a_mm=np.roll(arm.a_mm, 1), alpha_rad=np.roll(arm.alpha_rad, 1)
            ),
            "convention of the robot file is modified-dh",
        ),
    ],
)
def test_a_mistake_in_the_robot_file_is_named(change: Callable[[Arm], Arm], named: str) -> None:
    robot = replace(IRB120, arm=change(IRB120.arm))
    with pytest.raises(FitError, match=f"they fit if [^,]*{named}") as refused:
        fit_robot(robot, measured(1, 24, ["SMR1"]))
    assert ", or " not in str(refused.value)


def test_standard_rows_read_as_modified_ones_are_named() -> None:
    rows = np.column_stack([
        IRB120.arm.a_mm, np.degrees(IRB120.arm.alpha_rad), IRB120.arm.d_mm,
        np.degrees(IRB120.arm.offset_rad),
    ])  # fmt: skip
    robot = Robot.from_dh("modified", rows, convention="modified-dh")
    with pytest.raises(FitError, match=r"they fit if the convention .* is standard-dh:"):
        fit_robot(robot, measured(1, 24, ["SMR1"]))


def test_a_prismatic_joint_in_the_wrong_unit_is_named() -> None:
    rows = CHAINS["on a rail"].measured(1, 40, ["SMR1"])
    for factor, unit in ((1000.0, "millimetres"), (0.001, "metres")):
        wrong = joints(partial(np.multiply, np.append(factor, np.ones(6))))(rows)
        with pytest.raises(FitError, match=f"they fit if prismatic joint 1 is in {unit}:"):
            fit_robot(CHAINS["on a rail"].robot, wrong)


def test_reflectors_exchanged_in_few_test_poses_are_named() -> None:
    rows, test = (measured(n, 24, ["SMR1", "SMR2"]) for n in (1, 2))
    named = "SMR1 and SMR2 are exchanged in 2 poses: 2003, 2004:"
    with pytest.raises(FitError, match=f"they fit if reflectors {named}"):
        fit_robot(IRB120, rows, exchanged(2)(test))


def test_a_test_row_far_off_is_named_and_judged() -> None:
    rows, test = measured(1, 40, ["SMR1"]), measured(2, 20, ["SMR1"])
    assert fit_robot(IRB120, rows, test).result["test_outliers"] == []
    test.xyz_mm[7, 1] += 15.0
    result = fit_robot(IRB120, rows, test).result
    [far] = result["test_outliers"]
    assert (far["pose"], far["target"], result["test"]) == ("2007", "SMR1", 20)
    assert far["miss_mm"] == pytest.approx(15.0, abs=0.2)


def test_rows_are_named_where_a_third_is_corrupted() -> None:
    rows = measured(1, 60, ["SMR1"])
    rows.xyz_mm[::3] += np.random.default_rng(4).uniform(-9.0, 9.0, (20, 3))
    with pytest.raises(FitError, match=r"(19|20) of 60 .* contradict the others.*: pose 1000 tar"):
        fit_robot(IRB120, rows)


def test_mistakes_that_explain_alike_are_both_named() -> None:
    """Without a shoulder offset, the arm behind its base is the one before it, turned back."""
    rows = measured(1, 24, ["SMR1"])
    spoilt = joints(lambda q: q + np.radians([0, 180, 0, 0, 0, 0]))(rows)
    both = "joint 1 turns the other way, or the zero of joint 2 is off by 180 deg"
    with pytest.raises(FitError, match=f"they fit if {both}"):
        fit_robot(IRB120, spoilt)


def test_a_coupling_that_few_rows_show_by_millimetres_is_named() -> None:
    """They would be struck out as slips, and the robot corrected as if it were serial."""
    rows = measured(1, 60, ["SMR1"])
    true = rows.joints_rad.copy()
    true[:, 1] = np.where(np.arange(60) % 12 == 0, 0.01, 0.0)
    shown = true.copy()
    shown[:, 2] -= true[:, 1]
    with pytest.raises(FitError, match=r"5 of 60 .* they fit if joint 3 turns with joint 2 "):
        fit_robot(IRB120, replace(measured_at(true, rows), joints_rad=shown))


def test_rows_that_no_mistake_explains_say_so() -> None:
    rows = measured(1, 24, ["SMR1", "SMR2"])
    other = np.random.default_rng(3).permutation(24)
    shuffled = rows.joints_rad.reshape(24, 2, 6)[other].reshape(48, 6)
    with pytest.raises(
        FitError, match=r"none of the [0-9]+ mistakes tried explains all"
    ) as refused:
        fit_robot(IRB120, replace(rows, joints_rad=shuffled))
    assert "they fit if" not in str(refused.value)


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (joints(lambda q: q * [1, 1, 1, 1, -1, 1]), "joint 5 turns the other way"),
        (
            xyz(lambda x: apply(pose_from_zyx(3.0, -1.0, 2.0, 0.1, 0.0, 0.0), x)),
            "the tracker or the robot moved between the files",
        ),
    ],
)
def test_a_mistake_in_test_rows_is_named(spoil: Spoil, named: str) -> None:
    rows, test = measured(1, 24, ["SMR1"]), measured(2, 12, ["SMR1"])
    with pytest.raises(FitError, match=f"they fit if {named}"):
        fit_robot(IRB120, rows, spoil(test))


def test_undetermined_rows_are_named_and_the_others_judged() -> None:
    rows = measured(1, 25, ["SMR1"])
    train, test, others = (
        measured_at(turned_alike(seed, 25, turned_deg), rows)
        for seed, turned_deg in ((1, 20.0), (2, 20.0), (3, 30.0))
    )
    mixed = replace(
        test,
        joints_rad=np.concatenate([test.joints_rad[:20], others.joints_rad[:5]]),
        xyz_mm=np.concatenate([test.xyz_mm[:20], others.xyz_mm[:5]]),
    )
    result = fit_robot(IRB120, train, mixed).result
    assert [row["pose"] for row in result["undetermined"]] == mixed.pose[20:]
    assert all(row["bound_mm"] > result["undetermined_mm"] for row in result["undetermined"])
    assert (result["rows"], result["train"], result["test"]) == (25, 25, 20)
    assert result["methods"][result["chosen"]]["mean_mm"] < 0.06
