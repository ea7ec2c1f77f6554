"""``runs`` and ``show``: what the journals say."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from hilcell.commands.common import say
from hilcell.devices import load_entry
from hilcell.faces import print_table
from hilcell.ports import HilcellError
from hilcell.run.control import live_engine
from hilcell.run.log import Log
from hilcell.run.procedure import Procedure
from hilcell.runs import find_run, read_log, run_folders


def runs(args: argparse.Namespace) -> int:
    """List the runs of a folder."""
    found = [_summary(folder) for folder in run_folders(args.runs)]
    if args.json:
        say({"runs": found}, "", as_json=True)
        return 0
    if not found:
        print(f"no runs in {args.runs}", file=sys.stderr)
        return 0
    headers = ["run", "procedure", "cell", "state", "points", "exit"]
    print_table((headers, [[str(each.get(name, "")) for name in headers] for each in found]))
    return 0


def _summary(folder: Path) -> dict[str, Any]:
    try:
        log = read_log(folder)
        inputs = log.inputs
    except HilcellError as error:
        return {"run": folder.name, "state": "unreadable", "reason": str(error)}
    live = live_engine(folder) is not None
    return {
        "run": folder.name,
        "procedure": inputs.procedure,
        "cell": inputs.cell["name"],
        "state": state_of(log, live=live),
        "points": len(log.points),
        "exit": log.end["exit"] if log.end else None,
        "simulated": inputs.simulated,
        "operator": inputs.operator,
        "job": inputs.job,
        "live": live,
    }


def state_of(log: Log, *, live: bool) -> str:
    """Return the run's state in words; a journal that just ends was left by a crash."""
    state = log.states["run"]
    return state if live or log.end is not None else f"{state}, engine gone"


def show(args: argparse.Namespace) -> int:
    """Show a run; its result is computed anew from the journal."""
    folder = find_run(args.runs, args.run)
    log = read_log(folder)
    inputs = log.inputs
    procedure: Procedure = load_entry("procedures", inputs.procedure)
    finished = log.states["run"] == "finished"
    result = procedure.result(log) if finished else {}
    live = live_engine(folder) is not None
    summary = _summary(folder) | {
        "digest": inputs.digest,
        "seed": inputs.seed,
        "calibration": log.states["calibration"],
        "fault": log.fault,
        "sessions": log.session,
        "verdicts": log.verdicts,
        "result": result,
    }
    if args.json:
        say(summary, "", as_json=True)
        return 0
    rows = [[name, str(summary[name])] for name in _SHOWN if summary.get(name) not in ("", None)]
    rows.append(["state", state_of(log, live=live)])
    print_table((["run", folder.name], rows))
    if result:
        print_table(procedure.table(result))
    return 0


_SHOWN = (
    "procedure", "cell", "simulated", "operator", "job", "seed", "points",
    "calibration", "sessions", "fault", "exit",
)  # fmt: skip
