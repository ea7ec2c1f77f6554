"""The report: one HTML file that opens offline, needs no script and prints on A4."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial

from hilcell import __version__
from hilcell.calibration.instrument import TWO_FACES
from hilcell.calibration.measurement_budget import measurement_budget
from hilcell.calibration.position_errors import places, validation
from hilcell.cell.undetectable_errors import undetectable_errors
from hilcell.language import ENGLISH, Language, speaking
from hilcell.model.point import CONTROL, Sent
from hilcell.present.renderers import environment
from hilcell.present.table import Table
from hilcell.report.budgets import budget_table, mean_table, target_budget
from hilcell.report.drawings.error_plots import ErrorPlots, strip, variance_bar
from hilcell.report.drawings.figures import POSE_TEST, drawings
from hilcell.report.drawings.tracker_plots import both_faces, drift
from hilcell.report.drawings.views import plan_view, side_view
from hilcell.report.facts import Facts
from hilcell.report.first_page import Certificate, FirstPage
from hilcell.report.iso9283 import PoseReport, is_pose_test
from hilcell.report.tables import Tables
from hilcell.report.timeline import timeline

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
    "tracker": "Tracker", "stations": "Stations, worst targets, drift",
    "uncertainty": "Uncertainty and method", "curves": "Transmission curves",
    "paper": "Figures of the paper", "record": "Record", "items": "Where each required item is",
}  # fmt: skip


def report_html(
    facts: Facts, pages: Mapping[str, int] | None = None, language: Language = ENGLISH
) -> str:
    """Return the report of a run, the same from the same journal; its first page in a language.

    ``pages`` says on which page each part begins, where that is known: on paper.
    """
    log, cell, simulated = facts.log, facts.cell, facts.inputs.simulated
    budget, targets = measurement_budget(log), target_budget(log, facts.run)
    tables, page, plots, poses = (
        Tables(facts),
        FirstPage(facts),
        ErrorPlots(facts),
        PoseReport(facts),
    )
    validated = {name: validation(log, stations) for name, stations in places(cell).items()}
    measured_here = is_pose_test(facts) or any(validated.values())
    own = Table((), ()) if measured_here else tables.own_table()  # the report has its own of them
    accuracy, judged, worst_ones = tables.accuracy(), tables.verdicts(), tables.worst(targets)
    judged_tables = [accuracy, tables.orientation(), tables.stations(), tables.touches()]
    frames, nests, air = [tables.frames(), tables.circles()], plots.floor_nests(), plots.air()
    named = {
        "results": own,
        "stations": any(judged_tables),
        "worst targets": worst_ones,
        "frames": any(frames) and not any(judged_tables),
        "drift": nests or air,
    }
    stations_title = ", ".join(name for name, there in named.items() if there).capitalize()
    hidden = []
    if not targets.missing:
        hidden = undetectable_errors(cell, two_faces=TWO_FACES[0] in log.verdicts)
    tracker_mm, drawn = facts.tracker_mm, drawings(facts)
    templates, empty = environment("hilcell.report"), not (own or accuracy or judged)
    with speaking(language):
        first = templates.get_template("first_page.html.j2").render(
            language=language.code,
            facts=facts,
            page=page,
            issued=Certificate(facts),
            tables=tables,
            budget=budget,
            targets=targets,
            empty=empty,
            departures=poses.departures(),
            strip=strip(page.nearest_results(targets), simulated),
        )
    return templates.get_template("report.html.j2").render(
        first=first,
        facts=facts,
        page=page,
        issued=Certificate(facts),
        plots=plots,
        tables=tables,
        budget=budget,
        targets=targets,
        version=__version__,
        pages=pages or {},
        parts=PARTS | {"stations": stations_title},
        glossary_terms=partial(glossary_terms, has_rail=cell.has_rail),
        controls=sum(each.group == CONTROL for each in log.points.values()),
        page_mark=re.sub(r"[^A-Za-z0-9._-]", "_", facts.run),
        has_part=lambda name, body: f' id="{name}"' in body,
        departures=poses.departures(),
        pose_tables=poses.tables(),
        plan=plan_view(cell, tracker_mm, simulated),
        side=side_view(cell, tracker_mm, simulated),
        variance=variance_bar(targets, simulated),
        nests=nests,
        air=air,
        faces=both_faces(log),
        tracker_drift=drift(log),
        pose_drawings=[each for each in drawn if each.name in POSE_TEST],
        drawings=[each for each in drawn if each.name not in POSE_TEST],
        station_tables=[*judged_tables, *frames, worst_ones],
        procedure_table=own,
        empty=not (own or accuracy or judged),
        budget_table=budget_table(budget, targets, hidden),
        mean_table=mean_table(
            budget,
            {name: each[Sent.CHOSEN] for name, each in validated.items() if Sent.CHOSEN in each},
        ),
        verdicts=judged,
        record_tables=[
            timeline(facts), tables.remeasured(), tables.devices(), tables.conditions(),
            tables.groups(), tables.software(),
        ],
    )  # fmt: skip
