"""By how much the tool was turned from its nominal orientation, before and after."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np

from hilcell.calibration.decision import outcome_of
from hilcell.calibration.errors import OTHERS, places
from hilcell.calibration.orientation import Turned, validated_turns
from hilcell.geometry.sequential import Outcome
from hilcell.geometry.statistics import Figures
from hilcell.journal.ways_sent import BOTH, Sent
from hilcell.present.table import Column, Table, Value
from hilcell.report.drawings.paper_figures import series_name
from hilcell.report.facts import Facts
from hilcell.report.first_page import judged_places

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


class Result(NamedTuple):
    """The largest error of orientation that was judged, deg; None where it is not known."""

    name: str
    limit_deg: float
    before_deg: float | None
    after_deg: float
    U_deg: float

    @property
    def outcome(self) -> Outcome:
        """Return whether it keeps the limit, by the decision rule."""
        return outcome_of(self.after_deg, self.limit_deg, self.U_deg)


RESULTS: tuple[Column[Result], ...] = (
    Column("orientation of the tool", attrgetter("name")),
    Column("limit", attrgetter("limit_deg"), "°", ".3f"),
    Column("before", attrgetter("before_deg"), "°", ".4f"),
    Column("after", attrgetter("after_deg"), "°", ".4f"),
    Column("U", attrgetter("U_deg"), "°", ".4f"),
    Column("after may be at most", lambda row: row.limit_deg - row.U_deg, "°", ".4f"),
)


def results_sheet(facts: Facts) -> Table:
    """Return the orientation nearest to its limit, where one is stated, for the first page."""
    verdict = Column[Result](
        "verdict", lambda row: facts.outcome_words(row.outcome), form="s"
    )  # fmt: skip
    return Table((*RESULTS, verdict), _worst(facts), "Results, orientation at the worst station")


def _worst(facts: Facts) -> list[Result]:
    turns = {name: each.turn for name, each in judged_places(facts).items()}
    known = {name: turn for name, turn in turns.items() if turn is not None}
    limit_deg = facts.cell.validation.max_tolerance_deg
    if not known or limit_deg is None:
        return []
    place = max(known, key=lambda name: np.nan_to_num(known[name].max_deg, nan=np.inf))
    before = validated_turns(facts.log, [place]).get(Sent.BEFORE)
    before_deg = None if before is None else before.figures["max_deg"]
    return [Result(f"Largest at {place}", limit_deg, before_deg, *known[place])]


def oriented(facts: Facts) -> Iterator[tuple[str, Sent, Turned]]:
    """Yield place, way of sending and errors of each series of targets that had an orientation."""
    for place, stations in places(facts.cell).items():
        name = "others together" if place == OTHERS else place
        for how, turned in validated_turns(facts.log, stations).items():
            yield name, how, turned


def orientation(facts: Facts) -> Table:
    """Return by how much the tool was turned from its nominal orientation, before and after."""
    rows, last, noise_deg = list[Oriented](), "", 0.0
    for name, how, turned in oriented(facts):
        noise_deg = max(noise_deg, turned.noise_deg)
        shown = "" if name == last else name
        rows.append((shown, series_name(how, facts), len(turned), turned.figures))
        last = name
    note = (
        "The tool's pose is the rigid fit of its reflectors, where they were found on the flange; "
    )
    note += "about axis 6 it counts from the controller's zero. Error: the angle of one rotation; "
    note += "of a target measured again the larger one counts. The angles are measured: they have "
    note += f"the readings' noise in, up to {noise_deg:.4f}° (root mean square). The 95 % bound of "
    note += "a target in use is of the true angle, without that noise."
    becomes = facts.log.verdicts.get("fit", {}).get("orientation")
    return Table(ORIENTATION, rows, "Orientation", f"{note} Orientation {becomes}.")


def orientation_words(facts: Facts) -> str:
    """Return the figures at the grid's station in a sentence; "" where none were measured."""
    here = facts.cell.grid.station
    turns = validated_turns(facts.log, [here])
    if not set(BOTH) <= turns.keys():
        return ""
    before, after = (turns[how].figures for how in BOTH)
    means, most = (
        f"{before[name]:.4f}° before and {after[name]:.4f}° after"
        for name in ("mean_deg", "max_deg")
    )
    count = len(turns[Sent.CHOSEN])
    return (
        f"The tool was turned from its nominal orientation by {means} in the mean, at most {most} "
        f"({count} targets at {here})."
    )
