"""The report: one HTML file that opens offline, needs no script and prints on A4."""

from __future__ import annotations

import re

from hilcell import __version__
from hilcell.calibration.errors import places, validation
from hilcell.calibration.measurement_budget import budget_of
from hilcell.calibration.pose_test import ISO
from hilcell.ports import Array
from hilcell.report import pose_test, tables
from hilcell.report.certificate import (
    certificate,
    conditions_words,
    conformity_words,
    procedure_words,
    title,
)
from hilcell.report.columns import present
from hilcell.report.course import course
from hilcell.report.curves import curves
from hilcell.report.facts import Facts
from hilcell.report.figures import drawings, is_paper
from hilcell.report.first_page import (
    instruments,
    item_facts,
    results_sheet,
    uncertainty_words,
    validity_facts,
    verdict_word,
)
from hilcell.report.method import models
from hilcell.report.plan_view import plan_view
from hilcell.report.pose_test import tests_poses
from hilcell.report.remeasured import remeasured
from hilcell.report.target_budget import target_budget, target_sheets
from hilcell.report.templates import environment


def report_html(facts: Facts) -> str:
    """Return the report of a run, the same from the same journal."""
    budget, targets = budget_of(facts.log), target_budget(facts.log, facts.run)
    kind, words = standing(facts)
    return (
        environment()
        .get_template("report.html.j2")
        .render(
            facts=facts,
            version=__version__,
            title=title(facts),
            measured=measured(facts),
            kind=kind,
            standing=words,
            controls=len(facts.log.select("control")),
            page_mark=re.sub(r"[^A-Za-z0-9._-]", "_", facts.run),
            lead=lead(facts),
            word=verdict_word(facts),
            sentence=sentence(facts),
            conformity=conformity_words(facts),
            results=results_sheet(facts),
            uncertainty=uncertainty_words(facts, budget),
            item=item_facts(facts, measured(facts)),
            validity=validity_facts(facts),
            instruments=instruments(facts),
            conditions=conditions_words(facts),
            method=procedure_words(facts),
            plan=plan_view(facts.cell, tracker_mm(facts)),
            certificate=certificate(facts, budget, targets),
            result_sheets=pose_test.sheets(facts)
            + present(
                tables.accuracy(facts),
                tables.orientation(facts),
                models(facts),
                curves(facts),
                tables.paper_rows(facts),
                tables.verdicts(facts),
            ),
            own_sheet=None if has_tables(facts) else tables.own_table(facts),
            drawings=drawings(facts),
            frame_sheets=present(
                tables.stations(facts),
                tables.touches(facts),
                tables.circles(facts),
                tables.frames(facts),
            ),
            budget=budget,
            budget_sheets=tables.budget_sheets(budget) if budget else [],
            targets=targets,
            target_sheets=target_sheets(targets),
            record_sheets=present(
                tables.devices(facts),
                tables.conditions(facts),
                tables.groups(facts),
                tables.software(facts),
                remeasured(facts),
                course(facts),
            ),
        )
    )


def has_tables(facts: Facts) -> bool:
    """Whether targets were validated or poses tested: the report has its own tables of them."""
    return tests_poses(facts) or any(
        validation(facts.log, stations) for stations in places(facts.cell).values()
    )


def standing(facts: Facts) -> tuple[str, str]:
    """Return how the run stands: a kind for the style sheet, and words."""
    end, state = facts.log.end, facts.log.state
    if facts.revoked:
        return "bad", f"its calibration is revoked: {facts.revoked}"
    if facts.finished and end is not None:
        if end["exit"] == 0:
            judged = facts.result[ISO]["limits"] if tests_poses(facts) else facts.log.verdicts
            return "good", "in tolerance" if judged else "finished"
        return "bad", "out of tolerance"
    if end is None and state not in ("aborted", "faulted"):
        return "open", f"not finished: the journal ends while the run is {state}"
    return "open", f"not finished: {state}"


def lead(facts: Facts) -> str:
    """Return what the report is about, in a line."""
    if facts.log.calibration == "validated" and not is_paper(facts):
        robot = "Robot on a rail" if facts.cell.has_rail else "Robot"
        return f"{robot}: position errors of the tool point and their correction"
    return facts.procedure.summary[:1].upper() + facts.procedure.summary[1:]


def sentence(facts: Facts) -> str:
    """Return the verdict as a sentence."""
    if tests_poses(facts):
        return pose_test.sentence(facts)
    word = verdict_word(facts)
    if word.endswith("PASS"):
        return "After correction the robot keeps its limits, the uncertainty taken into account."
    if word.endswith("FAIL"):
        return "The robot is not shown to keep its limits, the uncertainty taken into account."
    return "No correction was judged against limits in this run."


def tracker_mm(facts: Facts) -> Array:
    """Return where the tracker stood in {W}, (3,)."""
    T = facts.log.matrix("world") if "world" in facts.log.frames else None
    found: Array = (facts.cell.tracker.pose.matrix() if T is None else T)[:3, 3]
    return found


def measured(facts: Facts) -> str:
    """Return from when to when the run went, to the second, UTC."""
    first, last = facts.records[0].t, facts.last.t
    begin, end = first[:19].replace("T", " "), last[:19].replace("T", " ")
    return f"{begin} to {end[11:] if end[:10] == begin[:10] else end}"
