"""``fit`` and ``compensate``: measured data in, figures or corrected targets out."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hilcell.calibration_file import NAME, compensate_targets, read_calibration
from hilcell.commands.common import say
from hilcell.faces import print_table
from hilcell.runs import find_run
from hilcell.targets import read_targets, write_targets


def fit(args: argparse.Namespace) -> int:
    """Fit measured data and print how far each method's predictions are off."""
    from hilcell.fit import fit as fit_rows
    from hilcell.robotfile import read_measurements, read_robot

    test = read_measurements(Path(args.test)) if args.test else None
    result = fit_rows(read_robot(Path(args.robot)), read_measurements(Path(args.train)), test)
    if args.json:
        say(result, "", as_json=True)
        return 0
    rows = [
        [name, *(f"{figures[key]:.4f}" for key in ("mean_mm", "p95_mm", "max_mm"))]
        for name, figures in result["methods"].items()
    ]
    print_table((["method", "mean mm", "p95 mm", "max mm"], rows))
    print(
        f"chosen: {result['chosen']}; {result['train']} rows learnt from, {result['test']} judged"
    )
    return 0


def compensate(args: argparse.Namespace) -> int:
    """Write corrected targets for one station."""
    where = Path(args.calibration)
    path = where if where.is_file() else find_run(args.runs, args.calibration) / NAME
    names, targets = read_targets(Path(args.targets))
    command = compensate_targets(read_calibration(path), args.station, targets, names)
    write_targets(Path(args.output), names, command)
    print(f"{len(names)} targets corrected for {args.station} into {args.output}", file=sys.stderr)
    return 0
