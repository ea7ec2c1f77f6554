"""The sign check holds for the right sign and fails for the wrong one: a robot of known error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.file import compensate_targets, read_calibration, write_calibration
from hilcell.calibration.frames import Frames
from hilcell.calibration.grid import grid_of, vertex_ids
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.model import LearntModel, Measured, Prediction
from hilcell.compensation.model_choice import MODELS
from hilcell.fit.methods import fit_robot
from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import forward
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.point import Point, PointId
from hilcell.model.verdicts import SignChecked, Verdict
from hilcell.ports import Array
from procedures.fit import SIGN_IDS, Fit, SignCheck
from procedures.plan import joints_for
from tests.hilcell.calibration.calibrations import calibration
from tests.hilcell.fit.test_fit import IRB120, SMR_MM
from tests.hilcell.fit.test_fit import measured as measured_rows
from tests.hilcell.verdicts import FITTED, plain
from tests.procedures.results import result_of

CELL = load_cell("paper", {"grid.pitch_mm": "450.0"})
BASE = CELL.layout.nominal_base(CELL.reference.rail_mm)
WORLD = np.eye(4)


def error_mm(at_mm: Array) -> Array:
    """Return errors (N, 3) in {B}, largest in the cell at the far corner."""
    place = (at_mm - grid_of(CELL).origin_mm) / 900.0
    error: Array = 0.5 + place @ np.array([[1.0, 0.2, 0.0], [0.0, 0.8, 0.1], [0.3, 0.0, 0.9]])
    return error


class FakeBench:
    """Measures where a robot with that error goes; keeps records as a journal would."""

    def __init__(self) -> None:
        self.cell, self.seed = CELL, 1
        self.log = Log()
        self.frames = Frames(CELL, self.log)
        self._count = self.closings = 0
        self.std_mm, self.off_mm = 0.0, 0.0  # of a reading, and of the corrected one
        self.keep("frame", "world", {"matrix": WORLD.tolist()})
        self.keep("frame", "base", {"matrix": BASE.tolist(), "calibration": "1-made"})
        values = msgspec.to_builtins(CELL)
        self.keep("plan", "", {
            "procedure": "sign-check", "cell": values, "digest": "", "seed": 1,
            "machine_seed": 1, "cell_file": "paper", "speed": None,
            "unattended": True, "operator": "", "job": "", "simulated": True, "versions": {},
            "settings": {}, "steps": [], "points": 0, "duration_s": 0.0,
        })  # fmt: skip
        grid = grid_of(CELL)
        vertices_mm = grid.serpentine_mm()
        joints_rad = joints_for(CELL, vertices_mm)
        for id, at_mm, joints in zip(vertex_ids(grid), vertices_mm, joints_rad, strict=True):
            self.measured(id, joints, at_mm, apply(BASE, at_mm[None])[0])
        self.keep("verdict", "fit", plain(replace(FITTED, method="trilinear")))
        for nest in CELL.layout.floor:
            self._point(PointId("world", nest=nest.name), nest.xyz_mm)

    def keep(self, kind: Any, key: str, body: dict[str, Any]) -> None:
        self._count += 1
        self.log.take(Record(self._count, "", kind, key, body))

    def measured(self, id: PointId, joints_rad: Array, at_mm: Array, nominal_mm: Array) -> None:
        reached_mm = at_mm + error_mm(at_mm[None])[0]
        self._point(
            id,
            apply(BASE, reached_mm[None])[0],
            nominal_mm=nominal_mm.tolist(),
            commanded_deg=np.degrees(joints_rad).tolist(),
        )

    def _point(self, id: PointId, xyz_mm: Array, **robot: Any) -> None:
        self.keep("point", id.key, {
            "id": msgspec.to_builtins(id), "group": id.group, "reflector": "",
            "station": CELL.grid.station, "samples": 1,
            "xyz_mm": xyz_mm.tolist(), "std_mm": [self.std_mm] * 3, "temperature_c": 20.0,
            "pressure_mbar": 1000.0, "humidity_percent": 50.0, "session": 1, "frame": "tracker",
            **robot,
        })  # fmt: skip

    def flange_point(
        self, id: PointId, station: Any, joints_rad: Array, *, nominal_mm: Array
    ) -> Point:
        assert station.name == CELL.grid.station
        if id.how == "corrected":
            nominal_mm = nominal_mm + [self.off_mm, 0.0, 0.0]
        self.measured(id, joints_rad, forward(CELL.robot.arm(), joints_rad)[:3, 3], nominal_mm)
        return self.log.point(id)

    def floor_nest_point(self, id: PointId, nest: Any) -> Point:
        self._point(id, nest.xyz_mm)
        return self.log.point(id)

    def close_step(self, *, carried: bool = False) -> None:
        for nest in CELL.layout.floor:
            self.floor_nest_point(
                PointId("control", session=1, pass_number=self.closings, nest=nest.name), nest
            )
        self.closings += 1

    def judge(self, key: str, verdict: Verdict) -> None:
        self.keep("verdict", key, plain(verdict))


class WrongSign(SignCheck):
    """The correction as the paper's words have it: the error is added."""

    def command(self, log: Log, target_mm: Array) -> Array:
        return 2 * target_mm - super().command(log, target_mm)


@pytest.fixture
def bench() -> Any:
    return FakeBench()


def test_the_worst_cell_is_chosen(bench: Any) -> None:
    np.testing.assert_allclose(SignCheck.worst_mm(bench.log), [grid_of(CELL).far_mm - 225.0])


def test_the_right_sign_holds(bench: Any) -> None:
    SignCheck().perform(bench)
    verdict = bench.log.verdict(SignChecked)
    assert verdict is not None
    assert verdict.holds is True
    assert verdict.before_mm == pytest.approx(
        float(np.linalg.norm(error_mm(SignCheck.worst_mm(bench.log)))), abs=1e-6
    )
    assert verdict.corrected_mm < 0.01
    assert [bench.log.point(id).group for id in SIGN_IDS.values()] == [
        "sign_before",
        "sign_corrected",
    ]
    assert [point.group for point in bench.log.points.values()][-3:] == ["control"] * 3


def test_the_wrong_sign_doubles_the_error_and_fails(bench: Any) -> None:
    WrongSign().perform(bench)
    verdict = bench.log.verdict(SignChecked)
    assert verdict is not None
    assert verdict.holds is False
    assert verdict.ratio == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize(("std_mm", "limit"), [(0.0, 0.5), (0.15, 0.782), (5.0, 1.0)])
def test_the_limit_is_wider_by_the_noise_of_the_readings(
    bench: Any, std_mm: float, limit: float
) -> None:
    """A single target by a coarse instrument comes less than half as close by chance."""
    before_mm = float(np.linalg.norm(error_mm(SignCheck.worst_mm(bench.log))))
    for key, each in bench.log.points.items():
        bench.log.points[key] = msgspec.structs.replace(each, std_mm=(std_mm,) * 3)
    bench.std_mm, bench.off_mm = std_mm, 0.6 * before_mm
    SignCheck().perform(bench)
    verdict = bench.log.verdict(SignChecked)
    assert verdict is not None
    assert verdict.ratio == pytest.approx(0.6, abs=0.01)
    assert verdict.limit == pytest.approx(limit, abs=0.03)
    assert verdict.holds is (std_mm > 0.0)


def test_a_resumed_run_does_not_judge_again(bench: Any) -> None:
    SignCheck().perform(bench)
    count = len(bench.log.points)
    WrongSign().perform(bench)
    assert len(bench.log.points) == count
    assert bench.log.verdicts["sign"].holds is True


def test_the_plan_counts_its_points() -> None:
    step = SignCheck().plan(CELL, 1)
    assert step.points == 2
    assert step.duration_s > 0


# -- A further model needs its own class and one registration, and no other line of the core -------


@dataclass(frozen=True, eq=False)
class Plane(LearntModel):
    """An error that is linear in the place."""

    name = "plane"
    text = "corrected by a plane"

    terms: Array  # (4, 3)

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        poses = measured.poses
        at_mm = _with_one(poses.nominal[:, :3, 3])
        terms = np.linalg.lstsq(at_mm, poses.error_mm, rcond=None)[0]
        return cls(np.array(terms, dtype=float))

    def predict(self, poses: Array) -> Prediction:
        error_mm = _with_one(poses[:, :3, 3]) @ self.terms
        return Prediction(error_mm, np.tile(1e-4 * np.eye(3), (len(error_mm), 1, 1)))


def _with_one(points_mm: Array) -> Array:
    return np.column_stack([np.ones(len(points_mm)), points_mm])


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(MODELS, "plane", Plane)


def test_it_is_judged_chosen_and_applied_on_the_cell() -> None:
    bench: Any = FakeBench()
    found = result_of(Fit(), bench.log)
    assert set(found["fit"]["loocv"]) >= {"nominal", "idw", "trilinear", "plane"}
    assert found["method"] in ("plane", "trilinear")  # the error is linear, up to rounding
    bench.keep("verdict", "fit", plain(replace(FITTED, method="plane")))
    SignCheck().perform(bench)
    judged = bench.log.verdict(SignChecked)
    assert judged is not None
    assert judged.corrected_mm < 0.01


def test_it_is_judged_on_a_robot_that_was_measured_elsewhere() -> None:
    rows, test = (measured_rows(seed, 16, list(SMR_MM)) for seed in (1, 2))
    assert set(fit_robot(IRB120, rows, test).result["methods"]) == {"nominal", "idw", "plane"}


def test_it_is_kept_in_the_file_and_corrects_targets(tmp_path: Path) -> None:
    path, target = tmp_path / "calibration.json", np.array([[0.0, 0, 1200, 0, 75, 0]])
    by_plane, by_trilinear = (
        compensate_targets(_kept(method, path), "S1100", target, ["H1"])
        for method in ("plane", "trilinear")
    )
    assert np.abs(by_plane - target).max() > 0.3
    np.testing.assert_allclose(by_plane, by_trilinear, atol=1e-6)  # of a linear field


def _kept(method: str, path: Path) -> Any:
    write_calibration(calibration(method=method), path)
    return read_calibration(path)


def test_its_bad_parameters_are_reported_by_field(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    made = calibration(method="plane")
    assert made.model is not None
    made.model.parameters.clear()
    write_calibration(made, path)
    with pytest.raises(SettingsError, match=r"model\.parameters: "):
        read_calibration(path)
