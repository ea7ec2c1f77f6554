"""``fit``: measured rows and a robot in; figures, an identified arm and corrections out."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

from hilcell.cell.settings import SettingsError
from hilcell.commands.fit_targets import correct, job_of
from hilcell.commands.output import print_data, print_json, print_message, print_table
from hilcell.commands.output_place import CSV, check_output
from hilcell.fit.fitted_arm import FittedArm
from hilcell.fit.methods import FitResult, Fitted, fitted, methods_table
from hilcell.fit.robot_file import Measurements, Robot, read_measurements, read_robot
from hilcell.fit.urdf_file import read_urdf

URDF = ".urdf"
NAMED = 10  # rows that are left out
MANY = 0.1  # share of rows left out beyond which they are no single slips


def fit(args: argparse.Namespace) -> int:
    """Fit measured data, print how far each method's predictions are off, write what is asked."""
    robot = _robot(Path(args.robot), args.tip)
    train = read_measurements(Path(args.train))
    test = read_measurements(Path(args.test)) if args.test else None
    if test is not None:
        _warn_of_shared(train, test)
    inputs = [Path(each) for each in (args.robot, args.train, args.test) if each]
    job = job_of(args, train, inputs)
    found = fitted(robot, train, test)
    more: dict[str, object] = {}
    if args.urdf_out or args.dh_out:
        more["rigid"] = _write_arm(args, robot, found, inputs)
    if job:
        more["corrected"] = correct(job, robot, found, train)
    if args.json:
        print_json({**found.result, **_covariance(found), **more})
    else:
        _print(found.result)
    _warn_of_many(found.result)
    return 0


def _covariance(fit: Fitted) -> dict[str, list[list[float]]]:
    """Return the covariance of the parameters of ``model``, in the order of their names."""
    arm = fit.methods[fit.result["model"]["method"]] if fit.result["model"] else None
    if not isinstance(arm, FittedArm):
        return {}
    return {"covariance": arm.estimate.system.covariance.tolist()}


def _write_arm(
    args: argparse.Namespace, robot: Robot, fit: Fitted, inputs: list[Path]
) -> dict[str, float]:
    """Write the identified arm as URDF and DH table; return the figures of what it leaves."""
    from hilcell.fit.arm_files import alone, write_dh, write_urdf
    from hilcell.fit.rigid_arm import rigid_arm

    if args.urdf_out:
        check_output(Path(args.urdf_out), (URDF, ".xml"), "a URDF", inputs=inputs)
    if args.dh_out:
        check_output(Path(args.dh_out), (*CSV, ".json"), "a DH table", inputs=inputs)
    found = rigid_arm(robot.arm(), fit)
    if args.urdf_out:
        remarks = [f"{fit.result['train']} rows of {Path(args.train).name}.", *alone(found.figures)]
        write_urdf(Path(args.urdf_out), robot, found, remarks, inputs=inputs)
        inputs = [*inputs, Path(args.urdf_out)]
    if args.dh_out:
        write_dh(Path(args.dh_out), robot, found, inputs=inputs)
    written = " and ".join(filter(None, (args.urdf_out, args.dh_out)))
    print_message("\n".join([f"the identified arm is in {written}", *alone(found.figures)]))
    return {f"{name}_mm": value for name, value in found.figures._asdict().items()}


def _print(result: FitResult) -> None:
    print_table(methods_table(result["methods"]))
    print_data(
        f"chosen: {result['chosen']}; {result['train']} rows learnt from, {result['test']} judged"
    )
    print_data(result["reason"])
    for reason in sorted(set(result["refused"].values())):
        print_message(f"no robot is identified: {reason}")
    for bad in result["outliers"][:NAMED]:
        print_message(
            f"pose {bad['pose']} target {bad['target']} contradicts the others by "
            f"{bad['miss_mm']:.4g} mm and is left out"
        )
    if len(result["outliers"]) > NAMED:
        print_message(f"and {len(result['outliers']) - NAMED} more")
    inside = result["coverage"].get(result["chosen"])
    if inside:
        print_data(
            f"{inside['share']:.1%} of them within 95 % bounds of {inside['bound_mm']:.3f} mm mean"
        )


def _warn_of_many(result: FitResult) -> None:
    """Say where to look when more rows are left out than slips explain."""
    struck = Counter(bad["target"] for bad in result["outliers"])
    if struck.total() <= MANY * result["train"]:
        return
    target, own = struck.most_common(1)[0]
    look = "the robot's and the tracker's state during the measurement"
    if 2 * own > struck.total():
        look = f"reflector {target}, {own} of them: it may have moved on the flange"
    print_message(
        f"warning: {struck.total()} of {result['train']} training rows are left out, wanted at "
        f"most {MANY:.0%}; bounds may be too small; look at {look}, and measure again"
    )


def _warn_of_shared(train: Measurements, test: Measurements) -> None:
    """Warn of test rows that were learnt from: they judge nothing."""
    learnt, judged = (
        set(map(tuple, np.column_stack([each.xyz_mm, each.joints_rad]).tolist()))
        for each in (train, test)
    )
    if shared := len(learnt & judged):
        print_message(
            f"warning: {shared} rows of {test.source} are training rows too; a test needs rows "
            "that nothing was learnt from: leave them out, or leave --test away"
        )


def _robot(path: Path, tip: str) -> Robot:
    """Read a robot by its file's suffix; raises `SettingsError`."""
    if path.suffix.lower() == URDF:
        return read_urdf(path, tip)
    if tip:
        raise SettingsError(str(path), [f"--tip {tip} names a link of a URDF; {URDF} is wanted"])
    return read_robot(path)
