"""Keys in texts of alarms and events become words; times of day are as people read them."""

from __future__ import annotations

from datetime import timedelta, timezone
from pathlib import Path

import msgspec
import pytest

from hilcell.cell.file import load_cell
from hilcell.journal.labels import (
    event_label,
    in_zone,
    local_time_text,
    period_text,
    time_text,
    with_labels,
    zone_of,
)
from hilcell.journal.log import Log
from hilcell.journal.runs import read_log
from hilcell.model.events import StationAlreadyHeld
from tests.hilcell.report.journals import Writer
from tests.hilcell.tui.sample_runs import measuring


@pytest.fixture(scope="module")
def log() -> Log:
    """Return the log of a run on its grid."""
    return Log(measuring().records)


def test_keys_become_words(log: Log) -> None:
    known = {
        "Tracker: measure grid/1-0-0": "Tracker: measure grid point 1-0-0 at S1100",
        "measure world/F1: no beam": "measure floor nest F1: no beam",
        "measure validate/S300/chosen/049/seat2.": ("measure corrected target 50, seat 2 at S300."),
        "Cell: verdict validation.S1900": "Cell: validation at S1900",
        "read at 20 mm/s in /tmp/grid/1-0-0": "read at 20 mm/s in /tmp/grid/1-0-0",
    }
    assert {text: with_labels(text, log) for text in known} == known


@pytest.mark.parametrize("text", ["grid/", "grid//", "sign/x/seat2", "held/", "grid/\u00b2-1-1"])
def test_a_key_of_no_known_form_is_no_error(log: Log, text: str) -> None:
    assert with_labels(text, log)
    assert with_labels(text, Log())


def test_a_robot_on_the_floor_has_no_rail_that_was_held(tmp_path: Path) -> None:
    held = StationAlreadyHeld(station="S1")
    assert event_label(held, read_log(Writer(tmp_path / "a").left())) == "rail found held at S1"
    on_floor = msgspec.to_builtins(load_cell("fixed"))
    assert event_label(held, read_log(Writer(tmp_path / "b", cell=on_floor).left())) == ""


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
    assert (local_time_text(T, zone), time_text(T, zone)) == (local, both)


def test_a_day_is_that_of_the_zone() -> None:
    assert in_zone(T, INDIA).date().isoformat() == "2026-03-05"
    later = "2026-03-05T00:10:00.000+00:00"
    assert period_text(T, later, zone_of(0)) == "2026-03-04 23:30:05 to 2026-03-05 00:10:00 UTC"
    assert period_text(T, later, INDIA) == (
        "2026-03-05 05:00:05 to 05:40:00 UTC+05:30 (23:30:05 to 00:10:00 UTC)"
    )
