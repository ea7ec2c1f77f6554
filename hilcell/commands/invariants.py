"""``show --check``: the invariants of a run, judged from its journal."""

from __future__ import annotations

from operator import itemgetter
from pathlib import Path

from hilcell.clean import encodable, harmless
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.invariants.judging import judge
from hilcell.invariants.tally import INVARIANTS, Break, Proof
from hilcell.journal.runs import read_records
from hilcell.present.table import Column, Table

FIRST = 3  # violations of one invariant that are printed


def check(folder: Path, *, as_json: bool) -> int:
    """Print each invariant, whether it holds and how often it was judged; 1 where one is broken."""
    verdicts = judge(read_records(folder))
    if as_json:
        found = {name: _facts(verdict) for name, verdict in verdicts.items()}
        print_json({"run": encodable(folder.name), "invariants": found})
    else:
        _print(verdicts)
    return 0 if all(verdict.holds for verdict in verdicts.values()) else 1


def _facts(verdict: Proof) -> dict[str, object]:
    return {
        "holds": verdict.holds,
        "checked": verdict.checked,
        "broken": [_place(each) for each in verdict.broken],
        "unproven": [_place(each) for each in verdict.unproven],
    }


def _place(found: Break) -> dict[str, object]:
    return {"record": found.seq, "what": encodable(found.what)}


def _print(verdicts: dict[str, Proof]) -> None:
    columns: list[Column[tuple[str, Proof]]] = [
        Column("", itemgetter(0)),
        Column("invariant", lambda row: INVARIANTS[row[0]]),
        Column("holds", lambda row: _word(row[1])),
        Column("checked", lambda row: row[1].checked, form="d"),
    ]
    print_table(Table(columns, verdicts.items()))
    for name, verdict in verdicts.items():
        for word, found in (("broken", verdict.broken), ("not proven", verdict.unproven)):
            for each in found[:FIRST]:
                print_message(f"{name} {word} at record {each.seq}: {harmless(each.what)}")
            if len(found) > FIRST:
                print_message(f"{name} {word} at {len(found) - FIRST} more records")


def _word(verdict: Proof) -> str:
    """Return the verdict in words; an invariant that was never judged is not claimed."""
    if not verdict.holds:
        return "BROKEN"
    return "yes" if verdict.checked else "not checked"
