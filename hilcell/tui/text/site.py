"""The cell from above as a run knows it: where nests, rail, robot and tracker stand in {W}.

Places are the frozen cell's, frames those that the run has measured, nominal before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.calibration.frames import Frames
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log
from hilcell.ports import Array
from hilcell.run.protocol import PromptStatus
from hilcell.tui.engine.run_view import RunView

Place = tuple[float, float]  # x and y in {W}, mm


@dataclass(frozen=True, slots=True)
class Site:
    """Where things stand; ``nests`` are those of the wanted one's frame, ``done`` the measured."""

    nests: dict[str, Place]
    done: frozenset[str]
    wanted: str
    wanted_mm: Place
    robot_mm: Place
    tracker_mm: Place
    along: Place  # the rail's direction, of length 1; 0, 0 where there is none
    stations: dict[str, Place]


def site_of(view: RunView, prompt: PromptStatus) -> Site | None:
    """Return the places around what a prompt asks for; None where it has no place."""
    if prompt.expected_mm is None:
        return None
    log, layout = view.log, view.log.cell.layout
    T_W_L = Frames(log.cell, log).tracker_in_world()
    wanted = apply(T_W_L, np.array([prompt.expected_mm]))[0]
    rail_mm = _rail_mm(log)
    T_W_B = layout.nominal_base(rail_mm)
    slide = {nest.name: _place(apply(T_W_B, nest.xyz_mm[None])[0]) for nest in layout.slide}
    standing = {nest.name: _place(nest.xyz_mm) for nest in layout.standing}
    nests = slide if prompt.place in slide else standing
    return Site(
        nests=nests,
        done=_done(view) & nests.keys(),
        wanted=prompt.place,
        wanted_mm=nests.get(prompt.place, _place(wanted)),
        robot_mm=_place(T_W_B[:3, 3]),
        tracker_mm=_place(T_W_L[:3, 3]),
        along=(layout.rail_direction[0], layout.rail_direction[1]),
        stations={
            each.name: _place(layout.nominal_base(each.rail_mm)[:3, 3])
            for each in log.cell.station
            if log.cell.has_rail
        },
    )


def _place(xyz_mm: Array) -> Place:
    return float(xyz_mm[0]), float(xyz_mm[1])


def _done(view: RunView) -> frozenset[str]:
    """Return the nests that were measured in the present step."""
    keys = view.measured.get(int(view.step["number"]), set()) if view.step else set()
    points = (view.log.points.get(key) for key in keys)
    return frozenset(point.id.nest for point in points if point is not None and point.id.nest)


def _rail_mm(log: Log) -> float:
    """Return where the slide stood when it was last recorded; at the grid's station before."""
    newest = [*log.points][-1:]
    found = log.points[newest[0]].rail_mm if newest else None
    if found is None:
        found = next(
            (
                float(each.body["rail_mm"])
                for each in reversed(log.events)
                if each.body["what"] == "station held"
            ),
            log.cell.station_named(log.cell.grid.station).rail_mm,
        )
    return found
