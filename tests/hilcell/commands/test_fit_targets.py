"""`fit --correct`: commands that bring the tool of a robot with errors to its targets."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.compensation.targets import read_named_rows, read_targets
from hilcell.compensation.targets import write_rows as write_list
from hilcell.fit.measurements import Measurements, read_measurements
from hilcell.fit.methods import FitResult, RobotFit, fit_robot
from hilcell.fit.robot_file import Robot
from hilcell.fit.urdf_file import Urdf, read_urdf
from hilcell.geometry.frames import (
    apply,
    inverse,
    matrix,
    pose_from_zyx,
    poses_from_zyx,
    zyx_from_pose,
)
from hilcell.geometry.inverse import refined
from hilcell.geometry.kinematics import Array, forward
from hilcell.programs.pose_correction import joint_header, joint_rows
from tests.drivers.fanuc.program_tp.samples import listing, position
from tests.hilcell.commands.test_fit import write_dh, write_rows
from tests.hilcell.commands.workplace import read_corrected
from tests.hilcell.fit.chains import chain_forward
from tests.hilcell.fit.test_fit import IRB120
from tests.hilcell.fit.urdfs import PLAIN
from tests.hilcell.lists import write_targets
from tests.whole.bench import command

T_L_B = pose_from_zyx(2200, -150, -600, 170, 2, -1)
SMR_MM = {"SMR1": np.array([0.2, -0.8, 120.5]), "SMR2": np.array([75.2, 90.6, 213.4])}
NAMES = [f"H{n}" for n in range(12)]
NOISE_MM = 0.01


def reached_mm(joints_rad: Array, target: str) -> Array:
    """Where a robot with errors has its reflector (N, 3), in the tracker's frame."""
    rng, arm = np.random.default_rng(7), IRB120.arm
    true = replace(
        arm,
        a_mm=arm.a_mm + rng.normal(0, 0.4, 6),
        offset_rad=arm.offset_rad + rng.normal(0, 1e-3, 6),
        alpha_rad=arm.alpha_rad + rng.normal(0, 7e-4, 6),
    )
    flange = T_L_B @ forward(true, joints_rad)
    reached: Array = flange[:, :3, 3] + flange[:, :3, :3] @ SMR_MM[target]
    return reached


def drawn(seed: int, count: int) -> Array:
    """Joints away from a stretched wrist."""
    low, high = np.radians([-60, -30, -30, -60, 30, -60]), np.radians([60, 40, 40, 60, 80, 60])
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot and 40 measured poses of two reflectors."""
    folder = tmp_path_factory.mktemp("fit")
    (folder / "robot.urdf").write_text(PLAIN)
    joints, names = np.repeat(drawn(1, 40), 2, axis=0), ["SMR1", "SMR2"] * 40
    xyz_mm = np.empty((80, 3))
    for n, name in enumerate(SMR_MM):
        xyz_mm[n::2] = reached_mm(joints[n::2], name)
    xyz_mm += np.random.default_rng(3).normal(0, NOISE_MM, xyz_mm.shape)
    labels = [str(n // 2) for n in range(80)]
    write_rows(folder / "train.csv", Measurements(labels, names, joints, xyz_mm))
    return folder


@pytest.fixture(scope="module")
def urdf(folder: Path) -> Urdf:
    return read_urdf(folder / "robot.urdf")


@pytest.fixture(scope="module")
def found(folder: Path, urdf: Urdf) -> RobotFit:
    return fit_robot(urdf, read_measurements(folder / "train.csv"))


@pytest.fixture(autouse=True)
def _fitted_once(monkeypatch: pytest.MonkeyPatch, found: RobotFit) -> None:
    def fit_of(robot: Robot, train: Measurements, test: Measurements | None) -> RobotFit:
        return replace(found, robot=robot, train=train)

    monkeypatch.setattr("hilcell.commands.targets.fit_robot", fit_of)


def fit(
    folder: Path, *words: str | Path, robot: str = "robot.urdf"
) -> subprocess.CompletedProcess[str]:
    train = folder / "train.csv"
    return command("fit", "--robot", folder / robot, "--train", train, "--json", *words)


def refused(folder: Path, *words: str | Path) -> str:
    done = fit(folder, *words)
    assert done.returncode == 2
    return done.stderr


def wanted_mm(found: dict[str, list[list[float]]], poses: Array) -> Array:
    """Where the targets (N, 4, 4) of the root are in the tracker's frame."""
    return apply(np.array(found["root_in_tracker"]), poses[:, :3, 3])


def tool_of(found: dict[str, list[float]]) -> Array:
    return matrix(np.eye(3), np.array(found["tool_mm"]))


def test_corrected_poses_bring_the_tool_to_its_targets(
    folder: Path, urdf: Urdf, tmp_path: Path
) -> None:
    targets, out, bounds = tmp_path / "t.csv", tmp_path / "c.csv", tmp_path / "b.csv"
    joints = drawn(2, len(NAMES))
    still = np.zeros(6)
    flange = inverse(chain_forward(urdf.chain, still)) @ forward(IRB120.arm, still)
    about = matrix(np.eye(3), apply(flange, SMR_MM["SMR2"][None])[0])
    poses = chain_forward(urdf.chain, joints) @ about
    write_targets(targets, NAMES, zyx_from_pose(poses))
    done = fit(folder, "--correct", targets, "--tool", "SMR2", "-o", out, "--bounds", bounds)
    found = json.loads(done.stdout)["corrected"]
    assert (found["targets"], found["tool"]) == (12, "SMR2")
    arm = replace(urdf.arm, tool=urdf.tool @ tool_of(found))
    missed = {}
    for name, path in (("before", targets), ("after", out)):
        read = read_targets if path == targets else read_corrected
        command = poses_from_zyx(read(path)[1])
        at, arrived = refined(arm, inverse(urdf.base) @ command, joints)
        assert arrived.all()
        missed[name] = np.linalg.norm(reached_mm(at, "SMR2") - wanted_mm(found, poses), axis=1)
    assert missed["before"].mean() > 0.2
    assert missed["after"].max() < 0.05
    columns = ["name", "bound95_mm", "u_x_mm", "u_y_mm", "u_z_mm"]
    rows = read_named_rows(bounds, bounds.read_bytes(), [columns], "rows")
    radii = np.array(rows.values)[:, 0]
    assert (missed["after"] < radii).mean() > 0.8
    assert 0.005 < radii.max() < 0.1
    assert found["bound95_max_mm"] == pytest.approx(radii.max(), abs=1e-4)


def test_corrected_joints_bring_the_tool_to_its_targets(
    folder: Path, urdf: Urdf, tmp_path: Path
) -> None:
    targets, out = tmp_path / "t.csv", tmp_path / "c.csv"
    joints = drawn(2, len(NAMES))
    write_list(targets, joint_header(urdf), joint_rows(urdf, NAMES, joints))
    done = fit(folder, "--correct", targets, "--tool", "SMR1", "-o", out)
    found = json.loads(done.stdout)["corrected"]
    poses = chain_forward(urdf.chain, joints) @ tool_of(found)
    _, values, stamps = read_corrected(out)
    assert ["train.csv" in stamp for stamp in stamps] == [True]
    refused(folder, "--correct", out, "--tool", "SMR1", "-o", tmp_path / "again.csv")
    command = np.radians(values)
    assert np.abs(command - joints).max() < 0.02
    missed = np.linalg.norm(reached_mm(command, "SMR1") - wanted_mm(found, poses), axis=1)
    assert missed.max() < 0.05
    before = np.linalg.norm(reached_mm(joints, "SMR1") - wanted_mm(found, poses), axis=1)
    assert before.mean() > 0.2


def test_a_program_is_corrected_in_place(folder: Path, urdf: Urdf, tmp_path: Path) -> None:
    about = matrix(np.eye(3), np.array([0.0, 0.0, 120.0]))
    poses = chain_forward(urdf.chain, drawn(2, 2)) @ about
    write_targets(tmp_path / "t.csv", ["a", "b"], zyx_from_pose(poses))
    values = read_targets(tmp_path / "t.csv")[1]
    lines = [
        "LIN {" + ",".join(f"{n} {v:.4f}" for n, v in zip("XYZABC", row, strict=True)) + "}"
        for row in values
    ]
    (tmp_path / "drill.src").write_text("\n".join(["DEF drill()", *lines, "END", ""]))
    words = ("--tool", "SMR1", "--correct")
    for source, out in (("t.csv", "c.csv"), ("drill.src", "out.src")):
        done = fit(folder, *words, tmp_path / source, "-o", tmp_path / out)
        assert done.returncode == 0
        assert "{W}" not in done.stderr, "its frame is the robot's root"
    written = (tmp_path / "out.src").read_text().splitlines()
    for line, wanted in zip(written[2:4], read_corrected(tmp_path / "c.csv")[1], strict=True):
        numbers = [float(each.split()[1].rstrip("}")) for each in line[5:].split(",")]
        np.testing.assert_allclose(numbers, wanted, atol=2e-4)


@pytest.fixture
def pose(urdf: Urdf) -> str:
    """A pose of the tool in the controller's words."""
    zyx = zyx_from_pose(chain_forward(urdf.chain, drawn(2, 1)) @ pose_from_zyx(0, 0, 120, 0, 0, 0))
    return ",".join(f"{n} {v:.4f}" for n, v in zip("XYZABC", zyx[0], strict=True))


def program(folder: Path, *lines: str) -> tuple[str | Path, ...]:
    """Write a program; return the words that correct it."""
    (folder / "p.src").write_text("\n".join(["DEF p()", *lines, "END", ""]))
    return "--tool", "SMR1", "--correct", folder / "p.src", "-o", folder / "out.src"


def test_a_program_with_strokes_or_another_base_wants_a_calibration(
    folder: Path, pose: str, tmp_path: Path
) -> None:
    base = "$BASE={X 1,Y 0,Z 0,A 0,B 0,C 0}"
    words = program(tmp_path, base, f"LIN {{{pose}}}", "LIN_REL {X 20} #TOOL")
    said = refused(folder, *words)
    assert "p.src line 4" in said
    assert "p.src line 2" in said
    assert not (tmp_path / "out.src").exists()


def test_nothing_is_corrected_where_no_method_helps(
    folder: Path, found: RobotFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    result: FitResult = {**found.result, "chosen": "nominal", "reason": "no method beats nominal"}
    changed = replace(found, result=result)
    monkeypatch.setattr("hilcell.commands.targets.fit_robot", lambda robot, train, test: changed)
    arms = ("--urdf-out", folder / "n.urdf", "--dh-out", folder / "n.csv")
    words = ("--correct", folder / "train.csv", "--tool", "SMR1", "-o", folder / "c.csv")
    assert "no method beats nominal" in refused(folder, *arms, *words)
    assert not list(folder.glob("n.*"))
    assert "is no better than the nominal one" in fit(folder, *arms).stderr


def test_undetermined_targets_are_named(
    folder: Path,
    found: RobotFit,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    result: FitResult = {**found.result, "undetermined_mm": 1e-6}
    changed = replace(found, result=result)
    monkeypatch.setattr("hilcell.commands.targets.fit_robot", lambda robot, train, test: changed)
    rows = joint_rows(IRB120, ["a", "b"], drawn(2, 2))
    write_list(tmp_path / "t.csv", joint_header(IRB120), rows)
    words = ("--correct", tmp_path / "t.csv", "--tool", "SMR1", "-o", tmp_path / "c.csv")
    assert "1e-06 mm: a, b" in refused(folder, *words)
    assert not (tmp_path / "c.csv").exists()


@pytest.mark.parametrize(
    ("words", "missing"),
    [
        (["--correct", "t.csv"], "--output"),
        (["-o", "c.csv"], "--correct"),
        (["--bounds", "c.csv"], "--correct"),
        (["--correct", "t.csv", "-o", "c.csv"], "SMR1, SMR2"),
        (["--correct", "t.csv", "-o", "c.csv", "--tool", "X"], "SMR1"),
    ],
)
def test_incomplete_orders_are_refused(folder: Path, words: list[str], missing: str) -> None:
    assert missing in refused(folder, *words)


def test_a_program_s_posture_is_the_one_that_was_measured(
    folder: Path, pose: str, tmp_path: Path
) -> None:
    """S 2 was corrected by the errors of S 6, and some holes became worse."""
    write_dh(folder / "robot.toml")
    taken = []
    for status in range(8):
        words = program(tmp_path, f"PTP {{{pose},S {status}}}")
        done = fit(folder, *words, robot="robot.toml")
        taken += [status] if done.returncode == 0 else []
        assert done.returncode == 0 or "posture" in done.stderr, done.stderr
    assert len(taken) == 1
    assert "postures of its targets were not checked" in fit(folder, *words).stderr  # of a URDF


def test_a_listing_s_posture_is_the_one_that_was_measured(
    folder: Path, urdf: Urdf, tmp_path: Path
) -> None:
    """CONFIG has no revolutions of the fit's robot: the letters decide."""
    write_dh(folder / "robot.toml")
    T = chain_forward(urdf.chain, drawn(2, 1)) @ pose_from_zyx(0, 0, 120, 0, 0, 0)
    x, y, z, r, p, w = zyx_from_pose(T)[0]
    words = ("--tool", "SMR1", "--correct", tmp_path / "p.ls", "-o", tmp_path / "out.ls")
    taken = []
    for letters in ("N U T", "N D T", "F U T", "F D T"):
        stated = position(2, x, y, z, w, p, r, uf=0, config=f"{letters}, 0, 0, 0")
        (tmp_path / "p.ls").write_text(listing(["L P[2] 100mm/sec FINE"], stated))
        done = fit(folder, *words, robot="robot.toml")
        taken += [letters] if done.returncode == 0 else []
        assert done.returncode == 0 or "posture" in done.stderr, done.stderr
    assert len(taken) == 1
    assert "corrected by fit of" in (tmp_path / "out.ls").read_text().replace(" ;\n", "")
