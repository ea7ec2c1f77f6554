"""Calibrations that must not be used: every reason is told, and only then."""

from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec
import pytest

from hilcell.calibration.decision_rule import Guard, decide, tolerance_limits
from hilcell.calibration.file import Calibration
from hilcell.calibration.validity import CalibrationRefused, check_usable
from hilcell.cell.file import load_cell
from hilcell.journal.calibration_status import CalibrationStatus
from hilcell.model.calibration import Update
from hilcell.model.verdicts import Limits, OrientationError
from tests.hilcell.calibration.calibrations import LIMITS, STAMP, calibration

CELL = load_cell("paper")
NOW = datetime(2026, 11, 20, 12, 0, 0, tzinfo=UTC)


def aged(days: float, **more: Any) -> Calibration:
    return calibration(written=f"{NOW - timedelta(days=days):{STAMP}}", **more)


def test_a_fit_calibration() -> None:
    check_usable(aged(179.9, digest=CELL.digest), NOW, cell=CELL, temperature_c=24.9)
    check_usable(aged(0), NOW, temperature_c=20.0)
    check_usable(aged(300), NOW, max_age_days=301)
    check_usable(aged(-0.01), NOW)


@pytest.mark.parametrize(
    ("days", "limit"), [(180.1, 180.0), (1.5, 1.0), (0.5, float("nan")), (-2.0, 180.0)]
)
def test_age(days: float, limit: float) -> None:
    with pytest.raises(CalibrationRefused, match=f"{abs(days)} days"):
        check_usable(aged(days), NOW, max_age_days=limit)


@pytest.mark.parametrize("provenance", [{"written": "yesterday"}, {"sign_checked": False}])
def test_a_date_that_is_none_and_an_unproven_sign(provenance: dict[str, Any]) -> None:
    with pytest.raises(CalibrationRefused):
        check_usable(calibration(**provenance), NOW)


def test_another_cell() -> None:
    with pytest.raises(CalibrationRefused, match=f"dddddddddddd, .*{CELL.digest[:12]}"):
        check_usable(aged(1), NOW, cell=CELL)


@pytest.mark.parametrize("temperature_c", [19.9, 25.1, float("nan")])
def test_temperature(temperature_c: float) -> None:
    with pytest.raises(CalibrationRefused, match=r"22\.0 \.\. 23\.0 C"):
        check_usable(aged(1), NOW, temperature_c=temperature_c)


def test_a_temperature_cannot_be_compared_with_none() -> None:
    values = msgspec.to_builtins(aged(1))
    values["validity"]["temperature_c"] = None
    without = msgspec.convert(values, Calibration)
    check_usable(without, NOW)
    with pytest.raises(CalibrationRefused, match=r"22\.0 C"):
        check_usable(without, NOW, temperature_c=22.0)


def test_all_reasons_at_once() -> None:
    with pytest.raises(CalibrationRefused) as told:
        check_usable(aged(400, sign_checked=False), NOW, cell=CELL, temperature_c=40.0)
    assert len(str(told.value).split("\n")) == 5


def validated(mean_mm: float, limits: Limits = LIMITS, **more: Any) -> Calibration:
    """Return a calibration whose validation found ``mean_mm``, with U = 0.04 mm."""
    found = decide(mean_mm, 0.1, limits, Guard(0.04, 0.05))
    return msgspec.structs.replace(aged(1, **more), verdicts={"S1100": found})


@pytest.mark.parametrize("over_mm", [0.001, 5.0])
def test_a_failed_validation(over_mm: float) -> None:
    bad = validated(LIMITS.mean_mm - 0.04 + over_mm)
    with pytest.raises(CalibrationRefused, match="S1100"):
        check_usable(bad, NOW)
    (accepted,) = check_usable(bad, NOW, accept_out_of_tolerance=True)
    assert "S1100" in accepted


def test_a_validation_that_was_never_made() -> None:
    never = msgspec.structs.replace(aged(1), verdicts={})
    with pytest.raises(CalibrationRefused, match="--accept-out-of-tolerance"):
        check_usable(never, NOW)
    assert len(check_usable(never, NOW, accept_out_of_tolerance=True)) == 1


def test_a_flag_is_offered_where_it_is_enough() -> None:
    failed = validated(5.0)
    with pytest.raises(CalibrationRefused, match="S1100") as refused:
        check_usable(failed, NOW, cell=CELL)
    assert "--accept" not in str(refused.value), "it is of another cell"
    doubted = CalibrationStatus("in doubt", reason="the tracker was bumped")
    with pytest.raises(
        CalibrationRefused, match="add --accept-not-current --accept-out-of-tolerance;"
    ):
        check_usable(failed, NOW, status=doubted)
    with pytest.raises(CalibrationRefused, match="in doubt") as refused:
        check_usable(failed, NOW, status=doubted, accept_out_of_tolerance=True)
    assert "--accept-out" not in str(refused.value)
    check_usable(failed, NOW, status=doubted, accept_out_of_tolerance=True, accept_not_current=True)


def test_another_tolerance_than_the_cell_s() -> None:
    """The reproduction: 3.7 mm off in tolerance, because the tolerance was 10 mm."""
    wide = {"validation.mean_tolerance_mm": "5.0", "validation.max_tolerance_mm": "10.0"}
    made = validated(3.7, Limits(5.0, 10.0), digest=load_cell("paper", wide).digest)
    with pytest.raises(CalibrationRefused, match=r"3\.7000"):
        check_usable(made, NOW, cell=CELL)
    assert check_usable(made, NOW, cell=CELL, accept_out_of_tolerance=True)
    assert not check_usable(made, NOW, cell=load_cell("paper", wide))


def test_another_limit_of_orientation_than_the_cell_s() -> None:
    limited = {
        "robot.more_smr_mm": "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]",
        "validation.max_tolerance_deg": "0.05",
    }
    today = load_cell("paper", limited)
    made = validated(0.01, digest=today.digest)
    with pytest.raises(CalibrationRefused, match=r"0\.05 deg"):
        check_usable(made, NOW, cell=today)
    found = decide(
        0.01,
        0.1,
        tolerance_limits(today),
        Guard(0.04, 0.05),
        orientation=OrientationError(0.01, 0.01),
    )
    was = msgspec.structs.replace(made, verdicts={"S1100": found})
    assert not check_usable(was, NOW, cell=today)
    del limited["validation.max_tolerance_deg"]
    with pytest.raises(CalibrationRefused) as refusal:  # the same cell, decide by another limit
        check_usable(was, NOW, cell=load_cell("paper", limited))
    assert "another cell" not in str(refusal.value)


def test_a_limit_of_orientation_and_a_cell_that_measures_none() -> None:
    found = decide(
        0.01,
        0.1,
        Limits(0.12, 0.3, 0.05),
        Guard(0.04, 0.05),
        orientation=OrientationError(0.01, 0.01),
    )
    made = msgspec.structs.replace(aged(1), verdicts={"S1100": found})
    with pytest.raises(CalibrationRefused, match=CELL.digest[:12]):
        check_usable(made, NOW, cell=CELL)
    with pytest.raises(CalibrationRefused, match="fixed"):
        check_usable(made, NOW, cell=load_cell("fixed"))


def test_another_verdict_that_does_not_hold() -> None:
    """The run ended with exit code 1, whatever its validation found."""
    said = "suspected ['mount slipped (0.2 mm), noticed by re-visited poses']"
    failed = msgspec.structs.replace(aged(1), failed={"suspicions": said})
    with pytest.raises(CalibrationRefused, match="mount slipped"):
        check_usable(failed, NOW)


def test_the_run_that_wrote_it_is_named_and_the_one_that_it_is_based_on() -> None:
    update = Update("2-recheck", "base", "2026-11-22T10:00:00Z", 7)
    bad = aged(400, run="1-made", updates=[update])
    with pytest.raises(CalibrationRefused, match=r"2-recheck .*1-made"):
        check_usable(bad, NOW)
    with pytest.raises(CalibrationRefused, match="1-made"):
        check_usable(aged(400, run="1-made"), NOW)
