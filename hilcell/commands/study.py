"""``study``: a design study performed, and its answers."""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from hilcell.atomic_files import check_output, write_whole
from hilcell.commands.console import print_data, print_json, print_message, print_table
from hilcell.commands.signatures import RunStudy
from hilcell.errors import EXIT_ABORTED, EXIT_FAULT, EXIT_OK, EXIT_OUT_OF_TOLERANCE, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.signals import interrupted_once
from hilcell.sanitize import clean, harmless_lines
from hilcell.study.design import Case, cases
from hilcell.study.study_file import Study, read_study

if TYPE_CHECKING:
    from hilcell.study.cluster import Workers
    from hilcell.study.results import Results
    from hilcell.study.tables import Summary

REPORT = "report"


def study(args: RunStudy) -> int:
    _check_words(args)
    try:
        return _report(args) if args.file == REPORT else _perform(args)
    except ImportError as error:
        raise HilcellError(
            f"study: {error.name or error} is not installed; in a clone, "
            "`pip install '.[study]'` installs what it needs",
            code="HC-D03",
        ) from error


def _check_words(args: RunStudy) -> None:
    of_report = args.file == REPORT
    options = {
        "--workers": args.workers,
        "--scheduler": args.scheduler,
        "--dry-run": args.dry_run,
    }
    performing = [option for option, given in options.items() if given]
    if of_report and not args.folder:
        refusal = "study report: name the folder of results"
    elif args.folder and not of_report:
        refusal = (
            f"study: {clean(args.folder)!r} is one word too many; results go to -o DIR, a report "
            "is `hilcell study report DIR`"
        )
    elif of_report and performing:
        refusal = f"study report: {performing[0]} is for performing"
    elif args.workers and args.scheduler:
        refusal = "study: --workers are of this PC, --scheduler has workers of its own; name one"
    else:
        return
    raise HilcellError(refusal, code="HC-C11")


def _perform(args: RunStudy) -> int:
    path = Path(args.file)
    asked = read_study(path)
    folder = Path(args.output) if args.output else path.with_name(f"{path.stem}-results")
    if args.dry_run:
        return _dry_run(asked, as_json=args.json)
    from hilcell.study.results import Results
    from hilcell.study.tables import Summary

    results = Results(folder, asked)
    planned = asked.most_cases
    with results.held():
        kept = len(results.finished())
        print_message(f"study {asked.name}: {planned} cases, {kept} of them kept in {folder}")
        if kept < planned:
            from hilcell.study.cluster import Cluster

            try:
                with interrupted_once() as check, _workers(args) as workers:
                    counts = _measured(results, workers, planned, kept, check)
            except (Cluster, KeyboardInterrupt) as error:
                lost = isinstance(error, Cluster)
                if not len(results.finished()) > (kept if lost else 0):
                    raise
                print_message(
                    f"hilcell: {error if lost else 'interrupted'}; finished cases are kept, the "
                    "same command goes on"
                )
                return EXIT_FAULT if lost else EXIT_ABORTED
            print_message(", ".join(f"{n} {state}" for state, n in sorted(counts.items())))
        else:
            results.merge()
    return _answer(Summary(asked, results.rows()), as_json=args.json)


def _dry_run(asked: Study, *, as_json: bool) -> int:
    found = cases(asked)
    if as_json:
        listed = [
            {
                "case": each.number,
                "point": each.point.number,
                "machine": each.machine,
                "seed": each.seed,
                "settings": each.point.values,
            }
            for each in found
        ]
        print_json({"study": asked.name, "cases": listed})
        return EXIT_OK
    from hilcell.study.tables import point_columns

    point, *factors = point_columns(asked)
    columns: list[Column[Case]] = [
        Column("case", attrgetter("number"), form="d"),
        point,
        Column("machine", attrgetter("machine"), form="d"),
        Column("seed", attrgetter("seed"), form="d"),
        *factors,
    ]
    most_listed = 1000  # a table of 65 536 takes half a minute
    print_table(Table(columns, itertools.islice(found, most_listed)))
    if more := sum(1 for _ in found):
        print_message(f"{more} more cases; --json lists all")
    if asked.optimise is not None:
        print_message(
            f"the search goes on from these; it measures {asked.most_cases} cases at most"
        )
    return EXIT_OK


def _workers(args: RunStudy) -> AbstractContextManager[Workers]:
    from hilcell.study.cluster import local_workers, workers_of

    if args.scheduler:
        return workers_of(args.scheduler, print_message)
    return local_workers(args.workers or len(os.sched_getaffinity(0)), print_message)


def _measured(
    results: Results, workers: Workers, planned: int, kept: int, check: Callable[[], None]
) -> Counter[str]:
    """Measure the cases that are left, with a progress bar on stderr; ``check`` may end it."""
    from hilcell.commands.run_output import progress_bar
    from hilcell.study.runner import perform

    with progress_bar() as progress:
        task = progress.add_task(clean(results.study.name), total=planned, completed=kept)

        def heard(_: object) -> None:
            progress.advance(task)
            check()

        return perform(results, workers, heard)


def _report(args: RunStudy) -> int:
    from hilcell.study.html import page
    from hilcell.study.results import open_results

    folder = Path(args.folder)
    results = open_results(folder)
    place = Path(args.output) if args.output else folder / "report.html"
    check_output(place, (".html", ".htm"), "a report", inputs=results.files())
    from hilcell.study.tables import Summary

    summary = Summary(results.study, results.rows())
    write_whole(place, page(summary).encode(), inputs=results.files())
    code = _answer(summary, as_json=args.json)
    print_message(f"report of study {results.study.name} in {place}")
    return code


def _answer(summary: Summary, *, as_json: bool) -> int:
    """Print the answers; return whether every case was done, or cannot be."""
    from hilcell.study.case import DONE, FAILED

    if as_json:
        print_json(summary.facts())
    else:
        for each in filter(None, summary.tables().values()):
            print_data(harmless_lines(f"\n{each.title}"))
            print_table(each)
            if each.note:
                print_data(harmless_lines(each.note))
    print_message(summary.counts())
    counts = summary.found.counts
    bad = counts.get(FAILED, 0) or not counts.get(DONE, 0)
    return EXIT_OUT_OF_TOLERANCE if bad else EXIT_OK
