"""How a run measured, in words, which model corrects, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter

from hilcell.calibration.errors import places, validation
from hilcell.calibration.frames import ORIENTED
from hilcell.compensation.choice import MODELS
from hilcell.compensation.kinematic import Kinematic
from hilcell.geometry.statistics import Figures
from hilcell.model.events import PosesChosen
from hilcell.model.point import BOTH, Sent
from hilcell.model.verdicts import Fitted
from hilcell.present.table import Column, Table
from hilcell.report.facts import Facts


def method_words(facts: Facts) -> str:
    """Return how a validated correction was found, from its journal."""
    log, here = facts.log, facts.cell.grid.station
    poses, touched = len(log.select("pose")), log.select("touch")
    measured = (
        f"{_measured(facts)} measured by laser tracker at "
        f"{len(log.select('grid'))} vertices of a grid at {here}"
    )
    if turned := len(log.select(ORIENTED)):
        measured += f", at {turned} in other orientations"
    if poses:
        measured += f" and at {poses} poses chosen by the errors found there"
    found = [measured]
    if log.curves:
        used = _used(log.verdict(Fitted))
        found.append(f"each gear's error by slow sweeps of {_axes(log.curves)}{used}")
    model = facts.log.method
    found.append(MODELS[model].text if model in MODELS else "corrected")
    if len(facts.cell.station) > 1:
        found.append("transferred to the other stations by station frames")
    if touched:
        stations = ", ".join(sorted({point.station for point in touched}))
        found.append(f"the base found again by touch poses on the visit of {stations}")
    return "; ".join([*found, "validated on targets sent and measured."])


def _measured(facts: Facts) -> str:
    """Return which errors of the tool were measured, and by how many reflectors."""
    count = len(facts.cell.robot.seats_mm)
    if count == 1:
        return "Position errors of the flange reflector"
    return f"Position and orientation errors of the tool, by {count} reflectors on the flange,"


def _axes(curves: Mapping[int, object]) -> str:
    return ("axes " if len(curves) > 1 else "axis ") + ", ".join(map(str, sorted(curves)))


def _used(fit: Fitted | None) -> str:
    used = fit is not None and fit.curves.used and fit.method == Kinematic.name
    return "" if used else " (not used)"


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


Missed = tuple[str, Mapping[str, float]]


def _miss(figure: str) -> Callable[[Missed], float | None]:
    return lambda row: row[1].get(figure)


def models(facts: Facts) -> Table:
    """Return how far each model misses poses left out, which one was chosen, and why."""
    fit = facts.log.verdict(Fitted)
    columns: tuple[Column[Missed], ...] = (
        Column("model", itemgetter(0)),
        *(Column(name, _miss(name), "mm", ".3f") for name in Figures._fields),
    )
    if fit is None:
        return Table(columns, (), "Choice of the correction")
    rows = [
        (f"{name}, chosen" if name == fit.method else name, figures)
        for name, figures in fit.loocv.items()
    ]
    reasons = [f"Chosen: {fit.reason}."]
    reasons += [f"No {name} model: {why}." for name, why in fit.refused.items()]
    reasons += [f"Curves of the axis sweeps: {fit.curves.reason}."] if fit.curves.reason else []
    unswept = facts.result.get("sweeps", {}).get("left_out", "")
    reasons += [f"Axes not swept: {unswept}."] if unswept else []
    return Table(columns, rows, "Choice of the correction", " ".join(reasons))


def chosen_poses_words(facts: Facts, chosen: PosesChosen) -> str:
    """Return how many poses were chosen beside the grid, and why no more."""
    plan, count, bounds_mm = facts.cell.plan, len(chosen.joints_deg), chosen.bounds_mm
    if not bounds_mm:
        return "none"
    course = f"{bounds_mm[0]:.3f} mm"
    if count:
        course += f" to {bounds_mm[-1]:.3f} mm"
    if plan.tilt_deg:
        why = f"{count} are measured for targets that turn by {plan.tilt_deg:g}° (plan.tilt_poses)"
    elif bounds_mm[-1] <= plan.bound_mm:
        why = f"{plan.bound_mm:g} mm are reached"
    elif count >= plan.most_poses:
        why = f"{plan.most_poses} are the most (plan.most_poses)"
    else:
        why = f"more would gain little towards {plan.bound_mm:g} mm"
    return f"{count} poses: predicted mean 95 % bound in the cube {course}; no more, because {why}"
