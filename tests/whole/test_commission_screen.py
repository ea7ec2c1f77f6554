"""Commissioning on the screen, against a hall that nobody has measured."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from hilcell.commission.record import Commissioned
from hilcell.commission.sequence import NAMES
from hilcell.journal.runs import read_log, run_folders
from hilcell.tui.app import HilcellApp
from hilcell.tui.screens.commissioning import CommissionScreen
from tests.whole.bench import LOOK_S
from tests.whole.commissioner import answer, begun, commissioning, hall, perform, shown

pytestmark = pytest.mark.process
FIRST = NAMES.index("rail") + 1  # steps of `make test`


def test_the_first_steps_are_performed_and_a_new_screen_goes_on(tmp_path: Path) -> None:
    """Esc at a question moves nothing, and what is proved stays."""

    async def first(lines: list[str]) -> None:
        async with commissioning(tmp_path) as pilot:
            work = await begun(pilot)
            await perform(pilot, work, lines, NAMES[FIRST])
            assert work.step == NAMES[FIRST], work.outcome
            await pilot.press("escape")
            while work.at_work:
                await pilot.pause(LOOK_S)
            assert isinstance(pilot.app.screen, CommissionScreen)
            assert "stopped" in work.outcome
        async with commissioning(tmp_path) as pilot:
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
@pytest.mark.timeout(1200)
def test_a_whole_hall_is_commissioned_on_the_screen(tmp_path: Path) -> None:
    async def whole(lines: list[str]) -> None:
        async with commissioning(tmp_path) as pilot:
            work = await begun(pilot)
            await perform(pilot, work, lines)
            while "ready to calibrate" not in shown(pilot.app):  # type: ignore[arg-type]
                await pilot.pause(LOOK_S)

    with hall(tmp_path, 7) as lines:
        asyncio.run(whole(lines))
    proved = {step.step for step in Commissioned.read(tmp_path / "my.toml").steps if step.holds}
    assert proved == {*NAMES}


@pytest.mark.nightly
def test_escape_stops_a_step_that_moves(tmp_path: Path) -> None:
    async def stopped(lines: list[str]) -> None:
        async with commissioning(tmp_path) as pilot:
            app = pilot.app
            assert isinstance(app, HilcellApp)
            work = await begun(pilot)
            await perform(pilot, work, lines, "rail")
            assert isinstance(app.screen, CommissionScreen)
            room = app.screen._asked
            assert room is not None
            await answer(pilot, room, "")
            while (moves := app.screen._asked) is None or moves is room:
                await pilot.pause(LOOK_S)
            await answer(pilot, moves, "")
            while not (app.live and app.view and app.view.state == "running"):
                await pilot.pause(LOOK_S)
            await pilot.press("escape")
            while work.at_work:
                await pilot.pause(LOOK_S)
            while "goes on with step rail" not in shown(app):
                await pilot.pause(LOOK_S)

    with hall(tmp_path, 40) as lines:
        asyncio.run(stopped(lines))
    *_, last = run_folders(tmp_path / "runs")
    assert read_log(last).state == "aborted"
    assert Commissioned.read(tmp_path / "my.toml").last("rail") is None
