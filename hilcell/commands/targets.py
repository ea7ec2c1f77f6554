"""``plan``, ``prepare``, ``compensate`` and ``fit``: plan holes, correct targets and programs."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hilcell.atomic_files import CSV, check_output, write_whole
from hilcell.calibration.tool_point import tip_named
from hilcell.cell.devices import load_measured
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.commands.console import print_data, print_json, print_message, print_table
from hilcell.commands.signatures import Compensate, Fit, Plan, Prepare
from hilcell.compensation.model_choice import NOMINAL
from hilcell.compensation.targets import as_listed, write_rows
from hilcell.errors import bounded
from hilcell.fit.columns import read_names
from hilcell.fit.measurements import Measurements, read_measurements
from hilcell.fit.methods import (
    FitResult,
    FittedArm,
    Outlier,
    RobotFit,
    fit_robot,
    in_mm,
    methods_table,
)
from hilcell.fit.robot_file import Robot
from hilcell.fit.urdf_file import URDF, read_robot
from hilcell.geometry.statistics import LEAST_BOUNDED
from hilcell.identification.measured_poses import turn_middles
from hilcell.language import of_environment
from hilcell.present.table import Table, listed
from hilcell.programs.corrected import UsableCalibration
from hilcell.programs.holes import read_holes
from hilcell.programs.plan import HolePlan, Volume, ratio
from hilcell.programs.plan import plan as plan_holes
from hilcell.programs.pose_correction import ArmTargets
from hilcell.programs.station_jobs import StationJobs
from hilcell.programs.target_jobs import StationTargets


def prepare(args: Prepare) -> int:
    """Plan the holes within the calibration's volume, correct them, and write all files."""
    check_settings(args.cell, dict(args.settings))
    jobs = StationJobs.plan(
        load_measured(args.cell, dict(args.settings)),
        args.calibration,
        Path(args.holes),
        args.release,
        tool=args.tool,
        standoff_mm=args.standoff,
        say=print_message,
    )
    messages = jobs.write(Path(args.output), [Path(args.cell)], of_environment(os.environ))
    if args.json:
        print_json(jobs.summary)
    else:
        print_table(jobs.table)
    print_message("\n".join(messages))
    return 0


def plan(args: Plan) -> int:
    """Print the fewest stations for the holes, and their orders with a lower bound on travel."""
    cell = load_measured(args.cell, dict(args.settings))
    volume = _calibrated_volume(args, cell)
    holes = read_holes(Path(args.holes), tip_named(cell, args.tool).T_D_T)
    for warning in holes.warnings:
        print_message(warning)
    planned = plan_holes(cell, holes, free=args.free, calibrated=volume, say=print_message)
    if args.output:
        out, inputs = Path(args.output), [Path(args.holes), Path(args.cell)]
        check_output(out, CSV, "a list", inputs=inputs)
        rows = (
            [each.station.name, str(order), name]
            for each in planned.stations
            for order, name in enumerate(each.holes, start=1)
        )
        write_rows(out, ["station", "order", "name"], rows, inputs=inputs)
    if args.json:
        print_json(_plan_facts(planned))
    else:
        _print_plan(cell, planned)
    return 0


def _calibrated_volume(args: Plan, cell: Cell) -> Volume | None:
    """Return the volume of the given calibration; refuses what `compensate` refuses."""
    if not args.calibration:
        print_message("planned without a calibration; --calibration RUN plans within its volume")
        return None
    if args.free:
        raise SettingsError("--free", ["cannot be combined with --calibration"])
    usable = UsableCalibration.named(args.calibration, args.release, cell)
    for note in usable.notes():
        print_message(note)
    return Volume(usable.calibration)


def _plan_facts(planned: HolePlan) -> dict[str, object]:
    def travel(travel_mm: float, bound_mm: float) -> dict[str, object]:
        return {"travel_mm": travel_mm, "bound_mm": bound_mm, "ratio": ratio(travel_mm, bound_mm)}

    stations = [
        {
            "name": each.station.name,
            "rail_mm": each.station.rail_mm,
            "holes": each.holes,
            "targets": as_listed(each.poses).tolist(),  # x, y, z, a, b, c in {W}, in the same order
            **travel(each.travel_mm, each.travel_bound_mm),
        }
        for each in planned.stations
    ]
    unreached: list[str] = []  # a plan that misses holes is refused
    total = travel(planned.travel_mm, planned.travel_bound_mm)
    return {"stations": stations, **total, "unreached": unreached}


def _print_plan(cell: Cell, planned: HolePlan) -> None:
    rows: list[tuple[str, float | None, int, float, float]] = [
        (
            each.station.name,
            each.station.rail_mm,
            len(each.holes),
            each.travel_mm,
            each.travel_bound_mm,
        )
        for each in planned.stations
    ]
    count = sum(row[2] for row in rows)
    rows.append(("all", None, count, planned.travel_mm, planned.travel_bound_mm))
    columns = listed(
        "station", ("rail", "mm", ".2f"), ("holes", "", "d"), ("travel", "mm", ".1f"),
        ("lower bound", "mm", ".1f"), ("ratio", "", ".4f"),
    )  # fmt: skip
    print_table(Table(columns, [(*row, ratio(row[3], row[4])) for row in rows]))
    new = [each.station.name for each in planned.stations if each.station not in cell.station]
    if new:
        print_message(f"not in the cell file: {', '.join(new)}; add them with their strip readings")


def compensate(args: Compensate) -> int:
    check_settings(args.cell, dict(args.settings))
    job = StationTargets.plan(
        load_measured(args.cell, dict(args.settings)) if args.cell else None,
        args.calibration,
        Path(args.targets),
        args.release,
        station=args.station,
        tool=args.tool,
        strokes=(args.allow_stroke, args.stroke_tolerance),
        say=print_message,
    )
    bounds = Path(args.bounds) if args.bounds else None
    messages = job.write(Path(args.output), bounds, [Path(args.cell)] if args.cell else [])
    if args.json:
        print_json(job.summary)
    print_message("\n".join(messages))
    return 0


def check_settings(cell: str | None, settings: dict[str, str]) -> None:
    """Refuse settings without effect; raises `SettingsError`."""
    if settings and not cell:
        raise SettingsError("--set", ["requires --cell CELL"])
    drill = "uncertainty.drill_offset_mm"
    unused = [
        f"{key}: the calibration has its own budget; of the cell's only {drill} is used"
        for key in settings
        if key.startswith("uncertainty.") and key != drill
    ]
    if unused:
        raise SettingsError("--set", unused)


def fit(args: Fit) -> int:
    """Fit measured data, print the prediction errors of each method, write the given files."""
    robot = read_robot(args.robot, args.tip, args.base, float(args.coupling))
    columns = read_names(args.columns) if args.columns else {}
    train = _read(Path(args.train), columns, robot)
    test = _read(Path(args.test), columns, robot) if args.test else None
    if test is not None:
        _warn_of_shared(train, test)
    inputs = [Path(each) for each in (args.robot, args.train, args.test) if each]
    tool = _tool(args, train)
    if args.correct:
        inputs.append(Path(args.correct))
    fitted = fit_robot(robot, train, test)
    for rows in filter(None, (train, test)):
        _tell_of_turns(robot, train, rows)
    _check_arm(args, inputs)  # all is planned before a file is written
    more: dict[str, object] = {}
    if args.correct:
        job = ArmTargets.plan(fitted, Path(args.correct), tool=tool, say=print_message)
        bounds = Path(args.bounds) if args.bounds else None
        print_message("\n".join(job.write(Path(args.output), bounds, inputs)))
        more["corrected"] = job.summary
        inputs.append(Path(args.output))
    if args.urdf_out or args.dh_out:
        more["rigid"] = _write_arm(args, fitted, inputs)
    if args.json:
        covariance: dict[str, object] = {}
        arm = fitted.methods[fitted.result["model"]["method"]] if fitted.result["model"] else None
        if isinstance(arm, FittedArm):  # in the order of the parameters' names in ``model``
            covariance["covariance"] = arm.found.covariance.tolist()
        print_json({**fitted.result, **covariance, **more})
    else:
        _print_fit(fitted.result)
    return 0


def _tool(args: Fit, train: Measurements) -> str:
    """Return the reflector that is the tool point of targets; raises `SettingsError`."""
    if not args.correct:
        if args.output or args.bounds:
            raise SettingsError("fit", ["--output and --bounds require --correct TARGETS"])
        return ""
    if not args.output:
        raise SettingsError("fit", ["--correct requires --output OUT"])
    names = sorted(set(train.target))
    if not args.tool and len(names) > 1:
        raise SettingsError("fit", [f"expected --tool with one of {', '.join(names)}"])
    tool = args.tool or names[0]
    if tool not in names:
        raise SettingsError("fit", [f"--tool: expected one of {', '.join(names)}, got {tool}"])
    return tool


def _check_arm(args: Fit, inputs: list[Path]) -> None:
    if args.urdf_out:
        check_output(Path(args.urdf_out), (URDF, ".xml"), "a URDF", inputs=inputs)
    if args.dh_out:
        check_output(Path(args.dh_out), (*CSV, ".json"), "a DH table", inputs=inputs)


def _write_arm(args: Fit, fit: RobotFit, inputs: list[Path]) -> dict[str, float]:
    """Write the identified arm as URDF and DH table; return its residuals in mm."""
    from hilcell.fit.rigid_arm import alone, rigid_arm, urdf_bytes, write_dh

    arm = rigid_arm(fit)
    if args.urdf_out:
        remarks = [f"{fit.result['train']} rows of {Path(args.train).name}.", *alone(arm.figures)]
        write_whole(Path(args.urdf_out), urdf_bytes(fit.robot, arm, remarks), inputs=inputs)
        inputs = [*inputs, Path(args.urdf_out)]
    if args.dh_out:
        write_dh(Path(args.dh_out), fit.robot, arm, inputs=inputs)
    written = " and ".join(filter(None, (args.urdf_out, args.dh_out)))
    print_message("\n".join([f"the identified arm is in {written}", *alone(arm.figures)]))
    if fit.chosen == NOMINAL:
        print_message(
            f"warning: that arm is no better than the nominal one: {fit.result['reason']}"
        )
    return in_mm(arm.figures)


def _print_fit(result: FitResult) -> None:
    print_table(methods_table(result["methods"]))
    print_data(
        f"chosen: {result['chosen']}; {result['train']} of {result['rows']} training rows kept, "
        f"{result['test']} rows judged"
    )
    print_data(result["reason"])
    for reason in sorted(set(result["refused"].values())):
        names = [name for name, why in result["refused"].items() if why == reason]
        print_message(f"left out: {', '.join(names)}: {reason}")
    for what, rows in (("excluded", result["outliers"]), ("judged", result["test_outliers"])):
        for line in bounded(_outlier(row, what) for row in rows):
            print_message(line)
    undetermined = (
        f"undetermined: pose {row['pose']} target {row['target']} has a 95 % bound of "
        f"{row['bound_mm']:.4g} mm, over {result['undetermined_mm']:.3g} mm, and is not judged"
        for row in result["undetermined"]
    )
    for line in bounded(undetermined):
        print_message(line)
    if inside := result["coverage"].get(result["chosen"]):
        print_data(
            f"{inside['share']:.1%} of them within 95 % bounds, mean {inside['bound_mm']:.3f} mm"
        )
    elif result["train"] < LEAST_BOUNDED:
        print_message(
            f"no 95 % bound: {result['train']} training rows, expected at least {LEAST_BOUNDED}"
        )


def _outlier(row: Outlier, what: str) -> str:
    named = "outlier" if what == "excluded" else "outlier of the test rows"
    anchor = f" anchor {row['anchor']}" if row["anchor"] else ""
    at = f"pose {row['pose']} target {row['target']}{anchor}"
    return f"{named}: {at} is off by {row['miss_mm']:.4g} mm and {what}"


def _read(path: Path, columns: Mapping[str, str], robot: Robot) -> Measurements:
    """Read measured rows, each distinct one once."""
    rows = read_measurements(path, columns, robot=robot, say=print_message)
    once = rows.once()
    if copies := len(rows) - len(once):
        print_message(
            f"warning: {copies} of {len(rows)} rows of {rows.source} repeat others exactly; equal "
            "rows count once"
        )
    return once


def _tell_of_turns(robot: Robot, train: Measurements, rows: Measurements) -> None:
    middles_rad = turn_middles(train.joints_rad, robot.arm.turning != 0.0)
    by_rad, usual_rad = (
        each.joints_rad - each.within_turns(middles_rad).joints_rad for each in (rows, train)
    )
    turned = np.abs(by_rad - np.median(usual_rad, axis=0)) > 1.0
    for joint in np.flatnonzero(turned.any(axis=0)):
        print_message(
            f"joint {joint + 1} of {rows.source}: {turned[:, joint].sum()} of {len(rows)} rows are "
            "a whole turn from most training rows; its errors are taken to repeat each turn"
        )


def _warn_of_shared(train: Measurements, test: Measurements) -> None:
    training, testing = (
        set(map(tuple, np.column_stack([each.xyz_mm, each.joints_rad]).tolist()))
        for each in (train, test)
    )
    if shared := len(training & testing):
        print_message(
            f"warning: {shared} rows of {test.source} are training rows too; a test needs "
            "independent rows"
        )
