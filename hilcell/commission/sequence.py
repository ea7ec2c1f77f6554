"""The steps of commissioning, in sequence."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hilcell.cell.file import Cell
from hilcell.commission.cell_text import CellText

ABILITIES = "abilities"
LACKS = ("has not", "read only")  # states of an ability that a person should see


class Step(NamedTuple):
    """One step; ``procedure``: of its run, "" for one without a run. ``confirms``: a fact that only
    a person sees, asked before the run; "" for none. ``of_rail``: left out without a rail.
    ``pulls``: the device whose cable a person pulls meanwhile; such a step may be put off.
    """

    name: str
    title: str
    procedure: str = ""
    confirms: Callable[[Cell], str] = lambda cell: ""
    of_rail: bool = False
    pulls: str = ""


def stands_clear(cell: Cell) -> str:
    along = "everything along the whole rail" if cell.has_rail else "everything"
    return f"the present pose of the robot becomes its safe pose; is it clear of {along}?"


def has_room(cell: Cell) -> str:
    """Return the question before the first motions of a slide whose place on its travel is open.

    An attempt that was broken off may have left it elsewhere than where the tape began.
    """
    if not (cell.has_rail and cell.rail.is_unplaced):
        return ""
    room_mm = (cell.rail.travel_max_mm - cell.rail.travel_min_mm) / 2.0
    return (
        f"the travel becomes {room_mm:.0f} mm each way from where the slide stands now: is it free "
        "for that, both ways? If not, delete rail.travel_min_mm from the cell file, and measure "
        "again by --only devices"
    )


def needs_no_volumes(cell: Cell) -> str:
    """Return the question to who has given no volumes."""
    if cell.keep_out or cell.volumes is not None:
        return ""
    return (
        "no keep-out volumes: runs keep to the grid's cube, no axis is swept, and the ripple of "
        "the gears stays in the error after correction; is that what you want?"
    )


STEPS = (
    Step("devices", "which devices there are"),
    Step(ABILITIES, "what the devices can"),
    Step(
        "controller",
        "settings of the robot's controller, the safe pose",
        "commission-controller",
        stands_clear,
    ),
    Step(
        "rail",
        "signs, scales, speed and stop of the rail, small first",
        "commission-rail",
        has_room,
        of_rail=True,
    ),
    Step(
        "self-stop",
        "the slide stops by itself when its cable is pulled",
        "commission-self-stop",
        of_rail=True,
        pulls="rail",
    ),
    Step("robot", "each axis by a degree", "commission-robot"),
    Step("tracker", "the tracker's pose, by the floor nests in any order", "commission-tracker"),
    Step("base", "the robot's base and the reflector on its flange", "commission-base"),
    Step("slide", "the nests on the slide", "commission-slide", of_rail=True),
    Step("stations", "the stations, by the strip", "commission-stations", of_rail=True),
    Step(
        "volumes",
        "the volumes that the arm keeps out of, by a list or by their corners",
        "commission-volumes",
        needs_no_volumes,
    ),
    Step(
        "proof",
        "a first pass, a correction that must go the right way, a stop",
        "commission-proof",
    ),
)
NAMES = [step.name for step in STEPS]


def steps_of(text: CellText) -> list[Step]:
    """Return the steps of a cell; a file with places and without [rail] has no rail."""
    has_rail = text.get("layout.base") is None or text.get("rail") is not None
    return [step for step in STEPS if has_rail or not step.of_rail]
