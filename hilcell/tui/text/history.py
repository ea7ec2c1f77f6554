"""The history in rows: one run a row, newest first."""

from __future__ import annotations

from collections.abc import Collection

from hilcell.journal.index import RunRow
from hilcell.tui.text.columns import Column, Row

PROCEDURE = 13
NARROW = (
    Column("", 1),
    Column("begun UTC", 16),
    Column("procedure", PROCEDURE),
    Column("state", 16),
    Column("points", 6, right=True),
    Column("before", 6, right=True),
    Column("after", 6, right=True),
    Column("job", 6),
)
WIDE = (
    *NARROW[:-1],
    Column("max mm", 6, right=True),
    Column("job", 12),
    Column("operator", 12),
    Column("cell", 12),
    Column("kind", 9),
    Column("run", 36),
)
WIDE_FROM = 130
_TONES = {"finished": "", "aborted": "dim", "faulted": "bad"}


def columns_for(width: int) -> tuple[Column, ...]:
    """Return the columns that fit; mean |e| before and after in mm."""
    return WIDE if width >= WIDE_FROM else NARROW


def history_row(run: RunRow, marked: Collection[str], width: int) -> Row:
    """Return the cells of one run; ``marked`` are those to be compared."""
    state = "LIVE " + run.state if run.live else "engine gone" if run.gone else run.condition
    if run.exit == 1:
        state = "out of tolerance"
    mark = "*" if run.name in marked else ""
    begun = run.begun[:16].replace("T", " ")
    tone = "info" if run.live else "bad" if run.exit in (1, 3) else _TONES.get(run.state, "warn")
    head = (
        mark,
        begun,
        run.procedure or run.name[-PROCEDURE:],
        state,
        str(run.points or ""),
        _mm(run.before_mean_mm),
        _mm(run.chosen_mean_mm),
    )
    if width < WIDE_FROM:
        return Row(run.name, (*head, run.job), tone)
    kind = "simulated" if run.simulated else "real"
    tail = (_mm(run.chosen_max_mm), run.job, run.operator, run.cell, kind, run.name)
    return Row(run.name, head + tail, tone)


def _mm(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"
