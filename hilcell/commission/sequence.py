"""The steps of commissioning, in sequence."""

from __future__ import annotations

from typing import NamedTuple

from hilcell.commission.cell_text import CellText

ABILITIES = "abilities"
LACKS = ("has not", "read only")  # states of an ability that a person should see


class Step(NamedTuple):
    """One step; ``procedure``: of its run, "" for one without a run. ``confirms``: a fact that only
    a person sees, asked before the run. ``of_rail``: left out where the cell has no rail.
    ``pulls``: the device whose cable a person pulls meanwhile; such a step may be put off.
    """

    name: str
    title: str
    procedure: str = ""
    confirms: str = ""
    of_rail: bool = False
    pulls: str = ""


STEPS = (
    Step("devices", "which devices there are"),
    Step(ABILITIES, "what the devices can"),
    Step(
        "controller",
        "settings of the robot's controller, the safe pose",
        "commission-controller",
        "the present pose of the robot becomes its safe pose; is it clear of everything, along the "
        "whole rail if there is one?",
    ),
    Step(
        "rail",
        "signs, scales, speed and stop of the rail, small first",
        "commission-rail",
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
