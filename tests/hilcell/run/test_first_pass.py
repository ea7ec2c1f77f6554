"""Where the robot was never driven outside of the cube, it goes slowly, and somebody watches."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.cell.file import Cell
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from procedures.plan import joints_for
from procedures.repeatability import Repeatability
from tests.hilcell.run.bed import CELL, PLAN, Bed, Live, until
from tests.hilcell.run.rig import Points, procedure

HOME = np.radians(CELL.robot.home_deg)
OUT = HOME + np.radians([20.0, 0.0, 0.0, 0.0, 0.0, 0.0])
CUBE = joints_for(CELL, Repeatability.places_mm(CELL))[0]
SLOW, USUAL = CELL.robot.first_pass_percent, CELL.robot.speed_percent


def pausing(cell: Cell) -> Cell:
    robot = msgspec.structs.replace(cell.robot, first_pass_pause=True)
    return msgspec.structs.replace(cell, robot=robot)


def go(*poses: Array) -> Callable[[CellSession, int], None]:
    def act(session: CellSession, number: int) -> None:
        for joints in poses:
            session.robot_to(joints, "a pose")

    return act


def run(bed: Bed, *poses: Array) -> None:
    assert bed.run(procedure(Points(1, go(*poses)))) == 0


def test_a_pose_outside_is_driven_to_slowly_once(tmp_path: Path) -> None:
    bed = Bed(tmp_path)
    run(bed, OUT, HOME, CUBE, OUT, OUT + np.radians(0.5))
    assert bed.robot.speeds == [SLOW] * 4 + [USUAL] * 6
    (event,) = bed.events("first pass")
    assert (event["key"], event["speed_percent"]) == ("a pose", SLOW)


@pytest.mark.parametrize("axis", [0, 5])
def test_another_pose_is_not_known(tmp_path: Path, axis: int) -> None:
    other = OUT.copy()
    other[axis] += np.radians(1.5)
    bed = Bed(tmp_path)
    run(bed, OUT, other)
    assert bed.robot.speeds == [SLOW] * 4


def test_the_same_pose_at_another_place_is_not_known(tmp_path: Path) -> None:
    bed = Bed(tmp_path)

    def act(session: CellSession, number: int) -> None:
        for joints in (OUT, CUBE, OUT, CUBE):
            session.robot_to(joints, "here")
        bed.rail.position_mm += 6.0
        session.robot_to(OUT, "there")

    assert bed.run(procedure(Points(1, act))) == 0
    assert bed.robot.speeds == [SLOW] * 2 + [USUAL] * 6 + [SLOW] * 2


def test_a_resumed_run_knows_only_motions_that_came_to_their_end(tmp_path: Path) -> None:
    bed = Bed(tmp_path)

    def lost(session: CellSession, number: int) -> None:
        session.robot_to(HOME, "arrives")
        session.robot_to(OUT, "may have arrived")
        raise RuntimeError("the engine dies")

    bed.run(procedure(Points(1, lost)))
    bed.robot.speeds.clear()
    run(bed, HOME, OUT)
    assert bed.robot.speeds == [USUAL, USUAL, SLOW, SLOW]


def test_a_finished_run_s_poses_are_known_to_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
    run(Bed(tmp_path / "first"), OUT)
    monkeypatch.setitem(PLAN, "driven_by", ["deleted", "first"])
    bed = Bed(tmp_path / "second")
    run(bed, OUT, HOME)
    assert bed.robot.speeds == [USUAL, USUAL, SLOW, SLOW]
    (event,) = bed.events("earlier run unreadable")
    assert event["run"] == "deleted"


def test_an_attended_run_pauses_before_the_first_of_them(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=pausing(CELL), unattended=False)
    with Live(bed, procedure(Points(1, go(CUBE, OUT, HOME)))) as live:
        live.until("state", "paused")
        assert bed.robot.speeds == [USUAL, USUAL]
        live.runner.post("proceed")
        until(lambda: live.code == 0)
    assert bed.robot.speeds == [USUAL] * 2 + [SLOW] * 4
    (paused,) = [r.body for r in bed.records("state") if r.body["to"] == "paused"]
    assert "a pose" in paused["reason"]


def test_a_run_that_waits_there_can_be_stopped(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=pausing(CELL), unattended=False)
    with Live(bed, procedure(Points(1, go(OUT)))) as live:
        live.until("state", "paused")
        live.runner.stop()
    assert bed.robot.speeds == []
    assert bed.states()[-1] == "aborted"


def test_a_run_that_nobody_attends_goes_on(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=pausing(CELL))
    run(bed, OUT)
    assert bed.robot.speeds == [SLOW, SLOW]
    assert "paused" not in bed.states()
