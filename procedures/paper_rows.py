"""The paper's figures beside ours, row by row, each with the criterion by which it holds.

A row that the cell file or the simulated machine brings about says "set": it cannot fail, and
nothing is proved by it. Every other row names a mistake that fails it (`Row.fails`); a test
commits that mistake. Where the limit is no figure of the paper, `paper_limits` gives its reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hilcell.journal.log import Log
from hilcell.model.point import Sent
from hilcell.model.results import PaperRow
from procedures import paper_figures as figures
from procedures import paper_limits as limits
from procedures.paper_figures import Experiments, Figure, Where, mean, place, reduction
from procedures.paper_limits import Limit, at_most, between, stations_planned


@dataclass(frozen=True, slots=True)
class Row:
    """One figure: its name, the paper's value, its unit, where ours is found, when it holds.

    ``set_by`` names the cause of the figure; a machine sets it only if it is simulated. ``chosen``
    is the same figure of the correction that was chosen instead of the paper's; it is not judged.
    """

    name: str
    paper: float | None
    unit: str
    here: Figure
    limits: Limit
    fails: str = ""
    set_by: Literal["", "cell file", "simulation"] = ""
    chosen: Figure | None = None

    def judged(self, log: Log, result: Experiments) -> PaperRow:
        """Return the row as it is reported."""
        here = float(self.here(log, result))
        low, high = self.limits(log, result)
        is_set = self.set_by == "cell file" or (bool(self.set_by) and log.inputs.simulated)
        return PaperRow(
            row=self.name,
            paper=self.paper,
            here=here,
            chosen=None if self.chosen is None else self.chosen(log, result),
            unit=self.unit,
            holds=is_set or bool(low <= here <= high),
            set=is_set,
            criterion=self.set_by if is_set else criterion(low, high),
            fails="" if is_set else self.fails,
        )


def criterion(low: float, high: float) -> str:
    """Return the criterion in words."""
    if low == high:
        return f"= {low:.4g}"
    if np.isinf(high):
        return f">= {low:.4g}"
    if np.isinf(low):
        return f"<= {high:.4g}"
    return f"{low:.4g} .. {high:.4g}"


def largest(where: Where, how: Sent) -> Figure:
    """Return the largest error of targets that were sent in one way."""
    return lambda log, result: place(log, result, where).sent[how].max


def by_cell(name: str, paper: float, here: Figure) -> Row:
    """Return a row whose count stands in the cell file."""
    return Row(name, paper, "", here, between(paper, paper), set_by="cell file")


ROWS = (
    Row(
        "fig1.error.max", 0.5, "mm", lambda log, r: r.rail_survey.max_error_mm,
        between(0.3, 0.7),  # one of the two ways has the backlash of 0.2 more than the other
        "the way back is read in the order of the way there",
    ),
    Row(
        "fig1.backlash", 0.2, "mm", lambda log, r: r.rail_survey.backlash_mm.value,
        between(0.15, 0.25),  # "about 0.2", to its digit
        "the way back is approached from the same side as the way there",
    ),
    Row(
        "fig2.stations", 3, "", lambda log, result: stations_planned(log.cell),
        limits.by_every_set,
        "every hole takes its closest station, also where fewer stations reach all holes",
    ),
    Row(
        "eq1-7.jacobian", None, "", figures.jacobian_error,
        at_most(1e-6),  # of central differences, relative
        "a link's error stays in its own frame, or R_T d^n is left out (eq 6)",
    ),
    Row(
        "eq8.similarity", None, "", figures.similarity_rank, limits.beyond_chance,
        "errors are paired with the joints of other vertices",
    ),
    Row(
        "eq9.weights", None, "mm", figures.interpolation_off_mm,
        at_most(0.001),  # the tracker's resolution
        "the nearest 8 of the whole grid are taken instead of the cell's 8, or weights 1/d^2",
    ),
    Row(
        "sec3.3.sign", None, "", lambda log, r: r.sign.ratio, limits.sign_residual,
        "the error is added instead of subtracted, or half of it is taken off",
    ),
    Row(
        "eq13-17.transfer", None, "mm", lambda log, result: figures.transfer(log, result)[0],
        limits.transfer_expanded,
        "the slide is shifted by the strip's travel alone, or eq 17's factors are exchanged",
    ),
    Row(
        "fig6.circle.rms", None, "mm",
        lambda log, result: max(result.base.circle_rms_mm), limits.circle_residual,
        "another axis still moves when a point of a sweep is measured",
    ),
    Row(
        "fig7.tool.u", None, "mm",
        lambda log, r: max(each.tool_uncertainty_mm for each in r.stations.values()),
        limits.rigid_slide,
        "a nest that was moved between two stations stays in the fit",
    ),
    Row(
        "fig8.ratio", 4, "", lambda log, r: r.frame_repeatability.ratio, limits.better_at_all,
        "the station's frame is built from the robot's circles, or frames are exchanged",
    ),
    Row(
        "fig10.strip.range", 0.035, "mm", lambda log, r: r.station_repeatability.strip.range_mm,
        at_most(0.035),
        "the loop of the strip is off",
    ),
    Row(
        "fig10.plain.range", 0.2, "mm", lambda log, r: r.station_repeatability.plain.range_mm,
        limits.plain_range,
        "all approaches come from one side, so that backlash is not seen",
    ),
    by_cell("fig10.repeats", 15, lambda log, r: r.station_repeatability.repeats),
    Row(
        "sec5.1.temperature.min", 22, "C", figures.lowest_temperature, between(21.9, 24.1),
        "the laboratory is not the paper's", "simulation",
    ),
    Row(
        "sec5.1.temperature.max", 24, "C", figures.highest_temperature, between(21.9, 24.1),
        "the laboratory is not the paper's", "simulation",
    ),
    Row(
        "sec5.1.tracker", 0.015, "mm", figures.nests_moved_mm, at_most(0.015),
        "single readings are taken instead of means, or the tracker moved during the run",
    ),
    by_cell("fig11.vertices", 64, lambda log, r: r.points["grid"]),
    by_cell("fig11.cells", 27, figures.cells),
    by_cell("fig12.targets", 135, lambda log, r: place(log, r, "reference").points),
    Row(
        "fig12.before.mean", 1.2092, "mm", mean("reference", Sent.BEFORE),
        between(1.09, 1.33), "the robot is not the paper's", "simulation",
    ),
    Row(
        "fig12.after.mean", 0.1168, "mm", mean("reference", Sent.IDW),
        limits.as_cross_validated,
        "the correction is not sent, has the wrong sign or two axes exchanged",
        chosen=mean("reference", Sent.CHOSEN),
    ),
    by_cell("fig13.targets", 150, lambda log, r: place(log, r, "others").points),
    Row(
        "fig13.before.mean", 1.2511, "mm", mean("others", Sent.BEFORE),
        limits.same_robot,
        "targets are placed by the cell file's base instead of the measured frames",
    ),
    Row(
        "fig13.after.mean", 0.16, "mm", mean("others", Sent.IDW), limits.transferred,
        "targets or measured data are carried by the strip's travel alone",
        chosen=mean("others", Sent.CHOSEN),
    ),
    Row(
        "abstract.before.max", 2.0, "mm", largest("reference", Sent.BEFORE),
        between(1.2, 2.4), "the robot is not the paper's", "simulation",
    ),
    Row(
        "abstract.after.max", 0.3, "mm", largest("reference", Sent.IDW),
        limits.largest_of_many,
        "one target is sent without its correction, or one vertex is wrong by 2 mm",
        chosen=largest("reference", Sent.CHOSEN),
    ),
    Row(
        "abstract.reduction.reference", 0.90, "", reduction("reference"),
        limits.reduced("reference"),
        "a part of the correction is lost; or squares are averaged, which beats the floor",
        chosen=reduction("reference", Sent.CHOSEN),
    ),
    Row(
        "abstract.reduction.others", 0.87, "", reduction("others"), limits.reduced("others"),
        "a part of the correction is lost on the way to another station",
        chosen=reduction("others", Sent.CHOSEN),
    ),
)  # fmt: skip
