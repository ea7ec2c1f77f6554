"""``fit``: measured rows and a robot in; figures, an identified arm and corrections out."""

from __future__ import annotations

import argparse
from pathlib import Path

from hilcell.calibration.robot_file import Robot, read_measurements, read_robot
from hilcell.calibration.urdf_file import read_urdf
from hilcell.cell.settings import SettingsError
from hilcell.commands.output import print_json, print_table

URDF = ".urdf"


def fit(args: argparse.Namespace) -> int:
    """Fit measured data and print how far each method's predictions are off."""
    from hilcell.calibration.fit import fit as fit_rows
    from hilcell.calibration.fit import methods_table

    robot = _robot(Path(args.robot), args.tip)
    test = read_measurements(Path(args.test)) if args.test else None
    result = fit_rows(robot, read_measurements(Path(args.train)), test)
    if args.json:
        print_json(result)
        return 0
    print_table(methods_table(result["methods"]))
    print(
        f"chosen: {result['chosen']}; {result['train']} rows learnt from, {result['test']} judged"
    )
    return 0


def _robot(path: Path, tip: str) -> Robot:
    """Read a robot by its file's suffix; raises `SettingsError`."""
    if path.suffix.lower() == URDF:
        return read_urdf(path, tip)
    if tip:
        raise SettingsError(str(path), [f"--tip {tip} names a link of a URDF; {URDF} is wanted"])
    return read_robot(path)
