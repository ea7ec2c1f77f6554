"""What several reflectors on the flange tell of the tool, from a log alone."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.file import Calibration
from hilcell.calibration.influence import ASSUMED, Frame, Influence, UncertaintyBudget, motion
from hilcell.calibration.orientation import (
    MOVED_MM,
    check_orientation_limit,
    expanded_deg,
    largest_orientation_error,
    largest_orientation_errors,
    last_orientation_errors,
    moved_on_flange_mm,
    orientation_bounds_deg,
    orientation_covariances_rad2,
    orientation_coverages,
)
from hilcell.cell.file import load_cell
from hilcell.compensation.model import PredictedOrientation, Prediction
from hilcell.geometry.frames import from_rotvec, from_zyx, pose_from_zyx, zyx_from_pose
from hilcell.geometry.statistics import bounds95_mm
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.point import PointId
from hilcell.model.records import Kind
from hilcell.ports import Array, HilcellError
from procedures.validate import Validate
from tests.hilcell.calibration.calibrations import calibration
from tests.hilcell.run.bed import PLAN

SEATS = {"robot.more_smr_mm": "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]"}
CELL = load_cell("paper", SEATS)
SEATS_MM = CELL.robot.seats_mm
ORIENTED = from_zyx([10.0, 70.0, 5.0])
TRACKER = np.eye(4)  # {W} is its frame


def logged(
    poses: list[tuple[PointId, Array]],
    seats_mm: dict[str, Array],
    world: Array = TRACKER,
    std_mm: tuple[float, float, float] = (0.01, 0.01, 0.01),
) -> Log:
    """Return a log of poses (3, 3); ``seats_mm`` (3, 3) are the reflectors by kind."""
    plan = PLAN | {"cell": msgspec.to_builtins(CELL)}
    records: list[tuple[Kind, str, dict[str, Any]]] = [
        ("plan", "", plan),
        ("frame", "world", {"matrix": world.tolist()}),
    ]
    for number, (id, R) in enumerate(poses):
        for seat, at_mm in enumerate(seats_mm[id.kind], start=1):
            each = id.at_seat(seat)
            body = {
                "id": msgspec.to_builtins(each), "group": each.group, "station": "S1100",
                "reflector": "SMR", "xyz_mm": (R @ at_mm + 100.0 * number).tolist(),
                "std_mm": [*std_mm], "samples": 1, "session": 1, "frame": "tracker",
                "nominal_mm": [0.0, 0.0, 0.0],
                "nominal_deg": zyx_from_pose(_pose(ORIENTED))[3:].tolist() if seat == 1 else None,
            }  # fmt: skip
            records.append(("point", each.key, body))
    return Log(Record(n, "", kind, key, body) for n, (kind, key, body) in enumerate(records, 1))


def _pose(R: Array) -> Array:
    T = np.eye(4)
    T[:3, :3] = R
    return T


def ids(kind: str, count: int) -> list[PointId]:
    return [PointId(kind, number=n) for n in range(count)]


def test_errors_are_rotation_vectors_in_world_from_nominal_to_actual() -> None:
    wanted_rad = np.array([3e-4, -2e-4, 5e-4])
    actual = from_rotvec(wanted_rad) @ ORIENTED
    log = logged([(ids("validate", 1)[0], actual)], {"validate": SEATS_MM})
    turned = last_orientation_errors(log, log.select("validate"), SEATS_MM)
    np.testing.assert_allclose(turned.error_rad, [wanted_rad], atol=1e-9)
    assert turned.figures.mean_deg == pytest.approx(np.degrees(np.linalg.norm(wanted_rad)))
    sigma_rad = np.sqrt(np.diagonal(turned.reading_rad2, axis1=1, axis2=2))
    assert (sigma_rad > 0.01 / 250.0).all()
    assert (sigma_rad < 0.01 / 80.0).all()


@pytest.mark.parametrize("order", [(3e-4, 1e-4), (1e-4, 3e-4), (1e-4, 3e-4, 2e-4)])
def test_of_a_pose_measured_again_the_largest_turn_counts(order: tuple[float, ...]) -> None:
    other, id = ids("validate", 2)
    poses = [(other, from_rotvec([0.0, 2e-4, 0.0]) @ ORIENTED)]
    poses += [(id, from_rotvec([0.0, 0.0, each]) @ ORIENTED) for each in order]
    log = logged(poses, {"validate": SEATS_MM})
    turned = largest_orientation_errors(log, log.select("validate"), SEATS_MM)
    assert [each.id for each in turned.points] == [other, id]
    np.testing.assert_allclose(turned.error_rad, [[0.0, 2e-4, 0.0], [0.0, 0.0, 3e-4]], atol=1e-9)
    latest = last_orientation_errors(log, log.select("validate"), SEATS_MM)
    np.testing.assert_allclose(latest.error_rad[1], [0.0, 0.0, order[-1]], atol=1e-9)


def test_the_uncertainty_of_an_orientation_covers_reflectors_that_are_seen_elsewhere() -> None:
    """By Monte Carlo: noise of the readings and stated limits, drawn for every reflector."""
    stated, rng = CELL.uncertainty, np.random.default_rng(90210)
    limits_mm = np.array([stated.tracker_limit_mm, stated.smr_centring_limit_mm])
    (id,) = ids("validate", 1)
    exact = logged([(id, ORIENTED)], {"validate": SEATS_MM})
    turned = last_orientation_errors(exact, exact.select("validate"), SEATS_MM)
    (U_deg,) = expanded_deg(orientation_covariances_rad2(exact, turned))
    bounds_deg = []
    for _ in range(200):
        off_mm = rng.normal(0.0, 0.01, (3, 3))
        off_mm += rng.uniform(-1.0, 1.0, (2, 3, 3)).T.swapaxes(0, 1) @ limits_mm
        log = logged([(id, ORIENTED)], {"validate": SEATS_MM + off_mm})
        bounds_deg.append(
            np.degrees(last_orientation_errors(log, log.select("validate"), SEATS_MM).error_rad[0])
        )
    sigma_deg = np.sqrt(np.linalg.eigvalsh(np.cov(np.array(bounds_deg).T))[-1])
    assert pytest.approx(2.0 * sigma_deg, rel=0.2) == U_deg
    assert largest_orientation_error(exact, turned) == (turned.figures.max_deg, U_deg)


def test_an_orientation_that_was_not_measured_is_no_number() -> None:
    log = logged([(ids("validate", 1)[0], ORIENTED)], {"validate": SEATS_MM[:2]})
    none = last_orientation_errors(log, log.select("validate"), SEATS_MM)
    for turned in (None, none):
        assert np.isnan(largest_orientation_error(log, turned)).all()


def test_what_a_reading_turns_has_the_axes_of_world() -> None:
    """The tracker's noise is unlike in its axes, and they are not those of {W}."""
    id, Q = ids("validate", 1)[0], from_rotvec([0.0, 0.3, 0.9])
    own, turned = (
        last_orientation_errors(log, log.select("validate"), SEATS_MM).reading_rad2[0]
        for log in (
            logged([(id, ORIENTED)], {"validate": SEATS_MM}, world, std_mm=(0.03, 0.01, 0.002))
            for world in (TRACKER, _pose(Q))
        )
    )
    np.testing.assert_allclose(turned, Q @ own @ Q.T, rtol=1e-6)
    assert np.abs(turned - own).max() > 0.1 * np.abs(own).max()


class Turning:
    """A model that knows no error, and the orientation's about x of the base to ``sigma_rad``."""

    sigma_rad = 2e-5

    def predict(self, poses: Array) -> Prediction:
        known = np.broadcast_to(np.diag([self.sigma_rad**2, 0.0, 0.0]), (len(poses), 3, 3))
        zeros = np.zeros((len(poses), 3))
        return Prediction(zeros, np.zeros_like(known), PredictedOrientation(zeros, known))


def test_a_bound_adds_model_and_frames_in_the_axes_of_world(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The base is turned by 30 deg: its x is {W}'s (cos 30, sin 30), about which all three turn.
    Shifts, and what turns the tool alone, do not count.
    """
    monkeypatch.setattr(Calibration, "error_model", lambda _: Turning())
    one, s = calibration(), Turning.sigma_rad
    T_W_B = pose_from_zyx(0.0, 0.0, 0.0, 30.0, 0.0, 0.0)
    about = T_W_B[:3, 0]
    parts: list[tuple[Frame, Array]] = [
        ("world", s**2 * np.outer(about, about)),
        ("base", np.diag([s**2, 0.0, 0.0])),
        ("tool", np.eye(3)),
    ]
    lines = [
        Influence(frame, ASSUMED, "", "", frame, motion(1.0, turn_rad2))
        for frame, turn_rad2 in parts
    ]
    made = msgspec.structs.replace(
        one,
        stations={"S1100": msgspec.structs.replace(one.stations["S1100"], T_W_B=T_W_B.tolist())},
        uncertainty=UncertaintyBudget(lines, {"S1100": []}, 0.0, 0.0),
    )
    bounds_deg = orientation_bounds_deg(made, "S1100", T_W_B[None])
    assert bounds_deg is not None
    assert bounds_deg.tolist() == pytest.approx([np.degrees(1.95996 * np.sqrt(3.0) * s)], rel=1e-4)


def test_a_bound_in_the_validation_has_the_readings_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else is uncertain here: one target is turned by half of that, one by twice."""
    place = "hilcell.calibration.orientation"
    monkeypatch.setattr(Turning, "sigma_rad", 0.0)
    monkeypatch.setattr(Calibration, "error_model", lambda _: Turning())
    monkeypatch.setattr(f"{place}.seats_of", lambda _: SEATS_MM)
    monkeypatch.setattr(f"{place}.driven_poses", lambda *found: np.tile(np.eye(4), (2, 1, 1)))
    monkeypatch.setattr(f"{place}.lines_in_validation", lambda *_: [])
    targets = [PointId("validate", station="S1100", how="chosen", number=n) for n in range(2)]
    at_rest = logged([(id, ORIENTED) for id in targets], {"validate": SEATS_MM})
    readings_rad2 = last_orientation_errors(
        at_rest, at_rest.select("validate"), SEATS_MM
    ).reading_rad2
    wanted_rad = bounds95_mm(readings_rad2)
    turns = [share * wanted_rad[0] * ORIENTED[:, 0] for share in (0.5, 2.0)]
    poses = [(id, from_rotvec(turn) @ ORIENTED) for id, turn in zip(targets, turns, strict=True)]
    log = logged(poses, {"validate": SEATS_MM})
    found = orientation_coverages(calibration(), log, {"S1100": ["S1100"]})["S1100"]
    assert found.coverage == 0.5
    assert found.mean_deg == pytest.approx(np.degrees(wanted_rad.mean()), rel=1e-3)


@pytest.mark.parametrize(("shift_mm", "moved"), [(0.0, False), (0.02, False), (0.05, True)])
def test_a_reflector_that_was_knocked_is_seen(shift_mm: float, moved: bool) -> None:
    knocked_mm = SEATS_MM + np.array([[0.0] * 3, [0.0] * 3, [0.0, -shift_mm, 0.0]])
    poses = [(id, ORIENTED) for id in (*ids("grid", 5), *ids("validate", 5))]
    log = logged(poses, {"grid": SEATS_MM, "validate": knocked_mm})
    found_mm = moved_on_flange_mm(log)
    assert found_mm == pytest.approx(shift_mm, abs=1e-6)
    assert (found_mm > MOVED_MM) == moved


def test_a_limit_that_nothing_could_keep_is_refused_before_anything_moves() -> None:
    """Stated 0.015 and 0.0127 mm, rectangular, turn this triangle by up to U = 0.0115 deg."""
    narrow, wide = (
        load_cell("paper", SEATS | {"validation.max_tolerance_deg": text})
        for text in ("0.0114", "0.0116")
    )
    check_orientation_limit(wide)
    with pytest.raises(HilcellError, match=r"max_tolerance_deg .*0\.0115 deg"):
        Validate().plan(narrow, 1)
