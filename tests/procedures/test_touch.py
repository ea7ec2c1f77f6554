"""Touch poses absorb the slip of a visit, and no figure is judged by the base that they find."""

from __future__ import annotations

from itertools import product
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.frames import Frames
from hilcell.calibration.grid import grid_of, measured_errors
from hilcell.calibration.touch import TouchPoses, beside_nest, touch_targets_mm
from hilcell.cell.file import Cell, Station, load_cell
from hilcell.compensation.model_choice import MODELS
from hilcell.geometry.frames import apply, from_rotvec, matrix
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log
from hilcell.model.frame import Frame
from hilcell.model.point import Point, PointId
from hilcell.model.verdicts import blamed, suspected_in
from hilcell.ports import Array, DeviceError
from procedures.plan import flange_points, joints_for, nearest_next
from procedures.touch_station import touch_once, touch_spans, touches
from procedures.validate import Validate, target_poses, targets
from tests.hilcell.verdicts import FITTED, framed, plain
from tests.procedures.results import result_of
from tests.procedures.test_sign_check import BASE, FakeBench, error_mm

SETTINGS = {"grid.pitch_mm": "450.0", "validation.per_cell": "1", "validation.others": "8"}
CELL = load_cell("paper", SETTINGS)
FAR = CELL.station_named("S300")
HERE = CELL.reference
SLIP_MM = 0.03
COVARIANCE = np.diag([1e-4] * 3 + [1e-10] * 3)


class Visits(FakeBench):
    """A robot of known error on a slide that comes back ``slip_mm`` beside its station.

    ``turned`` (4, 4) is what the base really does besides, at every station.
    """

    def __init__(self, cell: Cell = CELL) -> None:
        super().__init__()
        self.cell = cell
        values = msgspec.to_builtins(cell)
        self.keep("plan", "", msgspec.to_builtins(self.log.inputs) | {"cell": values})
        self.frames = Frames(cell, self.log)
        self.slip_mm, self.turned, self.growth, self.warmer_k = SLIP_MM, np.eye(4), 0.0, 0.0
        self.held: Station | None = None
        self.waiting: list[Station] = []  # where points are re-measured next
        rng = np.random.default_rng(9283)
        for place, number in product(range(3), range(10)):
            id = PointId("repeatability", place=place, number=number)
            self._point(id, 1000.0 * place + rng.normal(0.0, 0.01, 3))
        for station in cell.station:
            shift = np.eye(4)
            shift[1, 3] = station.strip_mm
            known = {"matrix": shift.tolist(), "covariance": COVARIANCE.tolist()}
            found = framed("station.S300", strip_mm=station.strip_mm) | known
            self.keep("frame", f"station.{station.name}", found)
            self.keep("frame", f"three_points.{station.name}", known)
        self.keep("verdict", "fit", plain(replace(FITTED, method="trilinear")))

    def frame(self, key: str, frame: Frame) -> None:
        self.keep("frame", key, plain(frame))

    def hold_station(self, station: Station) -> None:
        if self.held != station:
            self.held = station
            self.keep("intent", "", {"action": "rail.approach", "station": station.name})

    def retake_waiting(self) -> bool:
        if not self.waiting:
            return False
        self.hold_station(self.waiting.pop())
        return True

    def reach(self, trigger: str) -> None:
        pass

    def expect(self, station: Station, joints_rad: Array) -> None:
        pass

    def measured(self, id: PointId, joints_rad: Array, at_mm: Array, nominal_mm: Array) -> None:
        if id.kind == "grid":
            super().measured(id, joints_rad, at_mm, nominal_mm)
            return
        assert self.held is not None
        base = self.frames.base_in_world(self.held)
        reached_mm = (1.0 + self.growth) * (at_mm + error_mm(at_mm[None])[0])
        seen_mm = apply(self.turned @ base, reached_mm[None])[0]
        seen_mm[1] += self.slip_mm
        self._point(
            id, seen_mm, nominal_mm=nominal_mm.tolist(), station=self.held.name,
            commanded_deg=np.degrees(joints_rad).tolist(), std_mm=[0.01] * 3,
            temperature_c=20.0 + self.warmer_k,
        )  # fmt: skip

    def flange_point(
        self, id: PointId, station: Any, joints_rad: Array, *, nominal_mm: Array, **_: Any
    ) -> Point:
        self.retake_waiting()
        if known := self.log.find(id):
            return known
        self.hold_station(station)
        self.measured(id, joints_rad, forward(CELL.robot.arm(), joints_rad)[:3, 3], nominal_mm)
        return self.log.point(id)


def chosen_mm(bench: Any) -> dict[str, float]:
    """Return the mean error by station after `Validate`, the chosen way."""
    Validate().perform(bench)
    found = result_of(Validate(), bench.log)["validation"]
    return {name: found[name]["chosen"]["mean"] for name in ("S1100", "S300", "S1900")}


def bench_of(**settings: str) -> Any:
    return Visits(load_cell("paper", SETTINGS | {f"touch.{k}": v for k, v in settings.items()}))


def touch_base(bench: Any, station: Station, model: Any) -> Array:
    """Return the base for commands on this visit."""
    touch_once(bench, station, model)
    base: Array = bench.frames.base_on_visit(station)
    return base


def model_of(log: Log) -> Any:
    return MODELS["trilinear"].learn(measured_errors(log))


def test_the_poses_are_in_the_cube_and_spread() -> None:
    assert CELL.touch.poses == 8
    grid, targets_mm = grid_of(CELL), touch_targets_mm(CELL, HERE)
    grid.check_inside(targets_mm)
    assert len(targets_mm) == 8
    assert (np.ptp(targets_mm, axis=0) > 500.0).all()
    apart_mm = np.linalg.norm(targets_mm[:, None] - targets_mm[None], axis=-1)
    assert apart_mm[~np.eye(8, dtype=bool)].min() > 250.0


def test_the_poses_come_in_the_order_that_takes_the_least_time() -> None:
    bench = bench_of()
    touch_once(bench, FAR, model_of(bench.log))
    joints_rad = np.radians([point.commanded_deg for point in bench.log.select("touch")])
    assert nearest_next(CELL, joints_rad) == list(range(CELL.touch.poses))
    whole_s = touch_spans(CELL, FAR)[0].duration_s
    assert abs(whole_s - flange_points(CELL, joints_rad).duration_s) < 0.5
    drawn_rad = joints_for(CELL, touch_targets_mm(CELL, FAR))
    assert whole_s < 0.95 * flange_points(CELL, drawn_rad).duration_s


def test_a_total_station_is_sent_to_no_place_before_or_behind_a_nest() -> None:
    """At S1900 the fourth touch pose stood 1.45 mrad beside nest P6: several targets (HC-T56)."""
    coarse = load_cell("paper", {"tracker.driver": "leica-geocom"})
    station = coarse.station_named("S1900")
    old_mm = touch_targets_mm(CELL, station)
    assert beside_nest(coarse, station, old_mm).tolist() == [n == 3 for n in range(8)]
    targets_mm = touch_targets_mm(coarse, station)
    assert not beside_nest(coarse, station, targets_mm).any()
    assert np.array_equal(targets_mm[:7], np.delete(old_mm, 3, axis=0))
    assert len(targets_mm) == 8
    grid_of(coarse).check_inside(targets_mm)


def test_targets_before_or_behind_a_nest_are_drawn_again() -> None:
    coarse = load_cell("paper", {"tracker.driver": "leica-geocom"})
    redrawn = 0
    for seed in range(6):
        drawn = targets(coarse, seed)
        for name, poses in target_poses(coarse, seed).items():
            station = coarse.station_named(name)
            beside = beside_nest(coarse, station, drawn[name])
            same = (poses[:, :3, 3] == drawn[name]).all(axis=1)
            assert np.array_equal(same, ~beside)
            assert not beside_nest(coarse, station, poses[:, :3, 3]).any()
            redrawn += int(beside.sum())
    assert redrawn > 1


def test_without_touch_poses_the_slip_stays_in_the_figures() -> None:
    for name, mean_mm in chosen_mm(bench_of(poses="0")).items():
        assert mean_mm == pytest.approx(SLIP_MM, abs=1e-3), name


def test_touch_poses_absorb_the_slip() -> None:
    bench = bench_of()
    for name, mean_mm in chosen_mm(bench).items():
        assert mean_mm < 0.35 * SLIP_MM, name
    found = touches(bench.log)
    assert found["S300"].along_rail_mm == pytest.approx(SLIP_MM, abs=0.35 * SLIP_MM)
    assert found["S300"].u_after_mm < 0.7 * found["S300"].u_before_mm


def test_the_base_that_is_found_does_not_judge_itself() -> None:
    """A touched base that is wrong by 0.4 mm shows in full: targets stay where they were."""
    bench = bench_of()
    right = bench.frames.base_on_visit

    def wrong(station: Station) -> Array:
        base: Array = right(station).copy()
        base[2, 3] += 0.4
        return base

    bench.frames.base_on_visit = wrong
    assert all(mean_mm > 0.38 for mean_mm in chosen_mm(bench).values())


def test_targets_and_the_ways_beside_are_as_without_touch_poses() -> None:
    """Also where the visit has been touched before the first target is sent."""
    with_, without = bench_of(), bench_of(poses="0")
    touch_base(with_, HERE, model_of(with_.log))
    for bench in (with_, without):
        Validate().perform(bench)
    for how in ("before", "idw"):
        for one, other in zip(
            with_.log.select("validate", how=how),
            without.log.select("validate", how=how),
            strict=True,
        ):
            assert one.nominal_mm == pytest.approx(other.nominal_mm)
            assert one.commanded_deg == pytest.approx(other.commanded_deg)
    one_mm, other_mm = (
        np.array([point.nominal_mm for point in bench.log.select("validate", how="chosen")])
        for bench in (with_, without)
    )
    np.testing.assert_allclose(one_mm, other_mm)


def test_a_new_stop_is_touched_again_and_a_visit_once() -> None:
    bench: Any = Visits()
    model = model_of(bench.log)
    first = touch_base(bench, FAR, model)
    np.testing.assert_array_equal(touch_base(bench, FAR, model), first)
    assert len(bench.log.select("touch")) == 8
    bench.hold_station(HERE)
    assert not bench.frames.is_touched(FAR)
    np.testing.assert_array_equal(bench.frames.base_on_visit(FAR), bench.frames.base_in_world(FAR))
    bench.slip_mm = -SLIP_MM
    again = touch_base(bench, FAR, model)
    assert len(bench.log.select("touch")) == 16
    assert again[1, 3] < bench.frames.base_in_world(FAR)[1, 3] < first[1, 3]


def test_a_resumed_run_measures_only_what_is_missing_of_a_visit() -> None:
    bench: Any = Visits()
    model = model_of(bench.log)
    flange_point = bench.flange_point
    sent: list[PointId] = []

    def dies(id: PointId, *words: Any, **named: Any) -> Point:
        if len(sent) == 5:
            raise KeyboardInterrupt
        sent.append(id)
        point: Point = flange_point(id, *words, **named)
        return point

    bench.flange_point = dies
    with pytest.raises(KeyboardInterrupt):
        touch_base(bench, FAR, model)
    bench.flange_point = flange_point
    touch_base(bench, FAR, model)
    assert len(bench.log.select("touch")) == 8


@pytest.mark.parametrize("turn_rad", [[0.0, 0.0, 1e-4], [0.0, 1e-4, 0.0]], ids=["A1", "A2"])
def test_a_lost_zero_is_refused(turn_rad: list[float]) -> None:
    """A turn of axis 1 is a slip that is too large; one of axis 2 is no slip."""
    bench: Any = Visits()
    R, origin_mm = from_rotvec(np.array(turn_rad)), BASE[:3, 3]
    bench.turned = matrix(R, origin_mm - R @ origin_mm)
    with pytest.raises(DeviceError) as raised:
        touch_base(bench, HERE, model_of(bench.log))
    assert raised.value.code == "HC-T63"
    assert raised.value.device == "Cell"  # nothing is wrong with the tracker
    (suspicion,) = suspected_in(blamed(raised.value.facts()))
    assert suspicion.noticed_by == "touch poses at S1100"
    if turn_rad[2]:
        assert (suspicion.cause, suspicion.unit) == ("zero lost", "deg of axis 1")
        assert abs(suspicion.size) == pytest.approx(np.degrees(turn_rad[2]), rel=0.3)
    assert "touch.S1100" not in bench.log.frames


def test_what_moved_the_slide_or_grew_the_arm_is_named() -> None:
    for cause, size, change in (
        ("strip", 1.0, {"slip_mm": 1.0}), ("temperature", 1000.0, {"growth": 1e-3}),
    ):  # fmt: skip
        bench: Any = Visits()
        for name, value in change.items():
            setattr(bench, name, value)
        with pytest.raises(DeviceError) as raised:
            touch_base(bench, HERE, model_of(bench.log))
        (suspicion,) = suspected_in(blamed(raised.value.facts()))
        assert suspicion.cause == cause
        assert suspicion.size == pytest.approx(size, rel=0.3)


def test_the_covariance_of_the_base() -> None:
    bench: Any = Visits()
    log = bench.log
    slip, far = TouchPoses(log, HERE, []).prior, TouchPoses(log, FAR, []).prior
    assert np.linalg.matrix_rank(slip) == 1
    assert slip[1, 1] == pytest.approx(2 * 0.02**2 / 3)
    assert (np.linalg.eigvalsh(far[:6, :6]) > 0).all()
    lever_mm = bench.frames.base_in_world(FAR)[:3, 3] - [0.0, 300.0, 0.0]
    assert far[2, 2] == pytest.approx(1e-4 + 1e-10 * (lever_mm[0] ** 2 + lever_mm[1] ** 2))
    touch_base(bench, FAR, model_of(log))
    after = log.frames["touch.S300"].C
    assert np.trace(after[:3, :3]) < np.trace(far[:3, :3])
    np.testing.assert_array_equal(TouchPoses(log, FAR, []).prior, far)


@pytest.mark.parametrize(("poses", "least_mm", "most_mm"), [("0", 0.05, 0.1), ("20", 0.0, 0.012)])
def test_an_arm_that_has_grown_with_the_room_is_sent_less_far(
    poses: str, least_mm: float, most_mm: float
) -> None:
    """30 um/m: the cube's centre is 0.06 mm further out, its far corner 0.02 mm more."""
    bench = bench_of(poses=poses)
    bench.growth, bench.warmer_k = 30e-6, 2.0
    for name, mean_mm in chosen_mm(bench).items():
        assert least_mm <= mean_mm < most_mm, name
    if poses != "0":
        grown = touches(bench.log)["S1100"].growth_um_m
        assert grown == pytest.approx(30.0, abs=8.0)


def test_growth_may_move_the_cube_outwards() -> None:
    bench: Any = Visits()
    log = bench.log
    warm = [msgspec.structs.replace(p, temperature_c=23.0) for p in log.select("grid")[:2]]
    grown = TouchPoses(log, HERE, warm).prior - TouchPoses(log, HERE, []).prior
    assert np.linalg.matrix_rank(grown) == 1
    outwards_mm = BASE[:3, :3] @ CELL.grid.centre.matrix()[:3, 3]
    sigma_mm = 23e-6 * 3.0 * np.linalg.norm(outwards_mm) / np.sqrt(3.0)
    assert np.trace(grown) == pytest.approx(sigma_mm**2)
    assert grown[:3, :3] @ outwards_mm == pytest.approx(sigma_mm**2 * outwards_mm)


@pytest.mark.parametrize(("poses", "spans"), [("0", 0), ("8", 1), ("20", 1)])
def test_the_plan_counts_them(poses: str, spans: int) -> None:
    cell = load_cell("paper", {"touch.poses": poses})
    assert [span.measured for span in touch_spans(cell, FAR)] == [int(poses)] * spans
    plain = Validate().plan(load_cell("paper", {"touch.poses": "0"}), 1)
    planned = Validate().plan(cell, 1)
    assert planned.points - plain.points == 3 * int(poses)
    assert (planned.duration_s > plain.duration_s) == bool(spans)
