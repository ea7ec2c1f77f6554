"""Times of day as people read them: their own zone, and UTC beside it."""

from __future__ import annotations

from datetime import timedelta, timezone

import pytest

from hilcell.journal.times import in_zone, local_words, span_words, time_words, zone_of

T = "2026-03-04T23:30:05.250+00:00"
INDIA = timezone(timedelta(hours=5, minutes=30))


@pytest.mark.parametrize(
    ("offset_min", "local", "both"),
    [
        (0, "23:30:05 UTC", "23:30:05 UTC"),
        (60, "00:30:05 UTC+01:00", "00:30:05 UTC+01:00, 23:30:05 UTC"),
        (-210, "20:00:05 UTC-03:30", "20:00:05 UTC-03:30, 23:30:05 UTC"),
    ],
)
def test_a_time_has_its_zone_and_utc_beside_it(offset_min: int, local: str, both: str) -> None:
    zone = zone_of(offset_min)
    assert (local_words(T, zone), time_words(T, zone)) == (local, both)


def test_a_day_is_that_of_the_zone() -> None:
    assert in_zone(T, INDIA).date().isoformat() == "2026-03-05"
    later = "2026-03-05T00:10:00.000+00:00"
    assert span_words(T, later, zone_of(0)) == "2026-03-04 23:30:05 to 2026-03-05 00:10:00 UTC"
    assert span_words(T, later, INDIA) == (
        "2026-03-05 05:00:05 to 05:40:00 UTC+05:30 (23:30:05 to 00:10:00 UTC)"
    )
