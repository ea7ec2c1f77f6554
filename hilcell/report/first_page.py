"""The first page, which can be signed: verdict, limits, uncertainty, instruments, validity.

It stands alone: nothing on it needs another page. Results are those of the journalled verdicts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from operator import attrgetter
from typing import Literal, NamedTuple

import numpy as np

from hilcell.calibration.errors import places, validation
from hilcell.calibration.file import calibration_so_far
from hilcell.calibration.measurement_budget import Budget
from hilcell.calibration.orientation import validated_turns
from hilcell.calibration.validity import MAX_AGE_DAYS, TEMPERATURE_MARGIN_K
from hilcell.cell.file import Cell
from hilcell.geometry.frames import matrix, zyx_from_pose
from hilcell.journal.calibration_facts import SUSPECTED, facts_of, run_judged, run_outcome
from hilcell.journal.words import verdict_words
from hilcell.model.outcome import Outcome, gravest, outcome_of
from hilcell.model.point import BOTH, Sent
from hilcell.model.verdicts import VALIDATION, Judged, Verdict
from hilcell.present.table import Column, Table
from hilcell.report import iso9283
from hilcell.report.budgets import K_3D, TargetBudget
from hilcell.report.facts import Facts
from hilcell.report.iso9283 import PoseReport, tests_poses

BLANK = "…" * 12  # to fill in by hand
NOT_APPLICABLE = "–"


class Fact(NamedTuple):
    """A name and words; without words it is a line to fill in."""

    name: str
    words: str = ""


@dataclass(frozen=True, slots=True)
class Result:
    """One figure against its limit, in mm or in deg; None where it was not measured or stated.

    Without ``U`` it is a bound, which has the uncertainty in it and is not judged. ``also`` is an
    outcome that no figure explains by itself: of too few targets.
    """

    name: str
    limit: float
    before: float | None
    after: float
    U: float | None
    also: Outcome = Outcome.ACCEPTED

    @property
    def most(self) -> float:
        """Return what the figure may be at most: its limit less U."""
        return self.limit - (self.U or 0.0)

    @property
    def outcome(self) -> Outcome | None:
        """Return whether it keeps the limit, by the decision rule."""
        if self.U is None:
            return None
        return gravest([outcome_of(self.after, self.limit, self.U), self.also])


@dataclass(frozen=True, eq=False)
class FirstPage:
    """The first page of a run's report."""

    facts: Facts

    def results_sheet(self, targets: TargetBudget) -> Table:
        """Return the table of results, nothing where nothing was judged."""
        if tests_poses(self.facts):
            return PoseReport(self.facts).results_sheet()
        left = len(self.judged_places()) - len(self._shown())
        note = f"{left} stations further from their limits: see Verdicts." if left else ""
        results = [result for name in self._shown() for result in self.results_at(name)]
        if results and (bound := self.bound_result(targets)) is not None:
            results.append(bound)
        return Table(self._columns("3-D position error", "mm", ".3f"), results, "Results", note)

    def turn_results(self) -> Table:
        """Return the orientation nearest to its limit, or a pose test's; nothing without limits."""
        if tests_poses(self.facts):
            return PoseReport(self.facts).turn_results()
        turns = {name: each.turn for name, each in self.judged_places().items()}
        known = {name: turn for name, turn in turns.items() if turn is not None}
        limit_deg, results = self.facts.cell.validation.max_tolerance_deg, []
        if known and limit_deg is not None:
            place = max(known, key=lambda name: np.nan_to_num(known[name].max_deg, nan=np.inf))
            before = validated_turns(self.facts.log, [place]).get(Sent.BEFORE)
            before_deg = None if before is None else before.figures.max_deg
            results = [Result(f"Largest at {place}", limit_deg, before_deg, *known[place])]
        columns = self._columns("orientation of the tool", "°", ".4f")
        return Table(columns, results, "Results, orientation at the worst station")

    def _columns(self, what: str, unit: str, form: str) -> tuple[Column[Result], ...]:
        return (
            Column(what, attrgetter("name")),
            Column("limit", attrgetter("limit"), unit, ".3f"),
            Column("before", lambda row: NOT_APPLICABLE if row.U is None else row.before,
                   unit, form),
            Column("after", attrgetter("after"), unit, form),
            Column("U", lambda row: "included" if row.U is None else row.U, unit, form),
            Column("after may be at most", attrgetter("most"), unit, form),
            Column("verdict", lambda row: self.facts.outcome_words(row.outcome, NOT_APPLICABLE),
                   form="s"),
        )  # fmt: skip

    def judged_places(self) -> dict[str, Judged]:
        return {
            place: judged
            for place, stations in places(self.facts.cell).items()
            if len(stations) == 1
            and (judged := self.facts.log.verdict(Judged, VALIDATION + place)) is not None
        }

    def _shown(self) -> list[str]:
        """Return the stations on the page: those nearest to a limit, in the cell's order."""
        found = self.judged_places()
        nearest = sorted(found, key=lambda name: found[name].max_mm / found[name].max_tolerance_mm)
        kept = set(nearest[-most_places(self.facts.cell) :])
        return [name for name in found if name in kept]

    def nearest_results(self, targets: TargetBudget) -> list[tuple[str, Result]]:
        """Return mean and largest error nearest to their limits, and the largest bound, named."""
        pairs = {name: self.results_at(name) for name in self.judged_places()}
        if not pairs:
            return []
        found = []
        for n, word in enumerate(("Mean", "Largest")):
            shares = {name: pair[n].after / pair[n].limit for name, pair in pairs.items()}
            name = max(shares, key=shares.__getitem__)
            found.append((f"{word}, {name}", pairs[name][n]))
        if (bound := self.bound_result(targets)) is not None:
            found.append(("95 % bound", bound))
        return found

    def bound_result(self, targets: TargetBudget) -> Result | None:
        """Return the largest 95 % bound of a corrected target, None where none is stated."""
        if targets.missing:
            return None
        bound_mm = max(float(each.radii_mm.max()) for each in targets.in_use.values())
        limit_mm = self.facts.cell.validation.max_tolerance_mm
        return Result("Largest 95 % bound of a target", limit_mm, None, bound_mm, None)

    def results_at(self, name: str) -> tuple[Result, Result]:
        """Return mean and largest error of a judged station."""
        each, series = self.judged_places()[name], validation(self.facts.log, [name])
        before, after = (series.get(how) for how in BOTH)
        sent, count = (0 if errors is None else len(errors) for errors in (before, after))
        explained = each.holds or each.why != each.decision
        also = Outcome.ACCEPTED if explained else each.outcome
        targets = f"{count} targets at {name}"
        targets += f" (before: {sent})" if sent not in (0, count) else ""
        mean_mm, max_mm = (before.figures.mean, before.figures.max) if before else (None, None)
        return (
            Result(f"Mean of {targets}", each.mean_tolerance_mm, mean_mm, each.mean_mm,
                   each.mean_U_mm, also),
            Result(f"Largest of {targets}", each.max_tolerance_mm, max_mm, each.max_mm,
                   each.max_U_mm),
        )  # fmt: skip

    def judgement(self) -> Judgement:
        """Return how the run judged the robot.

        "suspected": a cause is suspected and no limit is missed; "failed check": nothing on the
        robot was judged, and another check failed.
        """
        if self.facts.revoked:
            return "revoked"
        if not self.facts.finished or self.facts.log.end is None:
            return "unfinished"
        found, said = run_judged(self.facts.log), facts_of(self.facts.log.verdicts)
        if found is None and said.verdict == SUSPECTED:
            return "suspected"
        if not said.judged:
            return "failed check" if found is Outcome.REJECTED else "not judged"
        return found or Outcome.REJECTED

    def verdict_word(self) -> str:
        """Return the verdict in a few words: PASS, FAIL or UNDECIDED where the robot was judged.

        Where it was not, or a cause is suspected and no limit is missed, it is the outcome in
        capitals; "NO VERDICT" before a run has finished.
        """
        match judged := self.judgement():
            case "revoked":
                return "REVOKED"
            case "unfinished":
                return "NO VERDICT"
            case "suspected" | "failed check" | "not judged":
                return run_outcome(self.facts.log).partition(";")[0].upper()
        word = judged.short.upper()
        if not self.facts.inputs.simulated:
            return word
        return f"WOULD BE {word}" if judged is Outcome.UNDECIDED else f"WOULD {word}"

    def deciding(self) -> str:
        """Return where which figures decided that the run does not pass, after a colon."""
        failed = {place: each for place, each in self.judged_places().items() if not each.holds}
        outcomes = [each.outcome for each in failed.values()]
        if not outcomes:
            return ""
        found = [
            f"{place}, {with_signs(each.why)}"
            for place, each in failed.items() if each.outcome == gravest(outcomes)
        ]  # fmt: skip
        most = 2  # stations that the verdict's sentence names
        more = f"; and at {len(found) - most} more stations" if found[most:] else ""
        return f": at {'; at '.join(found[:most])}{more}"

    def uncertainty_words(self, budget: Budget | None) -> str:
        """Return U with its coverage factors, of one coordinate and of a 3-D position."""
        if tests_poses(self.facts):
            return iso9283.uncertainty_words()
        if budget is None:
            return ""
        return (
            f"U of the table: expanded, k = 2 (about 95 %), along the error; u = {budget.u_mm:.4f} "
            f"mm of one coordinate. A measured 3-D position lies within {K_3D:.2f} u = "
            f"{K_3D * budget.u_mm:.3f} mm with 95 % (k = {K_3D:.2f}, three coordinates; GUM)."
        )

    def item_facts(self, measured: str) -> list[Fact]:
        """Return what was calibrated, for whom, when."""
        cell = self.facts.cell
        robot = self.facts.asset("robot")
        serial = "" if robot is None else f", serial {robot.serial}"
        travel_m = (cell.rail.travel_max_mm - cell.rail.travel_min_mm) / 1000
        on = f"on a rail of {travel_m:g} m" if cell.has_rail else "on the floor, without a rail"
        stations = (
            [cell.grid.station] if tests_poses(self.facts) else [each.name for each in cell.station]
        )
        most = most_places(cell)
        names = ", ".join(stations[:most])
        more = f" and {len(stations) - most} more" if len(stations) > most else ""
        parties = cell.certificate
        return [
            Fact("Laboratory", _party(parties.laboratory, parties.laboratory_address)),
            Fact("Customer", _party(parties.customer, parties.customer_address)),
            Fact("Run", self.facts.run),
            Fact("Job", self.facts.inputs.job),
            Fact("Cell", f"{cell.name}, serial {cell.serial}"),
            Fact("Robot", f"{cell.robot.name}{serial}, {on}"),
            Fact("Stations", names + more),
            *(Fact(*each) for each in PoseReport(self.facts).stated_conditions()),
            Fact("Measured", measured),
            Fact("Operator", self.facts.inputs.operator),
        ]

    def validity_facts(self) -> list[Fact]:
        """Return volume, orientation, temperature and age outside which `compensate` refuses.

        Nothing of a calibration that it refuses altogether.
        """
        calibration = calibration_so_far(self.facts.log, self.facts.run)
        if calibration is None or self.facts.revoked or self.facts.suspected:
            return []
        validity = calibration.validity
        a, b, c = zyx_from_pose(matrix(np.array(validity.orientation), np.zeros(3)))[3:]
        more = len(validity.orientations)
        also = f" (as from {more} more)" if more else ""
        ranges = zip("xyz", validity.low_mm, validity.high_mm, strict=True)
        cube = ", ".join(f"{axis} {low:.0f} to {high:.0f}" for axis, low, high in ranges)
        until = datetime.fromisoformat(self.facts.last.t) + timedelta(days=MAX_AGE_DAYS)
        return [
            Fact("Volume", f"{cube} mm in the robot's base {{B}}, at each station"),
            Fact(
                "Orientation",
                f"A {a:.1f}°, B {b:.1f}°, C {c:.1f}° of the flange in {{B}}, turned by at most "
                f"{validity.orientation_tolerance_deg:g}°{also}; every axis approached from below",
            ),
            Fact("Temperature", self._temperature(validity.temperature_c)),
            Fact(
                "Age",
                f"until {until:%Y-%m-%d} ({MAX_AGE_DAYS:g} days), earlier after a collision, a new "
                "mastering, a changed motor or tool, or a failed re-check",
            ),
        ]

    def instrument_rows(self) -> list[Instrument]:
        """Return what measured, with serial numbers and certificates; nothing without a tracker."""
        stated = self.facts.cell.uncertainty
        none = "none, simulated" if self.facts.inputs.simulated else ""
        unknown = none and NOT_APPLICABLE
        found = [
            Instrument("Laser tracker", each.model, each.serial, none or stated.tracker_certificate)
            for each in self.facts.log.assets
            if each.kind == "tracker"
        ]
        if not found:
            return []
        found.append(Instrument("Reflector", self.facts.cell.tracker.reflector, unknown,
                                none or stated.smr_certificate))  # fmt: skip
        if self.facts.log.temperatures_c():
            found.append(Instrument("Weather station", "of the tracker", unknown,
                                    none or stated.weather_certificate))  # fmt: skip
        for each in self.facts.cell.layout.length:
            name = f"{' to '.join(each.nests)}, {each.length_mm:g} mm, u {each.u_mm:g} mm"
            found.append(Instrument("Known length", name, NOT_APPLICABLE, none or each.certificate))
        return found

    def traceability(self) -> str:
        """Return in words whether the results are traceable."""
        if self.facts.inputs.simulated:
            return "Not traceable: no instrument measured anything."
        if not self.certified():
            return "Traceability is not shown: a certificate is missing."
        return "Traceable to the SI through these certificates."

    def certified(self) -> bool:
        """Whether real instruments measured, and the certificate of each is named."""
        rows = self.instrument_rows()
        named = bool(rows) and all(each.certificate for each in rows)
        return named and not self.facts.inputs.simulated

    @staticmethod
    def _temperature(range_c: tuple[float, float] | None) -> str:
        if range_c is None:
            return "not measured"
        low_c, high_c = (range_c[0] - TEMPERATURE_MARGIN_K, range_c[1] + TEMPERATURE_MARGIN_K)
        return (
            f"{low_c:.1f} to {high_c:.1f} °C at the tracker (calibrated {range_c[0]:.1f} to "
            f"{range_c[1]:.1f} °C)"
        )


def most_places(cell: Cell) -> int:
    """Return how many stations the page has room for."""
    long_name, most = 20, 4
    return 1 if any(len(station.name) > long_name for station in cell.station) else most


Judgement = Outcome | Literal["revoked", "unfinished", "suspected", "failed check", "not judged"]


def _party(name: str, address: str) -> str:
    return f"{name}, {address}" if name and address else name or address


@dataclass(frozen=True, slots=True)
class Instrument:
    """A measuring instrument; serial number and certificate are "" where they are not stated."""

    instrument: str
    model: str
    serial: str
    certificate: str


def instruments(facts: Facts) -> Table:
    rows = FirstPage(facts).instrument_rows()
    columns: tuple[Column[Instrument], ...] = (
        Column("instrument", attrgetter("instrument")),
        Column("model", attrgetter("model")),
        Column("serial", lambda row: row.serial or BLANK),
        Column("certificate", lambda row: row.certificate or BLANK),
    )
    return Table(columns, rows, "Instruments and traceability", FirstPage(facts).traceability())


def verdicts(facts: Facts) -> Table:
    """Return the verdicts, with the figures behind them."""
    columns: tuple[Column[tuple[str, Verdict]], ...] = (
        Column("judged", lambda row: verdict_words(row[0])),
        Column("verdict", lambda row: "holds" if row[1].holds else "does not hold"),
        Column("by", lambda row: with_signs(row[1].words)),
    )
    return Table(columns, facts.log.verdicts.items(), "Verdicts")


def with_signs(words: str) -> str:
    """Return words with the signs of print."""
    signs = {"<=": "≤", r"\+-": "±", r" deg\b": "°", r"\burad\b": "µrad"}
    for written, shown in signs.items():
        words = re.sub(written, shown, words)
    return words
