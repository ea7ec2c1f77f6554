"""`fit` on poses that were measured again, on rows in any order, and on rows that contradict."""

from dataclasses import replace

import numpy as np
import pytest

from hilcell.fit.methods import fit_robot, worse_than_nominal
from hilcell.fit.placement import FitError
from hilcell.fit.robot_file import Measurements
from hilcell.geometry.statistics import Figures
from tests.hilcell.fit.test_fit import IRB120, measured


def copied(rows: Measurements, times: int) -> Measurements:
    """The same poses again in further rounds, with pose numbers of their own, noise and joints that
    the controller reports a little differently.
    """
    rng = np.random.default_rng(6)
    again = rows.at(np.tile(np.arange(len(rows)), times))
    turn = np.repeat(np.arange(times), len(rows))
    return replace(
        again,
        pose=[f"{pose}.{n}" for pose, n in zip(again.pose, turn, strict=True)],
        joints_rad=again.joints_rad + np.radians(0.002) * rng.uniform(-1, 1, (len(again), 6)),
        xyz_mm=again.xyz_mm + rng.normal(0, 0.01, again.xyz_mm.shape),
    )


def test_poses_measured_again_do_not_flatter_a_method() -> None:
    """Their errors are known from the copy, whatever the pose's number."""
    rows, test = measured(1, 22, ["SMR1"]), measured(2, 40, ["SMR1"])
    once, thrice = (
        fit_robot(IRB120, rows, test).result,
        fit_robot(IRB120, copied(rows, 3), test).result,
    )
    assert thrice["chosen"] not in ("nominal", "idw")
    for result in (once, thrice):
        idw = result["coverage"]["idw"]
        assert idw["share"] >= 0.85
        assert idw["bound_mm"] > 0.8 * once["coverage"]["idw"]["bound_mm"]
    assert thrice["coverage"][thrice["chosen"]]["share"] >= 0.85


def test_a_pose_counts_once_however_often_it_is_measured() -> None:
    result = fit_robot(IRB120, copied(measured(1, 15, ["SMR1"]), 4)).result
    assert "15 poses" in result["refused"]["tool"]
    with pytest.raises(FitError, match="8"):
        fit_robot(IRB120, copied(measured(1, 8, ["SMR1"]), 4))


def test_the_order_of_rows_decides_nothing() -> None:
    rows, test = measured(1, 22, ["SMR1", "SMR2"]), measured(2, 20, ["SMR1", "SMR2"])
    rows.xyz_mm[7, 0] += 10.0
    first = fit_robot(IRB120, rows, test).result
    shuffled = rows.at(np.random.default_rng(4).permutation(len(rows)))
    again = fit_robot(IRB120, shuffled, test).result
    assert (again["chosen"], again["reason"]) == (first["chosen"], first["reason"])
    assert len(again["outliers"]) == len(first["outliers"]) == 1
    for method, figures in first["methods"].items():
        assert again["methods"][method] == pytest.approx(figures, rel=1e-5)
        assert again["coverage"][method] == pytest.approx(first["coverage"][method], rel=1e-5)


def test_test_rows_that_contradict_the_training_rows_are_refused() -> None:
    """A tracker whose lengths are 0.05 % too long."""
    rows, test = measured(1, 22, ["SMR1", "SMR2"]), measured(2, 20, ["SMR1", "SMR2"])
    other = replace(test, xyz_mm=1.0005 * test.xyz_mm, source="test.csv")
    with pytest.raises(FitError, match=r"test\.csv: .*40 rows"):
        fit_robot(IRB120, rows, other)


def test_a_choice_worse_than_nominal_on_the_test_rows_is_not_kept() -> None:
    """The reproduction: 6.1 against 5.3 mm, chosen without a word."""
    means_mm = (("nominal", 5.3), ("idw", 6.1), ("tool", 0.1))
    judged = {name: Figures(mean_mm, 7.0, 9.0) for name, mean_mm in means_mm}
    assert worse_than_nominal("idw", judged)
    assert not worse_than_nominal("tool", judged)
    assert not worse_than_nominal("nominal", judged)
    assert worse_than_nominal("idw", judged | {"idw": Figures(float("nan"), 7.0, 9.0)})
