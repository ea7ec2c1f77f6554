"""``runs`` and ``show``: recorded runs, read from their journals."""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from datetime import datetime
from operator import itemgetter
from typing import Any

from hilcell.calibration.in_use import standings_in
from hilcell.cell.devices import load_entry
from hilcell.clean import encodable, harmless
from hilcell.commands.invariants import check
from hilcell.commands.output import (
    print_json,
    print_message,
    print_table,
    terminal_columns,
)
from hilcell.commands.run_output import left_moving, print_suspected
from hilcell.journal.find_run import find_run
from hilcell.journal.folder_order import clock_notes
from hilcell.journal.index import UNREADABLE, RunRow, read_index, row_of
from hilcell.journal.runs import read_log
from hilcell.journal.standing import Standing
from hilcell.present.table import Column, Table
from hilcell.present.terminal import width_of
from hilcell.run.procedure import Procedure


def runs(args: argparse.Namespace) -> int:
    """List the runs of a folder, in the order of their names."""
    rows = read_index(args.runs)
    known = standings_in(args.runs, rows)
    listed = sorted((row for row in rows if _asked_for(row, args)), key=lambda row: row.name)
    found = [_summary(row, known.get(row.name)) for row in listed]
    for note in clock_notes(rows):
        print_message(f"warning: {note}")
    if args.json:
        print_json({"runs": found})
        return 0
    if not os.path.isdir(args.runs):  # noqa: PTH112 - Path.is_dir raises for a name too long
        print_message(f"no runs: the folder {args.runs} is not there")
        return 0
    if not found:
        print_message(f"no {'such ' if rows else ''}runs in {args.runs}")
        return 0
    print_list(found)
    for row in listed:
        if row.state == UNREADABLE:
            print_message(row.reason)
    return 0


def _asked_for(row: RunRow, args: argparse.Namespace) -> bool:
    """Return whether a run is of the cell and operator, and as young, as was asked for."""
    since: datetime | None = args.since
    begun = _time(row.begun)
    young = since is None or (begun is not None and begun >= since)
    return young and _same(args.cell, row.cell) and _same(args.operator, row.operator)


def _same(asked: str | None, found: str) -> bool:
    return asked is None or asked.casefold() == found.casefold()


def _time(begun: str) -> datetime | None:
    with suppress(ValueError):
        return datetime.fromisoformat(begun)
    return None


def _local(begun: str | None) -> str:
    """Return a time of the index (UTC) in the zone of this PC."""
    time = _time(begun or "")
    return "" if time is None else f"{time.astimezone():%Y-%m-%d %H:%M %Z}"


def _standing(summary: dict[str, Any]) -> str:
    standing = summary.get("standing")
    return "" if standing is None else harmless(str(standing["text"]))


def _kind(summary: dict[str, Any]) -> str:
    if "simulated" not in summary:  # it cannot be read
        return ""
    return "simulated" if summary["simulated"] else "real"


def _fact(name: str) -> Column[dict[str, Any]]:
    return Column(name, lambda each: "" if each.get(name) is None else harmless(str(each[name])))


LIST: tuple[Column[dict[str, Any]], ...] = (
    *map(_fact, ("run", "procedure", "cell", "operator", "state", "verdict", "points", "exit")),
    Column("begun", lambda each: _local(each.get("begun"))),
    Column("kind", _kind),
    Column("calibration", _standing),
)
FIRST_OUT = ("procedure", "exit", "points", "operator", "begun", "state", "calibration")


def print_list(found: list[dict[str, Any]]) -> None:
    """Print runs as a table; where a terminal is too narrow, without what is said elsewhere."""
    room, columns, left_out = terminal_columns(), [*LIST], [*FIRST_OUT]
    while room is not None and left_out and width_of(Table(columns, found)) > room:
        name = left_out.pop(0)
        columns = [column for column in columns if column.name != name]
    print_table(Table(columns, found))
    if len(columns) < len(LIST):
        print_message("a wider terminal, or --json, shows more of each run")


def _summary(row: RunRow, standing: Standing | None) -> dict[str, Any]:
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
        "begun": row.begun,
        "ended": row.ended or None,
        "verdict": row.verdict,
        "reason": encodable(row.reason),
        "standing": None if standing is None else _facts(standing),
    }


def _facts(standing: Standing) -> dict[str, Any]:
    """Return how a run's calibration stands among those of its cell."""
    return {
        "state": standing.state,
        "by": standing.by or None,
        "reason": encodable(standing.reason),
        "current": standing.current or None,
        "text": encodable(standing.text),
    }


def show(args: argparse.Namespace) -> int:
    """Show a run; its result is recomputed from the journal."""
    folder = find_run(args.runs, args.run)
    if args.check:
        return check(folder, as_json=args.json)
    log = read_log(folder)
    inputs = log.inputs
    procedure: Procedure = load_entry("procedures", inputs.procedure)
    finished = log.state == "finished"
    result = procedure.result(log) if finished else (log.end or {}).get("result", {})
    standing = standings_in(folder.parent, read_index(folder.parent)).get(folder.name)
    summary = _summary(row_of(folder), standing) | {
        "digest": inputs.digest,
        "seed": inputs.seed,
        "machine_seed": inputs.machine_seed,
        "calibration": log.calibration,
        "accepted": inputs.accepted or None,
        "fault": log.fault,
        "not_at_rest": left_moving(log) or None,
        "sessions": log.session,
        "link": log.link.text if log.link is not None else None,
        "link_warning": (log.link.warning or None) if log.link is not None else None,
        "verdicts": log.verdicts,
        "result": result,
    }
    if args.json:
        print_json(summary)
        return 0
    rows = [(name, str(summary[name])) for name in _SHOWN if summary.get(name) not in ("", None)]
    rows.append(("state", summary["state"]))
    if summary.get("reason") not in ("", summary.get("fault")):
        rows.append(("reason", summary["reason"]))
    if summary.get("verdict"):
        rows.append(("verdict", summary["verdict"]))
    if words := _standing(summary):
        rows.append(("its calibration", words))
    print_table(Table([Column("run", itemgetter(0)), Column(summary["run"], itemgetter(1))], rows))
    print_suspected(log)
    if finished:
        print_table(procedure.table(result))
        if words := procedure.words(result):
            print_message(words)
    return 0


_SHOWN = (
    "procedure", "cell", "simulated", "operator", "job", "seed", "machine_seed", "points",
    "calibration", "accepted", "sessions", "link", "link_warning", "fault", "not_at_rest", "exit",
)  # fmt: skip
