"""Free poses of a quick plan: where they may be, and that a resumed run takes the same ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.grid import grid_of
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import to_rotvec
from hilcell.geometry.kinematics import forward
from hilcell.identification.measured_poses import IdentificationError
from hilcell.model.events import Event
from hilcell.model.point import PointId
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import clear_poses
from procedures import robot_grid
from procedures.plan import flange_points, nearest_next, robot_moves_s
from procedures.robot_grid import CANDIDATES, ChosenPoses, Design, Rows, candidates_rad, design
from tests.procedures.results import result_of

QUICK = load_cell("paper", {"plan.quick": "true"})
STATION = QUICK.reference


class Journal:
    """A session that measures nothing, and remembers events and what was asked for."""

    def __init__(self) -> None:
        self.cell = QUICK
        self.log = SimpleNamespace(cell=QUICK, happened=self.happened)
        self.events: list[Event] = []
        self.frames = SimpleNamespace(base_in_world=lambda station: np.eye(4))
        self.sent: list[tuple[str, list[float]]] = []

    def add(self, event: Event) -> None:
        self.events.append(event)

    def happened(self, kind: type[Event]) -> list[Event]:
        return [each for each in self.events if isinstance(each, kind)]

    def close_step(self) -> None:
        self.sent.append(("closed", []))

    def flange_point(self, id: PointId, station: object, joints_rad: Array, **_: object) -> None:
        self.sent.append((id.key, np.degrees(joints_rad).round(9).tolist()))


def test_candidates_fill_the_cube_and_each_other_one_is_turned() -> None:
    found = forward(QUICK.robot.arm(), candidates_rad(QUICK))
    grid, centre = grid_of(QUICK), QUICK.grid.centre.matrix()
    assert len(found) > 0.9 * CANDIDATES
    assert (found[:, :3, 3] >= grid.origin_mm).all()
    assert (found[:, :3, 3] <= grid.far_mm).all()
    assert np.ptp(found[:, :3, 3], axis=0).min() > 800.0
    turns_deg = np.degrees(np.linalg.norm(to_rotvec(found[:, :3, :3] @ centre[:3, :3].T), axis=-1))
    assert turns_deg.max() <= QUICK.plan.turn_deg + 1e-6
    assert 0.4 < np.mean(turns_deg > 1.0) < 0.6


def test_no_candidate_is_turned_where_nothing_is_stated_of_the_surroundings() -> None:
    bare = replace(QUICK, robot=replace(QUICK.robot, envelope=None), keep_out=[])
    joints_rad = candidates_rad(bare)
    assert 0.4 * CANDIDATES < len(joints_rad) < 0.6 * CANDIDATES
    assert clear_poses(bare, STATION, joints_rad).all()


def test_poses_are_chosen_once(monkeypatch: pytest.MonkeyPatch) -> None:
    journal = Journal()
    session = cast("CellSession", journal)
    monkeypatch.setattr(robot_grid, "choice", lambda log, rad: Design([5, 2], [0.3, 0.2, 0.1]))
    ChosenPoses().perform(session)
    first = list(journal.sent)
    assert [key for key, _ in first] == ["pose/000", "pose/001", "closed"]
    chosen_rad = candidates_rad(QUICK)[[5, 2]]
    wanted_deg = np.degrees(chosen_rad[nearest_next(QUICK, chosen_rad)])
    np.testing.assert_allclose([joints for _, joints in first[:2]], wanted_deg, atol=1e-8)
    monkeypatch.setattr(robot_grid, "choice", lambda log, rad: Design([7], [0.1, 0.1]))
    ChosenPoses().perform(session)  # resumed, with more known by now
    assert journal.sent == first + first
    assert result_of(ChosenPoses(), session.log)["chosen_poses"]["bounds_mm"] == [0.3, 0.2, 0.1]


def test_a_robot_that_is_not_identified_gets_no_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(log: object, rad: object) -> Design:
        raise IdentificationError("too few")

    journal = Journal()
    monkeypatch.setattr(robot_grid, "choice", refuse)
    ChosenPoses().perform(cast("CellSession", journal))
    assert journal.sent == [("closed", [])]
    assert [event.why for event in journal.events][:1] == ["too few"]


def test_a_full_plan_has_none() -> None:
    assert ChosenPoses().plan(load_cell("paper"), 1).duration_s == 0.0


def test_the_plan_has_the_poses_that_are_needed_in_any_case() -> None:
    tilted = load_cell("paper", {"plan.quick": "true", "plan.tilt_deg": "20.0"})
    assert ChosenPoses().plan(QUICK, 1).points == QUICK.plan.least_poses
    assert ChosenPoses().plan(tilted, 1).points == tilted.plan.tilt_poses


def test_the_robot_goes_on_to_the_nearest_of_the_poses_that_are_left() -> None:
    joints_rad = candidates_rad(QUICK)[:30]
    order = nearest_next(QUICK, joints_rad)
    assert sorted(order) == list(range(30))
    here_rad = np.radians(QUICK.robot.safe_deg)
    for n, at in enumerate(order):
        moves_s = robot_moves_s(QUICK, here_rad, joints_rad[order[n:]])
        assert moves_s[0] == moves_s.min()
        here_rad = joints_rad[at]
    unordered_s = flange_points(QUICK, joints_rad).duration_s
    assert flange_points(QUICK, joints_rad[order]).duration_s < 0.8 * unordered_s


# -- Poses chosen by information: against dense algebra, by trial, and when to stop ----------------


P = 5


def rows(seed: int, count: int, noise_mm: float = 0.1) -> Rows:
    J = np.random.default_rng(seed).standard_normal((count, 3, P))
    return Rows(J, np.tile(noise_mm**2 * np.eye(3), (count, 1, 1)))


VOLUME, DRAWN = rows(1, 8, 0.01), rows(2, 20)
PRIOR = np.diag([1.0, 2.0, 0.5, 1.0, 3.0])


def mean_variance_mm2(measured: list[int]) -> float:
    """The predictions' variance (trace) over the volume, by the whole normal equations."""
    information = np.linalg.inv(PRIOR).astype(float)
    for n in measured:
        J = DRAWN.by_parameter[n]
        information = information + J.T @ np.linalg.inv(DRAWN.noise_mm2[n]) @ J
    covariance = np.linalg.inv(information).astype(float)
    covariances = VOLUME.covariance_mm2(covariance)
    return float(np.trace(covariances, axis1=1, axis2=2).mean())


def test_each_pose_is_the_best_after_those_before() -> None:
    found = design(DRAWN, VOLUME, PRIOR, bound_mm=1e-6, counts=(0, 4))
    for count, chosen in enumerate(found.chosen):
        before = found.chosen[:count]
        others = [n for n in range(20) if n not in before]
        assert chosen == min(others, key=lambda n: mean_variance_mm2([*before, n]))
    assert len(set(found.chosen)) == 4
    assert np.all(np.diff(found.bounds_mm) < 0)


def test_the_bound_is_that_of_the_posterior() -> None:
    """Of a spherical covariance 95 % of lengths are within 2.7955 standard deviations."""
    J = np.eye(3)[None]
    one = Rows(J, np.zeros((1, 3, 3)))
    found = design(
        Rows(J, 0.04 * np.eye(3)[None]), one, 0.04 * np.eye(3), bound_mm=1e-6, counts=(0, 1)
    )
    assert found.bounds_mm == pytest.approx([2.7955 * 0.2, 2.7955 * 0.2 / np.sqrt(2)], rel=1e-4)


def test_it_stops_where_the_bound_is_low_enough() -> None:
    whole = design(DRAWN, VOLUME, PRIOR, bound_mm=1e-6, counts=(0, 10))
    found = design(DRAWN, VOLUME, PRIOR, bound_mm=whole.bounds_mm[3], counts=(0, 10))
    assert found.chosen == whole.chosen[:3]
    assert design(DRAWN, VOLUME, PRIOR, bound_mm=1e3, counts=(0, 10)).chosen == []


def test_it_stops_where_noise_is_all_that_is_left() -> None:
    noisy = Rows(VOLUME.by_parameter, 1.0 * np.tile(np.eye(3), (8, 1, 1)))
    found = design(DRAWN, noisy, PRIOR, bound_mm=0.1, counts=(0, 20))
    assert 0 < len(found.chosen) < 5
    assert found.bounds_mm[-1] <= 1.1 * 2.7955
