"""Views of the made-up runs, as the functions of ``tui.text`` take them."""

from __future__ import annotations

from pathlib import Path

from hilcell.tui.layout import Lines
from hilcell.tui.run_view import RunView
from tests.hilcell.tui.recording_app import RecordingSession
from tests.hilcell.tui.sample_runs import fresh, sample_run


def view_of(name: str) -> RunView:
    """Return the view of a run in a state, at the moment of its last record."""
    session = RecordingSession(Path("/runs/made-up"))
    session.take(fresh(name), sample_run(name).now)
    return session.view


def drawn(text: Lines, width: int = 79, height: int = 24) -> str:
    """Return a text as a panel of this size shows it, without spaces at the ends of lines."""
    return "\n".join(line.plain.rstrip() for line in text.lines(width, height))
