"""``compare``: the drift between two runs of one cell."""

from __future__ import annotations

from operator import attrgetter

import msgspec

from hilcell.clean import encodable
from hilcell.commands.orders import Compare
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.errors import HilcellError
from hilcell.journal.engine_file import live_engine
from hilcell.journal.find_run import find_run
from hilcell.journal.runs import read_log
from hilcell.present.table import Column, Table
from hilcell.report.comparison import (
    CHANGES,
    Comparison,
    Setting,
    compare_runs,
    figure_words,
    where_words,
)

SETTINGS: tuple[Column[Setting], ...] = (
    Column("differs", attrgetter("key")),
    Column("first", attrgetter("first")),
    Column("second", attrgetter("second")),
)


def compare(args: Compare) -> int:
    """Print the changes from the first run to the second; a drift is no failure of the command."""
    folders = [find_run(args.runs, name) for name in (args.first, args.second)]
    if folders[0].resolve() == folders[1].resolve():
        raise HilcellError(f"run {folders[0].name} is both: two runs are wanted")
    first, second = (read_log(folder) for folder in folders)
    lives, other_lives = (live_engine(folder) is not None for folder in folders)
    found = compare_runs(first, second, live=(lives, other_lives))
    names = [encodable(folder.resolve().name) for folder in folders]
    if args.json:
        print_json(_facts(found, *names))
        return 0
    _print(found, *names)
    return 0


def _facts(found: Comparison, first: str, second: str) -> dict[str, object]:
    changes = [
        msgspec.to_builtins(each)
        | {"verdict": each.verdict, "where": where_words(each), "figure": figure_words(each)}
        for each in found.changes
    ]
    whole: dict[str, object] = msgspec.to_builtins(found)
    head: dict[str, object] = {"first": first, "second": second, "verdict": found.verdict}
    return head | whole | {"changes": changes}


def _print(found: Comparison, first: str, second: str) -> None:
    print_table(Table(SETTINGS, [Setting("run", first, second), *found.settings]))
    print_table(Table(CHANGES, found.changes))
    for note in found.notes:
        print_message(f"note: {note}")
    print_message(found.verdict)
