"""``compare``: the drift between two runs of one cell."""

from __future__ import annotations

import argparse

import msgspec

from hilcell.clean import encodable, harmless
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.errors import HilcellError
from hilcell.journal.engine_file import live_engine
from hilcell.journal.find_run import find_run
from hilcell.journal.runs import read_log
from hilcell.report.comparison import Comparison, compare_runs, figure_words, where_words
from hilcell.report.drift import Change

DIGITS = {"mm": 4, "deg": 5, "°C": 2}


def compare(args: argparse.Namespace) -> int:
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
    settings = [[each.key, each.first, each.second] for each in found.settings]
    _draw(["differs", "first", "second"], [["run", first, second], *settings])
    headers = ["where", "what", "first", "second", "change", "limit", "unit", "verdict"]
    _draw(headers, [_row(each) for each in found.changes])
    for note in found.notes:
        print_message(f"note: {note}")
    print_message(found.verdict)


def _draw(headers: list[str], rows: list[list[str]]) -> None:
    print_table((headers, [[harmless(text) for text in row] for row in rows]))


def _row(each: Change) -> list[str]:
    digits = DIGITS[each.unit]
    pair = ["" if value is None else f"{value:.{digits}f}" for value in (each.first, each.second)]
    sign = "" if each.first is None else "+"
    limit = "" if each.limit is None else f"{each.limit:.{digits}f}"
    change = f"{each.change:{sign}.{digits}f}"
    return [where_words(each), figure_words(each), *pair, change, limit, each.unit, each.verdict]
