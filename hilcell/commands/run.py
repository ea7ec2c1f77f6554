"""``run`` and ``resume``: perform what is ordered, and print it; ask before a run goes on."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from hilcell.cell.devices import load_entry
from hilcell.commands.console import print_message
from hilcell.commands.run_output import (
    JsonOutput,
    ProgressOutput,
    how_to_resume,
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
from hilcell.journal.runs import live_engine, read_log
from hilcell.journal.runs_folder import command_on
from hilcell.model.events import Announced, StepBegun
from hilcell.ports import HilcellError
from hilcell.run.control import order
from hilcell.run.engine import Engine, NewEngine, ResumedEngine
from hilcell.run.order import Attendance, Order, Resume
from hilcell.run.procedure import Procedure

UNASKED = "nobody can be asked whether the robot may go on, for this is no terminal"


def run(args: Order) -> int:
    plan = args.check(print_message)
    if args.dry_run:
        print_dry_run(plan.cell, plan.procedure, plan.steps, as_json=args.json)
        return 0
    print_warnings(plan.steps)
    with NewEngine(args, plan, print_message) as engine:
        return _performed(engine, as_json=args.json)


def resume(args: Resume) -> int:
    folder = find_run(args.runs, args.run)
    if live_engine(folder) is not None:
        return _resume_live(folder, args)
    somebody = asks(args.attendance)
    plan = args.check(folder, read_log(folder), somebody=somebody)
    with ResumedEngine(args, plan, print_message) as engine:
        log, plan = engine.journal.log, engine.plan
        if plan.goes_on and not somebody:
            check_unasked(folder.name, log, plan.procedure, args.attendance)
        elif plan.goes_on:
            if not agrees(folder.name, log, plan.procedure, plan.changes.inputs):
                return EXIT_ABORTED
            engine.agree()
        return _performed(engine, as_json=args.json)


def _performed(engine: Engine, *, as_json: bool) -> int:
    """Run to an end, print it, and return its exit code."""
    plan, log, name = engine.plan, engine.journal.log, engine.journal.run
    output = JsonOutput(name) if as_json else ProgressOutput(plan.folder, plan.points)
    code, fault, unclosed = engine.run(output)
    output.close(code, log, fault)
    print_end(plan.folder, log, plan.procedure, output, fault)
    print_unclosed(unclosed, fault)
    print_lost(plan.folder, output)
    if line := how_to_resume(plan.folder, code, fault):
        print_message(line)
    return EXIT_STORAGE if output.lost is not None and code in DONE else code


def _resume_live(folder: Path, args: Resume) -> int:
    """Let a live run go on; one that nobody attends, or that a screen shows, asks nobody here.

    A motion that was announced waits for a typed word, also where a screen is open.
    """
    somebody, status = asks(args.attendance), order(folder, "status")
    log, under_way = read_log(folder), status.state == "running" and not status.pausing
    procedure: Procedure = load_entry("procedures", log.inputs.procedure)
    motion = awaited_motion(log)
    if not somebody and motion and not log.inputs.simulated:
        raise HilcellError(
            f"run {folder.name}: {UNASKED}; it waits before a motion: {motion}; type "
            f'"yes" at `{command_on(folder, "resume")}` in a terminal, or let it go on at '
            "`hilcell tui`",
            code="HC-C31",
        )
    if somebody or not (status.unattended or status.screens):
        waits_for = log.life[-1].change.reason if log.life else ""
        if not somebody:
            check_unasked(folder.name, log, procedure, args.attendance)
        elif not under_way and not agrees(folder.name, log, procedure, [], waits_for):
            return EXIT_ABORTED
    seen = log.newest.seq if log.newest is not None else 0
    for key in args.retake:
        order(folder, "retake", key=key)
    if under_way:
        announced = log.happened(Announced)
        moving = announced[-1].motion if announced else _moves(log, procedure)
        print_message(
            f"{kind_of(log)} {folder.name}: {log.state}; it waits for no answer, and nothing was "
            f"asked of it. Under way: {moving}"
        )
        return 0
    answer = order(folder, "proceed", until=seen)
    print_message(f"run {folder.name}: asked to go on; it was {answer.state}")
    return 0


def asks(attendance: Attendance) -> bool:
    """Whether somebody is at a terminal to be asked: no script, and no screen, which asks itself.

    ``--unattended`` says that nobody is there.
    """
    here = sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()
    return here and not (attendance.unattended or attendance.screen)


def check_unasked(run: str, log: Log, procedure: Procedure, attendance: Attendance) -> None:
    """Refuse to let a real robot go on where somebody should be asked and nobody can be.

    A simulated one moves nothing: scripts go on with it, and what moves is only said.
    """
    if attendance.unattended or attendance.screen:
        return
    if not log.inputs.simulated:
        raise HilcellError(
            f"run {run}: {UNASKED}; resume it at a terminal or from `hilcell tui`, or add "
            "--unattended where nobody is in the cell",
            code="HC-C31",
        )
    moves = _moves(log, procedure)
    print_message(f"{kind_of(log)} {run}: nobody is asked, nothing real moves: {moves}")


def awaited_motion(log: Log) -> str:
    """Return the announced motion for which a live run waits, "" where it waits for none."""
    went_on = max((change.seq for change in log.life if change.to == "running"), default=0)
    since = (each.fact for each in reversed(log.events) if each.seq > went_on)
    return next((fact.motion for fact in since if isinstance(fact, Announced)), "")


def agrees(
    run: str, log: Log, procedure: Procedure, changes: Sequence[str], reason: str = ""
) -> bool:
    """Say what moves when the run goes on, and return whether the operator wants that.

    ``reason`` is what a live run waits for. Real devices move by the full word alone.
    """
    print_message(f"{kind_of(log)} {run}: {log.state}, {log.counted} points are measured")
    if reason:
        print_message(f"it waits: {reason}")
    for change in changes:
        print_message(f"not as before: {change}")
    if reason and awaited_motion(log):
        print_message("your answer is for this motion alone; the next one is asked for again")
    else:
        print_message(
            f"what goes on: {_moves(log, procedure)}; the robot goes to its safe pose before the "
            "slide moves. Clear the cell, and stay at the E-stop."
        )
    real = not log.inputs.simulated
    question = 'type "yes" to go on; any other answer moves nothing: ' if real else "go on? [y/N] "
    print(question, end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip()
    if answer.lower() in (("yes",) if real else ("y", "yes")):
        return True
    short = real and answer.lower() == "y"
    print_message('nothing was moved: expected "yes" in full' if short else "nothing was moved")
    return False


def _moves(log: Log, procedure: Procedure) -> str:
    """Return what moves in the step with which the run goes on."""
    begun = [each.number for each in log.happened(StepBegun)]
    number = min(begun[-1] if begun else 1, len(procedure.steps))
    step = procedure.steps[number - 1]
    return f"step {number} of {len(procedure.steps)}, {step.name}, moves {step.moves}"
