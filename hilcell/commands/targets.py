"""``compensate`` and ``fit``: correct targets or programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hilcell.atomic_files import CSV, check_output
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.commands.console import print_data, print_json, print_message, print_table
from hilcell.commands.signatures import Compensate, Fit
from hilcell.errors import bounded
from hilcell.fit.methods import FitResult, FittedArm, RobotFit, fit_robot, in_mm, methods_table
from hilcell.fit.robot_file import Measurements, read_measurements
from hilcell.fit.urdf_file import URDF, read_robot
from hilcell.programs.pose_correction import ArmTargets
from hilcell.programs.target_jobs import StationTargets


def compensate(args: Compensate) -> int:
    """Write corrected targets, or a corrected program, for one station."""
    check_settings(args.cell, dict(args.settings))
    job = StationTargets.plan(
        load_cell(args.cell, dict(args.settings)) if args.cell else None,
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
    robot = read_robot(args.robot, args.tip)
    train = _read(Path(args.train))
    test = _read(Path(args.test)) if args.test else None
    if test is not None:
        _warn_of_shared(train, test)
    inputs = [Path(each) for each in (args.robot, args.train, args.test) if each]
    tool = _tool(args, train)
    if args.correct:
        inputs.append(Path(args.correct))
    fitted = fit_robot(robot, train, test)
    more: dict[str, object] = {}
    if args.urdf_out or args.dh_out:
        more["rigid"] = _write_arm(args, fitted, inputs)
    if args.correct:
        job = ArmTargets.plan(fitted, Path(args.correct), tool=tool, say=print_message)
        bounds = Path(args.bounds) if args.bounds else None
        print_message("\n".join(job.write(Path(args.output), bounds, inputs)))
        more["corrected"] = job.summary
    if args.json:
        covariance: dict[str, object] = {}
        arm = fitted.methods[fitted.result["model"]["method"]] if fitted.result["model"] else None
        if isinstance(arm, FittedArm):  # in the order of the parameters' names in ``model``
            covariance["covariance"] = arm.estimate.system.covariance.tolist()
        print_json({**fitted.result, **covariance, **more})
    else:
        _print(fitted.result)
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


def _write_arm(args: Fit, fit: RobotFit, inputs: list[Path]) -> dict[str, float]:
    """Write the identified arm as URDF and DH table; return its residuals in mm."""
    from hilcell.fit.rigid_arm import alone, rigid_arm, write_dh, write_urdf

    if args.urdf_out:
        check_output(Path(args.urdf_out), (URDF, ".xml"), "a URDF", inputs=inputs)
    if args.dh_out:
        check_output(Path(args.dh_out), (*CSV, ".json"), "a DH table", inputs=inputs)
    arm = rigid_arm(fit)
    if args.urdf_out:
        remarks = [f"{fit.result['train']} rows of {Path(args.train).name}.", *alone(arm.figures)]
        write_urdf(Path(args.urdf_out), fit.robot, arm, remarks, inputs=inputs)
        inputs = [*inputs, Path(args.urdf_out)]
    if args.dh_out:
        write_dh(Path(args.dh_out), fit.robot, arm, inputs=inputs)
    written = " and ".join(filter(None, (args.urdf_out, args.dh_out)))
    print_message("\n".join([f"the identified arm is in {written}", *alone(arm.figures)]))
    return in_mm(arm.figures)


def _print(result: FitResult) -> None:
    print_table(methods_table(result["methods"]))
    print_data(
        f"chosen: {result['chosen']}; {result['train']} training rows, {result['test']} test rows"
    )
    print_data(result["reason"])
    for reason in sorted(set(result["refused"].values())):
        print_message(f"no robot is identified: {reason}")
    outliers = (
        f"outlier: pose {bad['pose']} target {bad['target']} is off by {bad['miss_mm']:.4g} mm and "
        "excluded"
        for bad in result["outliers"]
    )
    for line in bounded(outliers):
        print_message(line)
    if inside := result["coverage"].get(result["chosen"]):
        print_data(
            f"{inside['share']:.1%} of them within 95 % bounds, mean {inside['bound_mm']:.3f} mm"
        )


def _read(path: Path) -> Measurements:
    """Read measured rows, each distinct one once."""
    rows = read_measurements(path)
    once = rows.once()
    if copies := len(rows) - len(once):
        print_message(
            f"warning: {copies} of {len(rows)} rows of {rows.source} repeat others exactly; equal "
            "rows count once"
        )
    return once


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
