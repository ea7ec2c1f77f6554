"""Views of the made-up runs, as the functions of ``tui.text`` take them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from hilcell.tui.layout import Lines
from hilcell.tui.run_view import RunView
from hilcell.tui.widgets import Column
from tests.hilcell.tui.recording_app import RecordingSession
from tests.hilcell.tui.sample_runs import fresh, sample_run

T = TypeVar("T")


def view_of(name: str) -> RunView:
    """Return the view of a run in a state, at the moment of its last record."""
    session = RecordingSession(Path("/runs/made-up"))
    session.take(fresh(name), sample_run(name).now)
    return session.view


def drawn(text: Lines, width: int = 79, height: int = 24) -> str:
    """Return a text as a panel of this size shows it, without spaces at the ends of lines."""
    return "\n".join(line.plain.rstrip() for line in text.lines(width, height))


def cells(columns: Iterable[Column[T]], row: T, width: int = 80) -> dict[Column[T], str]:
    """Return the texts of a row in a table of this width."""
    found = {column: column.of(row) for column in columns if column.is_in(width)}
    return {of: cell if isinstance(cell, str) else cell[0] for of, cell in found.items()}
