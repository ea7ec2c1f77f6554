"""Orders: a new run, a resumed run, its attendance, and the calibration to use."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from hilcell.arguments import (
    CELL,
    JSON_LINES,
    MACHINE_SEED,
    NOT_CURRENT,
    NOTED,
    OUT_OF_TOLERANCE,
    RUN,
    RUNS,
    SETTINGS,
    Signature,
    option,
    parse_days,
    parse_finite,
    parse_name,
    parse_note,
    parse_run_name,
    parse_seed,
    parse_speed,
)

if TYPE_CHECKING:
    from hilcell.journal.log import Log
    from hilcell.run.procedure import Procedure
    from hilcell.run.run_plan import NewRun, ResumedRun


USUAL_SEED = 1


class Attendance(Signature):
    """The operator, a screen and a recording at a run."""

    unattended: bool = option("no operator can answer questions", default=False)
    screen: bool = option(
        "started by a screen: nothing moves before a screen is attached", default=False
    )
    record_wire: bool = option(
        "record all bytes to and from the devices, with times, beside the journal", default=False
    )


class Order(Signature):
    """Run a procedure on a cell."""

    procedure: str = option("procedure (default: calibrate)", default="calibrate", positional=True)
    cell: str = CELL
    settings: tuple[tuple[str, str], ...] = SETTINGS
    full: bool = option(
        "all targets of [validation] and the whole grid: the paper's (`plan.quick=false`)",
        default=False,
    )
    quick: bool = option(
        "as few targets as the verdict needs: calibrate's plan unless the cell file has another "
        "(`plan.quick=true`)",
        default=False,
    )
    start: str | None = option(
        "re-calibrate: start from the arm that this run's calibration knows, or the current one's "
        "(`plan.calibration=RUN`)",
        "RUN|current",
        parse_name,
        default=None,
        flags=("--from",),
    )
    seed: int | None = option(
        "seed of random targets, and of the simulated machine without --machine-seed (default: 1; "
        "of a run that uses a calibration, one that follows from that)",
        "N",
        parse_seed,
        default=None,
    )
    machine_seed: int | None = MACHINE_SEED
    runs: Path = RUNS
    speed: float | None = option(
        "speed of a simulated cell: a factor of real time, or as fast as possible (default: max)",
        "X|max",
        parse_speed,
        default=None,
    )
    attendance: Attendance = Attendance()
    operator: str = NOTED
    name: str | None = option(
        "name of the run and its folder (default: from time and procedure)",
        "RUN",
        parse_run_name,
        default=None,
    )
    job: str = option("recorded in the journal", "ID", parse_note, default="")
    accept_out_of_tolerance: bool = OUT_OF_TOLERANCE
    accept_not_current: bool = NOT_CURRENT
    dry_run: bool = option("check and print the plan only", default=False)
    json: bool = JSON_LINES

    @property
    def stated(self) -> dict[str, str]:
        """The stated values of the cell, with that of the plan; raises `HilcellError` for two."""
        from hilcell.errors import HilcellError

        if self.full and self.quick:
            raise HilcellError("--full and --quick: expected one of them")
        if self.full and self.start:
            raise HilcellError("--full and --from: expected one of them")
        settings, plan = dict(self.settings), dict[str, str]()
        if self.start:
            plan["plan.calibration"] = json.dumps(self.start)
        if self.full or self.quick or self.start:
            plan["plan.quick"] = "false" if self.full else "true"
        for key, value in plan.items():
            if settings.get(key, value) != value:
                raise HilcellError(
                    f"--set {key} and --full, --quick or --from: expected one of them"
                )
        return settings | plan

    def check(self, say: Callable[[str], object]) -> NewRun:
        """Return the run, planned; raises `HilcellError` where it must not begin.

        Nothing is opened, nothing is written, nothing moves. ``say`` takes warnings.
        """
        # `--help` does without these.
        from hilcell.calibration.known_arm import seed_after
        from hilcell.calibration.lookup import (
            calibrated_machine,
            calibration_named,
            with_calibration,
        )
        from hilcell.cell.devices import check_options, check_replay, load_entry, load_measured
        from hilcell.cell.differences import check_identity
        from hilcell.cell.file import located
        from hilcell.cell.settings import SettingsError
        from hilcell.errors import HilcellError
        from hilcell.journal.disk_space import check_space
        from hilcell.journal.runs import new_run
        from hilcell.run import run_plan

        procedure: Procedure = load_entry("procedures", self.procedure)
        settings = run_plan.with_plan(self.cell, self.stated, procedure)
        cell = load_measured(self.cell, settings)
        run_plan.check_of_simulator(cell, "--speed", self.speed)
        run_plan.check_of_simulator(cell, "--machine-seed", self.machine_seed)
        if warning := check_identity(self.cell, cell):
            say(warning)
        procedure.check_attended(cell, unattended=self.attendance.unattended)
        procedure.check(cell)
        if cell.plan.calibration and procedure.may_use != "plan":
            raise HilcellError(
                f"{procedure.name} starts from no calibration: --from (plan.calibration) is for "
                "calibrate; leave it out",
                code="HC-C10",
            )
        accepted, used, machine = list[str](), "", self.machine_seed
        seed = USUAL_SEED if self.seed is None else self.seed
        if uses := procedure.used_in(cell):
            cell, accepted, used = with_calibration(
                cell, uses, self.runs, machine=machine,
                accept_out_of_tolerance=self.accept_out_of_tolerance,
                accept_not_current=self.accept_not_current,
            )  # fmt: skip
            say("\n".join([used, *(f"accepted although {reason}" for reason in accepted)]))
            machine = run_plan.checked_machine_seed(machine, calibrated_machine(cell, uses))
        machine = run_plan.machine_seed(cell, seed, machine)
        if used and self.seed is None:
            seed = seed_after(calibration_named(cell, uses))
            if cell.plan.recalibrates:
                say(
                    f"seed {seed}, from that calibration: other poses than those of --seed "
                    f"{USUAL_SEED}"
                )
        try:
            check_options(cell)
        except SettingsError as error:
            raise located(self.cell, error.problems, settings) from None
        steps = procedure.plan(cell, seed)
        check_replay(cell, self.procedure, seed)
        if not self.dry_run:
            check_space(self.runs, steps.points)
        return run_plan.NewRun(
            folder=self.runs / (self.name or new_run(procedure.name)),
            cell=cell,
            procedure=procedure,
            points=steps.points,
            steps=steps,
            settings=settings,
            seed=seed,
            machine_seed=machine,
            accepted=accepted,
        )


class Resume(Signature):
    """Continue an interrupted or paused run."""

    run: str = RUN
    runs: Path = RUNS
    attendance: Attendance = Attendance()
    accept_changes: bool = option(
        "continue with another device, cell file or version of hilcell; recorded in the journal",
        default=False,
    )
    retake: tuple[str, ...] = option(
        "re-measure this point, also of a finished run; repeatable", "KEY", default=()
    )
    answer: str = option(
        "answer the prompt of a live run by one of its choices: release, here, wider",
        "CHOICE",
        default="",
    )
    json: bool = JSON_LINES

    def check(self, folder: Path, log: Log, *, operator_present: bool) -> ResumedRun:
        """Return the run to continue; raises `HilcellError` where it is finished or must not
        continue. Nothing is opened, nothing moves. ``operator_present``: can be prompted.
        """
        # `--help` does without these.
        from hilcell.cell.devices import check_options, load_entry
        from hilcell.cell.settings import SettingsError
        from hilcell.errors import HilcellError
        from hilcell.journal.disk_space import check_space
        from hilcell.journal.runs import CALIBRATION
        from hilcell.journal.runs_folder import command_on
        from hilcell.run.run_plan import Changes, ResumedRun, changed_inputs
        from hilcell.run.states import retake_refusal

        if self.answer:
            raise HilcellError(
                f"run {folder.name}: no engine is running that asks; resume it without --answer",
                code="HC-J08",
            )
        retakes = [key for key in self.retake if key not in log.retakes]
        if refusals := [why for key in retakes if (why := retake_refusal(log, key))]:
            raise HilcellError("\n".join(refusals))
        continues = bool(retakes or log.retakes) or log.state != "finished"
        written = not log.calibrates or (folder / CALIBRATION).is_file()
        if not continues and log.end is not None and written:
            raise HilcellError(
                f"run {folder.name} is finished; start a new one with `hilcell run`", code="HC-J09"
            )
        attendance = self.attendance
        procedure: Procedure = load_entry("procedures", log.inputs.procedure)
        procedure.check_attended(log.cell, unattended=attendance.unattended)
        changes = Changes()
        if continues:
            try:
                check_options(log.cell)
            except SettingsError as error:
                raise HilcellError(
                    f"run {folder.name} cannot continue here; it is unchanged. {error}\n"
                    "  it keeps the cell that it began with: install what is missing, then "
                    f"`{command_on(folder, 'resume')}`",
                    code=error.code,
                ) from error
            check_space(folder.parent, log.inputs.points - log.counted)
            found = changed_inputs(log, procedure.used_in(log.cell))
            can_ask = operator_present or (attendance.screen and not attendance.unattended)
            changes = Changes(found, self.accept_changes, can_ask)
            changes.check(found)
        return ResumedRun(
            folder=folder,
            cell=log.cell,
            procedure=procedure,
            points=log.inputs.points,
            changes=changes,
            continues=continues,
            retakes=retakes,
            operator_present=operator_present,
        )


class Release(Signature):
    """The conditions under which a calibration is used, and where runs are."""

    temperature: float | None = option(
        "ambient temperature: refuse a calibration made at one that differs by more than 2 K",
        "T_C",
        parse_finite,
        default=None,
    )
    max_age: float = option(
        "refuse an older calibration (default: 180)", "DAYS", parse_days, default=180.0
    )
    accept_out_of_tolerance: bool = OUT_OF_TOLERANCE
    accept_not_current: bool = NOT_CURRENT
    runs: Path = RUNS
