"""Commissioning on the screen, against a hall that nobody has measured, by keys alone."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

import pytest
from textual.events import Paste
from textual.pilot import Pilot

from hilcell.commission.dialogue import Question
from hilcell.commission.record import Commissioned
from hilcell.commission.sequence import NAMES
from hilcell.journal.runs import read_log, run_folders
from hilcell.tui.app import HilcellApp
from hilcell.tui.commissioning import Work
from hilcell.tui.keys import load_keys
from hilcell.tui.screens.base import Options
from hilcell.tui.screens.commissioning import CommissionScreen
from hilcell.tui.terminal import UNICODE
from tests.whole.bench import LOOK_S, sim_command
from tests.whole.test_commission import FREE_PORTS, answers
from tests.whole.test_pictures import shown

pytestmark = pytest.mark.process
FIRST = NAMES.index("rail") + 1  # steps of `make test`


@contextmanager
def hall(folder: Path, seed: int) -> Iterator[list[str]]:
    """Serve a hall; return what a person answers, by its sheet."""
    words = ("--cell", "unknown", "--seed", str(seed), "--speed", "max")
    sheet = folder / "hall"
    with sim_command(*words, "--sheet", str(sheet), "--ports", FREE_PORTS):
        facts = json.loads((sheet / "hall.json").read_text())
        yield answers(facts, sheet / "nests.csv").splitlines()


@asynccontextmanager
async def screen(folder: Path) -> AsyncIterator[Pilot[int]]:
    """Open the screen on a cell file; it offers to commission it."""
    options = Options(
        runs=folder / "runs", keymap=load_keys(None), glyphs=UNICODE, cell=str(folder / "my.toml")
    )
    app = HilcellApp(options)
    async with app.run_test(size=(80, 24)) as pilot:
        while not (isinstance(app.screen, CommissionScreen) and "goes on with" in shown(app)):
            await pilot.pause(LOOK_S)
        yield pilot
        app.open_runs.leave()


async def begun(pilot: Pilot[int]) -> Work:
    assert isinstance(pilot.app, HilcellApp)
    await pilot.press("enter")
    while pilot.app.commissioning is None:
        await pilot.pause(LOOK_S)
    return pilot.app.commissioning


async def answer(pilot: Pilot[int], question: Question, line: str) -> None:
    if question.choices:
        down = [*question.choices].index(line)
        await pilot.press("home", *["down"] * down)
    else:
        pilot.app.post_message(Paste(line))
    await pilot.pause(2 * HilcellApp.BURST_S)
    await pilot.press("enter")


def is_in_full(question: Question, seen: str) -> bool:
    """Whether a question stands on the screen, with every word of it."""
    words = seen.replace("│", " ").replace("•", " ").split()
    return all(word in words for word in question.text.split())


async def perform(pilot: Pilot[int], work: Work, lines: list[str], until: str = "") -> None:
    """Answer until the question of a step, or the end; each question of a motion in full view."""
    app, asked = pilot.app, None
    assert isinstance(app, HilcellApp)
    page = app.screen
    assert isinstance(page, CommissionScreen)
    while work.at_work:
        await pilot.pause(LOOK_S)
        question = page._asked
        if question is None or question is asked:
            continue
        asked = question
        while question.motion and not is_in_full(question, shown(app)):
            await pilot.pause(LOOK_S)
        if work.step == until:
            return
        await answer(pilot, question, "" if question.motion else lines.pop(0))


def test_the_first_steps_are_performed_and_a_new_screen_goes_on(tmp_path: Path) -> None:
    """Esc at a question moves nothing, and what is proved stays."""

    async def first(lines: list[str]) -> None:
        async with screen(tmp_path) as pilot:
            work = await begun(pilot)
            await perform(pilot, work, lines, NAMES[FIRST])
            assert work.step == NAMES[FIRST], work.outcome
            await pilot.press("escape")
            while work.at_work:
                await pilot.pause(LOOK_S)
            assert isinstance(pilot.app.screen, CommissionScreen)
            assert "stopped" in work.outcome
        async with screen(tmp_path) as pilot:
            assert isinstance(pilot.app, HilcellApp)
            assert f"goes on with step {NAMES[FIRST]}" in shown(pilot.app)

    with hall(tmp_path, 40) as lines:
        asyncio.run(first(lines))
    steps = Commissioned.read(tmp_path / "my.toml").steps
    assert {step.step for step in steps if step.holds} == {*NAMES[:FIRST]}
    runs = {step.run for step in steps if step.run}
    assert runs == {folder.name for folder in run_folders(tmp_path / "runs")}
    assert all(read_log(tmp_path / "runs" / run).state == "finished" for run in runs)


@pytest.mark.nightly
def test_a_whole_hall_is_commissioned_on_the_screen(tmp_path: Path) -> None:
    async def whole(lines: list[str]) -> None:
        async with screen(tmp_path) as pilot:
            work = await begun(pilot)
            await perform(pilot, work, lines)
            assert "this cell is ready to calibrate" in work.outcome
            while "every step is proved" not in shown(pilot.app):  # type: ignore[arg-type]
                await pilot.pause(LOOK_S)

    with hall(tmp_path, 7) as lines:
        asyncio.run(whole(lines))
    proved = {step.step for step in Commissioned.read(tmp_path / "my.toml").steps if step.holds}
    assert proved == {*NAMES}
