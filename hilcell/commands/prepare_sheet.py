"""Words and figures of the sheet that ``prepare`` writes for the shop floor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from hilcell.calibration.form import Validity
from hilcell.calibration.influence import NoBound
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.cell.file import Cell
from hilcell.commands.files import drill_mm_of
from hilcell.commands.prepared import Prepared
from hilcell.commands.released import Released
from hilcell.errors import bounded
from hilcell.geometry.statistics import lengths_mm
from hilcell.report.sheet import Sheet, SheetHole, SheetStation

SHEET = "sheet.html"
TRUE_ANGLE = "of the true angle; a measured one has the readings' noise, too"
INVALID = (
    "a collision, a new mastering, an exchanged motor, gear, drill spindle or reflector mount",
    "the rail, the strip or its head was moved, or the slide does not come to its strip reading",
    "the part or the floor was moved: {W} is no longer where it was",
    "the calibration was revoked or superseded since: `hilcell runs` says so",
    "a re-check (`hilcell run recheck`) that does not say valid",
    "tool, base, approach or points of a program were changed by hand",
)


def sheet_of(
    found: Released,
    cell: Cell,
    source: str,
    max_age_days: float,
    temperature_c: float | None,
    stations: Sequence[Prepared],
    twins: Sequence[str],
) -> Sheet:
    """Return the sheet of stations in order of visit; holes come from the file ``source``.

    ``twins`` are the warnings of holes that are listed twice.
    """
    made, validity = found.calibration.provenance, found.calibration.validity
    until = _until(made.written, max_age_days)
    air = _air(validity, temperature_c)
    count = sum(len(each.plan.holes) for each in stations)
    places = "station" if len(stations) == 1 else "stations"
    drill_mm = drill_mm_of(cell)
    at = "the reflector's centre"
    if drill_mm is not None:
        at = f"the drill, ({' '.join(f'{each:g}' for each in drill_mm)}) mm from the reflector"
    facts = [
        ("Holes", source),
        ("Cell", f"{cell.name}, serial {cell.serial}, robot {cell.robot.name}"),
        ("Calibration", f"{made.named}, written {_local(made.written)}"),
        ("Standing", _standing(found)),
        ("Use until", f"{until}, {max_age_days:g} days after it was written"),
        ("Air", air),
        ("Orientation", f"as calibrated, within {validity.orientation_tolerance_deg:g}°"),
        ("Bounds hold at", at),
        ("Prepared", f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"),
    ]
    if any(each.turns_deg is not None for each in stations):
        facts.append(("Bounds in degrees", TRUE_ANGLE))
    refusals = [each.bounds.reason for each in stations if isinstance(each.bounds, NoBound)]
    return Sheet(
        title=f"Drilling sheet: {count} hole{'s' * (count != 1)} at {len(stations)} {places}",
        simulated=made.simulated,
        has_rail=cell.has_rail,
        facts=facts,
        checks=list(_checks(cell, air)),
        stations=[_station(cell, each) for each in stations],
        no_bounds=refusals[0] if refusals else "",
        warnings=[
            *(note for note in found.notes() if "SIMULATED" not in note),
            *bounded(twins),
        ],
        invalid=[f"air outside of {air}", f"the time after {until}", *INVALID],
        footer=f"calibration {made.latest}, holes {source}",
    )


def _station(cell: Cell, each: Prepared) -> SheetStation:
    nominal, bounds_mm = each.plan.poses[:, :3], each.bounds95_mm
    turns_deg = None if each.turns_deg is None else each.turns_deg.tolist()
    moved_mm = lengths_mm(each.command[:, :3] - nominal).tolist()
    holes = [
        SheetHole(
            name,
            (x, y, z),
            moved_mm[n],
            None if bounds_mm is None else bounds_mm[n],
            None if turns_deg is None else turns_deg[n],
        )
        for n, (name, (x, y, z)) in enumerate(zip(each.plan.holes, nominal.tolist(), strict=True))
    ]
    station = each.plan.station
    return SheetStation(
        station.name, station.rail_mm, station.strip_mm, cell.rail.strip_tolerance_mm,
        next((Path(name).stem for name in each.program), each.file), [*each.program, each.file],
        holes,
    )  # fmt: skip


def _standing(found: Released) -> str:
    if found.accepted:
        return f"{found.stands}; OUT OF TOLERANCE, accepted"
    return "not known to be current" if found.standing is None else found.standing.text


def _checks(cell: Cell, air: str) -> Iterator[str]:
    """Yield what is ticked before the first hole."""
    yield "The right cell, robot and part; the part clamped, its place in {W} as it was planned"
    yield "Tool and drill as in the cell file; the drill is drawn back while the robot moves"
    yield f"Air at the cell {air}"
    if cell.has_rail:
        yield (
            f"At each station: robot at its safe pose, slide moved, held, strip within "
            f"{cell.rail.strip_tolerance_mm:g} mm, then the station's own program"
        )
    yield "Programs copied to the controller as they are, all files of a station together"
    yield "First hole of each station at reduced speed, a hand at the emergency stop"


def _air(validity: Validity, temperature_c: float | None) -> str:
    """Return the temperatures at which the bounds hold."""
    if validity.temperature_c is None:
        return "not measured by the calibration"
    low_c, high_c = validity.temperature_c
    allowed = f"{low_c - TEMPERATURE_MARGIN_K:.1f} to {high_c + TEMPERATURE_MARGIN_K:.1f} °C"
    return allowed if temperature_c is None else f"{allowed}, bounds for {temperature_c:.1f} °C"


def _until(written: str, max_age_days: float) -> str:
    """Return the last day of use; days beyond any calendar are no limit."""
    try:
        last = _time(written) + timedelta(days=max_age_days)
    except OverflowError:
        return "any day"
    return f"{last.astimezone():%Y-%m-%d}"


def _local(written: str) -> str:
    return f"{_time(written).astimezone():%Y-%m-%d %H:%M %Z}"


def _time(written: str) -> datetime:
    return datetime.strptime(written, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
