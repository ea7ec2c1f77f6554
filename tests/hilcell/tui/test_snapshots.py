"""Every screen in every state as text, compared with the files in ``snapshots/``.

To write them again after an intended change, then read the difference before it is committed:

    HILCELL_SNAPSHOTS=write pytest tests/hilcell/tui/test_snapshots.py
"""

from __future__ import annotations

import asyncio
import difflib
import os
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from textual.pilot import Pilot

from tests.hilcell.tui.all_screens import form_of, isolated, screens_of
from tests.hilcell.tui.recording_app import SIZE, RecordingApp, options, settle, text_at_rest
from tests.hilcell.tui.sample_runs import sample_runs

FOLDER = Path(__file__).with_name("snapshots")
SWITCH = "HILCELL_SNAPSHOTS"


def differences(seen: dict[str, str], prefix: str) -> str:
    """Return a unified diff of all screens whose names begin so; nothing where all are alike.

    ``seen`` maps names to texts. A file that no screen stands for any more is a difference, too.
    """
    if os.environ.get(SWITCH) == "write":
        _write(seen, prefix)
    known = {path.stem: path.read_text("utf-8") for path in FOLDER.glob(f"{prefix}*.txt")}
    names = sorted(known.keys() | seen.keys())
    return "\n".join(_diff(name, known.get(name, ""), seen.get(name, "")) for name in names).strip()


def _diff(name: str, known: str, seen: str) -> str:
    lines = difflib.unified_diff(
        known.splitlines(), seen.splitlines(), f"{name} as kept", f"{name} now", lineterm=""
    )
    return "\n".join(lines)


def _write(seen: dict[str, str], prefix: str) -> None:
    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.glob(f"{prefix}*.txt"):
        if path.stem not in seen:
            path.unlink()
    for name, text in seen.items():
        (FOLDER / f"{name}.txt").write_text(text, "utf-8")


__all__ = ["isolated"]

STATES = tuple(sample_runs())
RUNS = Path("/runs")  # no folder of this machine: nothing is read there
LEAST = 100
THOROUGH = ("suspended", "intolerant")  # every screen also where it is crowded
WIDE, LOW, TINY = (160, 40), (60, 15), (20, 5)

pytestmark = pytest.mark.usefixtures("isolated")
Walk = Callable[[RecordingApp, Pilot[int]], Awaitable[dict[str, str]]]


def seen_on(app: RecordingApp, walk: Walk, size: tuple[int, int] = SIZE) -> dict[str, str]:
    """Return what a walk sees on a terminal of some size."""

    async def run_app() -> dict[str, str]:
        async with app.run_test(size=size) as pilot:
            return await walk(app, pilot)

    return asyncio.run(run_app())


def named(prefix: str, seen: dict[str, str]) -> dict[str, str]:
    return {f"{prefix}-{name}": text for name, text in seen.items()}


async def first_screen(app: RecordingApp, pilot: Pilot[int]) -> dict[str, str]:
    await settle(pilot)
    return {"run": text_at_rest(app)}


@pytest.mark.parametrize("state", STATES)
def test_every_screen_looks_as_it_did(state: str) -> None:
    seen = seen_on(RecordingApp(options(RUNS), state), screens_of)
    problems = differences(named(state, seen), f"{state}-")
    assert not problems, problems
    assert all(len(line) <= SIZE[0] for text in seen.values() for line in text.splitlines())


def test_the_form_and_its_plan_look_as_they_did() -> None:
    seen = seen_on(RecordingApp(options(RUNS)), form_of)
    problems = differences(named("new", seen), "new-")
    assert not problems, problems


def test_there_are_enough_of_them() -> None:
    names = [path.stem for path in FOLDER.glob("*.txt")]
    assert len([name for name in names if name.split("-")[0] in STATES]) >= LEAST


@pytest.mark.parametrize("state", ["running", "suspended", "fault", "done"])
def test_wider_terminals_add_panels(state: str) -> None:
    seen = seen_on(RecordingApp(options(RUNS), state), first_screen, WIDE)
    problems = differences(named(f"wide-{state}", seen), f"wide-{state}-")
    assert not problems, problems
    assert "map: |e|" in seen["run"]


@pytest.mark.parametrize(
    ("size", "has_map"), [((99, 24), False), ((100, 24), True), ((120, 24), False)]
)
def test_the_map_stands_where_the_table_needs_no_room(size: tuple[int, int], has_map: bool) -> None:
    text = seen_on(RecordingApp(options(RUNS), "running"), first_screen, size)["run"]
    assert ("map: " in text) == has_map
    assert all(len(line) <= size[0] for line in text.splitlines())


@pytest.mark.parametrize("rows", [28, 36, 45])
def test_taller_terminals_add_interlocks_steps_and_events(rows: int) -> None:
    text = seen_on(RecordingApp(options(RUNS), "running"), first_screen, (80, rows))["run"]
    heads = ("interlocks", "next steps", "newest events")
    found = [f"─ {head} ─" in text for head in heads]
    assert found == [True, rows > 28, rows > 28]
    lines = text.splitlines()
    assert len(lines) == rows
    assert "Esc STOP" in lines[-2]


@pytest.mark.parametrize("state", STATES)
def test_small_terminals_keep_the_state(state: str) -> None:
    tiny = RecordingApp(options(RUNS), state)
    walk = screens_of if state in THOROUGH else first_screen
    for text in seen_on(tiny, walk, TINY).values():
        assert tiny.glyphs.states[state] in text.splitlines()[0] or "╭" in text, text
    low = seen_on(RecordingApp(options(RUNS), state), first_screen, LOW)
    problems = differences(named(f"low-{state}", low), f"low-{state}-")
    assert not problems, problems


@pytest.mark.parametrize("state", STATES)
def test_ascii_is_ascii_on_every_screen(state: str) -> None:
    walk = screens_of if state in THOROUGH else first_screen
    seen = seen_on(RecordingApp(options(RUNS, ascii_only=True), state), walk)
    for name, text in seen.items():
        foreign = {letter for letter in text if not letter.isascii()}
        assert not foreign, f"{name}: {foreign}\n{text}"
    problems = differences({f"ascii-{state}-run": seen["run"]}, f"ascii-{state}-")
    assert not problems, problems


def test_the_form_is_ascii_too() -> None:
    seen = seen_on(RecordingApp(options(RUNS, ascii_only=True)), form_of)
    assert "".join(seen.values()).isascii()
