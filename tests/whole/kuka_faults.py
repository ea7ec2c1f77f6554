"""Faults of a KUKA that end a run by whichever wire, with their alarms and usual values."""

from __future__ import annotations

KUKA_ENDS: dict[str, tuple[str, object]] = {
    "robot.wrong_identity": ("HC-B05", "#KR6"),
    "robot.e_stop": ("HC-B10", True),
    "robot.stopmess": ("HC-B14", True),
    "robot.mode_t1": ("HC-B12", True),
    "robot.override_zero": ("HC-B16", True),
    "robot.deselected": ("HC-B15", True),
    "robot.wrong_tool": ("HC-B07", 2),
    "robot.wrong_base": ("HC-B07", 3),
    "robot.softlimit": ("HC-B20", True),
    "robot.stops_short": ("HC-B24", 1.0),
    "robot.frozen": ("HC-B23", True),
    "robot.idle_close": ("HC-B02", True),
    "robot.tag_mismatch": ("HC-B02", True),
    "robot.no_reply": ("HC-B02", True),
    "robot.half_open": ("HC-B02", True),
    "robot.bad_number": ("HC-B26", "NaN"),
    "robot.ack_previous": ("HC-B23", True),
}
