"""Calibrations that must not be used: every reason is told, and only then."""

from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec
import pytest

from hilcell.calibration.form import Calibration
from hilcell.calibration.validity import Unfit, check_fitness
from tests.hilcell.calibration.calibrations import STAMP, calibration

NOW = datetime(2026, 11, 20, 12, 0, 0, tzinfo=UTC)


def aged(days: float, **more: Any) -> Calibration:
    return calibration(written=f"{NOW - timedelta(days=days):{STAMP}}", **more)


def test_a_fit_calibration() -> None:
    check_fitness(aged(179.9), NOW, digest="d" * 64, temperature_c=24.9)
    check_fitness(aged(0), NOW, temperature_c=20.0)
    check_fitness(aged(300), NOW, max_age_days=301)
    check_fitness(aged(-0.01), NOW)


@pytest.mark.parametrize(
    ("days", "limit", "part"),
    [
        (180.1, 180.0, "it was written 2026-05-24T09:36:00Z, 180.1 days ago, wanted <= 180 days"),
        (1.5, 1.0, "1.5 days ago, wanted <= 1 days"),
        (0.5, float("nan"), "0.5 days ago"),
        (-2.0, 180.0, "2.0 days from now; check the computer's clock"),
    ],
)
def test_age(days: float, limit: float, part: str) -> None:
    with pytest.raises(Unfit, match=part.replace(".", r"\.")):
        check_fitness(aged(days), NOW, max_age_days=limit)


def test_a_date_that_is_none() -> None:
    with pytest.raises(Unfit, match="'yesterday' for when it was written"):
        check_fitness(calibration(written="yesterday"), NOW)


def test_another_cell() -> None:
    with pytest.raises(Unfit, match="digest dddddddddddd, the cell given has eeeeeeeeeeee"):
        check_fitness(aged(1), NOW, digest="e" * 64)


@pytest.mark.parametrize("temperature_c", [19.9, 25.1, float("nan")])
def test_temperature(temperature_c: float) -> None:
    with pytest.raises(Unfit, match=r"is not within 2 K of the calibrated 22\.0 \.\. 23\.0 C"):
        check_fitness(aged(1), NOW, temperature_c=temperature_c)


def test_a_temperature_cannot_be_compared_with_none() -> None:
    values = msgspec.to_builtins(aged(1))
    values["validity"]["temperature_c"] = None
    without = msgspec.convert(values, Calibration)
    check_fitness(without, NOW)
    with pytest.raises(Unfit, match=r"22\.0 C cannot be compared: .* no weather station"):
        check_fitness(without, NOW, temperature_c=22.0)


def test_an_unproven_sign() -> None:
    with pytest.raises(Unfit, match="its sign check did not hold, or was not made"):
        check_fitness(aged(1, sign_checked=False), NOW)


def test_all_reasons_at_once() -> None:
    with pytest.raises(Unfit) as told:
        check_fitness(aged(400, sign_checked=False), NOW, digest="e", temperature_c=40.0)
    assert len(str(told.value).split("\n")) == 5
