"""Asks at a terminal before a run goes on, and says what will move and what has changed."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from hilcell.commands.output import print_message
from hilcell.commands.run_output import kind_of
from hilcell.errors import HilcellError
from hilcell.journal.log import Log
from hilcell.model.events import Announced, StepBegun
from hilcell.run.order import Attendance
from hilcell.run.procedure import Procedure


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
            f"run {run}: nobody can be asked whether the robot may go on, for this is no terminal; "
            "resume it at a terminal or from `hilcell tui`, or add --unattended where nobody is "
            "in the cell",
            code="HC-C31",
        )
    moves = _moves(log, procedure)
    print_message(f"{kind_of(log)} {run}: nobody is asked, nothing real moves: {moves}")


def awaited_motion(log: Log) -> str:
    """Return the announced motion for which a live run waits, "" where it waits for none."""
    went_on = max((change.seq for change in log.life if change.to == "running"), default=0)
    since = (each.fact for each in reversed(log.events) if each.seq > went_on)
    return next((fact.motion for fact in since if isinstance(fact, Announced)), "")


def check_word(run: str, motion: str, log: Log) -> None:
    """Refuse a real motion that needs a typed word where nobody can type it."""
    if motion and not log.inputs.simulated:
        raise HilcellError(
            f"run {run}: nobody can be asked whether the robot may go on, for this is no terminal; "
            f'it waits before a motion: {motion}; type "yes" at `hilcell resume {run}` in a '
            "terminal, or let it go on at `hilcell tui`",
            code="HC-C31",
        )


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
    print_message('nothing was moved: "yes" is wanted in full' if short else "nothing was moved")
    return False


def say_under_way(run: str, log: Log, procedure: Procedure) -> None:
    """Say what a run does that waits for nobody."""
    announced = log.happened(Announced)
    what = announced[-1].motion if announced else _moves(log, procedure)
    print_message(
        f"{kind_of(log)} {run}: {log.state}; it waits for no answer, and nothing was asked of it. "
        f"Under way: {what}"
    )


def _moves(log: Log, procedure: Procedure) -> str:
    """Return what moves in the step with which the run goes on."""
    begun = [each.number for each in log.happened(StepBegun)]
    number = min(begun[-1] if begun else 1, len(procedure.parts))
    part = procedure.parts[number - 1]
    return f"step {number} of {len(procedure.parts)}, {part.name}, moves {part.moves}"
