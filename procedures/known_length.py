"""Certified lengths are measured when {W} is framed: the tracker's scale, before hours go by."""

from __future__ import annotations

from typing import Any

import msgspec

from hilcell.calibration.known_length import VERDICT, LengthFound, known_lengths
from hilcell.cell.file import Cell
from hilcell.journal.log import Log
from hilcell.journal.point_id import LENGTH, PointId
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Span
from procedures.durations import readings


def length_spans(cell: Cell) -> list[Span]:
    """Return the span of the bars' nests; those on the floor are measured anyway."""
    count = len(cell.layout.bar)
    return [readings(cell, count, cell.nest_samples)] if count else []


def check_lengths(session: CellSession) -> None:
    """Measure and judge the certified lengths, once; a wrong one pauses an attended run."""
    layout = session.cell.layout
    if not layout.length or VERDICT in session.log.verdicts:
        return
    for nest in layout.bar:
        session.floor_point(PointId(LENGTH, nest=nest.name), nest)
    found = known_lengths(session.cell, session.log)
    wrong = [each.text for each in found if not each.holds]
    session.verdict(
        "known-length", holds=not wrong, lengths=msgspec.to_builtins(found), wrong=wrong
    )
    if wrong:
        session.pause(f"the tracker's scale is not the certificate's: {'; '.join(wrong)}")


def length_result(log: Log) -> dict[str, Any]:
    """Return the certified lengths as found, where there are any."""
    rows = log.verdicts.get(VERDICT, {}).get("lengths", [])
    found = [(row, msgspec.convert(row, LengthFound)) for row in rows]
    lengths = [row | {"off_ppm": each.off_ppm, "holds": each.holds} for row, each in found]
    return {"known_lengths": lengths} if lengths else {}
