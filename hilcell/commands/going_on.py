"""Asks at a terminal before a run goes on, and says what will move and what has changed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from hilcell.commands.output import print_message
from hilcell.commands.run_output import kind_of
from hilcell.errors import HilcellError
from hilcell.journal.log import Log
from hilcell.run.procedure import Procedure


def asks(args: argparse.Namespace) -> bool:
    """Whether somebody is at a terminal to be asked: no script, and no screen, which asks itself.

    ``--unattended`` says that nobody is there.
    """
    here = sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()
    return here and not (args.unattended or args.screen)


def check_unasked(run: str, log: Log, procedure: Procedure, args: argparse.Namespace) -> None:
    """Refuse to let a real robot go on where somebody should be asked and nobody can be.

    A simulated one moves nothing: scripts go on with it, and what moves is only said.
    """
    if args.unattended or args.screen:
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


def agrees(
    run: str, log: Log, procedure: Procedure, changes: Sequence[str], reason: str = ""
) -> bool:
    """Say what moves when the run goes on, and return whether the operator wants that.

    ``reason`` is what a live run waits for.
    """
    print_message(f"{kind_of(log)} {run}: {log.state}, {log.counted} points are measured")
    if reason:
        print_message(f"it waits: {reason}")
    for change in changes:
        print_message(f"not as before: {change}")
    print_message(
        f"it goes on at once: {_moves(log, procedure)}; the robot goes to its safe pose before the "
        "slide moves. Clear the cell, and stay at the E-stop."
    )
    print("go on? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() in ("y", "yes"):
        return True
    print_message("nothing was moved")
    return False


def _moves(log: Log, procedure: Procedure) -> str:
    """Return what moves in the step with which the run goes on."""
    begun = [int(e.body["number"]) for e in log.events if e.body["what"] == "step"]
    number = min(begun[-1] if begun else 1, len(procedure.parts))
    part = procedure.parts[number - 1]
    return f"step {number} of {len(procedure.parts)}, {part.name}, moves {part.moves}"
