"""The library: its names, what it costs to import, its examples, and that the commands call it."""

import ast
import doctest
import json
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import hilcell as hc
from hilcell.report.export import sheets
from tests.hilcell.fit.test_fit import IRB120, measured
from tests.whole.bench import command
from tests.whole.golden import GoldenRuns

ROOT = Path(__file__).parents[1]
DH_ROWS = [
    [0, -90, 290, 0],
    [270, 0, 0, -90],
    [70, -90, 0, 0],
    [0, 90, 302, 0],
    [0, -90, 0, 0],
    [0, 0, 72, 180],
]


def test_the_stub_states_the_same_names_as_the_module() -> None:
    stub = ast.parse((ROOT / "hilcell/__init__.pyi").read_text("utf-8"))
    stated = {
        str(alias.asname): str(node.module)
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert stated == {**hc._MODULES, "ports": "hilcell"}  # type: ignore[attr-defined]
    assert sorted(stated) == sorted(hc.__all__)
    assert len(hc.__all__) <= 15


@pytest.mark.parametrize("name", hc.__all__)
def test_each_name_is_there_and_documented(name: str) -> None:
    named = getattr(hc, name)
    assert named.__doc__
    assert isinstance(named, ModuleType) or named.__name__ == name


def test_another_name_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibrate'"):
        hc.calibrate  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.process
def test_the_import_loads_nothing_else() -> None:
    """Neither another module of hilcell, nor a package such as numpy."""
    code = "import sys; before = {*sys.modules}; import hilcell; print({*sys.modules} - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = ast.literal_eval(done.stdout)
    assert {each for each in loaded if each.split(".")[0] not in sys.stdlib_module_names} == {
        "hilcell"
    }


@pytest.mark.parametrize(
    ("module", "name"),
    sorted((module, name) for name, module in hc._MODULES.items()),  # type: ignore[attr-defined]
)
def test_the_examples_of_its_docstrings(
    module: str, name: str, example_folder: Path, golden: GoldenRuns,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(example_folder)
    named = getattr(hc, name)
    names = {each: getattr(hc, each) for each in hc.__all__}
    if "open_" in name or name == "UsableCalibration":
        monkeypatch.setenv("HILCELL_RUNS", str(golden["small"].runs))
    for test in doctest.DocTestFinder(recurse=False).find(
        named, name, import_module(module), extraglobs={**names, "np": np}
    ):
        assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test).failed == 0


@pytest.fixture(scope="session")
def example_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot and measurements of it, as the examples name them."""
    folder = tmp_path_factory.mktemp("examples")
    robot = ['[robot]\nname = "IRB 120"\nconvention = "standard-dh"']
    keys = ("a_mm", "alpha_deg", "d_mm", "offset_deg")
    for row in DH_ROWS:
        values = "\n".join(f"{key} = {value}" for key, value in zip(keys, row, strict=True))
        robot.append(f"[[robot.joint]]\n{values}")
    (folder / "irb120.toml").write_text("\n".join(robot))
    rows = measured(1, 20, ["SMR1", "SMR2"])
    lines = ["pose,target,j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg,x_mm,y_mm,z_mm"]
    numbers = np.column_stack([np.degrees(rows.joints_rad), rows.xyz_mm]).tolist()
    for pose, target, values in zip(rows.pose, rows.target, numbers, strict=True):
        lines.append(",".join([pose, target, *map(repr, values)]))
    (folder / "train.csv").write_text("\n".join(lines) + "\n")
    return folder


# -- robots and measurements of arrays -------------------------------------------------------------


def test_a_robot_of_dh_rows_is_that_of_its_file(example_folder: Path) -> None:
    robot, read = (
        hc.Robot.from_dh("IRB 120", DH_ROWS),
        hc.read_robot(example_folder / "irb120.toml"),
    )
    for each in ("a_mm", "alpha_rad", "d_mm", "offset_rad", "sign", "tool"):
        np.testing.assert_array_equal(getattr(robot.arm, each), getattr(read.arm, each))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: hc.Robot.from_dh("r", np.zeros((6, 3))), r"DH rows.*\(6, 3\)"),
        (lambda: hc.Robot.from_dh("r", np.zeros((10, 4))), "got 10"),
        (lambda: hc.Robot.from_dh("r", np.zeros(())), "got 0"),
        (lambda: hc.Robot.from_dh("r", np.zeros((6, 4)), convention="craig"), "modified-dh"),  # type: ignore[arg-type]
        (lambda: hc.Robot.from_dh("r", np.full((6, 4), np.nan)), "finite"),
        (lambda: hc.Robot.from_dh("r", np.zeros((6, 4)), 0.5), "signs"),
        (lambda: hc.Measurements.from_arrays(np.zeros(4), np.zeros((4, 3))), "joints_rad"),
        (lambda: hc.Measurements.from_arrays(np.zeros((4, 6)), np.zeros((3, 3))), "xyz_mm"),
        (lambda: hc.Measurements.from_arrays(np.zeros((4, 6)), np.full((4, 3), np.inf)), "xyz_mm"),
        (lambda: hc.Measurements.from_arrays(np.zeros((2, 6)), np.zeros((2, 3)), ["a"]), "target"),
        (
            lambda: hc.Measurements.from_arrays(np.zeros((1, 6)), np.zeros((1, 3)), pose="12"),
            "pose",
        ),
    ],
)
def test_arrays_of_another_shape_are_refused(make: Callable[[], object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make()


@pytest.fixture(scope="module")
def fit() -> hc.RobotFit:
    rows = measured(1, 30, ["SMR1", "SMR2"])
    train = hc.Measurements.from_arrays(rows.joints_rad, rows.xyz_mm, rows.target, rows.pose)
    return hc.fit_robot(IRB120, train)


def test_predictions_keep_their_bounds(fit: hc.RobotFit) -> None:
    asked = measured(2, 100, ["SMR1"])
    found = fit.predict(asked.joints_rad, "SMR1")
    off_mm = np.linalg.norm(asked.xyz_mm - found.xyz_mm, axis=1)
    assert 0.85 < np.mean(off_mm <= found.bound95_mm) <= 1.0
    assert found.covariance_mm2.shape == (100, 3, 3)
    with pytest.raises(hc.HilcellError, match="SMR9"):
        fit.predict(asked.joints_rad, "SMR9")


def test_poses_and_joints_are_corrected_alike(fit: hc.RobotFit) -> None:
    correction = hc.PoseCorrection.of(fit, "SMR1")
    joints_rad = fit.train.joints_rad[:10:2]
    by_joints = correction.of_joints(joints_rad)
    by_poses = correction.of_poses(by_joints.nominal)
    np.testing.assert_allclose(by_poses.command, by_joints.command, atol=1e-5)
    np.testing.assert_array_equal(by_joints.command[:, :3, :3], by_joints.nominal[:, :3, :3])
    assert by_poses.names == list("12345")
    turned_rad = np.abs(by_joints.command_rad() - joints_rad)
    assert 0.0 < turned_rad.max() < np.radians(5.0)


# -- runs and calibrations -------------------------------------------------------------------------


def test_a_run_is_that_of_the_commands(golden: GoldenRuns) -> None:
    small = golden["small"]
    run = hc.open_run(small.folder)
    assert (run.name, run.procedure, run.simulated) == ("small", "calibrate", True)
    shown = json.loads(command("show", small.folder, "--json").stdout)
    assert shown["result"] == json.loads(json.dumps(run.result))
    assert shown["points"] == len(run.points)
    assert run.calibration is not None
    assert run.calibration.provenance.run == "small"
    assert [*run.tables] == [table.title for table in sheets(run.facts)]
    assert hc.open_run("small", small.runs).name == "small"
    assert run.cell.name == "paper"


def test_a_run_as_data_frames(golden: GoldenRuns) -> None:
    run = hc.open_run(golden["small"].folder)
    points = run.data_frame()
    assert [*points.columns] == run.tables["points"].keys
    assert len(points) == len(run.points)
    assert str(points["t_utc"].dtype).endswith("UTC]")
    sent = (points["group"] == "validate_before") & (points["station"] == "S1100")
    judged = run.result["validation"]["S1100"]["before"]
    assert points.loc[sent, "error_mm"].mean() == pytest.approx(judged["mean"])
    with pytest.raises(hc.HilcellError, match="unknown table 'grid'"):
        run.data_frame("grid")


def test_without_pandas_it_is_named(golden: GoldenRuns, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(hc.HilcellError, match="pandas is not installed"):
        hc.open_run(golden["small"].folder).data_frame()
