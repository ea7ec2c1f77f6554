"""Every state x every screen, as text: at 80x24, and some wider, smaller and in ASCII."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from textual.pilot import Pilot

from tests.hilcell.tui.scenes import stories
from tests.hilcell.tui.snapshots import FOLDER, differences
from tests.hilcell.tui.stage import SIZE, Stage, options, settle, text_of, unpainted
from tests.hilcell.tui.walk import form_of, outside, screens_of

__all__ = ["outside", "unpainted"]

STATES = tuple(stories())
RUNS = Path("/runs")  # no folder of this machine: nothing is read there
LEAST = 100
THOROUGH = ("suspended", "intolerant")  # every screen also where it is crowded
WIDE, LOW, TINY = (160, 40), (60, 15), (20, 5)

pytestmark = pytest.mark.usefixtures("outside", "unpainted")
Walk = Callable[[Stage, Pilot[int]], Awaitable[dict[str, str]]]


def seen_on(app: Stage, walk: Walk, size: tuple[int, int] = SIZE) -> dict[str, str]:
    """Return what a walk sees on a terminal of some size."""

    async def play() -> dict[str, str]:
        async with app.run_test(size=size) as pilot:
            return await walk(app, pilot)

    return asyncio.run(play())


def named(prefix: str, seen: dict[str, str]) -> dict[str, str]:
    return {f"{prefix}-{name}": text for name, text in seen.items()}


async def first_screen(app: Stage, pilot: Pilot[int]) -> dict[str, str]:
    await settle(pilot)
    return {"run": text_of(app)}


@pytest.mark.parametrize("state", STATES)
def test_every_screen_looks_as_it_did(state: str) -> None:
    seen = seen_on(Stage(options(RUNS), state), screens_of)
    problems = differences(named(state, seen), f"{state}-")
    assert not problems, problems
    assert all(len(line) <= SIZE[0] for text in seen.values() for line in text.splitlines())


def test_the_form_and_its_plan_look_as_they_did() -> None:
    seen = seen_on(Stage(options(RUNS)), form_of)
    problems = differences(named("new", seen), "new-")
    assert not problems, problems


def test_there_are_enough_of_them() -> None:
    names = [path.stem for path in FOLDER.glob("*.txt")]
    assert len([name for name in names if name.split("-")[0] in STATES]) >= LEAST


@pytest.mark.parametrize("state", ["running", "suspended", "fault", "done"])
def test_wider_terminals_add_panels(state: str) -> None:
    seen = seen_on(Stage(options(RUNS), state), first_screen, WIDE)
    problems = differences(named(f"wide-{state}", seen), f"wide-{state}-")
    assert not problems, problems
    assert "newest records" in seen["run"]


@pytest.mark.parametrize("state", STATES)
def test_small_terminals_keep_the_state(state: str) -> None:
    tiny = Stage(options(RUNS), state)
    walk = screens_of if state in THOROUGH else first_screen
    for text in seen_on(tiny, walk, TINY).values():
        assert tiny.glyphs.states[state] in text.splitlines()[0] or "╭" in text, text
    low = seen_on(Stage(options(RUNS), state), first_screen, LOW)
    problems = differences(named(f"low-{state}", low), f"low-{state}-")
    assert not problems, problems


@pytest.mark.parametrize("state", STATES)
def test_ascii_is_ascii_on_every_screen(state: str) -> None:
    walk = screens_of if state in THOROUGH else first_screen
    seen = seen_on(Stage(options(RUNS, ascii_only=True), state), walk)
    for name, text in seen.items():
        foreign = {letter for letter in text if not letter.isascii()}
        assert not foreign, f"{name}: {foreign}\n{text}"
    problems = differences({f"ascii-{state}-run": seen["run"]}, f"ascii-{state}-")
    assert not problems, problems


def test_the_form_is_ascii_too() -> None:
    seen = seen_on(Stage(options(RUNS, ascii_only=True)), form_of)
    assert "".join(seen.values()).isascii()
