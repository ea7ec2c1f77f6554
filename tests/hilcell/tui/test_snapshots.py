"""Every state of a run and every page once as text, compared with the files in ``snapshots/``.

To write them again after an intended change, then read the difference before it is committed:

    HILCELL_SNAPSHOTS=write pytest tests/hilcell/tui/test_snapshots.py
"""

from __future__ import annotations

import difflib
import os
from pathlib import Path

import pytest
from textual.command import CommandList, CommandPalette

from hilcell.commission.sequence import STEPS
from hilcell.tui.terminal import UNICODE
from tests.hilcell.tui.all_screens import form_of, isolated, screens_of, work_of
from tests.hilcell.tui.recording_app import (
    SIZE,
    Press,
    Stage,
    on_screen,
    press,
    run_app,
    settle,
    text_at_rest,
)
from tests.hilcell.tui.sample_runs import sample_runs
from tests.whole.bench import sweep

__all__ = ["isolated"]

FOLDER = Path(__file__).with_name("snapshots")
SWITCH = "HILCELL_SNAPSHOTS"
WIDE, LOW, TINY = (160, 40), (60, 15), (20, 5)
STATES = tuple(sample_runs())
CROWDED = ("running", "suspended", "fault", "done")  # points, prompt, alarm, verdict
COMMISSIONED = ("", "running", "paused", "suspended")  # a form, and the run of a step
# A page that each state shows best, with the keys that open it.
PAGES: dict[str, dict[str, tuple[str, ...]]] = {
    "running": {
        "interlocks": ("i",),
        "log": ("l",),
        "help": ("question_mark",),
        "asks-abort": ("a",),
        "asks-quit": ("ctrl+q",),
        "asks-retake": ("r",),
        "point": ("enter",),
        "palette": ("ctrl+p", *"alarm"),
    },
    "paused": {"asks-pause": ("space",)},
    "fault": {"alarms": ("e",), "points": ("enter",)},
    "done": {
        "report": ("o",),
        "plot-1": ("p", "1"),
        "plot-2": ("p", "2"),
        "plot-3": ("p", "3"),
        "plot-4": ("p", "4"),
        "history": ("h",),
        "compare": ("h", "x", "down", "x", "c"),
    },
}

pytestmark = pytest.mark.usefixtures("isolated")


def differences(seen: dict[str, str]) -> str:
    """Return a unified diff with the files of these names; nothing where all are alike."""
    if os.environ.get(SWITCH) == "write":
        for name, text in seen.items():
            (FOLDER / f"{name}.txt").write_text(text, "utf-8")
    return "\n".join(filter(None, map(_difference, seen, seen.values())))


def _difference(name: str, seen: str) -> str:
    file = FOLDER / f"{name}.txt"
    known = file.read_text("utf-8") if file.exists() else ""
    lines = difflib.unified_diff(
        known.splitlines(), seen.splitlines(), f"{name} as kept", f"{name} now", lineterm=""
    )
    return "\n".join(lines)


async def _pages(app: Stage, pilot: Press, state: str) -> dict[str, str]:
    """Return the run's screen and the pages that are kept of this state."""
    await settle(pilot)
    home, seen = app.screen, {f"{state}-run": text_at_rest(app)}
    for name, keys in PAGES.get(state, {}).items():
        await press(pilot, *keys)
        if isinstance(app.screen, CommandPalette):
            while not app.screen.query_one(CommandList).option_count:
                await settle(pilot)
            await settle(pilot)
        seen[f"{state}-{name}"] = text_at_rest(app)
        while app.screen is not home:
            app.pop_screen()
            await settle(pilot)
    return seen


@pytest.mark.parametrize("state", STATES)
@on_screen(size=SIZE)
async def test_every_screen_looks_as_it_did(app: Stage, pilot: Press, state: str) -> None:
    seen = await _pages(app, pilot, state)
    problems = differences(seen)
    assert not problems, problems
    assert all(len(line) <= SIZE[0] for text in seen.values() for line in text.splitlines())


@on_screen(size=SIZE)
async def test_the_form_and_its_plan_look_as_they_did(app: Stage, pilot: Press) -> None:
    seen = await form_of(app, pilot)
    problems = differences({f"new-{name}": text for name, text in seen.items()})
    assert not problems, problems


@pytest.mark.parametrize("state", COMMISSIONED)
@on_screen(size=SIZE)
async def test_commissioning_looks_as_it_did(
    app: Stage, pilot: Press, state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the first steps: a further one changes no picture."""
    for room in ("commission.sequence", "tui.text.commissioning"):
        monkeypatch.setattr(f"hilcell.{room}.STEPS", STEPS[:6])
    if state:
        app.commissioning = work_of("rail")
    await press(pilot, "C")
    problems = differences({f"commission-{state or 'form'}": text_at_rest(app)})
    assert not problems, problems


@on_screen("running", size=WIDE)
async def test_the_map_stands_beside_the_points_where_no_column_needs_its_place(
    app: Stage, pilot: Press
) -> None:
    """On one terminal, which changes its width."""
    found = []
    for width in (90, 99, 100, 119, 120, 137, 138):
        await pilot.resize_terminal(width, WIDE[1])
        await pilot.pause()
        if app.screen.query_one("#side").display:
            found.append(width)
    assert found == [100, 119, 138]


@pytest.mark.parametrize("state", CROWDED)
@on_screen(size=WIDE)
async def test_small_terminals_keep_the_state_and_wide_ones_add_panels(
    app: Stage, pilot: Press, state: str
) -> None:
    """On one terminal, which changes its size."""
    for size in (WIDE, LOW, TINY):
        await pilot.resize_terminal(*size)
        await settle(pilot)
        text = text_at_rest(app)
        lines = text.splitlines()
        assert UNICODE.states[state] in lines[0]
        assert all(len(line) <= size[0] for line in lines)
        assert len(lines) == size[1]
        problems = differences({f"wide-{state}-run": text}) if size == WIDE else ""
        assert not problems, problems


def test_no_file_is_kept_of_a_screen_that_is_gone() -> None:
    seen = {f"{state}-run" for state in STATES} | {"new-form", "new-plan"}
    seen |= {f"{state}-{name}" for state, pages in PAGES.items() for name in pages}
    seen |= {f"wide-{state}-run" for state in CROWDED}
    seen |= {f"commission-{state or 'form'}" for state in COMMISSIONED}
    assert {path.stem for path in FOLDER.iterdir()} == seen


@pytest.mark.parametrize(
    ("state", "whole"),
    [*((state, False) for state in ("intolerant", "suspended", "silent", "")),
     *sweep(("intolerant", True))],
)  # fmt: skip
def test_ascii_is_ascii_on_every_screen(state: str, whole: bool) -> None:
    """On the first screen of states; by day test_untrusted_text looks at every page."""

    async def look(app: Stage, pilot: Press) -> None:
        if not state:
            seen = await form_of(app, pilot)
        else:
            seen = await screens_of(app, pilot) if whole else {"run": text_at_rest(app)}
        assert not {name: set(text) for name, text in seen.items() if not text.isascii()}

    run_app(look, state, size=SIZE, ascii_only=True)
