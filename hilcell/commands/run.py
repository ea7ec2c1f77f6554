"""``run`` and ``resume``: run a procedure and print it; ask before a run is resumed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from hilcell.cell.devices import load_entry
from hilcell.cell.file import Cell
from hilcell.cell.source import built_in_cells
from hilcell.commands.console import print_message
from hilcell.commands.run_output import (
    JsonOutput,
    ProgressOutput,
    kind_of,
    print_dry_run,
    print_end,
    print_lost,
    print_unclosed,
    print_warnings,
)
from hilcell.errors import DONE, EXIT_ABORTED, EXIT_STORAGE
from hilcell.journal.index import find_run
from hilcell.journal.log import Log
from hilcell.journal.runs import EngineFile, live_engine, read_log
from hilcell.journal.runs_folder import command_on
from hilcell.model.events import Announced, StepBegun
from hilcell.model.records import WAITING
from hilcell.ports import HilcellError
from hilcell.run.control import HERE, MEASURED_S, RELEASE, PromptStatus, order
from hilcell.run.engine import Engine, NewEngine, ResumedEngine
from hilcell.run.last_word import last_word
from hilcell.run.order import Attendance, Order, Resume
from hilcell.run.procedure import Procedure

UNASKED = "cannot ask for confirmation (not a terminal); the robot was not moved"


def run(args: Order) -> int:
    if not args.dry_run:
        refuse_unproved(args)
    plan = args.check(print_message)
    if args.dry_run:
        print_dry_run(plan.cell, plan.procedure, plan.steps, as_json=args.json)
        return 0
    print_warnings(plan.steps)
    with NewEngine(args, plan, print_message) as engine:
        return _performed(engine, as_json=args.json)


def refuse_unproved(args: Order) -> None:
    """Raise `HilcellError` for a cell file with assumed places, and for a step of commissioning
    before which another is not proved.
    """
    if args.cell in built_in_cells() or not Path(args.cell).is_file():
        return  # a file that is missing is refused where it is read
    from hilcell.commission.sequence import STEPS
    from hilcell.commission.steps import check_proved, steps_to_perform  # edits cell files

    path = Path(args.cell)
    step = next((each.name for each in STEPS if each.procedure == args.procedure), "")
    if step:
        steps_to_perform(path, "", step)
    else:
        check_proved(path)


def resume(args: Resume) -> int:
    folder = find_run(args.runs, args.run)
    if (lives := live_engine(folder)) is not None:
        return _resume_live(folder, lives, args)
    operator = can_ask(args.attendance)
    plan = args.check(folder, read_log(folder), operator_present=operator)
    with ResumedEngine(args, plan, print_message) as engine:
        log, plan = engine.journal.log, engine.plan
        if plan.continues and not operator:
            check_unasked(folder.name, log, plan.procedure, args.attendance)
        elif plan.continues:
            if not confirmed(folder.name, log, plan.procedure, plan.changes.inputs):
                return EXIT_ABORTED
            engine.agree()
        return _performed(engine, as_json=args.json)


def _performed(engine: Engine, *, as_json: bool) -> int:
    plan, log, name = engine.plan, engine.journal.log, engine.journal.run
    output = JsonOutput(name) if as_json else ProgressOutput(plan.folder, plan.points)
    code, fault, unclosed = engine.run(output)
    output.close(code, log, fault)
    print_end(plan.folder, log, plan.procedure, output, fault)
    print_unclosed(unclosed, fault)
    print_lost(plan.folder, output)
    journalled = log.end is not None and log.end.exit == code
    print_message(last_word(log, plan.folder, None if journalled else fault).text)
    return EXIT_STORAGE if output.lost is not None and code in DONE else code


def _resume_live(folder: Path, engine: EngineFile, args: Resume) -> int:
    """Let a live run continue; not confirmed here where it is unattended or a screen shows it.

    An announced motion of a real robot always needs a typed "yes" or a screen.
    """
    if args.answer == RELEASE:  # the run still waits
        order(folder, "answer", choice=args.answer, timeout_s=MEASURED_S)
        resume = command_on(folder, "resume")
        print_message(f"the beam is free: put it on the nest, then `{resume} --answer {HERE}`")
        return 0
    operator, status = can_ask(args.attendance), order(folder, "status")
    log = read_log(folder)
    procedure: Procedure = load_entry("procedures", log.inputs.procedure)
    if not (status.pausing or status.state in WAITING):
        return _leave_working(folder, engine, args, log, procedure, status.state)
    motion = awaited_motion(log)
    if not operator and motion and not log.inputs.simulated:
        raise HilcellError(
            f"run {folder.name}: {UNASKED}; it waits before a motion: {motion}; type "
            f'"yes" at `{command_on(folder, "resume")}` in a terminal, or continue it in '
            "`hilcell tui`",
            code="HC-C31",
        )
    if operator or not (status.unattended or status.screens):
        reason = log.life[-1].change.reason if log.life else ""
        if not operator:
            check_unasked(folder.name, log, procedure, args.attendance)
        elif not confirmed(folder.name, log, procedure, [], reason):
            return EXIT_ABORTED
    newest = log.newest.seq if log.newest is not None else 0
    for key in args.retake:
        order(folder, "retake", key=key)
    if args.answer:
        order(folder, "answer", choice=args.answer, timeout_s=MEASURED_S)
        print_message(f"run {folder.name}: answered {args.answer}; the run continues")
        return 0
    if status.prompt is not None and status.state == "suspended":
        words = _answered(folder, log.cell, status.prompt, carries=operator)
        print_message(f"run {folder.name}: {words}")
        return 0
    answer = order(folder, "proceed", until=newest)
    print_message(f"run {folder.name}: asked to continue; it was {answer.state}")
    return 0


def _answered(folder: Path, cell: Cell, prompt: PromptStatus, *, carries: bool) -> str:
    """Say that a run's prompt is done; return whether the tracker agrees. In a simulated cell the
    person ``carries`` the reflector first, where there is somebody who was asked to.
    """
    from hilcell.commission.first_steps import carry_reflector  # edits cell files

    try:
        if carries and prompt.expected_mm is not None:
            carry_reflector(cell, prompt.expected_mm)
        order(folder, "answer", timeout_s=MEASURED_S)
    except HilcellError as error:
        return f"it still waits: {prompt.title}; {error}"
    return f"{prompt.title}: done; the run continues"


def _leave_working(
    folder: Path, engine: EngineFile, args: Resume, log: Log, procedure: Procedure, state: str
) -> int:
    """Say that a live run works, since when and on what; raises `HilcellError` if it ends now."""
    began = [f" since {each.t[:19]}Z" for each in log.life if each.change.to == "checking"]
    since = f"in process {engine.pid}{(began or [''])[-1]}"
    what, watch = f"{kind_of(log)} {folder.name} is {state} {since}", command_on(folder, "watch")
    if state not in ("idle", "checking", "running"):
        raise HilcellError(
            f"{what}; `{watch}` until it has ended, then `{command_on(folder, 'resume')}`",
            code="HC-J08",
        )
    for key in args.retake:
        order(folder, "retake", key=key)
    announced = log.happened(Announced)
    moving = announced[-1].motion if announced else _moves(log, procedure)
    print_message(
        f"{what}; it waits for no answer, so none was sent. In progress: {moving}. `{watch}` "
        f"follows it, `{command_on(folder, 'pause')}` pauses it"
    )
    return 0


def can_ask(attendance: Attendance) -> bool:
    """Whether an operator at this terminal can answer: no script, no screen, not unattended."""
    terminal = sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()
    return terminal and not (attendance.unattended or attendance.screen)


def check_unasked(run: str, log: Log, procedure: Procedure, attendance: Attendance) -> None:
    """Refuse to continue a real run without a confirmation; a simulated one moves nothing."""
    if attendance.unattended or attendance.screen:
        return
    if not log.inputs.simulated:
        raise HilcellError(
            f"run {run}: {UNASKED}; resume it in a terminal or in `hilcell tui`, or add "
            "--unattended if the cell is clear of people",
            code="HC-C31",
        )
    moves = _moves(log, procedure)
    print_message(f"{kind_of(log)} {run}: continues without confirmation, simulated: {moves}")


def awaited_motion(log: Log) -> str:
    """Return the announced motion for which a live run waits, or ""."""
    resumed = max((change.seq for change in log.life if change.to == "running"), default=0)
    since = (each.fact for each in reversed(log.events) if each.seq > resumed)
    return next((fact.motion for fact in since if isinstance(fact, Announced)), "")


def confirmed(
    run: str, log: Log, procedure: Procedure, changes: Sequence[str], reason: str = ""
) -> bool:
    """Print what will move, and return whether the operator confirms it.

    ``reason``: why a live run waits. Real devices move only after a full "yes".
    """
    print_message(f"{kind_of(log)} {run}: {log.state}, {log.counted} points are measured")
    if reason:
        print_message(f"it waits: {reason}")
    for change in changes:
        print_message(f"changed: {change}")
    if reason and awaited_motion(log):
        print_message("your answer applies to this motion only")
    else:
        print_message(
            f"next: {_moves(log, procedure)}; the robot moves to its safe pose before the "
            "slide moves. Clear the cell, and stay at the E-stop."
        )
    real = not log.inputs.simulated
    question = (
        'type "yes" to continue; other answers move nothing: ' if real else "continue? [y/N] "
    )
    print(question, end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip()
    if answer.lower() in (("yes",) if real else ("y", "yes")):
        return True
    short = real and answer.lower() == "y"
    print_message('nothing was moved: expected "yes" in full' if short else "nothing was moved")
    return False


def _moves(log: Log, procedure: Procedure) -> str:
    begun = [each.number for each in log.happened(StepBegun)]
    number = min(begun[-1] if begun else 1, len(procedure.steps))
    step = procedure.steps[number - 1]
    return f"step {number} of {len(procedure.steps)}, {step.name}, moves {step.moves}"
