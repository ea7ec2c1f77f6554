"""The layouts between the widths at which panels come and go: nothing is cut, nothing overlaps."""

from __future__ import annotations

import re

import pytest
from textual.pilot import Pilot

from tests.hilcell.tui.all_screens import isolated
from tests.hilcell.tui.recording_app import RecordingApp, options, press, settle, text_of
from tests.hilcell.tui.test_snapshots import RUNS, differences, seen_on

__all__ = ["isolated"]
WIDTHS = (80, 100, 119, 120, 128, 137, 138, 160)
ROWS = 36
CUT = re.compile(r"\d…|…\d|\d\.(?!\d|\s|$)(?=[│┤])")

pytestmark = pytest.mark.usefixtures("isolated")


async def pages(app: RecordingApp, pilot: Pilot[int]) -> dict[str, str]:
    """Return the run and its plots."""
    await settle(pilot)
    seen = {"run": text_of(app)}
    await press(pilot, "p")
    return seen | {"plots": text_of(app)}


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("state", ["running", "done"])
def test_run_and_plots_at_every_width(state: str, width: int) -> None:
    seen = seen_on(RecordingApp(options(RUNS), state), pages, (width, ROWS))
    prefix = f"columns-{width}-{state}-"
    problems = differences({f"{prefix}{name}": text for name, text in seen.items()}, prefix)
    assert not problems, problems
    for text in seen.values():
        lines = text.splitlines()
        assert len(lines) == ROWS
        assert all(len(line) <= width for line in lines)
        assert not CUT.search(text), text
    assert ("map: " in seen["run"]) == (width in (100, 119) or width >= 138)
