"""A hall that nobody has measured, and a person who commissions it on the screen, by keys alone."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

from textual.events import Paste
from textual.pilot import Pilot

from hilcell.commission.dialogue import Question
from hilcell.tui.app import HilcellApp
from hilcell.tui.commissioning import Work
from hilcell.tui.keys import load_keys
from hilcell.tui.screens.base import Options
from hilcell.tui.screens.commissioning import CommissionScreen
from hilcell.tui.terminal import UNICODE
from tests.whole.bench import LOOK_S
from tests.whole.halls import answers, unknown_hall


def shown(app: HilcellApp) -> str:
    strips = app.screen._compositor.render_strips()
    return "\n".join("".join(segment.text for segment in strip) for strip in strips)


@contextmanager
def hall(folder: Path, seed: int) -> Iterator[list[str]]:
    """Serve a hall; return what a person answers, by its sheet."""
    with unknown_hall(folder / "hall", seed) as served:
        yield answers(served.sheet, served.folder).splitlines()


@asynccontextmanager
async def commissioning(folder: Path) -> AsyncIterator[Pilot[int]]:
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
