"""The first page, which can be signed, and what a calibration certificate has to state.

The page is complete: nothing on it needs another one. Results are those of the journalled
verdicts.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from operator import attrgetter
from typing import Literal, NamedTuple

import numpy as np

from hilcell.calibration.from_run import calibration_so_far, validation_verdicts
from hilcell.calibration.grid import ORIENTED
from hilcell.calibration.known_arm import carried_calibration
from hilcell.calibration.measurement_budget import Budget
from hilcell.calibration.orientation import validated_orientation_errors
from hilcell.calibration.position_errors import places, validation
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.cell.file import Cell
from hilcell.compensation.kinematic import Kinematic
from hilcell.compensation.model_choice import MODELS
from hilcell.geometry.frames import matrix, zyx_from_pose
from hilcell.identification.known_arm import in_words
from hilcell.journal.calibration_facts import SUSPECTED
from hilcell.journal.labels import in_zone, period_text
from hilcell.language import date_text, tr
from hilcell.model.calibration import MAX_AGE_DAYS
from hilcell.model.outcome import RULE, Outcome, gravest, outcome_of
from hilcell.model.point import BOTH, Sent
from hilcell.model.verdicts import VALIDATION, Fitted, InstrumentChecked, Judged, Rechecked
from hilcell.present.table import Column, Table
from hilcell.report.budgets import K_3D, TargetBudget
from hilcell.report.facts import Facts
from hilcell.report.iso9283 import PoseReport, is_pose_test
from hilcell.report.tables import typeset

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
        return self.limit - (self.U or 0.0)

    @property
    def outcome(self) -> Outcome | None:
        if self.U is None:
            return None
        return gravest([outcome_of(self.after, self.limit, self.U), self.also])


@dataclass(frozen=True, eq=False)
class FirstPage:
    """The first page of a run's report."""

    facts: Facts

    def results_table(self, targets: TargetBudget) -> Table:
        if is_pose_test(self.facts):
            return PoseReport(self.facts).results_table()
        left = len(self.station_verdicts()) - len(self._shown())
        note = (
            tr("{left} stations further from their limits: see Verdicts.", left=left)
            if left
            else ""
        )
        results = [result for name in self._shown() for result in self.results_at(name)]
        if results and (bound := self.bound_result(targets)) is not None:
            results.append(bound)
        return Table(
            self._columns(tr("3-D position error"), "mm", ".3f"), results, tr("Results"), note
        )

    def orientation_results(self) -> Table:
        """Return the orientation nearest to its limit, or a pose test's; nothing without limits."""
        if is_pose_test(self.facts):
            return PoseReport(self.facts).orientation_results()
        turns = {name: each.orientation for name, each in self.station_verdicts().items()}
        known = {name: turn for name, turn in turns.items() if turn is not None}
        limit_deg, results = self.facts.cell.validation.max_tolerance_deg, []
        if known and limit_deg is not None:
            place = max(known, key=lambda name: np.nan_to_num(known[name].max_deg, nan=np.inf))
            before = validated_orientation_errors(self.facts.log, [place]).get(Sent.BEFORE)
            before_deg = None if before is None else before.figures.max_deg
            results = [
                Result(tr("Largest at {place}", place=place), limit_deg, before_deg, *known[place])
            ]
        columns = self._columns(tr("orientation of the tool"), "°", ".4f")
        return Table(columns, results, tr("Results, orientation at the worst station"))

    def _columns(self, what: str, unit: str, form: str) -> tuple[Column[Result], ...]:
        return (
            Column(what, attrgetter("name")),
            Column(tr("limit"), attrgetter("limit"), unit, ".3f"),
            Column(tr("before"), lambda row: NOT_APPLICABLE if row.U is None else row.before,
                   unit, form),
            Column(tr("after"), attrgetter("after"), unit, form),
            Column("U", lambda row: tr("included") if row.U is None else row.U, unit, form),
            Column(tr("after may be at most"), attrgetter("most"), unit, form),
            Column(tr("verdict"), lambda row: self.facts.outcome_text(row.outcome, NOT_APPLICABLE),
                   form="s"),
        )  # fmt: skip

    def station_verdicts(self) -> dict[str, Judged]:
        return {
            place: judged
            for place, stations in places(self.facts.cell).items()
            if len(stations) == 1
            and (judged := self.facts.log.verdict(Judged, VALIDATION + place)) is not None
        }

    def _shown(self) -> list[str]:
        """Return the stations on the page: those nearest to a limit, in the cell's order."""
        judged = self.station_verdicts()
        nearest = sorted(
            judged, key=lambda name: judged[name].max_mm / judged[name].max_tolerance_mm
        )
        kept = set(nearest[-max_stations(self.facts.cell) :])
        return [name for name in judged if name in kept]

    def nearest_results(self, targets: TargetBudget) -> list[tuple[str, Result]]:
        """Return mean and largest error nearest to their limits, and the largest bound, named."""
        pairs = {name: self.results_at(name) for name in self.station_verdicts()}
        if not pairs:
            return []
        results = []
        for n, word in enumerate((tr("Mean"), tr("Largest"))):
            shares = {name: pair[n].after / pair[n].limit for name, pair in pairs.items()}
            name = max(shares, key=shares.__getitem__)
            results.append((f"{word}, {name}", pairs[name][n]))
        if (bound := self.bound_result(targets)) is not None:
            results.append((tr("95 % bound"), bound))
        return results

    def bound_result(self, targets: TargetBudget) -> Result | None:
        if targets.missing:
            return None
        bound_mm = max(float(each.radii_mm.max()) for each in targets.in_use.values())
        limit_mm = self.facts.cell.validation.max_tolerance_mm
        return Result(tr("Largest 95 % bound of a target"), limit_mm, None, bound_mm, None)

    def results_at(self, name: str) -> tuple[Result, Result]:
        each, series = self.station_verdicts()[name], validation(self.facts.log, [name])
        before, after = (series.get(how) for how in BOTH)
        sent, count = (0 if errors is None else len(errors) for errors in (before, after))
        explained = each.holds or each.why != each.decision
        also = Outcome.ACCEPTED if explained else each.outcome
        targets = tr("{count} targets at {name}", count=count, name=name)
        targets += tr(" (before: {sent})", sent=sent) if sent not in (0, count) else ""
        mean_mm, max_mm = (before.figures.mean, before.figures.max) if before else (None, None)
        return (
            Result(tr("Mean of {targets}", targets=targets), each.mean_tolerance_mm, mean_mm,
                   each.mean_mm,
                   each.mean_U_mm, also),
            Result(tr("Largest of {targets}", targets=targets), each.max_tolerance_mm, max_mm,
                   each.max_mm,
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
        outcome, facts = self.facts.log.outcome, self.facts.log.facts
        if outcome is None and facts.verdict == SUSPECTED:
            return "suspected"
        if not facts.judged:
            return "failed check" if outcome is Outcome.REJECTED else "not judged"
        return outcome or Outcome.REJECTED

    def verdict_title(self) -> str:
        """Return the verdict in a few words: PASS, FAIL or UNDECIDED where the robot was judged.

        Where it was not, or a cause is suspected and no limit is missed, it is the outcome in
        capitals; "NO VERDICT" before a run has finished.
        """
        match judged := self.judgement():
            case "revoked":
                return tr("REVOKED")
            case "unfinished":
                return tr("NO VERDICT")
            case "suspected" | "failed check" | "not judged":
                return tr(self.facts.log.outcome_text.partition(";")[0]).upper()
        word = tr(judged.short).upper()
        if not self.facts.inputs.simulated:
            return word
        return (
            tr("WOULD BE {word}", word=word)
            if judged is Outcome.UNDECIDED
            else tr("WOULD {word}", word=word)
        )

    def status(self) -> tuple[str, str]:
        """Return the status of the run: a kind for the style sheet, and a text."""
        facts = self.facts
        end, state = facts.log.end, facts.log.state
        if facts.revoked:
            return "bad", tr("its calibration is revoked: {revoked}", revoked=facts.revoked)
        if facts.finished and end is not None:
            later = tr(
                "; its calibration is superseded by {superseded}", superseded=facts.superseded
            ) * bool(facts.superseded)
            return "bad" if end.exit else "good", _outcome(facts) + later
        if end is None and state not in ("aborted", "faulted"):
            return "open", tr("not begun") if state == "idle" else tr(
                "not finished: {state}, engine gone", state=tr(state)
            )
        return "open", tr("not finished: {outcome}", outcome=_outcome(facts))

    def sentence(self) -> str:
        facts = self.facts
        if facts.revoked:
            return tr("The calibration of this run was revoked: do not use it for correction.")
        if is_pose_test(facts):
            return PoseReport(facts).sentence()
        for kind in ("recheck", "targets"):
            if kind in facts.result:
                return str(facts.result[kind]["text"])
        checked = InstrumentChecked.by(facts.log.verdicts)
        match self.judgement():
            case "failed check" | "not judged" if checked is not None:
                said = tr(checked.form, **checked.values)
                return f"{said[:1].upper()}{said[1:]}."
            case "suspected":
                return tr(
                    "{suspected}. Correct nothing by it until that is cleared.",
                    suspected=facts.suspected,
                )
            case Outcome() as outcome if outcome is not Outcome.REJECTED or self.deciding():
                return tr(
                    "{only}With its correction the robot is {decision}{deciding}.",
                    only=tr("In simulation only: ") if facts.inputs.simulated else "",
                    decision=tr(outcome.decision),
                    deciding=self.deciding(),
                )
            case "failed check" | Outcome.REJECTED:
                return tr("A check of this run is beyond its limit: see the verdicts.")
        return tr("No correction was judged against limits in this run.")

    def deciding(self) -> str:
        """The stations and figures by which the run does not pass, after a colon."""
        failed = {place: each for place, each in self.station_verdicts().items() if not each.holds}
        outcomes = [each.outcome for each in failed.values()]
        if not outcomes:
            return ""
        reasons = [
            f"{place}, {typeset(each.why)}"
            for place, each in failed.items() if each.outcome == gravest(outcomes)
        ]  # fmt: skip
        most = 2  # stations that the verdict's sentence names
        more = tr("; and at {n} more stations", n=len(reasons) - most) if reasons[most:] else ""
        return tr(": at {reasons}{more}", reasons=tr("; at ").join(reasons[:most]), more=more)

    def uncertainty_text(self, budget: Budget | None) -> str:
        """Return U with its coverage factors, of one coordinate and of a 3-D position."""
        if is_pose_test(self.facts):
            return PoseReport.UNCERTAINTY
        if budget is None:
            return ""
        return tr(
            "U: expanded, k = 2 (about 95 %); of the largest along the error, u = {u_mm:.4f} mm of "
            "one coordinate; of a mean by its own table. A measured 3-D position lies within "
            "{k:.2f} u = {U_mm:.3f} mm with 95 % (k = {k:.2f}, three coordinates; GUM).",
            u_mm=budget.u_mm,
            k=K_3D,
            U_mm=K_3D * budget.u_mm,
        )

    def time_span(self) -> str:
        facts = self.facts
        return period_text(facts.records[0].t, facts.last.t, facts.zone)

    def lead(self) -> str:
        facts = self.facts
        if facts.log.calibration != "validated" or facts.is_paper:
            summary = tr(facts.procedure.summary)
            return summary[:1].upper() + summary[1:]
        robot = tr("Robot on a rail") if facts.cell.has_rail else tr("Robot")
        turned = bool(facts.cell.robot.more_smr_mm)
        errors = tr("position and orientation errors of the tool") if turned else (
            tr("position errors of the tool point")
        )  # fmt: skip
        return tr("{robot}: {errors} and their correction", robot=robot, errors=errors)

    def item_facts(self) -> list[Fact]:
        cell = self.facts.cell
        robot = self.facts.asset("robot")
        serial = "" if robot is None else tr(", serial {serial}", serial=robot.serial)
        travel_m = (cell.rail.travel_max_mm - cell.rail.travel_min_mm) / 1000
        on = (
            tr("on a rail of {m:g} m", m=travel_m)
            if cell.has_rail
            else tr("on the floor, without a rail")
        )
        stations = (
            [cell.grid.station]
            if is_pose_test(self.facts)
            else [each.name for each in cell.station]
        )
        most = max_stations(cell)
        names = ", ".join(stations[:most])
        more = tr(" and {n} more", n=len(stations) - most) if len(stations) > most else ""
        carried = carried_calibration(self.facts.log)
        of = (
            ""
            if carried is None
            else tr(", re-calibrated from {latest}", latest=carried.provenance.latest)
        )
        parties = cell.certificate
        laboratory = parties.laboratory, parties.laboratory_address
        customer = parties.customer, parties.customer_address
        return [
            Fact(tr("Laboratory"), ", ".join(filter(None, laboratory))),
            Fact(tr("Customer"), ", ".join(filter(None, customer))),
            Fact(tr("Run"), f"{self.facts.run}{of}"),
            Fact(tr("Job"), self.facts.inputs.job),
            Fact(tr("Cell"), tr("{name}, serial {serial}", name=cell.name, serial=cell.serial)),
            Fact(tr("Robot"), f"{cell.robot.name}{serial}, {on}"),
            Fact(tr("Stations"), names + more),
            *(Fact(*each) for each in PoseReport(self.facts).stated_conditions()),
            Fact(tr("Measured"), self.time_span()),
            Fact(tr("Operator"), self.facts.inputs.operator),
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
        also = tr(" (as from {more} more)", more=more) if more else ""
        ranges = zip("xyz", validity.low_mm, validity.high_mm, strict=True)
        cube = ", ".join(
            tr("{axis} {low:.0f} to {high:.0f}", axis=axis, low=low, high=high)
            for axis, low, high in ranges
        )
        until = datetime.fromisoformat(self.facts.last.t) + timedelta(days=MAX_AGE_DAYS)
        return [
            Fact(
                tr("Volume"), tr("{cube} mm in the robot's base {{B}}, at each station", cube=cube)
            ),
            Fact(
                tr("Orientation"),
                tr(
                    "A {a:.1f}°, B {b:.1f}°, C {c:.1f}° of the flange in {{B}}, turned by at most "
                    "{within:g}°{also}; every axis approached from below",
                    a=a,
                    b=b,
                    c=c,
                    within=validity.orientation_tolerance_deg,
                    also=also,
                ),
            ),
            Fact(tr("Temperature"), self._temperature(validity.temperature_c)),
            Fact(
                tr("Age"),
                tr(
                    "until {day} ({days:g} days), earlier after a collision, a new mastering, a "
                    "changed motor or tool, or a failed re-check",
                    day=date_text(until),
                    days=MAX_AGE_DAYS,
                ),
            ),
        ]

    def instrument_rows(self) -> list[Instrument]:
        """Return what measured, with serial numbers and certificates; nothing without a tracker."""
        stated = self.facts.cell.uncertainty
        none = tr("none, simulated") if self.facts.inputs.simulated else ""
        unknown = none and NOT_APPLICABLE
        instruments = [
            Instrument(
                tr("Laser tracker"), each.model, each.serial, none or stated.tracker_certificate
            )
            for each in self.facts.log.assets
            if each.kind == "tracker"
        ]
        if not instruments:
            return []
        instruments.append(Instrument(tr("Reflector"), self.facts.cell.tracker.reflector, unknown,
                                none or stated.smr_certificate))  # fmt: skip
        if self.facts.log.temperatures_c():
            instruments.append(Instrument(tr("Weather station"), tr("of the tracker"), unknown,
                                    none or stated.weather_certificate))  # fmt: skip
        for each in self.facts.cell.layout.length:
            name = tr(
                "{nests}, {length_mm:g} mm, u {u_mm:g} mm",
                nests=" to ".join(each.nests),
                length_mm=each.length_mm,
                u_mm=each.u_mm,
            )
            instruments.append(
                Instrument(tr("Known length"), name, NOT_APPLICABLE, none or each.certificate)
            )
        return instruments

    def instruments(self) -> Table:
        columns: tuple[Column[Instrument], ...] = (
            Column(tr("instrument"), attrgetter("instrument")),
            Column(tr("model"), attrgetter("model")),
            Column(tr("serial"), lambda row: row.serial or BLANK),
            Column(tr("certificate"), lambda row: row.certificate or BLANK),
        )
        title = tr("Instruments and traceability")
        return Table(columns, self.instrument_rows(), title, self.traceability())

    def traceability(self) -> str:
        if self.facts.inputs.simulated:
            return tr("Not traceable: no instrument measured anything.")
        if not self.certified():
            return tr("Traceability is not shown: a certificate is missing.")
        return tr("Traceable to the SI through these certificates.")

    def certified(self) -> bool:
        """Whether real instruments measured, and the certificate of each is named."""
        rows = self.instrument_rows()
        named = bool(rows) and all(each.certificate for each in rows)
        return named and not self.facts.inputs.simulated

    @staticmethod
    def _temperature(range_c: tuple[float, float] | None) -> str:
        if range_c is None:
            return tr("not measured")
        low_c, high_c = (range_c[0] - TEMPERATURE_MARGIN_K, range_c[1] + TEMPERATURE_MARGIN_K)
        return tr(
            "{low:.1f} to {high:.1f} °C at the tracker (calibrated {least:.1f} to {most:.1f} °C)",
            low=low_c,
            high=high_c,
            least=range_c[0],
            most=range_c[1],
        )


def _outcome(facts: Facts) -> str:
    return "; ".join(map(tr, facts.log.outcome_text.split("; ")))


def max_stations(cell: Cell) -> int:
    long_name, most = 20, 4
    return 1 if any(len(station.name) > long_name for station in cell.station) else most


Judgement = Outcome | Literal["revoked", "unfinished", "suspected", "failed check", "not judged"]


@dataclass(frozen=True, slots=True)
class Instrument:
    """A measuring instrument; serial number and certificate are "" where they are not stated."""

    instrument: str
    model: str
    serial: str
    certificate: str


# -- contents of a calibration certificate (ISO/IEC 17025:2017, 7.8.2, 7.8.4), item by item --------

# Items that the journal proves are filled in, the rest are blank lines for the laboratory. A filled
# form is not an accredited certificate, and a simulated run calibrates nothing.


@dataclass(frozen=True, slots=True)
class Item:
    """One item: its clause, its name, its text, and the id of the report's part that has it.

    Without words it is a blank to fill in.
    """

    clause: str
    name: str
    words: str = ""
    part: str = "certificate"


def _uncertainty(budget: Budget | None, targets: TargetBudget) -> str:
    if budget is None:
        return "not evaluated: this run measured no position in {W}"
    words = f"U = {budget.U_mm:.3f} mm for one coordinate of a measured position, k = 2, about 95 %"
    if not targets.missing:
        radii_mm = targets.in_use[targets.worst].radii_mm
        words += (
            f"; 3D error of a corrected target within {radii_mm.mean():.3f} mm in the mean, "
            f"{radii_mm.max():.3f} mm at most, 95 % bounds at {targets.worst}"
        )
    return words + " (JCGM 100:2008)"


@dataclass(frozen=True, slots=True)
class Certificate:
    """Texts and items of a calibration certificate (ISO/IEC 17025:2017, 7.8.2, 7.8.4)."""

    facts: Facts

    def items(self, budget: Budget | None, targets: TargetBudget) -> list[Item]:
        facts = self.facts
        inputs, cell, robot = facts.inputs, facts.cell, facts.asset("robot")
        measured_air = bool(facts.log.temperatures_c())
        travel_mm = cell.rail.travel_max_mm - cell.rail.travel_min_mm
        stands = f"{len(cell.station)} stations on a rail of {travel_mm:g} mm"
        stands = stands if cell.has_rail else "on the floor, without a rail"
        kinds = ("tracker", "strip")
        devices = [f"{each.text} ({each.kind})" for each in facts.log.assets if each.kind in kinds]
        serial = "" if robot is None else f", serial {robot.serial}"
        begun = in_zone(facts.records[0].t, facts.zone).date().isoformat()
        dates = facts.date if begun == facts.date else f"{begun} to {facts.date}"
        results_part = "poses" if is_pose_test(facts) else "stations"
        results = "none: nothing was measured"
        if facts.log.points:
            air = ", temperatures °C" if measured_air else ""
            results = f"the tables of this report; lengths mm, angles °{air}"
        deviations = [f"a calibration was used although {why}" for why in inputs.accepted]
        deviations += PoseReport(facts).departures()
        revoked = f"REVOKED: {facts.revoked}; " if facts.revoked else ""
        return [
            Item("7.8.2.1 a", "Title", self.title()),
            Item("7.8.2.1 b, c", "Laboratory, place of the calibration",
                 cell.certificate.laboratory),
            Item("7.8.2.1 d", "Unique identification",
                 f"{facts.run}, journal {facts.fingerprint[:16]}"),
            Item("7.8.2.1 e", "Customer", cell.certificate.customer),
            Item("7.8.2.1 e", "Job", inputs.job),
            Item("7.8.2.1 f", "Method", self.method(), "uncertainty"),
            Item("7.8.2.1 g", "Item", f"cell {cell.name}, serial {cell.serial}; robot "
                 f"{cell.robot.name}{serial}; {stands}"),
            Item("7.8.2.1 g, h", "Condition of the item, date of receipt"),
            Item("7.8.2.1 i", "Date of measurement", dates),
            Item("7.8.2.1 j", "Date of issue"),
            Item("7.5.1", "Measured by", inputs.operator),
            Item("7.8.2.1 o", "Authorised by (name, signature)"),
            Item("7.8.2.1 m", "Results and units", results, results_part),
            Item("7.8.2.1 n", "Deviations from the method",
                 "; ".join(deviations) or "none recorded"),
            Item("7.8.4.1 a", "Measurement uncertainty", _uncertainty(budget, targets),
                 "uncertainty"),
            Item("7.8.4.1 b", "Conditions", self.conditions()),
            Item("7.8.4.1 c", "Measured with", "; ".join(devices)),
            Item("7.8.4.1 c", "Traceability: certificates of tracker, reflector"
                 + (", thermometer" if measured_air else "")),
            Item("7.8.4.1 d", "Before and after adjustment", self.adjustment(), "stations"),
            Item("7.8.6.2", "Conformity, decision rule", self.conformity()),
            Item("7.8.2.1 l", "Validity",
                 f"{revoked}the results relate only to the item {self._validity()}"),
        ]  # fmt: skip

    def title(self) -> str:
        """Return the kind of this report: without a validated correction nothing is calibrated."""
        facts = self.facts
        if is_pose_test(facts):
            return tr("Pose test after ISO 9283")
        if not self._calibrated():
            return tr("Measurement report")
        again = facts.cell.plan.recalibrates
        if facts.inputs.simulated:
            return tr("Simulated re-calibration") if again else tr("Simulated calibration")
        if FirstPage(facts).certified():
            return tr("Re-calibration certificate") if again else tr("Calibration certificate")
        return tr("Re-calibration report") if again else tr("Calibration report")

    def _calibrated(self) -> bool:
        return self.facts.log.calibration == "validated"

    def method(self) -> str:
        facts = self.facts
        if self._calibrated():
            return self._correction_method()
        if is_pose_test(facts):
            return PoseReport(facts).method_text()
        return tr(
            "hilcell procedure {procedure}: {summary}",
            procedure=facts.inputs.procedure,
            summary=tr(facts.procedure.summary),
        )

    def _correction_method(self) -> str:
        facts = self.facts
        log, reflectors = facts.log, len(facts.cell.robot.seats_mm)
        measured = tr("Position errors of the flange reflector")
        if reflectors > 1:
            measured = tr("Position and orientation errors of the tool, ")
            measured += tr("by {reflectors} reflectors on the flange,", reflectors=reflectors)
        counts = {
            tr("vertices of a grid"): len(log.select("grid")),
            tr("vertices in other orientations"): len(log.select(ORIENTED)),
            tr("poses chosen by what they determine"): len(log.select("pose")),
        }
        places = tr(" and ").join(f"{count} {places}" for places, count in counts.items() if count)
        phrases = [
            tr(
                "{measured} measured by laser tracker at {places} at {station}",
                measured=measured,
                places=places,
                station=facts.cell.grid.station,
            )
        ]
        if (carried := carried_calibration(log)) is not None:
            run, found = carried.provenance.latest, facts.result.get("known_arm", {"changed": {}})
            since = in_words(found["changed"])
            phrases.append(
                tr(
                    "the arm, its gears' errors and its repeatability known from the calibration "
                    "of run {run}",
                    run=run,
                )
                + (tr(", changed since: {since}", since=since) if since else "")
            )
        if log.curves:
            fit, axes = log.verdict(Fitted), tr("axes") if len(log.curves) > 1 else tr("axis")
            used = fit is not None and fit.curves.used and fit.method == Kinematic.name
            numbers = ", ".join(map(str, sorted(log.curves)))
            swept = f"{axes} {numbers}" + ("" if used else tr(" (not used)"))
            phrases.append(tr("each gear's error by slow sweeps of {swept}", swept=swept))
        phrases.append(tr(MODELS[log.method].text if log.method in MODELS else "corrected"))
        if len(facts.cell.station) > 1:
            phrases.append(tr("transferred to the other stations by station frames"))
        if touched := {point.station for point in log.select("touch")}:
            stations = ", ".join(sorted(touched))
            phrases.append(
                tr(
                    "the base measured by touch poses at each visit of {stations}",
                    stations=stations,
                )
            )
        return "; ".join([*phrases, tr("validated on targets sent and measured.")])

    def _validity(self) -> str:
        """Return for what the results hold: the first page states the volume of a calibration."""
        if not (self._calibrated() or FirstPage(self.facts).validity_facts()):
            return tr("described and to its state when it was measured")
        if self.facts.log.temperatures_c():
            return tr("calibrated, in the volume, orientation and temperatures stated here")
        return tr(
            "calibrated, in the volume and orientation stated here; no temperature was measured"
        )

    def conditions(self) -> str:
        """Return the air in words, "" where nothing was measured."""
        if not self.facts.log.points:
            return ""
        celsius = self.facts.log.temperatures_c()
        if not celsius:
            return tr("air not measured: the tracker has no weather station")
        return tr(
            "air {low:.1f} to {high:.1f} °C at the tracker",
            low=min(celsius),
            high=max(celsius),
        )

    def conformity(self) -> str:
        facts = self.facts
        if is_pose_test(facts):
            return PoseReport(facts).conformity_text()
        limits, plan = facts.cell.validation, facts.cell.plan
        judged = validation_verdicts(facts.log)
        rule = tr(RULE)
        if facts.log.verdict(Rechecked) is not None:
            return tr("chi-square tests of the errors against those that the calibration predicts")
        if plan.quick and not facts.procedure.used_in(facts.cell):
            rule = tr(
                "sequential: that the mean of the volume is below its limit, and less than "
                "{share:.0%} of it above the maximum, is each shown at every station at a risk of "
                "{risk:.1%}; {rule}",
                share=plan.share_above_max,
                risk=plan.accept_risk,
                rule=rule,
            )
        if not judged:
            return rule
        stated = tr(
            "mean ≤ {mean_mm:g} mm and maximum ≤ {max_mm:g} mm",
            mean_mm=limits.mean_tolerance_mm,
            max_mm=limits.max_tolerance_mm,
        )
        limits_deg = {each.max_tolerance_deg for each in judged.values() if each.max_tolerance_deg}
        stated += "".join(
            tr(", error of orientation ≤ {limit_deg:g}°", limit_deg=limit_deg)
            for limit_deg in limits_deg
        )
        return f"{stated}; {rule}"

    def adjustment(self) -> str:
        """Return which of the errors before and after adjustment this run measured."""
        facts = self.facts
        series = [validation(facts.log, names) for names in places(facts.cell).values()]
        measured = {how for each in series for how in each}
        if set(BOTH) <= measured:
            return tr(
                "both are reported: “before” is the robot commanded by its nominal kinematics, "
                "“after” the same robot with corrected targets"
            )
        if measured:
            how = tr("before") if Sent.BEFORE in measured else tr("after")
            return tr("only “{how}” was measured", how=how)
        if facts.procedure.used_in(facts.cell):
            return tr(
                "not both: targets were commanded with the correction of the calibration used, and "
                "measured as found"
            )
        return tr("neither was measured: this run sent no targets to compare")
