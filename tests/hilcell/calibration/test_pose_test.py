"""Limits of the pose test: a figure and its uncertainty keep them, or they are not kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.calibration.pose_test import ISO, interruptions, judgement
from hilcell.journal.log import Log
from hilcell.journal.point_id import PointId
from hilcell.journal.runs import read_records
from tests.hilcell.report.journals import Writer


def result(ad_mm: float = -0.2, **limits: float) -> dict[str, Any]:
    return {
        "worst": {"ap_mm": 1.0, "ap_u95_mm": 0.1, "rp_mm": 0.05, "rp_u95_mm": 0.01},
        "distance": {"ad_mm": ad_mm, "ad_u95_mm": 0.05, "rd_mm": 0.06, "rd_u95_mm": 0.01},
        "limits": limits,
    }


@pytest.mark.parametrize(
    ("limits", "holds"),
    [
        ({"ap_limit_mm": 1.11}, True),
        ({"ap_limit_mm": 1.05}, False),  # AP keeps it, AP + U does not
        ({"rp_limit_mm": 0.061}, True),
        ({"rp_limit_mm": 0.059}, False),
        ({"ad_limit_mm": 0.26}, True),  # of either sign
        ({"ad_limit_mm": 0.24}, False),
        ({"rd_limit_mm": 0.071}, True),
        ({"rd_limit_mm": 0.069}, False),
        ({"ap_limit_mm": 1.05, "rp_limit_mm": 0.061}, False),
    ],
)
def test_a_limit_is_kept_with_the_uncertainty(limits: dict[str, float], holds: bool) -> None:
    judged = judgement(result(**limits))
    assert judged["holds"] is holds
    assert limits.items() <= judged.items()


ANGLES = {
    "P1": {
        "ap_deg": {"a": 0.01, "b": -0.05, "c": 0.0},
        "ap_u95_deg": {"a": 0.01, "b": 0.01, "c": 0.01},
        "rp_deg": {"a": 0.03, "b": 0.01, "c": 0.01},
        "rp_u95_deg": {"a": 0.004, "b": 0.002, "c": 0.002},
    }
}


@pytest.mark.parametrize(
    ("limits", "holds"),
    [
        ({"ap_limit_deg": 0.061}, True),  # of either sign
        ({"ap_limit_deg": 0.055}, False),  # AP_b keeps it, AP_b + U does not
        ({"rp_limit_deg": 0.035}, True),
        ({"rp_limit_deg": 0.033}, False),
    ],
)
def test_the_worst_angle_keeps_its_limit_or_not(limits: dict[str, float], holds: bool) -> None:
    judged = judgement(result(**limits) | {"orientation": ANGLES})
    assert judged["holds"] is holds
    assert limits.items() <= judged.items()
    assert judgement(result(**limits))["holds"] is False  # limited and not measured


def test_without_limits_there_is_no_verdict() -> None:
    assert judgement(result()) == {}


def test_a_figure_that_is_no_number_keeps_no_limit() -> None:
    assert judgement(result(np.nan, ad_limit_mm=1.0))["holds"] is False


def test_stops_and_pauses_between_visits_are_departures(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    for session in (1, 2):
        writer.state("run", "paused")  # the first is before any visit
        writer.state("run", "running")
        writer.point(PointId(ISO, pose="P1", number=session), (0.0, 0.0, 0.0), session=session)
    log = Log(read_records(writer.left()))
    assert list(interruptions(log)) == [
        "the cycles were interrupted once and resumed; the slide was held again, its slip is in RP",
        "the cycles were paused once, the robot at rest meanwhile",
    ]
