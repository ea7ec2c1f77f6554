"""The closed loop of section 4.3: the slide is brought to the strip's recorded reading.

The trap: the drive's encoder is blind to backlash. So the last motion always comes from the same
side, and only the strip, read at rest, says where the slide is.
"""

from __future__ import annotations

from dataclasses import dataclass

from hilcell.cell.file import RailTable, Station
from hilcell.ports import DeviceError, Rail, RailReading, StripLost


@dataclass(frozen=True, slots=True)
class Approach:
    """A held station: the reading at rest and how many approaches it took."""

    station: str
    reading: RailReading
    tries: int


def approach_station(rail: Rail, table: RailTable, station: Station) -> Approach:
    """Bring the slide to ``station`` from below; raises `DeviceError` when it does not hold.

    Raises `StripLost` for a strip that does not follow at all. Every approach must shrink the
    error; the side of approach never changes.
    """
    command_mm = station.rail_mm
    error_mm = float("inf")
    for tries in range(1, table.max_approaches + 1):
        before = _back_off(rail, table, command_mm)
        rail.move_to(command_mm)
        reading = rail.settle()
        _check_strip_follows(table, station, before, reading)
        found_mm = station.strip_mm - reading.strip_mm
        if abs(found_mm) <= table.strip_tolerance_mm + 1e-9:
            return Approach(station.name, reading, tries)
        if not abs(found_mm) < abs(error_mm):
            break
        error_mm = found_mm
        command_mm += found_mm
    raise DeviceError(
        "HC-S04",
        "Rail",
        f"station {station.name} not held",
        f"strip {reading.strip_mm:.2f} mm",
        wanted=f"{station.strip_mm:.2f} +-{table.strip_tolerance_mm:.2f} mm in {tries} approaches",
        act="check the strip head and the slide's friction, then resume",
        fields={
            "station": station.name,
            "strip_mm": reading.strip_mm,
            "wanted_mm": station.strip_mm,
            "tolerance_mm": table.strip_tolerance_mm,
            "tries": tries,
        },
    )


def _back_off(rail: Rail, table: RailTable, command_mm: float) -> RailReading:
    rail.move_to(command_mm - table.back_off_mm)
    return rail.settle()


def _check_strip_follows(
    table: RailTable, station: Station, before: RailReading, reading: RailReading
) -> None:
    motor_mm = abs(reading.position_mm - before.position_mm)
    strip_mm = abs(reading.strip_mm - before.strip_mm)
    if motor_mm > 0.4 and not strip_mm > 0.0:
        raise StripLost(
            "HC-S02",
            "Rail",
            f"approach of {station.name}",
            f"strip frozen at {reading.strip_mm:.2f} mm while the drive moved {motor_mm:.2f} mm",
            act="check the strip head and its cable",
            fields={"station": station.name, "strip_mm": reading.strip_mm, "moved_mm": motor_mm},
        )
    slip_mm = reading.position_mm - reading.strip_mm
    if not abs(slip_mm) <= table.slip_limit_mm:
        raise DeviceError(
            "HC-S03",
            "Rail",
            f"approach of {station.name}",
            f"drive {reading.position_mm:.2f} mm and strip {reading.strip_mm:.2f} mm differ",
            wanted=f"<= {table.slip_limit_mm:.2f} mm apart",
            act="the slide slipped or this is another station; home and check the coupling",
            fields={
                "station": station.name,
                "drive_mm": reading.position_mm,
                "strip_mm": reading.strip_mm,
                "limit_mm": table.slip_limit_mm,
            },
        )
