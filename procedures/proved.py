"""Verdicts of commissioning, and the values of the cell file that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from operator import itemgetter

import msgspec

from hilcell.decoding import Json, typed
from hilcell.journal.log import Log
from hilcell.model.verdicts import Proved
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result

PREFIX = "commissioning."


def prove(
    session: CellSession,
    what: str,
    *,
    holds: bool,
    found: str,
    expected: str,
    values: Mapping[str, object] | None = None,
) -> bool:
    """Journal a verdict on ``what``, once in a run, and return whether it holds."""
    key = PREFIX + what
    if key not in session.log.verdicts:
        plain: Json = msgspec.to_builtins(values or {})
        session.judge(key, Proved(holds=holds, found=found, expected=expected, values=plain))
    return session.log.verdicts[key].holds


def proved_result(log: Log) -> Result:
    """Return all verdicts of commissioning, by what they are about."""
    found = {
        key.removeprefix(PREFIX): verdict
        for key, verdict in log.verdicts.items()
        if isinstance(verdict, Proved)
    }
    return {"proved": found}


def proved_table(result: Result) -> Table:
    rows = typed(result["proved"], dict[str, Proved]).items()
    return Table(
        [
            Column("verified", itemgetter(0)),
            Column("found", lambda row: row[1].found),
            Column("expected", lambda row: row[1].expected),
            Column("", lambda row: "" if row[1].holds else "differs"),
        ],
        list(rows),
    )
