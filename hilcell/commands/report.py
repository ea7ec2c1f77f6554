"""``report`` and ``export``: the results of a run, as one page or as tables."""

from __future__ import annotations

from pathlib import Path

from hilcell.commands.orders import Export, Report
from hilcell.commands.output import print_message
from hilcell.journal.find_run import find_run
from hilcell.journal.index import row_of
from hilcell.journal.runs import CALIBRATION, JOURNAL
from hilcell.report.facts import Facts, read_facts
from hilcell.writing import CSV, check_output, write_whole


def report(args: Report) -> int:
    """Write one self-contained HTML file, or print it to a PDF where it is named so."""
    from hilcell.report.html import PARTS, report_html
    from hilcell.report.pdf import find_browser, pages_of, pdf_of

    folder, place = find_run(args.runs, args.run), Path(args.output)
    check_output(place, (".html", ".htm", ".pdf"), "a report", inputs=_files(folder))
    browser = find_browser() if place.suffix.lower() == ".pdf" else ""
    facts = read_facts(folder)
    html = report_html(facts)
    if browser:  # once to see on which page each part begins, once to say so
        html = report_html(facts, pages_of(pdf_of(html, browser), PARTS))
    content = pdf_of(html, browser) if browser else html.encode()
    write_whole(place, content, inputs=_files(folder))
    _say_written("report", facts, folder, args.output)
    return 0


def export(args: Export) -> int:
    """Write points as CSV, tables as a workbook, the certificate as a DCC, or all as JSON."""
    from hilcell.report.dcc import dcc_bytes
    from hilcell.report.export import csv_bytes, json_bytes, xlsx_bytes

    forms = {"csv": csv_bytes, "xlsx": xlsx_bytes, "json": json_bytes, "dcc": dcc_bytes}
    folder, place = find_run(args.runs, args.run), Path(args.output)
    suffixes, what = _NAMED[args.form]
    check_output(place, suffixes, what, inputs=_files(folder))
    facts = read_facts(folder)
    write_whole(place, forms[args.form](facts), inputs=_files(folder))
    _say_written(args.form, facts, folder, args.output)
    return 0


def _say_written(what: str, facts: Facts, folder: Path, output: str) -> None:
    print_message(f"{what} of run {facts.run} in {output}")
    if facts.log.state != "finished":
        state = row_of(folder).condition
        print_message(f"the run is {state}, not finished: it holds what was measured so far")


_NAMED = {
    "csv": (CSV, "CSV"),
    "xlsx": ((".xlsx",), "a workbook"),
    "json": ((".json",), "JSON"),
    "dcc": ((".xml", ".dcc"), "a DCC"),
}


def _files(folder: Path) -> list[Path]:
    """Return what a run is made of: none of it can be made again from the others."""
    return [*folder.glob(f"{JOURNAL}*"), folder / CALIBRATION]
