"""The arm of a URDF and a DH table, judged by an independent reader of the files."""

import csv
import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.fit.measurements import Measurements
from hilcell.fit.methods import fit_robot
from hilcell.fit.placement import FitError
from hilcell.fit.rigid_arm import RigidArm, alone, rigid_arm, urdf_bytes, write_dh
from hilcell.fit.robot_file import Robot
from hilcell.fit.urdf_file import Urdf, read_urdf
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array, forward
from hilcell.geometry.statistics import figures_of
from tests.hilcell.fit.test_fit import IRB120, SMR_MM, T_L_B, measured
from tests.hilcell.fit.urdfs import PLAIN, reached_m

NOISE_MM = 0.02  # of each coordinate of `measured`
NAMES = list(SMR_MM)


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Urdf:
    path = tmp_path_factory.mktemp("urdf") / "robot.urdf"
    path.write_text(PLAIN)
    return read_urdf(path)


@pytest.fixture(scope="module")
def found(urdf: Urdf) -> RigidArm:
    return rigid_arm(fit_robot(urdf, measured(1, 20, NAMES)))


def seen_mm(text: bytes, T_L_root: Array, smr_mm: dict[str, Array], rows: Measurements) -> Array:
    """Where a URDF has the rows' reflectors, in the tracker's frame."""
    out = []
    for joints, target in zip(rows.joints_rad, rows.target, strict=True):
        tip = reached_m(text, {f"joint_{n + 1}": q for n, q in enumerate(joints)})
        tip[:3, 3] *= 1000.0
        out.append(apply(T_L_root @ tip, smr_mm[target][None])[0])
    return np.array(out)


@pytest.mark.parametrize("form", ["urdf", "toml"])
def test_a_calibrated_urdf_alone_predicts_other_poses(
    urdf: Urdf, found: RigidArm, tmp_path: Path, form: str
) -> None:
    robot: Robot = urdf
    arm = found
    if form == "toml":
        robot, arm = IRB120, rigid_arm(fit_robot(IRB120, measured(1, 20, NAMES)))
    (tmp_path / "c.urdf").write_bytes(urdf_bytes(robot, arm, ["a remark"]))
    text = (tmp_path / "c.urdf").read_bytes()
    assert b"a remark" in text
    T_L_root = arm.T_L_B @ inverse(robot.base)
    smr_mm = {n: apply(inverse(robot.tool), p[None])[0] for n, p in arm.smr_mm.items()}
    rows = measured(2, 6, NAMES)
    missed = np.linalg.norm(rows.xyz_mm - seen_mm(text, T_L_root, smr_mm, rows), axis=1)
    assert missed.mean() < 2.5 * NOISE_MM
    nominal = seen_mm(PLAIN.encode(), T_L_root, smr_mm, rows)
    assert np.linalg.norm(rows.xyz_mm - nominal, axis=1).mean() > 10 * missed.mean()


@pytest.mark.parametrize("coupling", [0.0, 1.0, -1.0])
def test_the_limits_are_those_of_the_axes_and_the_arm_is_the_same_there(
    found: RigidArm, coupling: float
) -> None:
    arm = replace(IRB120.arm, sign=np.array([-1.0, 1, 1, -1, 1, -1]), coupling=coupling)
    low, high = np.radians([[-170, -110, -110, -160, -120, -400], [165, 100, 70, 150, 110, 390]])
    robot = Robot(
        "r", arm, limits_rad=np.array([low, high]), speeds_rad_s=np.radians(np.arange(6) + 100.0)
    )
    text = urdf_bytes(robot, replace(found, arm=arm), ["a remark"])
    limits = [each.attrib for each in ET.fromstring(text).findall("joint[@type='revolute']/limit")]
    lower, upper, speed = (
        np.array([float(each[key]) for each in limits]) for key in ("lower", "upper", "velocity")
    )
    ends_rad = np.array([low, high, np.where(np.arange(6) == 1, high, low)])
    for joints, axes in zip(ends_rad, arm.angles(ends_rad), strict=True):
        tip = reached_m(text, {f"joint_{n}": angle for n, angle in enumerate(axes, start=1)})
        tip[:3, 3] *= 1000.0
        np.testing.assert_allclose(tip, forward(arm, joints), atol=1e-4)
    others = [0, 1, 3, 4, 5]
    np.testing.assert_allclose(np.array([lower, upper])[:, others], [low[others], high[others]])
    corners_rad = np.array([[low[1], low[2]], [low[1], high[2]], [high[1], low[2]],
                            [high[1], high[2]]])  # fmt: skip
    third_rad = corners_rad[:, 1] + coupling * corners_rad[:, 0]
    np.testing.assert_allclose([lower[2], upper[2]], [third_rad.min(), third_rad.max()])
    assert np.degrees(speed[2]) == pytest.approx(102.0 + abs(coupling) * 101.0)


def test_the_comment_places_root_and_reflectors(
    urdf: Urdf, found: RigidArm, tmp_path: Path
) -> None:
    content = urdf_bytes(urdf, found, alone(figures_of(np.ones(3))))
    (tmp_path / "c.urdf").write_bytes(content)
    head = (tmp_path / "c.urdf").read_text().split("-->")[1]
    assert "1.0000 mm" in head
    line = next(each for each in head.splitlines() if "Root link" in each)
    xyz = [float(word) for word in line.split(": ")[1].split(";")[0].split()]
    np.testing.assert_allclose(xyz, T_L_B[:3, 3] / 1000.0, atol=2e-3)
    line = next(each for each in head.splitlines() if "Reflector SMR2" in each)
    xyz = [float(word) for word in line.split(": ")[1].split()]
    np.testing.assert_allclose(np.linalg.norm(xyz), np.linalg.norm(SMR_MM["SMR2"]) / 1e3, atol=2e-3)


def test_the_table_states_what_the_poses_determine(
    urdf: Urdf, found: RigidArm, tmp_path: Path
) -> None:
    write_dh(tmp_path / "dh.csv", urdf, found, inputs=[])
    lines = (tmp_path / "dh.csv").read_text().splitlines()
    rows = {row["parameter"]: row for row in csv.DictReader(lines)}
    assert len(rows) == 30
    assert float(rows["a2"]["nominal"]) == pytest.approx(270.0)
    assert rows["a2"]["unit"] == "mm"
    assert rows["alpha3"]["unit"] == "deg"
    true = np.random.default_rng(99).normal(0, 0.2, 6)  # the errors of a in `measured`
    for number in (1, 2, 3):
        row = rows[f"a{number}"]
        assert row["determined"] == "yes"
        error = float(row["identified"]) - float(row["nominal"])
        assert abs(error - true[number - 1]) < 4 * float(row["u"]) + 0.02
        assert float(row["u"]) < float(row["prior_u"])
    assert rows["d1"]["determined"] == "no"  # the base's height does the same


def test_the_json_table_has_the_covariance(urdf: Urdf, found: RigidArm, tmp_path: Path) -> None:
    write_dh(tmp_path / "dh.json", urdf, found, inputs=[])
    table = json.loads((tmp_path / "dh.json").read_text())
    covariance = np.array(table["covariance"])
    u = [each["u"] for each in table["parameters"]]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), u, rtol=1e-9)
    assert sorted(table["reflectors_mm"]) == sorted(SMR_MM)
    np.testing.assert_array_equal(table["T_L_B"], found.T_L_B)


def test_left_out_poses_are_predicted_to_the_noise(found: RigidArm) -> None:
    assert found.figures.mean < 2.5 * NOISE_MM < found.figures.max


def test_too_few_poses_identify_no_arm(urdf: Urdf) -> None:
    few = fit_robot(urdf, measured(1, 14, ["SMR1"]))
    with pytest.raises(FitError, match="14 poses"):
        rigid_arm(few)
