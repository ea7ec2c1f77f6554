"""The paper's own figures, redrawn from one run: errors target by target, and their similarity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hilcell.calibration.grid import binned, grid_pairs
from hilcell.calibration.position_errors import Errors, places, validation
from hilcell.model.point import Sent
from hilcell.model.verdicts import OTHERS
from hilcell.report.drawings.figures import (
    COLOURS,
    MUTED,
    Drawn,
    NamedFigure,
    axes_grid,
    legend_above,
    scatter,
)
from hilcell.report.facts import Facts

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True)
class PaperFigures:
    """The figures of one run, by name and title; None for one without data."""

    facts: Facts

    def listed(self) -> list[NamedFigure]:
        return [
            ("targets", "Error at each target, station of the grid (Fig 12)", self.grid_targets),
            ("transferred", "Error at each target, other stations (Fig 13)", self.other_targets),
            ("similarity", "Similarity of errors (eq 8)", self.similarity),
        ]

    def grid_targets(self) -> Drawn | None:
        facts = self.facts
        log = facts.log
        series = validation(log, [facts.cell.grid.station])
        paper = "The paper: mean 1.2092 mm before, 0.1168 mm after (135)."
        return self._targets(series, paper)

    def other_targets(self) -> Drawn | None:
        facts = self.facts
        stations = places(facts.cell).get(OTHERS) or list(places(facts.cell))[1:]
        series = validation(facts.log, stations)
        words = f"Stations {' and '.join(stations)}, corrected by data transferred to them. "
        paper = "The paper: mean 1.2511 mm before, 0.1600 mm after (150)."
        return self._targets(series, words + paper)

    def _targets(self, series: Mapping[Sent, Errors], caption: str) -> Drawn | None:
        if not series:
            return None
        figure, axes = axes_grid(2.6)
        ax: Axes = axes[0, 0]
        for how, errors in series.items():
            scatter(ax, how, errors.norms_mm, self.facts.series_name(how))
            mean_mm, colour = errors.figures.mean, COLOURS[how]
            ax.axhline(mean_mm, color=colour, linewidth=0.8, linestyle=(0, (4, 2)))
            if how != Sent.IDW:  # it would lie on the other mean
                ax.text(1.008, mean_mm, f"{mean_mm:.3f}", color=colour, va="center", fontsize=7.5,
                        transform=ax.get_yaxis_transform())  # fmt: skip
        ax.set_xlim(0, max(len(errors) for errors in series.values()) + 1)
        ax.set_ylim(bottom=0.0)
        ax.set(xlabel="target", ylabel="3D error, mm")
        legend_above(ax)
        return figure, "Dashed lines: means. " + caption

    def similarity(self) -> Drawn | None:
        facts = self.facts
        known = facts.log.frames.keys() | facts.log.verdicts.keys()
        if not {"base", "fit"} <= known:
            return None
        pairs = grid_pairs(facts.log)
        count = len(pairs.difference_mm)
        # each dot is an element of the page: a picture of them its policy would block
        pairs_drawn = 500
        every = max(1, count // pairs_drawn)
        figure, axes = axes_grid(2.6, 1, 2, sharey=True)
        for ax, distance, name in (
            (axes[0, 0], np.degrees(pairs.joint_rad), "distance of joints, deg"),
            (axes[0, 1], pairs.cartesian_mm, "distance of vertices, mm"),
        ):
            ax.plot(distance[::every], pairs.difference_mm[::every], ".", color=MUTED, alpha=0.35,
                    markersize=2, label="a pair of vertices")  # fmt: skip
            edges = np.linspace(0.0, distance.max(), 13)
            middles, means, _ = binned(distance, pairs.difference_mm, edges)
            ax.plot(middles, means, color=COLOURS[Sent.CHOSEN], label="mean")
            ax.set_xlabel(name)
        axes[0, 0].set_ylabel("difference of errors, mm")
        legend_above(axes[0, -1])
        return figure, (
            "The similarity of eq 8 is one over this difference: near joints have like errors. "
            "Over one orientation of the tool the distance of the vertices says the same. "
            f"Shown: {len(range(0, count, every))} of {count} pairs; the mean is of all."
        )
