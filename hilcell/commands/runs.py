"""The commands on recorded runs: list, show, compare, report, export, revoke."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from operator import attrgetter, itemgetter
from pathlib import Path

import msgspec

from hilcell.atomic_files import CSV, check_output, write_whole
from hilcell.calibration.lookup import calibration_status, calibration_statuses
from hilcell.cell.devices import load_entry
from hilcell.commands.console import print_json, print_message, print_table, terminal_columns
from hilcell.commands.run_output import left_moving, print_suspected
from hilcell.commands.signatures import Compare, Export, ListRuns, Report, Revoke, Show
from hilcell.decoding import Json
from hilcell.invariants import INVARIANTS, InvariantResult, Violation, check_invariants
from hilcell.journal.calibration_status import CalibrationStatus, descended_from
from hilcell.journal.index import UNREADABLE, RunRow, clock_notes, find_run, read_index, row_of
from hilcell.journal.journal import StorageError
from hilcell.journal.log import RunJournal
from hilcell.journal.runs import CALIBRATION, JOURNAL, live_engine, read_log, read_records
from hilcell.journal.runs_folder import command_on
from hilcell.language import of_environment
from hilcell.model.events import CalibrationRevoked
from hilcell.ports import HilcellError
from hilcell.present.renderers import width_of
from hilcell.present.table import Column, Table
from hilcell.report.comparison import CHANGES, Setting, compare_runs
from hilcell.report.facts import Facts, read_facts
from hilcell.run.cell_lock import lock_of_name, locked
from hilcell.run.last_word import last_word
from hilcell.run.procedure import Procedure
from hilcell.sanitize import encodable, harmless

# -- runs and show --------------------------------------------------------------------------------


def runs(args: ListRuns) -> int:
    """List the runs of a folder, sorted by name."""
    rows = read_index(args.runs)
    known = calibration_statuses(args.runs, rows)
    listed = sorted((row for row in rows if _selected(row, args)), key=lambda row: row.name)
    for note in clock_notes(rows):
        print_message(f"warning: {note}")
    if args.json:
        print_json({"runs": [_summary(row, known.get(row.name)) for row in listed]})
        return 0
    if not os.path.isdir(args.runs):  # noqa: PTH112 - Path.is_dir raises for a name too long
        print_message(f"no runs: the folder {args.runs} does not exist")
        return 0
    if not listed:
        print_message(f"no {'such ' if rows else ''}runs in {args.runs}")
        return 0
    _print_list(listed, known)
    for row in listed:
        if row.state == UNREADABLE:
            print_message(row.reason)
    return 0


def _selected(row: RunRow, args: ListRuns) -> bool:
    begun = _time(row.begun)
    recent = args.since is None or (begun is not None and begun >= args.since)
    names = ((args.cell, row.cell), (args.operator, row.operator))
    return recent and all(
        wanted is None or wanted.casefold() == own.casefold() for wanted, own in names
    )


def _time(begun: str) -> datetime | None:
    with suppress(ValueError):
        return datetime.fromisoformat(begun)
    return None


def _local(begun: str) -> str:
    """Return a time of the index (UTC) in local time."""
    time = _time(begun)
    return "" if time is None else f"{time.astimezone():%Y-%m-%d %H:%M %Z}"


def _procedure(row: RunRow) -> str:
    carried = encodable(row.facts.carried)
    return f"{row.procedure} from {carried}" if carried else row.procedure


LIST: tuple[Column[RunRow], ...] = (
    Column("run", lambda row: encodable(row.name)),
    Column("procedure", _procedure),
    Column("cell", attrgetter("cell")),
    Column("operator", attrgetter("operator")),
    Column("state", lambda row: row.condition if row.readable else row.state),
    Column("verdict", attrgetter("verdict")),
    Column("points", lambda row: row.points if row.readable else None, form="d"),
    Column("exit", attrgetter("exit"), form="d"),
    Column("begun", lambda row: _local(row.begun) if row.readable else None),
    Column("kind", lambda row: ("simulated" if row.simulated else "real") if row.readable else ""),
)


def _print_list(rows: list[RunRow], known: Mapping[str, CalibrationStatus]) -> None:
    """Print runs as a table, with fewer columns in a narrow terminal."""
    texts = {row.name: encodable(known[row.name].text) for row in rows if row.name in known}
    status = Column[RunRow](
        "calibration", lambda row: texts.get(row.name) if row.readable else None
    )
    width, columns = terminal_columns(), [*LIST, status]
    for name in ("procedure", "exit", "points", "operator", "begun", "state", "calibration"):
        if width is not None and width_of(Table(columns, rows)) > width:
            columns = [column for column in columns if column.name != name]
    print_table(Table(columns, rows))
    if len(columns) <= len(LIST):
        print_message("a wider terminal or --json shows more columns")


def _summary(row: RunRow, status: CalibrationStatus | None) -> Json:
    name = encodable(row.name)
    if not row.readable:
        return {"run": name, "state": row.state, "reason": encodable(row.reason)}
    return {
        "run": name,
        "procedure": row.procedure,
        "from": encodable(row.facts.carried) or None,
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
        "standing": status
        and {
            "state": status.state,
            "by": status.by or None,
            "reason": encodable(status.reason),
            "current": status.current or None,
            "text": encodable(status.text),
        },
    }


def show(args: Show) -> int:
    folder = find_run(args.runs, args.run)
    if args.check:
        return _check(folder, as_json=args.json)
    log = read_log(folder)
    inputs = log.inputs
    procedure: Procedure = load_entry("procedures", inputs.procedure)
    finished = log.state == "finished"
    result = procedure.result(log) if finished else log.result
    status = calibration_status(folder)
    word = None if live_engine(folder) is not None else last_word(log, folder).text
    summary = _summary(row_of(folder), status) | {
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
        "last_word": word,
        "verdicts": {key: record.body for key, record in log.verdict_records.items()},
        "result": result,
    }
    if args.json:
        print_json(summary)
        return 0
    shown = (
        "procedure", "from", "cell", "simulated", "operator", "job", "seed", "machine_seed",
        "points", "stage", "accepted", "sessions", "link", "link_warning", "fault",
        "not_at_rest", "exit",
    )  # fmt: skip
    summary["stage"] = log.calibration.replace("_", " ")
    rows = [(name, str(summary[name])) for name in shown if summary.get(name) not in ("", None)]
    rows.append(("state", summary["state"]))
    if summary.get("reason") not in ("", summary.get("fault")):
        rows.append(("reason", summary["reason"]))
    if summary.get("verdict"):
        rows.append(("verdict", summary["verdict"]))
    if status is not None:
        rows.append(("its calibration", encodable(status.text)))
    print_table(Table([Column("run", itemgetter(0)), Column(summary["run"], itemgetter(1))], rows))
    print_suspected(log)
    if finished:
        print_table(procedure.table(result))
        if words := procedure.words(result):
            print_message(words)
    if word is not None:
        print_message(word)
    return 0


# -- show --check: the invariants -----------------------------------------------------------------


def _check(folder: Path, *, as_json: bool) -> int:
    """Print each invariant, whether it is kept and how often it was checked; 1 if one is broken."""
    results = check_invariants(read_records(folder))
    if as_json:
        checks = {
            name: {
                "holds": result.holds,
                "checked": result.checked,
                "broken": _listed(result.broken),
                "unproven": _listed(result.inconclusive),
            }
            for name, result in results.items()
        }
        print_json({"run": encodable(folder.name), "invariants": checks})
    else:
        columns: list[Column[tuple[str, InvariantResult]]] = [
            Column("", itemgetter(0)),
            Column("invariant", lambda row: INVARIANTS[row[0]]),
            Column("kept", lambda row: _kept(row[1])),
            Column("checked", lambda row: row[1].checked, form="d"),
        ]
        print_table(Table(columns, results.items()))
        most = 3  # violations of one invariant
        for name, result in results.items():
            for word, breaks in (("broken", result.broken), ("not verified", result.inconclusive)):
                for each in breaks[:most]:
                    print_message(f"{name} {word} at record {each.seq}: {harmless(each.what)}")
                if len(breaks) > most:
                    print_message(f"{name} {word} at {len(breaks) - most} more records")
    return 0 if all(result.holds for result in results.values()) else 1


def _listed(breaks: Sequence[Violation]) -> list[Json]:
    return [{"record": each.seq, "what": encodable(each.what)} for each in breaks]


def _kept(result: InvariantResult) -> str:
    if not result.holds:
        return "BROKEN"
    return "yes" if result.checked else "not checked"


# -- compare --------------------------------------------------------------------------------------


def compare(args: Compare) -> int:
    """Print the changes from the first run to the second."""
    folders = [find_run(args.runs, name) for name in (args.first, args.second)]
    if folders[0].resolve() == folders[1].resolve():
        raise HilcellError(f"expected two runs, got run {folders[0].name} twice")
    first, second = (read_log(folder) for folder in folders)
    live = [live_engine(folder) is not None for folder in folders]
    found = compare_runs(first, second, live=(live[0], live[1]))
    names = [encodable(folder.resolve().name) for folder in folders]
    if args.json:
        changes = [
            msgspec.to_builtins(each)
            | {"verdict": each.verdict, "where": each.where, "figure": each.figure}
            for each in found.changes
        ]
        head: Json = {"first": names[0], "second": names[1], "verdict": found.verdict}
        print_json(head | msgspec.to_builtins(found) | {"changes": changes})
        return 0
    columns: list[Column[Setting]] = [
        Column("differs", attrgetter("key")),
        Column("first", attrgetter("first")),
        Column("second", attrgetter("second")),
    ]
    print_table(Table(columns, [Setting("run", *names), *found.settings]))
    print_table(Table(CHANGES, found.changes))
    for note in found.notes:
        print_message(f"note: {note}")
    print_message(found.verdict)
    return 0


# -- report and export ----------------------------------------------------------------------------


def report(args: Report) -> int:
    from hilcell.report.html import PARTS, report_html
    from hilcell.report.pdf import find_browser, pages_of, pdf_of

    folder, place = find_run(args.runs, args.run), Path(args.output)
    check_output(place, (".html", ".htm", ".pdf"), "a report", inputs=_files(folder))
    browser = find_browser() if place.suffix.lower() == ".pdf" else ""
    facts = read_facts(folder)
    language = of_environment(os.environ)
    html = report_html(facts, language=language)
    if browser:  # printed twice: first to read the page numbers
        html = report_html(facts, pages_of(pdf_of(html, browser), PARTS), language)
    content = pdf_of(html, browser) if browser else html.encode()
    write_whole(place, content, inputs=_files(folder))
    _print_written("report", facts, folder, args.output)
    return 0


def export(args: Export) -> int:
    from hilcell.report.dcc import dcc_bytes
    from hilcell.report.export import csv_bytes, json_bytes, urdf_of_run, xlsx_bytes

    written, suffixes, what = {
        "csv": (csv_bytes, CSV, "CSV"),
        "xlsx": (xlsx_bytes, (".xlsx",), "a workbook"),
        "json": (json_bytes, (".json",), "JSON"),
        "dcc": (dcc_bytes, (".xml", ".dcc"), "a DCC"),
        "urdf": (urdf_of_run, (".urdf", ".xml"), "a URDF"),
    }[args.form]
    folder, place = find_run(args.runs, args.run), Path(args.output)
    check_output(place, suffixes, what, inputs=_files(folder))
    facts = read_facts(folder)
    write_whole(place, written(facts), inputs=_files(folder))
    _print_written(args.form, facts, folder, args.output)
    return 0


def _print_written(what: str, facts: Facts, folder: Path, output: str) -> None:
    print_message(f"{what} of run {facts.run} written to {output}")
    if facts.log.state != "finished":
        state = row_of(folder).condition
        print_message(f"the run is {state}, not finished: {output} has the points up to now")


def _files(folder: Path) -> list[Path]:
    """Return the original files of a run, which must not be overwritten."""
    return [*folder.glob(f"{JOURNAL}*"), folder / CALIBRATION]


# -- revoke ---------------------------------------------------------------------------------------


def revoke(args: Revoke) -> int:
    """Revoke the calibration of a run, or a re-check's verdict on one, and print which calibration
    is current now.
    """
    folder = find_run(args.runs, args.run)
    log = read_log(folder)
    redo = log.state == "finished" and log.facts.recheck == "redo"
    if not (log.calibrates or redo) or live_engine(folder) is not None:
        raise HilcellError(
            f"run {folder.name} has no calibration to revoke: it is {log.state}", code="HC-J09"
        )
    facts = row_of(folder).facts
    if before := facts.revoked:
        raise HilcellError(f"run {folder.name} is already revoked: {before}", code="HC-J09")
    cell = f"cell {log.cell.name}"
    operator = ("--operator", args.operator) if args.operator else ()
    again = command_on(folder, "revoke", "--reason", args.reason, *operator)
    _check_permission(folder, again)
    with locked(lock_of_name(folder.parent, log.cell.name), cell, folder.name):
        name = encodable(folder.name)
        journal = RunJournal(folder / JOURNAL, name, create=False, again=again)
        try:
            revoked = CalibrationRevoked(reason=args.reason, operator=args.operator)
            journal.append("event", "", revoked)
        finally:
            journal.close()
    status = calibration_status(folder.resolve().with_name(facts.used) if redo else folder)
    current = status.current if status else ""
    rows = read_index(folder.parent)
    known = calibration_statuses(folder.parent, rows)
    rest = [] if redo else descended_from(rows, folder.name)
    if args.json:
        head: Json = {"run": folder.name, "reason": args.reason, "current": current or None}
        states = {encodable(row.name): known[row.name].state for row in rest}
        print_json(head | ({"descended": states} if states else {}))
        return 0
    machine = f" ({status.machine})" if status and status.machine else ""
    none = f"{cell}{machine} has no current calibration now"
    now = f"the current one is {current}" if current else none
    what = "verdict redo" if redo else "calibration"
    print_message(f"the {what} of run {folder.name} is revoked; {now}")
    for row in rest:
        kin = f"has the arm of {row.facts.carried}" if row.facts.carried else "is based on it"
        print_message(f"that of run {encodable(row.name)} {kin}: {known[row.name].text}")
    if any(row.facts.carried and known[row.name].state != "revoked" for row in rest):
        print_message("revoke these too if the reason is the arm, its gears or its reflector")
    return 0


def _check_permission(folder: Path, again: str) -> None:
    """Raise `StorageError` where no record can be added; the lock is beside the run."""
    for place in (folder / JOURNAL, folder, folder.resolve().parent):
        why = ""
        if os.statvfs(place).f_flag & os.ST_RDONLY:
            why = f"{place} is on a read-only file system; mount it for writing"
        elif not os.access(place, os.W_OK):
            why = f"no permission to write {place}; ask its owner, or revoke as the owner"
        if why:
            raise StorageError(
                f"run {folder.name}: its calibration is not revoked: {why}, then `{again}`"
            )
