"""``fit`` and ``compensate``: measured data, targets or programs in, figures or corrections out."""

from __future__ import annotations

import argparse
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from hilcell.calibration.file import compensate_targets, read_calibration
from hilcell.calibration.form import Calibration
from hilcell.calibration.validity import check_fitness
from hilcell.cell.file import Cell, load_cell
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.compensation.programs import Program, load_program, write_program
from hilcell.compensation.targets import read_targets, write_targets
from hilcell.journal.runs import CALIBRATION, find_run


def fit(args: argparse.Namespace) -> int:
    """Fit measured data and print how far each method's predictions are off."""
    from hilcell.calibration.fit import fit as fit_rows
    from hilcell.calibration.fit import methods_table
    from hilcell.calibration.robot_file import read_measurements, read_robot

    test = read_measurements(Path(args.test)) if args.test else None
    result = fit_rows(read_robot(Path(args.robot)), read_measurements(Path(args.train)), test)
    if args.json:
        print_json(result)
        return 0
    print_table(methods_table(result["methods"]))
    print(
        f"chosen: {result['chosen']}; {result['train']} rows learnt from, {result['test']} judged"
    )
    return 0


def compensate(args: argparse.Namespace) -> int:
    """Write corrected targets, or a corrected program, for one station."""
    where = Path(args.calibration)
    is_file = os.path.isfile(where)  # noqa: PTH113 - Path.is_file raises for a name too long
    path = where if is_file else find_run(args.runs, args.calibration) / CALIBRATION
    calibration = read_calibration(path)
    cell = load_cell(args.cell, dict(args.set)) if args.cell else None
    check_fitness(
        calibration,
        datetime.now(UTC),
        max_age_days=args.max_age,
        temperature_c=args.temperature,
        digest=cell.digest if cell else None,
    )
    source, out = Path(args.targets), Path(args.output)
    inputs = [source, path, Path(args.cell or source)]
    program = load_program(source)
    if program is None:
        count, written = _compensate_list(calibration, args.station, inputs, out)
    else:
        count, written = _compensate_program(calibration, args.station, program, inputs, out, cell)
    print_message(f"{count} targets corrected for {args.station} into {written}")
    if calibration.provenance.simulated:
        print_message(
            f"hilcell: SIMULATED: run {calibration.provenance.run} measured no real robot; the "
            "output is for trying out, not for a machine"
        )
    return 0


def _compensate_list(
    calibration: Calibration, station: str, inputs: list[Path], out: Path
) -> tuple[int, str]:
    names, targets = read_targets(inputs[0])
    command = compensate_targets(calibration, station, targets, names)
    write_targets(out, names, command, inputs=inputs)
    return len(names), str(out)


def _compensate_program(
    calibration: Calibration,
    station: str,
    program: Program,
    inputs: list[Path],
    out: Path,
    cell: Cell | None,
) -> tuple[int, str]:
    source = inputs[0]
    command = compensate_targets(calibration, station, program.values(), program.names)
    if cell is not None:
        T_W_B = np.array(calibration.stations[station].T_W_B)
        program.check_joints(cell.robot.arm(), T_W_B, command)
    elif program.needs_arm:
        print_message(f"{source.name}: {program.needs_arm} were not checked; --cell CELL does")
    written = write_program(program, command[:, :3], source, out, inputs=inputs)
    for note in program.notes:
        print_message(f"{source.name}: {note}")
    return len(program.names), " and ".join(map(str, written))
