"""The report: one HTML file that opens offline, needs no script and prints on A4."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from operator import attrgetter, itemgetter

import numpy as np

from hilcell import __version__
from hilcell.calibration.instrument import TWO_FACES
from hilcell.calibration.measurement_budget import Budget, measurement_budget
from hilcell.calibration.position_errors import places, validation
from hilcell.cell.file import Cell
from hilcell.cell.undetectable_errors import undetectable_errors
from hilcell.geometry.frames import apply
from hilcell.geometry.statistics import Figures
from hilcell.journal.labels import period_text
from hilcell.model.events import URAD, CurveMeasured
from hilcell.model.point import CONTROL
from hilcell.model.verdicts import Fitted
from hilcell.ports import Array
from hilcell.present.renderers import environment
from hilcell.present.table import Column, Table
from hilcell.report.budgets import TargetBudget, bounds_table, budget_table, target_budget
from hilcell.report.drawings.error_plots import ErrorPlots, strip, variance_bar
from hilcell.report.drawings.figures import POSE_TEST, drawings
from hilcell.report.drawings.views import plan_view, side_view
from hilcell.report.facts import Facts
from hilcell.report.first_page import Certificate, FirstPage, instruments, verdicts
from hilcell.report.iso9283 import PoseReport, is_pose_test
from hilcell.report.tables import Tables, worst
from hilcell.report.timeline import timeline


def volume_table(cell: Cell, tracker_mm: Array) -> Table:
    """Return the table; ``tracker_mm`` (3,) is the tracker's place in {W}."""
    centre, half = cell.grid.centre.matrix()[:3, 3], np.array(cell.grid.size_mm) / 2
    cube_mm = centre + np.array([*product((-1.0, 1.0), repeat=3)]) * half
    places = {s.name: apply(cell.layout.nominal_base(s.rail_mm), cube_mm) for s in cell.station}
    every = np.concatenate(list(places.values()))
    far_m = np.linalg.norm(every - tracker_mm, axis=1) / 1000
    note = f"Tracker to corners: {far_m.min():.1f} to {far_m.max():.1f} m."
    lows = np.array([corners.min(axis=0) for corners in places.values()])
    highs = np.array([corners.max(axis=0) for corners in places.values()])
    extents = list[tuple[str, float, float]]()
    most_stations = 4  # one by one
    same_mm = 0.5
    for n, axis in enumerate("xyz"):
        low, high = lows[:, n], highs[:, n]
        same = max(np.ptp(low), np.ptp(high)) <= same_mm
        if same or len(places) > most_stations:
            words = axis if same else f"{axis}, {len(places)} stations"
            extents.append((words, float(low.min()), float(high.max())))
        else:
            rows = zip(places, low.tolist(), high.tolist(), strict=True)
            extents += [(f"{axis}, {name}", *ends) for name, *ends in rows]
    columns: tuple[Column[tuple[str, float, float]], ...] = (
        Column("in {W}, mm", itemgetter(0)),
        Column("from", itemgetter(1), form=".0f"),
        Column("to", itemgetter(2), form=".0f"),
    )
    return Table(columns, extents, "Calibrated volume", note)


def _lines(record: CurveMeasured) -> str:
    pairs = zip(record.cycles, record.amplitudes_urad, strict=True)
    return ", ".join(f"{cycles:.1f}: {size:.1f}" for cycles, size in pairs) or "none"


GLOSSARY = (
    ("3-D error", r"\b3-?D\b", "length from the place commanded to the place measured"),
    ("95 % bound", r"95 % bound",
     "length that the 3-D error of a corrected target keeps with 95 % probability"),
    ("u", r"\bu\b", "standard uncertainty, k = 1; of one coordinate, where nothing else is said"),
    ("U, k", r"\bU\b", "expanded uncertainty U = k u, about 95 %; k: coverage factor"),
    ("AP, RP", r"\bAP_p\b",
     "ISO 9283: mean position less the commanded one; radius that repeated arrivals keep"),
    ("AD, RD", r"\bAD_x\b", "accuracy and repeatability of a distance (ISO 9283)"),
    ("{W}", r"\{W\}", "world frame, of the floor nests"),
    ("{B}", r"\{B\}", "base frame of the robot"),
    ("A, B, C", r"\bA °", "angles about z, y and x, turned in this order"),
    ("Station", r"\bS\d+\b|\b[Ss]tations\b", "place of the robot on the rail, held by the strip"),
    ("Touch pose", r"[Tt]ouch pose", "pose measured to find where the slide came to rest"),
    ("SMR", r"\bSMR\b", "spherically mounted retroreflector, seen by the tracker"),
    ("RMS, rms", r"\b(rms|RMS)\b", "root mean square"),
    ("p95", r"\bp95\b", "95 % of the figures are below it"),
    ("IDW", r"\b(IDW|idw)\b", "error as the mean of the vertices' errors by inverse distance"),
)  # fmt: skip


def glossary_terms(html: str, has_rail: bool = True) -> list[tuple[str, str]]:
    """Return the words that stand in a page, with their meaning in such a cell."""
    text = re.sub(r"<[^>]*>", " ", html)
    own = {} if has_rail else {"Station": "place of the robot, on the floor"}
    shown = ((name, meaning) for name, pattern, meaning in GLOSSARY if re.search(pattern, text))
    return [(name, own.get(name, meaning)) for name, meaning in shown]


PARTS = {
    "certificate": "first page", "glance": "At a glance", "poses": "Poses",
    "stations": "Stations, worst targets, drift", "uncertainty": "Uncertainty and method",
    "curves": "Transmission curves", "paper": "Figures of the paper", "record": "Record",
    "items": "Where each required item is",
}  # fmt: skip


def report_html(facts: Facts, pages: Mapping[str, int] | None = None) -> str:
    """Return the report of a run, the same from the same journal.

    ``pages`` says on which page each part begins, where that is known: on paper.
    """
    budget, targets = measurement_budget(facts.log), target_budget(facts.log, facts.run)
    tables = Tables(facts)
    measured_here = is_pose_test(facts) or any(
        validation(facts.log, stations) for stations in places(facts.cell).values()
    )
    own = Table((), ()) if measured_here else tables.own_table()  # the report has its own of them
    text = ReportText(facts)
    drawn = text.drawings(targets)
    accuracy, judged, worst_ones = tables.accuracy(), verdicts(facts), worst(facts, targets)
    judged_tables = [accuracy, tables.orientation(), tables.stations(), tables.touches()]
    frames = [tables.frames(), tables.circles()]
    named = {
        "results": own,
        "stations": any(judged_tables),
        "worst targets": worst_ones,
        "frames": any(frames) and not any(judged_tables),
        "drift": drawn["nests"] or drawn["air"],
    }
    stations_title = ", ".join(name for name, there in named.items() if there).capitalize()
    two_faces = TWO_FACES[0] in facts.log.verdicts
    hidden = [] if targets.missing else undetectable_errors(facts.cell, two_faces=two_faces)
    return environment("hilcell.report").get_template("report.html.j2").render(
        **text.first_page(budget, targets),
        **drawn,
        facts=facts,
        version=__version__,
        pages=pages or {},
        parts=PARTS | {"stations": stations_title},
        glossary_terms=partial(glossary_terms, has_rail=facts.cell.has_rail),
        controls=sum(each.group == CONTROL for each in facts.log.points.values()),
        page_mark=re.sub(r"[^A-Za-z0-9._-]", "_", facts.run),
        certificate=Certificate(facts).items(budget, targets),
        pose_tables=PoseReport(facts).tables(),
        has_part=lambda name, body: f' id="{name}"' in body,
        station_tables=[*judged_tables, *frames, worst_ones],
        procedure_table=own,
        empty=not (own or accuracy or judged),
        curve_table=text.curves(),
        paper_table=tables.paper_rows(),
        budget_table=budget_table(budget, targets, hidden),
        bounds_table=bounds_table(targets),
        models=text.models(),
        verdicts=judged,
        targets=targets,
        record_tables=[
            timeline(facts), tables.remeasured(), tables.devices(), tables.conditions(),
            tables.groups(), tables.software(),
        ],
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ReportText:
    """Tables, texts and drawings of one run's report."""

    facts: Facts

    def curves(self) -> Table:
        note = (
            "Found by slow sweeps in both directions: lines in cycles per revolution of the joint. "
            "Lag: how much older the joints' readings are than the tracker's. Noise: of one "
            "sample. Signal: share of the short-wave variance that the lines explain."
        )
        columns: tuple[Column[CurveMeasured], ...] = (
            Column("axis", lambda row: f"A{row.axis}"),
            Column("cycles: amplitude", _lines, "µrad"),
            Column("used", lambda row: "yes" if row.holds else f"no: {row.reason}"),
            Column("from", lambda row: float(np.degrees(row.low_rad)), "°", ".1f"),
            Column("to", lambda row: float(np.degrees(row.high_rad)), "°", ".1f"),
            Column("lag", lambda row: row.lag_s * 1e3, "ms", ".2f"),
            Column("lag u", lambda row: row.lag_sigma_s * 1e3, "ms", ".2f"),
            Column("noise", lambda row: row.noise_rad * URAD, "µrad", ".1f"),
            Column("signal", lambda row: 100 * row.share, "%", ".0f"),
            Column("samples lost", attrgetter("lost"), form="d"),
        )
        return Table(columns, self.facts.log.curves.values(), "Transmission errors", note)

    def models(self) -> Table:
        """Return how far each model misses poses left out, which one was chosen, and why."""
        fit = self.facts.log.verdict(Fitted)
        columns: tuple[Column[tuple[str | float | None, ...]], ...] = (
            Column("model", itemgetter(0)),
            *(
                Column(name, itemgetter(n), "mm", ".3f")
                for n, name in enumerate(Figures._fields, 1)
            ),
        )
        if fit is None:
            return Table(columns, (), "Choice of the correction")
        rows = [
            (f"{name}, chosen" if name == fit.method else name, *map(figures.get, Figures._fields))
            for name, figures in fit.loocv.items()
        ]
        reasons = [f"Chosen: {fit.reason}."]
        reasons += [f"No {name} model: {why}." for name, why in fit.refused.items()]
        reasons += [f"Curves of the axis sweeps: {fit.curves.reason}."] if fit.curves.reason else []
        unswept = self.facts.result.get("sweeps", {}).get("left_out", "")
        reasons += [f"Axes not swept: {unswept}."] if unswept else []
        return Table(columns, rows, "Choice of the correction", " ".join(reasons))

    def first_page(self, budget: Budget | None, targets: TargetBudget) -> dict[str, object]:
        facts = self.facts
        page, (kind, words) = FirstPage(facts), self.status()
        lead = facts.procedure.summary[:1].upper() + facts.procedure.summary[1:]
        if facts.log.calibration == "validated" and not facts.is_paper:
            robot = "Robot on a rail" if facts.cell.has_rail else "Robot"
            turned = bool(facts.cell.robot.more_smr_mm)
            errors = "position and orientation errors of the tool" if turned else (
                "position errors of the tool point"
            )  # fmt: skip
            lead = f"{robot}: {errors} and their correction"
        return {
            "title": Certificate(facts).title(),
            "kind": kind,
            "standing": words,
            "lead": lead,
            "word": page.verdict_title(),
            "sentence": self.sentence(),
            "conformity": Certificate(facts).conformity(),
            "results": page.results_table(targets),
            "orientation_results": page.orientation_results(),
            "strip": strip(page.nearest_results(targets), facts.inputs.simulated),
            "uncertainty": page.uncertainty_text(budget),
            "item": page.item_facts(self.time_span()),
            "validity": page.validity_facts(),
            "instruments": instruments(facts),
            "turns": Tables(facts).orientation_text(),
            "conditions": Certificate(facts).conditions(),
            "method": Certificate(facts).method(),
            "departures": PoseReport(facts).departures(),
        }

    def drawings(self, targets: TargetBudget) -> dict[str, object]:
        facts = self.facts
        world = facts.log.matrix("world") if "world" in facts.log.frames else None
        tracker_mm = (facts.cell.tracker.pose.matrix() if world is None else world)[:3, 3]
        simulated, drawn = facts.inputs.simulated, drawings(facts)
        valid = FirstPage(facts).validity_facts()
        return {
            "plan": plan_view(facts.cell, tracker_mm, simulated),
            "side": side_view(facts.cell, tracker_mm, simulated),
            "volume": volume_table(facts.cell, tracker_mm) if valid else None,
            "order": ErrorPlots(facts).sorted_errors(),
            "enlarged": ErrorPlots(facts).errors_after(targets),
            "vectors": ErrorPlots(facts).vectors(),
            "variance": variance_bar(targets, simulated),
            "nests": ErrorPlots(facts).floor_nests(),
            "air": ErrorPlots(facts).air(),
            "histogram": ErrorPlots(facts).bound_histogram(targets),
            "curve_plots": ErrorPlots(facts).gears(),
            "pose_drawings": [each for each in drawn if each.name in POSE_TEST],
            "drawings": [each for each in drawn if each.name not in POSE_TEST],
        }

    def status(self) -> tuple[str, str]:
        """Return the status of the run: a kind for the style sheet, and a text."""
        facts = self.facts
        end, state = facts.log.end, facts.log.state
        if facts.revoked:
            return "bad", f"its calibration is revoked: {facts.revoked}"
        if facts.finished and end is not None:
            later = f"; its calibration is superseded by {facts.superseded}" * bool(
                facts.superseded
            )
            return "bad" if end.exit else "good", facts.log.outcome + later
        if end is None and state not in ("aborted", "faulted"):
            return "open", "not begun" if state == "idle" else f"not finished: {state}, engine gone"
        return "open", f"not finished: {facts.log.outcome}"

    def sentence(self) -> str:
        facts = self.facts
        if facts.revoked:
            return "The calibration of this run was revoked: do not use it for correction."
        if is_pose_test(facts):
            return PoseReport(facts).sentence()
        for kind in ("recheck", "targets"):
            if kind in facts.result:
                return str(facts.result[kind]["text"])
        only = "In simulation only: " if facts.inputs.simulated else ""
        match FirstPage(facts).judgement():
            case "failed check":
                return "A check of this run is beyond its limit: see the verdicts."
            case "suspected":
                return f"{facts.suspected}. Correct nothing by it until that is cleared."
            case "accepted":
                return f"{only}With its correction the robot keeps its limits, uncertainty added."
            case "rejected":
                shown = "The robot is not shown to keep its limits, with the uncertainty added"
                return f"{only}{shown}{FirstPage(facts).deciding()}."
            case "undecided":
                shown = "Conformity is neither shown nor refuted"
                return f"{only}{shown}{FirstPage(facts).deciding()}."
        return "No correction was judged against limits in this run."

    def time_span(self) -> str:
        facts = self.facts
        return period_text(facts.records[0].t, facts.last.t, facts.zone)
