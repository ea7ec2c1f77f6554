"""The rail's table in the cell file is strict."""

from __future__ import annotations

import pytest

from drivers.canopen.rail import CanopenRail
from hilcell.cell.settings import SettingsError, convert


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"drive_node": 6}, "must differ"),
        ({"travel_max_mm": -1.0}, "travel_min_mm must be below"),
        ({"counts_per_mm": 1e9}, "does not fit 32 bits"),
        ({"interface": "virtual"}, "interface"),
        ({"strip_counts": 1}, "did you mean"),
        ({"standstill_window_mm": 1000.0}, "standstill_window_mm.*allowed: >= 0.001, <= 0.1"),
        ({"standstill_window_mm": 1e-9}, "standstill_window_mm.*allowed"),
        ({"standstill_speed_mm_s": 1e9}, "standstill_speed_mm_s.*allowed: >= 0.01, <= 5"),
        ({"standstill_speed_mm_s": 1e-9}, "standstill_speed_mm_s.*allowed"),
        ({"standstill_dwell_s": 0.0001}, "standstill_dwell_s.*allowed: >= 0.05, <= 5"),
    ],
)
def test_options_are_strict(changed: dict[str, object], message: str) -> None:
    values: dict[str, object] = {
        "channel": "can0",
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
    }
    with pytest.raises(SettingsError, match=message):
        convert(values | changed, CanopenRail.Options, "rail")
