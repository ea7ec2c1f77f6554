"""``runs`` and ``show``: recorded runs, read from their journals."""

from __future__ import annotations

import argparse
from typing import Any

from hilcell.cell.devices import load_entry
from hilcell.clean import encodable, harmless
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.journal.index import RunRow, read_index, row_of
from hilcell.journal.runs import find_run, read_log
from hilcell.run.procedure import Procedure


def runs(args: argparse.Namespace) -> int:
    """List the runs of a folder, in the order of their names."""
    found = [_summary(row) for row in sorted(read_index(args.runs), key=lambda row: row.name)]
    if args.json:
        print_json({"runs": found})
        return 0
    if not found:
        print_message(f"no runs in {args.runs}")
        return 0
    headers = ["run", "procedure", "cell", "state", "points", "exit"]
    rows = [[*(_word(each.get(name)) for name in headers), _kind(each)] for each in found]
    print_table(([*headers, "kind"], rows))
    return 0


def _kind(summary: dict[str, Any]) -> str:
    if "simulated" not in summary:  # it cannot be read
        return ""
    return "simulated" if summary["simulated"] else "real"


def _word(value: object) -> str:
    return "" if value is None else harmless(str(value))


def _summary(row: RunRow) -> dict[str, Any]:
    name = encodable(row.name)
    if not row.readable:
        return {"run": name, "state": row.state, "reason": encodable(row.reason)}
    return {
        "run": name,
        "procedure": row.procedure,
        "cell": row.cell,
        "state": row.condition,
        "points": row.points,
        "exit": row.exit,
        "simulated": row.simulated,
        "operator": row.operator,
        "job": row.job,
        "live": row.live,
    }


def show(args: argparse.Namespace) -> int:
    """Show a run; its result is recomputed from the journal."""
    folder = find_run(args.runs, args.run)
    log = read_log(folder)
    inputs = log.inputs
    procedure: Procedure = load_entry("procedures", inputs.procedure)
    finished = log.state == "finished"
    result = procedure.result(log) if finished else {}
    summary = _summary(row_of(folder)) | {
        "digest": inputs.digest,
        "seed": inputs.seed,
        "machine_seed": inputs.truth_seed,
        "calibration": log.calibration,
        "fault": log.fault,
        "sessions": log.session,
        "link": log.link.text if log.link is not None else None,
        "link_warning": (log.link.warning or None) if log.link is not None else None,
        "verdicts": log.verdicts,
        "result": result,
    }
    if args.json:
        print_json(summary)
        return 0
    rows = [[name, str(summary[name])] for name in _SHOWN if summary.get(name) not in ("", None)]
    rows.append(["state", summary["state"]])
    print_table((["run", summary["run"]], rows))
    if result:
        print_table(procedure.table(result))
        if words := procedure.words(result):
            print_message(words)
    return 0


_SHOWN = (
    "procedure", "cell", "simulated", "operator", "job", "seed", "machine_seed", "points",
    "calibration", "sessions", "link", "link_warning", "fault", "exit",
)  # fmt: skip
