"""Commissioning of the rail: small jogs first, each judged before the next.

Drive and strip must agree in sign and scale, the drive's own speed with its positions, and a stop
must stop. A jog moves at most its bound, whatever the drive's scale is.
"""

from __future__ import annotations

from typing import NamedTuple

from hilcell.cell.devices import jogging_rail
from hilcell.cell.file import Cell
from hilcell.geometry.statistics import rounded
from hilcell.identification.rail_motion import (
    GROSS,
    SLOW_MM,
    JogFigures,
    RailFigures,
    jog_figures,
    rail_figures,
    stop_figures,
)
from hilcell.journal.log import Log
from hilcell.model.events import SlideJogged
from hilcell.model.plan import PlannedStep, Span
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result, Step
from procedures.plan import homing_s, rail_move_s
from procedures.proved import prove, proved_result, proved_table


class Jog(NamedTuple):
    """A jog towards the middle of the travel (``way`` +1) or back; bound: before a quick stop."""

    key: str
    distance_mm: float
    speed_mm_s: float
    way: int = 1

    @property
    def bound_mm(self) -> float:
        return 1.2 * self.distance_mm + 3.0


# All but the first in one direction: no backlash is between them.
JOGS = (
    Jog("0.5 mm", 0.5, 0.5),
    Jog("0.5 mm more", 0.5, 0.5),
    Jog("5 mm", 5.0, 2.0),
    Jog("20 mm", 20.0, 5.0),
    Jog("100 mm", 100.0, 20.0),
    Jog("500 mm", 500.0, 50.0),
)
STOP = Jog("stop", 500.0, 50.0, -1)
BACK = Jog("20 mm on", 20.0, 5.0)  # the other way than the jog before it
RETURN, RETURN_MM = "return", 2.0  # a slide that is nearer stays
STOP_AFTER_MM = 100.0
SCALE_SHARE = 1e-3  # that drive and strip may differ in scale
UNIT_SHARE = 0.15  # within which a short jog's scale is a simple factor
NOTHING = 0.02  # a scale below is no motion
TOO_FAST = 3.0  # times the announced speed, of a short jog: the servo's noise counts in it
SPEED_SHARE = 0.05  # by which a speed may differ from the ordered one


def _rescaled(session: CellSession, scale: float, U_scale: float = 0.0) -> dict[str, object]:
    """Return the values of the cell file with another scale of the drive; its speeds follow.

    They have the digits that the scale's uncertainty supports.
    """
    rail = jogging_rail(session.devices.rail)
    values = _options(session, rail.rescaled(scale, 1.0, abs(scale)))
    return {
        path: rounded(value, U_scale * abs(value)) if isinstance(value, float) else value
        for path, value in values.items()
    }


def _of_speed(session: CellSession, share: float) -> dict[str, object]:
    """Return the values of the cell file with another unit of the drive's speed."""
    return _options(session, jogging_rail(session.devices.rail).rescaled(1.0, 1.0, share))


def _options(session: CellSession, options: dict[str, object]) -> dict[str, object]:
    """Return the options that differ from the cell file's, by path."""
    stated = session.cell.rail.options
    return {
        f"rail.options.{key}": value
        for key, value in options.items()
        if value != stated.get(key) and (value or key in stated)
    }


class RailJogs(Step):
    """Jogs of 0.5 to 500 mm: sign, scale, speed unit, stop, backlash."""

    name = "rail-jogs"
    needs = (
        "a robot parked clear of the slide, a slide free for "
        f"{sum(jog.distance_mm for jog in JOGS):g} mm in that direction"
    )
    moves = (
        f"the slide by {', '.join(f'{jog.distance_mm:g}' for jog in JOGS)} mm towards the middle "
        f"of its travel, by {sum(jog.distance_mm for jog in JOGS):g} mm in all, and back, at "
        f"{JOGS[0].speed_mm_s:g} to {JOGS[-1].speed_mm_s:g} mm/s, the first "
        f"{JOGS[0].distance_mm:g} mm faster if the drive has another unit; each motion is stopped "
        "at 1.2 times its distance plus 3 mm"
    )
    measures = "drive, strip, and the drive's own speed"
    yields = "signs, scales, speed unit, backlash and the stop of the rail"

    def announced(self, cell: Cell) -> str:
        if not (cell.has_rail and cell.rail.is_unplaced):
            return self.moves
        return self.moves.replace(
            "towards the middle of its travel", "in one direction, not known yet"
        )

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        seconds = sum(
            jog.distance_mm / jog.speed_mm_s + rail_move_s(cell, 0.0) for jog in (*JOGS, STOP, BACK)
        )
        return PlannedStep.of_spans(self.name, 0, [Span("jogs", 0, seconds)])

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        rail, cell = session.devices.rail.read(), session.cell.rail
        room_mm = cell.travel_max_mm - cell.travel_min_mm
        towards = 1 if rail.strip_mm < (cell.travel_min_mm + cell.travel_max_mm) / 2 else -1
        first, *jogs = [jog for jog in JOGS if jog.distance_mm <= room_mm / 3]
        there = [self._jog(session, first, towards)]
        for jog in jogs:
            there.append(self._jog(session, jog, towards))
            if not self._not_gross(session, jog, jog_figures(there[-1])):
                self._return(session, BACK.speed_mm_s)
                return
        jogged = self._jog(session, STOP, towards, stop_after_mm=min(STOP_AFTER_MM, room_mm / 8))
        self._judge(session, rail_figures(there, self._jog(session, BACK, towards)))
        self._return(session, STOP.speed_mm_s)
        stop = stop_figures(jogged)
        limit_mm = stop.expected_mm(cell.acceleration_mm_s2)
        prove(
            session,
            "stop",
            holds=jogged.stopped_by == "stop" and stop.distance_mm <= limit_mm,
            found=f"{stop.distance_mm:.1f} mm and {stop.duration_s:.2f} s from "
            f"{stop.speed_mm_s:.0f} mm/s to rest",
            expected=f"<= {limit_mm:.1f} mm",
        )

    @staticmethod
    def _return(session: CellSession, speed_mm_s: float) -> None:
        """Return the slide to where it stood, by the drive's own counting."""
        jogs = session.log.happened(SlideJogged)
        back_mm = -sum(each.driven_mm for each in jogs if each.key != RETURN)
        if abs(back_mm) > RETURN_MM:
            session.jog_rail(
                RETURN, back_mm, bound_mm=1.2 * abs(back_mm) + 3.0, speed_mm_s=speed_mm_s
            )

    @staticmethod
    def _jog(
        session: CellSession, jog: Jog, towards: int, stop_after_mm: float | None = None
    ) -> SlideJogged:
        return session.jog_rail(
            jog.key,
            towards * jog.way * jog.distance_mm,
            bound_mm=jog.bound_mm,
            speed_mm_s=jog.speed_mm_s,
            stop_after_mm=stop_after_mm,
        )

    @staticmethod
    def _not_gross(session: CellSession, jog: Jog, figures: JogFigures) -> bool:
        """Judge signs and units; return whether the next jog may follow.

        A drive that counts far too much has not left the backlash after the shortest jog.
        """
        hardly = abs(figures.scale) <= NOTHING and figures.stopped_by == ""
        if hardly and jog.distance_mm < SLOW_MM:
            return True
        scale_ok = prove(
            session,
            f"sign by {jog.key}",
            holds=not figures.is_gross and figures.stopped_by == "",
            found=f"drive {figures.driven_mm:+.3f} mm, strip {figures.moved_mm:+.3f} mm: "
            f"{figures.words}",
            expected=f"one direction, within a factor of {GROSS:g}",
            values=_rescaled(session, figures.simple_scale(UNIT_SHARE))
            if figures.is_gross and abs(figures.scale) > NOTHING
            else {},
        )
        share = figures.speed_share
        holds = 1.0 / GROSS <= share <= GROSS
        if short := jog.distance_mm < SLOW_MM:  # over within a few polls
            holds = figures.mean_mm_s <= TOO_FAST * jog.speed_mm_s or not share > 0.0
        if not scale_ok or (holds and short):
            return scale_ok
        return prove(
            session,
            f"speed in {jog.key}",
            holds=holds,
            found=f"{abs(figures.driven_mm):.2f} mm by positions, {figures.by_speed_mm:.3g} mm by "
            f"the speeds that the drive states: factor {share:.4g}; {figures.mean_mm_s:.3g} mm/s",
            expected=f"equal within a factor of {GROSS:g}; {jog.speed_mm_s:g} mm/s",
            values=_of_speed(session, share) if not holds and share > 0.0 else {},
        )

    @staticmethod
    def _judge(session: CellSession, rail: RailFigures) -> None:
        """Judge the rail by all its jogs, each limit with the uncertainty of its figure."""
        limit = SCALE_SHARE + rail.U_scale
        holds = abs(rail.scale - 1.0) <= limit
        prove(
            session,
            "scale",
            holds=holds,
            found=f"{rail.scale:.5f} mm by the strip a mm of the drive, U {rail.U_scale:.1g} "
            "(k = 2)",
            expected=f"1 within {limit:.2g}",
            values={} if holds else _rescaled(session, rail.scale, rail.U_scale),
        )
        holds = abs(rail.speed_share - 1.0) <= SPEED_SHARE
        prove(
            session,
            "speed unit",
            holds=holds,
            found=f"{rail.speed_share:.3f} mm by positions a mm by the speeds that the drive "
            f"states, U {rail.U_speed_share:.1g} (k = 2)",
            expected=f"1 within {SPEED_SHARE:g}",
            values={} if holds else _of_speed(session, rail.speed_share),
        )
        limit_mm = session.cell.rail.max_backlash_mm
        prove(
            session,
            "backlash",
            holds=abs(rail.lost_mm) <= limit_mm,
            found=f"{rail.lost_mm:.3f} mm lost at a reversal, U {rail.U_lost_mm:.2g} mm (k = 2)",
            expected=f"<= {limit_mm:g} mm",
        )

    def result(self, log: Log) -> Result:
        return proved_result(log)


STATIONS = (0.0, -0.6, 0.6)  # of a draft, as shares of the room each way


class RailReference(Step):
    """References the drive: drive and absolute strip must then agree."""

    name = "rail-reference"
    needs = "a rail whose signs and scales are proved"
    moves = "the slide to its reference, where the homing method has one"
    measures = "drive and strip"
    yields = "a drive that reads as its strip"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, 0, homing_s(cell))

    def perform(self, session: CellSession) -> None:
        if not all(verdict.holds for verdict in session.log.verdicts.values()):
            return
        if not session.rail_referenced():
            session.pause(
                "the drive takes its reference: with homing 35 or 37 the slide stays where it is, "
                f"else it moves at {session.cell.rail.homing_mm_s:g} mm/s, perhaps to the end of "
                "its travel; clear the rail and stay at the E-stop"
            )
            session.home_rail()
        rail, table, survey = session.devices.rail.read(), session.cell.rail, session.cell.survey
        room_mm = (table.travel_max_mm - table.travel_min_mm) / 2.0
        low_mm, high_mm = (round(rail.strip_mm + end * room_mm, 1) for end in (-1.0, 1.0))
        places = [round(rail.strip_mm + share * room_mm, 1) for share in STATIONS]
        placed = {
            "rail.travel_min_mm": low_mm,
            "rail.travel_max_mm": high_mm,
            "survey.from_mm": places[0],
            "survey.to_mm": round(places[0] + survey.to_mm - survey.from_mm, 1),
            "station": [
                {"name": f"S{n}", "rail_mm": at_mm, "strip_mm": at_mm}
                for n, at_mm in enumerate(places, start=1)
            ],
        }
        inside = table.travel_min_mm <= rail.strip_mm <= table.travel_max_mm
        prove(
            session,
            "travel",
            holds=inside or table.is_unplaced,
            found=f"the slide stands at {rail.strip_mm:.2f} mm by the strip",
            expected=f"{room_mm:g} mm free each way"
            if table.is_unplaced
            else f"{table.travel_min_mm:g} .. {table.travel_max_mm:g} mm",
            values=placed if table.is_unplaced else {},
        )
        off_mm = rail.position_mm - rail.strip_mm
        prove(
            session,
            "reference",
            holds=abs(off_mm) <= session.cell.rail.slip_limit_mm,
            found=f"drive {rail.position_mm:.2f} mm, strip {rail.strip_mm:.2f} mm",
            expected=f"<= {session.cell.rail.slip_limit_mm:g} mm apart",
        )

    def result(self, log: Log) -> Result:
        return proved_result(log)


COMMISSION_RAIL = Procedure(
    "commission-rail",
    "commissioning: the rail by small jogs, each judged before the next",
    (RailJogs(), RailReference()),
    proved_table,
    by_hand="watch the first motions at the E-stop",
    of_rail=True,
)
