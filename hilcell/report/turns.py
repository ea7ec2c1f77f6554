"""By how much the tool was turned from its nominal orientation, before and after."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import itemgetter

from hilcell.calibration.errors import OTHERS, places
from hilcell.calibration.orientation import Turned, validated_turns
from hilcell.geometry.statistics import Figures
from hilcell.report.columns import Column, Sheet, Value, sheet
from hilcell.report.drawings.paper_figures import series_name
from hilcell.report.facts import Facts

# A place, the way of sending, how many targets, their figures.
Oriented = tuple[str, str, int, Mapping[str, float]]


def _angle(figure: str) -> Callable[[Oriented], Value]:
    return lambda row: row[3][f"{figure}_deg"]


ORIENTATION: tuple[Column[Oriented], ...] = (
    Column("station", itemgetter(0)),
    Column("error", itemgetter(1)),
    Column("targets", itemgetter(2), form="d"),
    *(Column(name, _angle(name), "°", ".4f") for name in Figures._fields),
)


def oriented(facts: Facts) -> Iterator[tuple[str, str, Turned]]:
    """Yield place, way of sending and errors of each series of targets that had an orientation."""
    for place, stations in places(facts.cell).items():
        name = "others together" if place == OTHERS else place
        for how, turned in validated_turns(facts.log, stations).items():
            yield name, how, turned


def orientation(facts: Facts) -> Sheet | None:
    """Return by how much the tool was turned from its nominal orientation, before and after."""
    rows, last = list[Oriented](), ""
    for name, how, turned in oriented(facts):
        shown = "" if name == last else name
        rows.append((shown, series_name(how, facts), len(turned), turned.figures))
        last = name
    note = (
        "The tool's pose is the rigid fit of its reflectors, where they were found on the flange; "
    )
    note += "about axis 6 it counts from the controller's zero. Error: the angle of one rotation; "
    note += "of a target measured again the larger one counts."
    becomes = facts.log.verdicts.get("fit", {}).get("orientation")
    return sheet("Orientation", ORIENTATION, rows, f"{note} Orientation {becomes}.")


def orientation_words(facts: Facts) -> str:
    """Return the figures at the grid's station in a sentence; "" where none were measured."""
    here = facts.cell.grid.station
    turns = validated_turns(facts.log, [here])
    if not {"before", "chosen"} <= turns.keys():
        return ""
    before, after = (turns[how].figures for how in ("before", "chosen"))
    means, most = (
        f"{before[name]:.4f}° before and {after[name]:.4f}° after"
        for name in ("mean_deg", "max_deg")
    )
    count = len(turns["chosen"])
    return (
        f"The tool was turned from its nominal orientation by {means} in the mean, at most {most} "
        f"({count} targets at {here})."
    )
