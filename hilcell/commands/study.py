"""``study``: run a design study, and print its results."""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from hilcell.atomic_files import check_output, write_whole
from hilcell.commands.console import print_data, print_json, print_message, print_table
from hilcell.commands.signatures import RunStudy
from hilcell.errors import EXIT_ABORTED, EXIT_FAULT, EXIT_OK, EXIT_OUT_OF_TOLERANCE, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.signals import interrupted_once
from hilcell.sanitize import clean, counted, harmless_lines
from hilcell.study.case import Row
from hilcell.study.design import Case, cases, points
from hilcell.study.study_file import Study, read_study

if TYPE_CHECKING:
    from hilcell.study.cluster import Workers
    from hilcell.study.results import Results
    from hilcell.study.tables import Summary

REPORT = "report"
T = TypeVar("T")


def study(args: RunStudy) -> int:
    try:
        _check_arguments(args)
        return _report(args) if args.file == REPORT else _run(args)
    except ImportError as error:
        raise HilcellError(
            f"study: {error.name or error} is not installed; in a clone, run "
            "`pip install '.[study]'`",
            code="HC-D03",
        ) from error


def _check_arguments(args: RunStudy) -> None:
    report = args.file == REPORT
    options = {
        "--workers": args.workers,
        "--scheduler": args.scheduler,
        "--dry-run": args.dry_run,
    }
    given = [option for option, value in options.items() if value]
    if report and not args.folder:
        refusal = "study report: expected the folder of results"
    elif args.folder and not report:
        refusal = (
            f"study: unexpected argument {clean(args.folder)!r}; -o DIR sets the folder of "
            "results, `hilcell study report DIR` writes a report"
        )
    elif report and given:
        refusal = f"study report: unexpected option {given[0]}"
    elif args.workers and args.scheduler:
        refusal = "study: expected either --workers or --scheduler, got both"
    else:
        return
    raise HilcellError(refusal, code="HC-C11")


def _run(args: RunStudy) -> int:
    path = Path(args.file)
    study = read_study(path)
    folder = Path(args.output) if args.output else path.with_name(f"{path.stem}-results")
    if args.dry_run:
        return _dry_run(study, as_json=args.json)
    from hilcell.study.results import Results
    from hilcell.study.tables import Summary

    results = Results(folder, study)
    planned = study.most_cases
    with results.held():
        finished = len(results.finished())
        print_message(f"study {study.name}: {planned} cases, {finished} finished, in {folder}")
        if finished < planned:
            from hilcell.study.cluster import ClusterError

            try:
                with interrupted_once() as check, _workers(args) as workers:
                    counts = _measured(results, workers, planned, finished, check)
            except (ClusterError, KeyboardInterrupt) as error:
                lost = isinstance(error, ClusterError)
                if not len(results.finished()) > (finished if lost else 0):
                    raise
                print_message(
                    f"hilcell: {error if lost else 'interrupted'}; finished cases are stored, the "
                    "same command continues"
                )
                return EXIT_FAULT if lost else EXIT_ABORTED
            print_message(", ".join(f"{n} {state}" for state, n in sorted(counts.items())))
        else:
            results.merge()
    return _answer(Summary(study, results.rows()), as_json=args.json)


def _dry_run(study: Study, *, as_json: bool) -> int:
    """Plan each point, and list the cases."""
    from hilcell.study.runner import plan_of
    from hilcell.study.tables import point_columns

    listed = points(study)
    with _progress(study, len(listed)) as advance:
        plans = {each.number: advance(plan_of(study, each)) for each in listed}
    planned = cases(study)
    if as_json:
        of_points = [
            {"point": number, "minutes": each.minutes, "cannot_be": each.cannot_be}
            for number, each in plans.items()
        ]
        of_cases = [
            {
                "case": each.number,
                "point": each.point.number,
                "machine": each.machine,
                "seed": each.seed,
                "settings": each.point.values,
            }
            for each in planned
        ]
        print_json({"study": study.name, "points": of_points, "cases": of_cases})
        return EXIT_OK
    point, *factors = point_columns(study)
    columns: list[Column[Case]] = [
        Column("case", attrgetter("number"), form="d"),
        point,
        Column("machine", attrgetter("machine"), form="d"),
        Column("seed", attrgetter("seed"), form="d"),
        *factors,
        Column("minutes", lambda each: plans[each.point.number].shown_minutes, form=".1f"),
    ]
    most_listed = 1000  # a table of 65 536 takes half a minute
    print_table(Table(columns, itertools.islice(planned, most_listed)))
    if more := sum(1 for _ in planned):
        print_message(f"{more} more cases; --json lists all")
    reasons: dict[str, list[int]] = {}
    for number, each in plans.items():
        if each.cannot_be:
            reasons.setdefault(each.cannot_be, []).append(number)
    for reason, numbers in reasons.items():
        print_data(harmless_lines(f"\npoints that cannot be: {', '.join(map(str, numbers))}"))
        print_data(harmless_lines(reason))
    bad = sum(map(len, reasons.values()))
    print_message(f"{counted(len(plans), 'point')}, of which {bad} cannot be")
    if study.optimise is not None:
        print_message(
            f"the search starts from these; it simulates at most {study.most_cases} cases"
        )
    return EXIT_OK


def _workers(args: RunStudy) -> AbstractContextManager[Workers]:
    from hilcell.study.cluster import local_workers, scheduler_workers

    if args.scheduler:
        return scheduler_workers(args.scheduler, print_message)
    return local_workers(args.workers or len(os.sched_getaffinity(0)), print_message)


def _measured(
    results: Results, workers: Workers, planned: int, finished: int, check: Callable[[], None]
) -> Counter[str]:
    """Simulate the remaining cases; ``check`` may end it."""
    from hilcell.study.runner import run_study

    with _progress(results.study, planned, finished) as advance:

        def on_progress(row: Row) -> None:
            advance(row)
            check()

        return run_study(results, workers, on_progress)


@contextmanager
def _progress(study: Study, total: int, finished: int = 0) -> Iterator[Callable[[T], T]]:
    """Show a progress bar on stderr; yield a function that advances it and returns its argument."""
    from hilcell.commands.run_output import progress_bar

    with progress_bar() as progress:
        task = progress.add_task(clean(study.name), total=total, completed=finished)

        def advance(done: T) -> T:
            progress.advance(task)
            return done

        yield advance


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
    """Print the results; exit code 1 if a case failed or none was done."""
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
