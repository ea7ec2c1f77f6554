"""A total station in the place of the laser tracker: what a cell file says of it."""

from __future__ import annotations

TOTAL_STATION = {
    "tracker.driver": "leica-geocom",
    "tracker.max_std_mm": "3.0",
    "tracker.samples": "4",
    "base_frame.points": "24",
    "tracker.options.temperature_c": "23.0",
    "tracker.options.pressure_mbar": "1009.0",
    "uncertainty.tracker_limit_mm": "0.3",
    "uncertainty.tracker_limit_um_m": "2.0",
    "layout.max_tool_std_mm": "1.0",
    "validation.mean_tolerance_mm": "2.0",
    "validation.max_tolerance_mm": "4.0",
}
