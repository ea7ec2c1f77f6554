"""Contents of a calibration certificate (ISO/IEC 17025:2017, 7.8.2, 7.8.4), item by item.

hilcell fills in the items that the journal proves; the rest stays a blank line for the laboratory.
A filled form is not an accredited certificate, and a simulated run calibrates nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

from hilcell.calibration.errors import places, validation
from hilcell.calibration.file import verdicts_of
from hilcell.calibration.grid import ORIENTED
from hilcell.calibration.measurement_budget import Budget
from hilcell.cell.file import Cell
from hilcell.compensation.choice import MODELS
from hilcell.compensation.kinematic import Kinematic
from hilcell.journal.words import in_zone
from hilcell.model.outcome import RULE
from hilcell.model.point import BOTH, Sent
from hilcell.model.verdicts import Fitted, Rechecked
from hilcell.report.budgets import TargetBudget
from hilcell.report.facts import Facts
from hilcell.report.first_page import FirstPage
from hilcell.report.iso9283 import PoseReport, tests_poses

PAGE_1, POSES, STATIONS, UNCERTAINTY = "certificate", "poses", "stations", "uncertainty"


@dataclass(frozen=True, slots=True)
class Item:
    """One item: its clause, its name, its words, and the part of the report where it stands.

    Without words it is a blank to fill in.
    """

    clause: str
    name: str
    words: str = ""
    part: str = PAGE_1


def certificate(facts: Facts, budget: Budget | None, targets: TargetBudget) -> list[Item]:
    """Return the items in the standard's order."""
    inputs, cell, robot = facts.inputs, facts.cell, facts.asset("robot")
    measured_air = bool(facts.log.temperatures_c())
    kinds = ("tracker", "strip")
    found = [f"{each.text} ({each.kind})" for each in facts.log.assets if each.kind in kinds]
    serial = "" if robot is None else f", serial {robot.serial}"
    begun = in_zone(facts.records[0].t, facts.zone).date().isoformat()
    dates = facts.date if begun == facts.date else f"{begun} to {facts.date}"
    results, results_part = "none: nothing was measured", POSES if tests_poses(facts) else STATIONS
    if facts.log.points:
        air = ", temperatures °C" if measured_air else ""
        results = f"the tables of this report; lengths mm, angles °{air}"
    deviations = [f"a calibration was used although {why}" for why in inputs.accepted]
    deviations += PoseReport(facts).departures()
    revoked = f"REVOKED: {facts.revoked}; " if facts.revoked else ""
    return [
        Item("7.8.2.1 a", "Title", title(facts)),
        Item("7.8.2.1 b, c", "Laboratory, place of the calibration", cell.certificate.laboratory),
        Item("7.8.2.1 d", "Unique identification",
             f"{facts.run}, journal {facts.fingerprint[:16]}"),
        Item("7.8.2.1 e", "Customer", cell.certificate.customer),
        Item("7.8.2.1 e", "Job", inputs.job),
        Item("7.8.2.1 f", "Method", procedure_words(facts), UNCERTAINTY),
        Item("7.8.2.1 g", "Item", f"cell {cell.name}, serial {cell.serial}; robot "
             f"{cell.robot.name}{serial}; {_stands(cell)}"),
        Item("7.8.2.1 g, h", "Condition of the item, date of receipt"),
        Item("7.8.2.1 i", "Date of measurement", dates),
        Item("7.8.2.1 j", "Date of issue"),
        Item("7.5.1", "Measured by", inputs.operator),
        Item("7.8.2.1 o", "Authorised by (name, signature)"),
        Item("7.8.2.1 m", "Results and units", results, results_part),
        Item("7.8.2.1 n", "Deviations from the method", "; ".join(deviations) or "none recorded"),
        Item("7.8.4.1 a", "Measurement uncertainty", _uncertainty(budget, targets),
             UNCERTAINTY),
        Item("7.8.4.1 b", "Conditions", conditions_words(facts)),
        Item("7.8.4.1 c", "Measured with", "; ".join(found)),
        Item("7.8.4.1 c", "Traceability: certificates of tracker, reflector"
             + (", thermometer" if measured_air else "")),
        Item("7.8.4.1 d", "Before and after adjustment", adjustment_words(facts), STATIONS),
        Item("7.8.6.2", "Conformity, decision rule", conformity_words(facts)),
        Item("7.8.2.1 l", "Validity",
             f"{revoked}the results relate only to the item {_limits_of_validity(facts)}"),
    ]  # fmt: skip


def _stands(cell: Cell) -> str:
    if not cell.has_rail:
        return "on the floor, without a rail"
    travel_mm = cell.rail.travel_max_mm - cell.rail.travel_min_mm
    return f"{len(cell.station)} stations on a rail of {travel_mm:g} mm"


def title(facts: Facts) -> str:
    """Return the kind of this report: without a validated correction nothing is calibrated."""
    if tests_poses(facts):
        return "Pose test after ISO 9283"
    if not _calibrated(facts):
        return "Measurement report"
    if facts.inputs.simulated:
        return "Simulated calibration"
    return "Calibration certificate" if FirstPage(facts).certified() else "Calibration report"


def _calibrated(facts: Facts) -> bool:
    return facts.log.calibration == "validated"


def procedure_words(facts: Facts) -> str:
    if _calibrated(facts):
        return _correction_words(facts)
    if tests_poses(facts):
        return PoseReport(facts).method_words()
    return f"hilcell procedure {facts.inputs.procedure}: {facts.procedure.summary}"


def _correction_words(facts: Facts) -> str:
    log, reflectors = facts.log, len(facts.cell.robot.seats_mm)
    measured = "Position errors of the flange reflector"
    if reflectors > 1:
        measured = "Position and orientation errors of the tool, "
        measured += f"by {reflectors} reflectors on the flange,"
    measured += (
        f" measured by laser tracker at {len(log.select('grid'))} vertices of a grid at "
        f"{facts.cell.grid.station}"
    )
    if turned := len(log.select(ORIENTED)):
        measured += f", at {turned} in other orientations"
    if poses := len(log.select("pose")):
        measured += f" and at {poses} poses chosen by the errors found there"
    found = [measured]
    if log.curves:
        fit, axes = log.verdict(Fitted), "axes" if len(log.curves) > 1 else "axis"
        used = fit is not None and fit.curves.used and fit.method == Kinematic.name
        swept = f"{axes} {', '.join(map(str, sorted(log.curves)))}{'' if used else ' (not used)'}"
        found.append(f"each gear's error by slow sweeps of {swept}")
    found.append(MODELS[log.method].text if log.method in MODELS else "corrected")
    if len(facts.cell.station) > 1:
        found.append("transferred to the other stations by station frames")
    if touched := {point.station for point in log.select("touch")}:
        stations = ", ".join(sorted(touched))
        found.append(f"the base found again by touch poses on the visit of {stations}")
    return "; ".join([*found, "validated on targets sent and measured."])


def _limits_of_validity(facts: Facts) -> str:
    """Return for what the results hold: the first page states the volume of a calibration."""
    if not (_calibrated(facts) or FirstPage(facts).validity_facts()):
        return "described and to its state when it was measured"
    if facts.log.temperatures_c():
        return "calibrated, in the volume, orientation and temperatures stated here"
    return "calibrated, in the volume and orientation stated here; no temperature was measured"


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


def conditions_words(facts: Facts) -> str:
    """Return the air in words, "" where nothing was measured."""
    if not facts.log.points:
        return ""
    celsius = facts.log.temperatures_c()
    if not celsius:
        return "air not measured: the tracker has no weather station"
    return f"air {min(celsius):.1f} to {max(celsius):.1f} °C at the tracker"


def conformity_words(facts: Facts) -> str:
    if tests_poses(facts):
        return PoseReport(facts).conformity_words()
    limits, plan = facts.cell.validation, facts.cell.plan
    judged = verdicts_of(facts.log)
    rule = RULE
    if facts.log.verdict(Rechecked) is not None:
        return "chi-square tests of the errors against those that the calibration predicts"
    if plan.quick and not facts.procedure.used_in(facts.cell):
        rule = (
            f"sequential: that the mean of the volume is below its limit, and less than "
            f"{plan.share_above_max:.0%} of it above the maximum, is each shown at every station "
            f"at a risk of {plan.accept_risk:.1%}; {rule}"
        )
    if not judged:
        return rule
    stated = f"mean ≤ {limits.mean_tolerance_mm:g} mm and maximum ≤ {limits.max_tolerance_mm:g} mm"
    turns_deg = {each.max_tolerance_deg for each in judged.values() if each.max_tolerance_deg}
    stated += "".join(f", error of orientation ≤ {limit_deg:g}°" for limit_deg in turns_deg)
    return f"{stated}; {rule}"


def adjustment_words(facts: Facts) -> str:
    """Return which of the errors before and after adjustment this run measured."""
    series = [validation(facts.log, names) for names in places(facts.cell).values()]
    measured = {how for each in series for how in each}
    if set(BOTH) <= measured:
        return (
            "both are reported: “before” is the robot commanded by its nominal kinematics, "
            "“after” the same robot with corrected targets"
        )
    if measured:
        how = "before" if Sent.BEFORE in measured else "after"
        return f"only “{how}” was measured"
    if facts.procedure.used_in(facts.cell):
        return (
            "not both: targets were commanded with the correction of the calibration used, and "
            "measured as found"
        )
    return "neither was measured: this run sent no targets to compare"
