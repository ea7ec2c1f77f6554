"""``fit``: measured rows and a robot in; figures, an identified arm and corrections out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hilcell.calibration.form import written_now
from hilcell.calibration.influence import bounds_of
from hilcell.calibration.programs import POSTURE_BITS, check_posture
from hilcell.cell.settings import SettingsError
from hilcell.commands.bounds import summary, write_bounds
from hilcell.commands.orders import Fit
from hilcell.commands.output import print_data, print_json, print_message, print_table
from hilcell.commands.output_place import CSV, check_output
from hilcell.compensation.choice import NOMINAL
from hilcell.compensation.programs import (
    Program,
    load_program,
    notes_of,
    statuses_of,
    write_program,
)
from hilcell.compensation.stamp import Stamp
from hilcell.fit.fitted_arm import FittedArm
from hilcell.fit.methods import UNDETERMINED_MM, FitResult, Fitted, fitted, in_mm, methods_table
from hilcell.fit.placement import FitError
from hilcell.fit.robot_file import Measurements, Robot, read_measurements, read_robot
from hilcell.fit.robot_targets import (
    MOST_KNOWN,
    Reach,
    RobotTargets,
    read_robot_targets,
    refuse,
    targets_of,
    with_tool_point,
    write_joints,
    write_poses,
)
from hilcell.fit.tool_errors import controller_of
from hilcell.fit.urdf_file import read_urdf
from hilcell.geometry.closed_form import ReachError, status_of
from hilcell.geometry.frames import zyx_from_pose
from hilcell.ports import Array

URDF = ".urdf"
NAMED = 10  # rows that are left out


def fit(args: Fit) -> int:
    """Fit measured data, print how far each method's predictions are off, write what is asked."""
    robot = _robot(Path(args.robot), args.tip)
    train = _read(Path(args.train))
    test = _read(Path(args.test)) if args.test else None
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
    return 0


def _covariance(fit: Fitted) -> dict[str, list[list[float]]]:
    """Return the covariance of the parameters of ``model``, in the order of their names."""
    arm = fit.methods[fit.result["model"]["method"]] if fit.result["model"] else None
    if not isinstance(arm, FittedArm):
        return {}
    return {"covariance": arm.estimate.system.covariance.tolist()}


def _write_arm(args: Fit, robot: Robot, fit: Fitted, inputs: list[Path]) -> dict[str, float]:
    """Write the identified arm as URDF and DH table; return the figures of what it leaves."""
    from hilcell.fit.rigid_arm import alone, rigid_arm, write_dh, write_urdf

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
    return in_mm(found.figures)


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


def _read(path: Path) -> Measurements:
    """Read measured rows; a copy of another row is no measurement, and counts once."""
    rows = read_measurements(path)
    once = rows.once()
    if copies := len(rows) - len(once):
        print_message(
            f"warning: {copies} of {len(rows)} rows of {rows.source} repeat another exactly: its "
            "target, joints and position; equal rows count once"
        )
    return once


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


# -- targets that ``fit`` corrects: a list of poses or joints, or a robot program ------------------

ROOT = "the robot's root frame"  # that poses of `fit` are in
MARGIN_RAD = np.radians(5.0)  # beyond the measured joints that still counts as within


@dataclass(frozen=True, eq=False)
class Job:
    """Targets to correct, their tool point, and the files to write."""

    source: Path
    out: Path
    bounds: Path | None
    tool: str
    train: str
    inputs: list[Path]


def job_of(args: Fit, train: Measurements, inputs: list[Path]) -> Job | None:
    """Return what the command line asks for, or nothing; raises `SettingsError`."""
    if not args.correct:
        if args.output or args.bounds:
            raise SettingsError("fit", ["--output and --bounds want --correct TARGETS"])
        return None
    if not args.output:
        raise SettingsError("fit", ["--correct wants --output OUT"])
    names = sorted(set(train.target))
    if not args.tool and len(names) > 1:
        raise SettingsError("fit", [f"--tool says which is the tool point: {', '.join(names)}"])
    tool = args.tool or names[0]
    if tool not in names:
        raise SettingsError("fit", [f"--tool {tool}: measured were {', '.join(names)}"])
    source = Path(args.correct)
    bounds = Path(args.bounds) if args.bounds else None
    return Job(source, Path(args.output), bounds, tool, Path(args.train).name, [*inputs, source])


def correct(job: Job, robot: Robot, found: Fitted, train: Measurements) -> dict[str, object]:
    """Correct the targets by the chosen method and write them.

    Prints a summary, and returns it with the targets' frames. Raises `HilcellError`.
    """
    chosen = found.result["chosen"]
    if chosen == NOMINAL:
        raise FitError(f"no target is corrected: {found.result['reason']}")
    method = found.methods[chosen]
    controller = controller_of(robot, method, train, job.tool)
    arm = with_tool_point(replace(robot.arm(), tool=robot.tool), controller.tool_mm)
    known = np.unique(train.joints_rad, axis=0)
    known = known[:: len(known) // MOST_KNOWN + 1]
    reach = Reach(arm, robot.base, known, robot.limits_rad)
    program = load_program(job.source)
    if program is None:
        targets, as_joints = read_robot_targets(job.source, reach)
    else:
        targets, as_joints = targets_of(program.names, program.values(), reach), False
    errors = controller.errors(method, targets.joints_rad)
    command = targets.corrected(errors.error_mm)
    bounds = bounds_of(errors.covariance_mm2, [], np.eye(4), targets.poses)
    refuse(
        ~(bounds.radii_mm <= UNDETERMINED_MM),
        targets.names,
        f"targets have 95 % bounds over {UNDETERMINED_MM:g} mm",
        "the training rows do not determine them; measure poses near them",
    )
    joints = reach.near(command, targets.joints_rad, targets.names) if as_joints else None
    if program is not None:
        _refuse_unchecked(program, job.source)
        _check_posture(program, reach, targets.joints_rad, job.source.name)
    if program is not None and program.needs_arm:
        _check_program(program, reach, command, job.source.name)
    inputs = job.inputs
    if program is None:
        check_output(job.out, CSV, "a list", inputs=inputs)
    else:
        check_output(job.out, tuple(program.suffixes), "a program", inputs=inputs)
    if job.bounds:
        write_bounds(job.bounds, bounds, targets.names, job.out, inputs=inputs)
        inputs = [*inputs, job.bounds]
    written, stamp = [job.out], Stamp(f"fit of {job.train}", written_now())
    if program is not None:
        written = write_program(
            program, command[:, :3, 3], job.source, job.out, stamp=stamp, inputs=inputs
        )
    elif joints is not None:
        write_joints(job.out, targets.names, joints, stamp=stamp, inputs=inputs)
    else:
        write_poses(job.out, targets.names, command, stamp=stamp, inputs=inputs)
    for note in notes_of(program, ROOT, job.source, written) if program else ():
        print_message(f"{job.source.name}: {note}")
    where = " ".join(f"{each:.4f}" for each in controller.tool_mm)
    print_message(
        f"{len(targets.names)} targets of {job.tool} (tool point {where} mm) corrected into "
        + " and ".join(map(str, written))
    )
    print_message(summary(bounds, targets.names))
    print_message("keep the stamp in the file: corrected targets are known by it alone")
    _warn_outside(targets, train)
    return {
        "targets": len(targets.names),
        "tool": job.tool,
        "tool_mm": controller.tool_mm.tolist(),
        "root_in_tracker": controller.root.tolist(),
        "bound95_median_mm": float(np.median(bounds.radii_mm)),
        "bound95_max_mm": float(bounds.radii_mm.max()),
    }


def _refuse_unchecked(program: Program, source: Path) -> None:
    """Refuse what only a calibration can judge: strokes, and a base that is not the root."""
    problems = [
        f"{each.where}: strokes are corrected by `compensate` alone" for each in program.strokes
    ]
    if program.base is not None and any(program.base.values):
        problems.append(f"{program.base.where}: the base set there is not {ROOT}")
    if problems:
        raise SettingsError(str(source), problems)


def _check_posture(program: Program, reach: Reach, joints_rad: Array, name: str) -> None:
    """Refuse targets in another posture than the joints (N, 6) that were found for them."""
    if not statuses_of(program, 0):
        return
    try:
        status, *others = np.unique(status_of(reach.arm, joints_rad)).tolist()
    except ReachError as error:
        print_message(f"{name}: the postures of its targets were not checked: {error}")
        return
    stated = statuses_of(program, status)
    check_posture(status, [each for each in stated if each[1] & POSTURE_BITS not in others])


def _check_program(program: Program, reach: Reach, command: Array, name: str) -> None:
    """Refuse whole turns of joints that would change, where the arm's form lets them be known."""
    try:
        program.check_joints(reach.arm, reach.base, zyx_from_pose(command))
    except ReachError as error:
        print_message(f"{name}: {program.needs_arm} were not checked: {error}")


def _warn_outside(targets: RobotTargets, train: Measurements) -> None:
    """Say which joints go beyond those that were measured: nothing was learnt there."""
    low, high = train.joints_rad.min(axis=0) - MARGIN_RAD, train.joints_rad.max(axis=0) + MARGIN_RAD
    beyond = ~((targets.joints_rad >= low) & (targets.joints_rad <= high))
    if beyond.any():
        axes = ", ".join(f"A{axis + 1}" for axis in np.flatnonzero(beyond.any(axis=0)))
        count = int(np.count_nonzero(beyond.any(axis=1)))
        first = targets.names[int(np.flatnonzero(beyond.any(axis=1))[0])]
        print_message(
            f"{count} targets, {first} the first, are beyond the joints that were measured "
            f"({axes}); errors there are extrapolated"
        )
