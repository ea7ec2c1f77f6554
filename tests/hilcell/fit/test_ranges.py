"""Distances of a reflector from unknown points: a ball bar, and an instrument of range alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.fit.measurements import Measurements, read_measurements
from hilcell.fit.methods import FittedArm, fit_robot
from hilcell.fit.placement import FitError, place
from hilcell.fit.ranges import Anchors
from hilcell.geometry.frames import apply, rigid_fit
from hilcell.geometry.kinematics import Array, forward
from tests.hilcell.fit.test_fit import IRB120, SMR_MM, crooked_arm

RANGE = np.array([1.2, 0.8, 0.8, 1.5, 1.2, 2.0])
ANCHORS = np.array([[500.0, 300.0, 0.0], [400.0, -500.0, 100.0], [0.0, 500.0, 200.0]])
BAR_MM = 400.0


def reflector(joints_rad: Array) -> Array:
    """Places (N, 3) of the crooked robot's reflector in its root frame."""
    flange = forward(crooked_arm(), joints_rad)
    return np.asarray(flange[:, :3, 3] + flange[:, :3, :3] @ np.array(SMR_MM["SMR2"]))


def on_the_bar(joints_rad: Array) -> Array:
    """The joints moved least, until the reflector is a bar's length from the first anchor."""
    for _ in range(8):
        off_mm = np.linalg.norm(reflector(joints_rad) - ANCHORS[0], axis=1) - BAR_MM
        slope = np.empty(joints_rad.shape)
        for joint in range(6):
            step = 1e-6 * np.eye(6)[joint]
            away = np.linalg.norm(reflector(joints_rad + step) - ANCHORS[0], axis=1)
            slope[:, joint] = (away - off_mm - BAR_MM) / 1e-6
        joints_rad = joints_rad - (off_mm / np.sum(slope**2, axis=1))[:, None] * slope
    return joints_rad


def ranges(seed: int, poses: int, anchors: int, *, bar: bool = False) -> Measurements:
    rng = np.random.default_rng(seed)
    joints_rad = RANGE * rng.uniform(-1.0, 1.0, (poses, 6))
    if bar:
        joints_rad = on_the_bar(joints_rad)
        reached = np.abs(joints_rad) <= 2.5
        joints_rad = joints_rad[reached.all(axis=1)]
    of_row = rng.integers(0, anchors, len(joints_rad))
    away = np.linalg.norm(reflector(joints_rad) - ANCHORS[of_row], axis=1)
    positions = np.zeros((len(joints_rad), 3))
    return replace(
        Measurements.from_arrays(joints_rad, positions),
        xyz_mm=np.full_like(positions, np.nan),
        anchor=[f"nest {n}" for n in of_row],
        distance_mm=away + rng.normal(0, 0.01, len(away)),
    )


def shape_mm(rows: Measurements) -> tuple[float, float]:
    """Mean distances of nominal and identified positions from the true ones, all at other poses and
    in the best common frame: distances from points that nobody measured tell of no other.
    """
    train = Anchors.of(IRB120.arm, rows).located(rows)
    arm = FittedArm.learn(place(IRB120.arm, train), train, "mdh", trusted=False)
    joints_rad = RANGE * np.random.default_rng(77).uniform(-1.0, 1.0, (60, 6))
    true_mm = reflector(joints_rad)
    found = []
    nominal = forward(IRB120.arm, joints_rad)
    at_smr_mm = nominal[:, :3, 3] + nominal[:, :3, :3] @ np.array(SMR_MM["SMR2"])
    for at_mm in (at_smr_mm, arm.predict(Measurements.unmeasured(joints_rad, "SMR"))[0]):
        T = rigid_fit(at_mm, true_mm).T
        found.append(float(np.linalg.norm(apply(T, at_mm) - true_mm, axis=1).mean()))
    return found[0], found[1]


@pytest.mark.parametrize(
    ("anchors", "bar", "most_mm"), [(1, False, 0.05), (3, False, 0.05), (1, True, 0.05)]
)
def test_distances_identify_a_robot(anchors: int, bar: bool, most_mm: float) -> None:
    nominal_mm, found_mm = shape_mm(ranges(1, 100, anchors, bar=bar))
    assert nominal_mm > 0.5
    assert found_mm < most_mm


def test_distances_are_predicted_within_their_bounds() -> None:
    rows, test = ranges(2, 60, 3), ranges(3, 60, 3)
    assert rows.distance_mm is not None
    rows.distance_mm[7] += 3.0
    result = fit_robot(IRB120, rows, test).result
    assert [each["pose"] for each in result["outliers"]] == ["8"]
    assert "distances" in result["refused"]["idw"]
    assert result["methods"][result["chosen"]]["mean_mm"] < 0.02
    assert result["methods"]["nominal"]["mean_mm"] > 0.1
    assert result["coverage"][result["chosen"]]["share"] >= 0.85


def test_repeated_distances_count_once() -> None:
    once = ranges(1, 60, 2)
    rows = once.at(np.repeat(np.arange(len(once)), 3))
    assert rows.distance_mm is not None
    noise_mm = np.random.default_rng(4).normal(0, 0.01, len(rows))
    result = fit_robot(IRB120, replace(rows, distance_mm=rows.distance_mm + noise_mm)).result
    assert result["rows"] == len(once)


def test_distances_are_read(tmp_path: Path) -> None:
    rows, said = ranges(4, 5, 2), list[str]()
    assert rows.distance_mm is not None
    lines = ["Anchor,distance_m,j1_rad,j2_rad,j3_rad,j4_rad,j5_rad,j6_rad"]
    for anchor, away, joints in zip(rows.anchor, rows.distance_mm, rows.joints_rad, strict=True):
        lines.append(",".join([anchor, f"{away / 1000:.9f}", *(f"{each:.9f}" for each in joints)]))
    path = tmp_path / "ranges.csv"
    path.write_text("\n".join(lines))
    read = read_measurements(path, say=said.append)
    assert read.anchor == rows.anchor
    assert read.distance_mm is not None
    np.testing.assert_allclose(read.distance_mm, rows.distance_mm, atol=1e-5)
    assert "anchors nest 0, nest 1; 6 joints in rad; distances in m" in said[0]
    for wrong, says in (
        ("x_mm,distance_m", "missing: y_mm, z_mm; not understood: Anchor, distance_m"),
        ("rx_rad,distance_m", "missing: ry_deg"),
        ("away", "missing: x_mm, y_mm, z_mm; not understood: away"),
    ):
        path.write_text("\n".join([lines[0].replace("distance_m", wrong), *lines[1:]]))
        with pytest.raises(SettingsError, match=says):
            read_measurements(path)
    path.write_text("\n".join([*lines, lines[1].replace("0.", "-0.", 1)]))
    with pytest.raises(SettingsError, match=r"line 7: distance_m is -.* more than 0"):
        read_measurements(path)


def test_distances_that_tell_nothing_are_refused() -> None:
    rows, test = ranges(2, 40, 1), ranges(3, 10, 2)
    with pytest.raises(FitError, match="no training row measures from anchor nest 1"):
        fit_robot(IRB120, rows, test)
    with pytest.raises(FitError, match="positions or distances, in both"):
        fit_robot(IRB120, rows, replace(test, distance_mm=None))
    backwards = replace(rows, joints_rad=rows.joints_rad[::-1])
    with pytest.raises(FitError, match="they fit if the poses' joints are in reverse order"):
        fit_robot(IRB120, backwards)
    mixed = np.random.default_rng(4).permutation(len(rows.joints_rad))
    with pytest.raises(FitError, match="half of the distances"):
        fit_robot(IRB120, replace(rows, joints_rad=rows.joints_rad[mixed]))


def exchanged(rows: Measurements, poses: list[int]) -> Measurements:
    """The rows with two anchors exchanged in some."""
    other = {"nest 0": "nest 1", "nest 1": "nest 0"}
    anchor = [other[each] if n in poses else each for n, each in enumerate(rows.anchor)]
    return replace(rows, anchor=anchor)


def test_exchanged_anchors_are_named() -> None:
    rows, test = (ranges(seed, 60, 2) for seed in (1, 2))
    for train, asked, named in (
        (exchanged(rows, [4, 20, 41]), test, "exchanged in 3 poses: 5, 21, 42:"),
        (rows, exchanged(test, [4, 20, 41]), "exchanged in 3 poses: 5, 21, 42:"),
        (rows, exchanged(test, [*range(60)]), "exchanged:"),
    ):
        with pytest.raises(FitError, match=f"they fit if anchors nest 0 and nest 1 are {named}"):
            fit_robot(IRB120, train, asked)


def test_a_slip_of_a_distance_is_named_with_its_anchor() -> None:
    rows = ranges(1, 60, 2)
    assert rows.distance_mm is not None
    rows.distance_mm[7] += 3.0
    [found] = fit_robot(IRB120, rows).result["outliers"]
    assert (found["pose"], found["anchor"]) == ("8", rows.anchor[7])
    rows.distance_mm[7] += 300.0
    with pytest.raises(FitError, match=f"pose 8 target SMR anchor {rows.anchor[7]} by 30[0-9]"):
        fit_robot(IRB120, rows)
