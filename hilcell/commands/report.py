"""``report`` and ``export``: what a run found, as one page or as tables."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hilcell.report.facts import read_facts
from hilcell.report.place import write_whole
from hilcell.runs import find_run


def report(args: argparse.Namespace) -> int:
    """Write one self-contained HTML file."""
    from hilcell.report.html import report_html

    facts = read_facts(find_run(args.runs, args.run))
    write_whole(Path(args.output), report_html(facts).encode())
    print(f"report of run {facts.run} in {args.output}", file=sys.stderr)
    return 0


def export(args: argparse.Namespace) -> int:
    """Write points as CSV, tables as a workbook, or everything as JSON."""
    from hilcell.report.export import csv_bytes, json_bytes, xlsx_bytes

    forms = {"csv": csv_bytes, "xlsx": xlsx_bytes, "json": json_bytes}
    facts = read_facts(find_run(args.runs, args.run))
    write_whole(Path(args.output), forms[args.form](facts))
    print(f"{args.form} of run {facts.run} in {args.output}", file=sys.stderr)
    return 0
