"""``runs`` and ``show``: recorded runs, read from their journals."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from operator import attrgetter, itemgetter

from hilcell.calibration.in_use import standings_in
from hilcell.cell.devices import load_entry
from hilcell.clean import encodable
from hilcell.commands.invariants import check
from hilcell.commands.orders import ListRuns, Show
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
from hilcell.present.renderers import width_of
from hilcell.present.table import Column, Table
from hilcell.run.procedure import Procedure
from hilcell.typed import Json


def runs(args: ListRuns) -> int:
    """List the runs of a folder, in the order of their names."""
    rows = read_index(args.runs)
    known = standings_in(args.runs, rows)
    listed = sorted((row for row in rows if _asked_for(row, args)), key=lambda row: row.name)
    for note in clock_notes(rows):
        print_message(f"warning: {note}")
    if args.json:
        print_json({"runs": [_summary(row, known.get(row.name)) for row in listed]})
        return 0
    if not os.path.isdir(args.runs):  # noqa: PTH112 - Path.is_dir raises for a name too long
        print_message(f"no runs: the folder {args.runs} is not there")
        return 0
    if not listed:
        print_message(f"no {'such ' if rows else ''}runs in {args.runs}")
        return 0
    _print_list(listed, known)
    for row in listed:
        if row.state == UNREADABLE:
            print_message(row.reason)
    return 0


def _asked_for(row: RunRow, args: ListRuns) -> bool:
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


def _local(begun: str) -> str:
    """Return a time of the index (UTC) in the zone of this PC."""
    time = _time(begun)
    return "" if time is None else f"{time.astimezone():%Y-%m-%d %H:%M %Z}"


def _kind(row: RunRow) -> str:
    if not row.readable:
        return ""
    return "simulated" if row.simulated else "real"


LIST: tuple[Column[RunRow], ...] = (
    Column("run", lambda row: encodable(row.name)),
    Column("procedure", attrgetter("procedure")),
    Column("cell", attrgetter("cell")),
    Column("operator", attrgetter("operator")),
    Column("state", lambda row: row.condition if row.readable else row.state),
    Column("verdict", attrgetter("verdict")),
    Column("points", lambda row: row.points if row.readable else None, form="d"),
    Column("exit", attrgetter("exit"), form="d"),
    Column("begun", lambda row: _local(row.begun) if row.readable else None),
    Column("kind", _kind),
)
FIRST_OUT = ("procedure", "exit", "points", "operator", "begun", "state", "calibration")


def _print_list(rows: list[RunRow], known: Mapping[str, Standing]) -> None:
    """Print runs as a table; where a terminal is too narrow, without what is said elsewhere."""
    texts = {row.name: encodable(known[row.name].text) for row in rows if row.name in known}
    standing = Column[RunRow](
        "calibration", lambda row: texts.get(row.name) if row.readable else None
    )
    room, columns, left_out = terminal_columns(), [*LIST, standing], [*FIRST_OUT]
    while room is not None and left_out and width_of(Table(columns, rows)) > room:
        name = left_out.pop(0)
        columns = [column for column in columns if column.name != name]
    print_table(Table(columns, rows))
    if len(columns) <= len(LIST):
        print_message("a wider terminal, or --json, shows more of each run")


def _summary(row: RunRow, standing: Standing | None) -> Json:
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


def _facts(standing: Standing) -> Json:
    """Return how a run's calibration stands among those of its cell."""
    return {
        "state": standing.state,
        "by": standing.by or None,
        "reason": encodable(standing.reason),
        "current": standing.current or None,
        "text": encodable(standing.text),
    }


def show(args: Show) -> int:
    """Show a run; its result is recomputed from the journal."""
    folder = find_run(args.runs, args.run)
    if args.check:
        return check(folder, as_json=args.json)
    log = read_log(folder)
    inputs = log.inputs
    procedure: Procedure = load_entry("procedures", inputs.procedure)
    finished = log.state == "finished"
    result = procedure.result(log) if finished else log.result
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
        "link": log.link.counts if log.link is not None else None,
        "link_warning": (log.link.warning or None) if log.link is not None else None,
        "verdicts": {key: record.body for key, record in log.judged.items()},
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
    if standing is not None:
        rows.append(("its calibration", encodable(standing.text)))
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
