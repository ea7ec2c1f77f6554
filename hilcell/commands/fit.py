"""``fit``: measured rows and a robot in; figures, an identified arm and corrections out."""

from __future__ import annotations

import argparse
from pathlib import Path

from hilcell.calibration.fit import FitResult, methods_table
from hilcell.calibration.fit import fit as fit_rows
from hilcell.calibration.identified import identified
from hilcell.calibration.robot_file import Measurements, Robot, read_measurements, read_robot
from hilcell.calibration.urdf_file import read_urdf
from hilcell.cell.settings import SettingsError
from hilcell.commands.fit_targets import correct, job_of
from hilcell.commands.output import print_json, print_message, print_table

URDF = ".urdf"


def fit(args: argparse.Namespace) -> int:
    """Fit measured data, print how far each method's predictions are off, write what is asked."""
    robot = _robot(Path(args.robot), args.tip)
    train = read_measurements(Path(args.train))
    test = read_measurements(Path(args.test)) if args.test else None
    inputs = [Path(each) for each in (args.robot, args.train, args.test) if each]
    job = job_of(args, train, inputs)
    result = fit_rows(robot, train, test)
    more: dict[str, object] = {}
    if args.urdf_out or args.dh_out:
        more["rigid"] = _write_arm(args, robot, train, inputs)
    if job:
        more["corrected"] = correct(job, robot, identified(robot.arm(), train), train)
    if args.json:
        print_json({**result, **more})
    else:
        _print(result)
    return 0


def _write_arm(
    args: argparse.Namespace, robot: Robot, train: Measurements, inputs: list[Path]
) -> dict[str, float]:
    """Write the identified arm as URDF and DH table; return the figures of what it leaves."""
    from hilcell.calibration.arm_files import alone, write_dh, write_urdf
    from hilcell.calibration.rigid_arm import rigid_arm

    found = rigid_arm(robot.arm(), train)
    if args.urdf_out:
        remarks = [f"{len(train)} rows of {Path(args.train).name}.", *alone(found.figures)]
        write_urdf(Path(args.urdf_out), robot, found, remarks, inputs=inputs)
        inputs = [*inputs, Path(args.urdf_out)]
    if args.dh_out:
        write_dh(Path(args.dh_out), robot, found, inputs=inputs)
    written = " and ".join(filter(None, (args.urdf_out, args.dh_out)))
    print_message("\n".join([f"the identified arm is in {written}", *alone(found.figures)]))
    return {f"{name}_mm": value for name, value in found.figures._asdict().items()}


def _print(result: FitResult) -> None:
    print_table(methods_table(result["methods"]))
    print(
        f"chosen: {result['chosen']}; {result['train']} rows learnt from, {result['test']} judged"
    )


def _robot(path: Path, tip: str) -> Robot:
    """Read a robot by its file's suffix; raises `SettingsError`."""
    if path.suffix.lower() == URDF:
        return read_urdf(path, tip)
    if tip:
        raise SettingsError(str(path), [f"--tip {tip} names a link of a URDF; {URDF} is wanted"])
    return read_robot(path)
