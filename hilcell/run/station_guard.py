"""The proof that a held slide stands where the strip says: one of its nests, after each hold.

A strip that has jumped a pole reads the station's value with the slide beside it; neither drive nor
strip shows that, and after a jump while everything was dead nothing else does. So the nest is
compared with the first hold of the station in this run: base and station frame rest on that one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hilcell.calibration.causes import Cause, Suspicion
from hilcell.cell.file import Nest, Station
from hilcell.geometry.frames import apply
from hilcell.journal.log import Point, positions_mm
from hilcell.journal.point_id import HELD, PointId
from hilcell.journal.reading_noise import run_noise
from hilcell.journal.set_ups import world_key
from hilcell.ports import DeviceError
from hilcell.run.motion import Motion
from hilcell.run.run_context import RunContext
from hilcell.run.tracker_guard import TrackerGuard, limits_of

SLIDE_PROVEN = "slide proven"  # event: so far off at most, which is within the limit
STRAIGHT_MM = 0.5  # a way between stations by the strip: its error, the rail's tilt and lean


class Off(NamedTuple):
    """How far the slide stands beside where it was, along the rail, and the limit."""

    off_mm: float
    limit_mm: float

    @property
    def holds(self) -> bool:
        """Whether hold, readings and drift explain it."""
        return abs(self.off_mm) <= self.limit_mm


class StationGuard:
    """Holds stations; ``measure`` measures a nest on a slide that is held."""

    def __init__(
        self,
        run: RunContext,
        motion: Motion,
        tracker: TrackerGuard,
        measure: Callable[[PointId, Station, Nest], Point],
    ) -> None:
        self._run, self._motion = run, motion
        self._tracker, self._measure = tracker, measure
        self._proven: tuple[str, int] | None = None  # station and visit

    def hold(self, station: Station) -> None:
        """Hold a station and prove it, unless it was proven since the slide last moved.

        Without {W}, without a rail, and where the reflector is carried by hand, nothing can be
        proven. Raises `BlockLost` where it was the tracker that has moved. A strip that has jumped
        pauses an attended run; `DeviceError` where the slide is still beside its place afterwards.
        """
        self._motion.hold_station(station)
        log = self._run.log
        framed = world_key(log.set_ups.number) in log.frames
        if not (framed and self._run.cell.has_rail) or self._run.cell.layout.by_hand:
            return
        if self._proven == (station.name, log.visit):
            return
        self._motion.park_robot()  # the arm may stand in the beam's way to the slide
        off = self._prove(station)
        if not off.holds:
            self._tracker.prove()
            self._run.pause(
                f"the slide stands {off.off_mm:+.3f} mm along the rail beside where {station.name} "
                f"was, wanted within {off.limit_mm:.3f} mm: the strip has jumped, or a slide nest "
                "has moved"
            )
            self._motion.hold_station(station, again=True)
            off = self._prove(station)
        if not off.holds:
            raise _jumped(station, off)
        self._proven = (station.name, log.visit)

    def _prove(self, station: Station) -> Off:
        """Measure the nest, and journal that it is where it was, if so."""
        self._tracker.prove_where_doubtful()
        nest = self._run.cell.layout.slide[0]
        turn = len(self._run.log.select(HELD, station.name))
        id = PointId(
            HELD, station=station.name, session=self._run.log.session, turn=turn, nest=nest.name
        )
        point = self._measure(id, station, nest)
        off = self._off(station, point)
        if off.holds:
            self._run.event(SLIDE_PROVEN, key=point.key, off_mm=off.off_mm, limit_mm=off.limit_mm)
        return off

    def _off(self, station: Station, now: Point) -> Off:
        """Return how far a point of this hold is from the first one's: of the station, or of any.

        The first of all is where it is. From one station to another the strip leads less well than
        back to the same.
        """
        log, cell = self._run.log, self._run.cell
        keys = (event.body["key"] for event in log.events if event.body["what"] == SLIDE_PROVEN)
        before = [log.points[key] for key in keys if key in log.points]
        here = [point for point in before if point.station == station.name]
        if not before:
            return Off(0.0, 0.0)
        first = (here or before)[0]
        held_mm = 2.0 * cell.rail.held_within_mm if here else STRAIGHT_MM
        limit_mm = held_mm + float(limits_of(cell, run_noise(log), [first], [now])[0])
        at_mm = apply(log.matrix("world"), positions_mm([first, now]))
        way_mm = station.strip_mm - cell.station_named(first.station).strip_mm
        along_mm = float((at_mm[1] - at_mm[0]) @ np.array(cell.layout.rail_direction))
        return Off(along_mm - way_mm, limit_mm)


def _jumped(station: Station, off: Off) -> DeviceError:
    suspicion = Suspicion(Cause.STRIP, off.off_mm, "mm", f"slide nest at {station.name}")
    return DeviceError(
        "HC-S10",
        "Rail",
        f"hold {station.name}",
        f"the strip reads the station, the slide stands {off.off_mm:+.3f} mm beside it",
        wanted=f"within {off.limit_mm:.3f} mm along the rail of its first hold in this run",
        act="the strip has jumped, or a slide nest has moved; put the strip head right and resume, "
        "else start a new run",
        fields=suspicion.facts
        | {"station": station.name, "off_mm": off.off_mm, "limit_mm": off.limit_mm},
    )
