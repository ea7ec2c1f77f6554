"""A reflector carried by hand is asked for where the journal says it is not."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.model.point import PointId
from hilcell.run.cell_session import CellSession
from tests.hilcell.run.bed import Bed, Live, until
from tests.hilcell.run.rig import Points, procedure

QUICK = {"settle.robot_s": "0.0", "settle.rail_s": "0.0"}
BY_HAND = load_cell("paper", QUICK | {"layout.reflectors": "by_hand"})
S1100 = BY_HAND.station_named("S1100")
S1900 = BY_HAND.station_named("S1900")


@pytest.fixture
def bed(tmp_path: Path) -> Bed:
    return Bed(tmp_path, unattended=False, cell=BY_HAND)


def slide(session: CellSession, number: int) -> None:
    """Measure P1 at two stations in turn, before the floor's first nest."""
    station = (S1100, S1900)[number % 2]
    id = PointId("s", number=number)
    session.slide_point(id, station, BY_HAND.layout.slide[0], samples=1)


def test_it_is_asked_for_once_a_place_and_where_it_rode_to(bed: Bed) -> None:
    with Live(bed, procedure(Points(2, slide))) as live:
        asked = []
        for _ in range(4):
            until(lambda: live.status("state") == "suspended")
            asked.append(live.status("prompt"))
            assert live.runner.answer() == ""
    assert live.code == 0
    assert [prompt["place"] for prompt in asked] == ["P1", "F1", "P1", "F1"]
    assert [prompt["limit_mm"] for prompt in asked] == [50.0, 50.0, 5.0, 5.0]
    rode_mm = np.array(asked[2]["expected_mm"]) - asked[0]["expected_mm"]
    assert np.linalg.norm(rode_mm) == pytest.approx(800.0, abs=0.01)
    assert asked[3]["expected_mm"] == pytest.approx(asked[1]["expected_mm"])
    assert [event["place"] for event in bed.events("seated")] == ["P1", "F1", "P1", "F1"]


def test_nobody_is_asked_to_come_while_the_slide_has_power(bed: Bed) -> None:
    def power(session: CellSession, number: int) -> None:
        bed.rail.powered = True

    assert bed.run(procedure(Points(1, power))) == 3
    assert "F1" in bed.log().fault
    assert "suspended" not in bed.states()


def test_the_robot_is_parked_before_somebody_is_asked(bed: Bed) -> None:
    def away(session: CellSession, number: int) -> None:
        if number:
            bed.robot.joints_rad = np.radians(BY_HAND.robot.home_deg)
            slide(session, 0)

    with Live(bed, procedure(Points(2, away))) as live:
        live.until("state", "suspended")
        assert live.runner.answer() == ""
        until(lambda: (live.status("prompt") or {}).get("place") == "P1")
        assert np.allclose(np.degrees(bed.robot.joints_rad), BY_HAND.robot.safe_deg)
        live.runner.stop()


def test_a_mounted_cell_asks_nobody(tmp_path: Path) -> None:
    bed = Bed(tmp_path)
    assert bed.run(procedure(Points(2))) == 0
    assert bed.events("seated") == []
