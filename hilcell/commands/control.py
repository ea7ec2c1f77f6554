"""``pause``, ``stop`` and ``watch``: control a live run from another process."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NoReturn

from hilcell.commands.console import print_answer, print_message
from hilcell.commands.run_output import (
    JsonOutput,
    ProgressOutput,
    RunOutput,
    end_text,
    kind_of,
    left_moving,
)
from hilcell.commands.signatures import Pause, Stop, Watch
from hilcell.errors import EXIT_ABORTED, EXIT_REFUSED, HilcellError
from hilcell.journal.index import find_run
from hilcell.journal.journal import Record, read_journal
from hilcell.journal.log import Log
from hilcell.journal.runs import JOURNAL, live_engine
from hilcell.run.control import Command, order
from hilcell.run.last_word import last_word
from hilcell.sanitize import encodable


def pause(args: Pause) -> int:
    return _command(args, "pause")


def stop(args: Stop) -> int:
    return _command(args, "stop")


def _command(args: Pause, command: Command) -> int:
    folder = find_run(args.runs, args.run)
    answer = order(folder, command)
    print_answer(answer.answer(), f"run {folder.name}: asked to {command}", as_json=args.json)
    return 0


def watch(args: Watch) -> int:
    """Print a run's records to its end, or until its process has died."""
    if (args.bind or args.port) and not args.web:
        raise HilcellError("watch: --bind and --port require --web")
    folder = find_run(args.runs, args.run)
    try:
        if args.web:
            _serve(folder, args)
        return _watch(folder, as_json=args.json)
    except KeyboardInterrupt:
        print_message(f"run {folder.name}: watching ended; the run is not affected")
        return EXIT_ABORTED


def _serve(folder: Path, args: Watch) -> NoReturn:
    """Show a run to browsers, also after its end."""
    from hilcell.web.server import LOOPBACK, PageServer
    from hilcell.web.snapshot import FollowedRun

    run, name = FollowedRun(folder), encodable(folder.name)
    with PageServer(args.bind or LOOPBACK, args.port or 0) as server:
        text = f"run {name}: {server.url} shows it until ctrl-C"
        print_answer({"run": name, "url": server.url}, text, as_json=args.json)
        while True:
            server.publish(run.snapshot(datetime.now(UTC)))
            time.sleep(1.0)


def _watch(folder: Path, *, as_json: bool) -> int:
    log = Log()
    records = _follow(folder)
    first = next(records, None)
    if first is None or first.kind != "plan":
        print_message(f"run {folder.name}: no records yet")
        return EXIT_REFUSED
    log.take(first)
    name = encodable(folder.name)
    output: RunOutput = JsonOutput(name) if as_json else ProgressOutput(folder, log.inputs.points)
    with output:
        output.take(first)
        for record in records:
            if output.lost is not None:
                raise output.lost
            log.take(record)
            output.take(record)
    if output.lost is not None:
        raise output.lost
    print_message(f"{kind_of(log)} {folder.name}: {end_text(log)}")
    if problem := left_moving(log):
        print_message(problem)
    print_message(last_word(log, folder).text)
    return 0


def _follow(folder: Path) -> Iterator[Record]:
    """Yield the records of a journal as they come, until the run's process has ended."""
    count = 0
    while True:
        alive = live_engine(folder) is not None
        new = read_journal(folder / JOURNAL, after=count)
        yield from new
        count += len(new)
        if not alive and not new:
            return
        time.sleep(0.1)
