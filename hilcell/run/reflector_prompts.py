"""Questions to the operator when the tracker sees no reflector: where it belongs, in words."""

from __future__ import annotations

from hilcell.cell.file import Cell
from hilcell.ports import Array, NoReading
from hilcell.run.prompts import Prompt

FLANGE = "flange"


def where(cell: Cell, place: str) -> str:
    """Return where a nest is, for a person who looks for it."""
    layout = cell.layout
    for nests, on in ((layout.floor, "floor"), (layout.bar, "bar"), (layout.slide, "slide")):
        for nest in nests:
            if nest.name == place:
                frame = "nominal {B}" if on == "slide" else "{W}"
                at = f"x {nest.x_mm:.0f}, y {nest.y_mm:.0f}, z {nest.z_mm:.0f} mm in {frame}"
                return f"nest {place} on the {on}, {at}"
    if place == FLANGE:
        return "the nest on the robot's flange"
    seat = place.removeprefix(f"{FLANGE} ")
    return f"reflector {seat} on the robot's flange" if seat != place else f"reflector {place}"


def seat_prompt(cell: Cell, place: str, at: str, expected_mm: Array, limit_mm: float) -> Prompt:
    """Return what is asked before ``place`` is measured while the reflector is ``at`` another."""
    x, y, z = (round(float(value), 3) for value in expected_mm)
    take = f"Take the reflector from {where(cell, at)} and" if at else "Take the reflector and"
    on = "on the flange" if place == FLANGE else f"in {place}"
    return Prompt(
        title=f"Seat the reflector {on}",
        text=f"{take} seat it in {where(cell, place)}. The robot rests at its safe pose, the "
        "slide is held.",
        place=place,
        expected_mm=(x, y, z),
        limit_mm=limit_mm,
        reason=f"{place} is to be measured, the reflector is {at or 'nowhere'}",
    )


def beam_prompt(
    cell: Cell, key: str, place: str, near_mm: Array, limit_mm: float, error: NoReading
) -> Prompt:
    """Return what is asked when the tracker gives no good reading of a reflector.

    The error's own advice goes first: a driver knows best, and not every cause is in the beam.
    """
    x, y, z = (round(float(value), 3) for value in near_mm)
    advice = f"{error.act[:1].upper()}{error.act[1:]}. " if error.act else ""
    return Prompt(
        title=f"No good reading of {place}",
        text=f"{error.summary}, at {where(cell, place)}. {advice}See that nothing is in the line "
        "of sight, and that the reflector is clean and sits well.",
        place=place,
        expected_mm=(x, y, z),
        limit_mm=limit_mm,
        reason=f"{key}: {error.summary}",
    )
