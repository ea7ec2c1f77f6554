"""The pictures of the screen in README and docs, from real engines.

``HILCELL_PICTURES=docs/pictures pytest tests/whole/test_pictures.py`` draws them again, from whole
calibrations; without it small ones are looked at, and nothing is written.
"""

from __future__ import annotations

import asyncio
import os
import re
import subprocess
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from textual.pilot import Pilot

from hilcell.tui.app import HilcellApp
from hilcell.tui.keys import load_keys
from hilcell.tui.screens.base import Options
from hilcell.tui.terminal import UNICODE
from tests.whole.bench import HILCELL, LOOK_S, SMALL, Simulation, hilcell, sets, simulation
from tests.whole.commissioner import begun, commissioning, hall, perform, shown
from tests.whole.golden import GoldenRuns

ROOT = Path(__file__).parents[2]
WANTED = os.environ.get("HILCELL_PICTURES", "")
PICTURES = (
    "screen-running",
    "screen-running-light",
    "screen-plan",
    "screen-fault",
    "screen-prompt",
    "screen-done",
    "screen-plots",
    "screen-plots-light",
    "screen-wide",
    "screen-commission",
)
BY_HAND = {"layout.reflectors": "by_hand"}
SIZE = {} if WANTED else SMALL
WORDS = ["--operator", "Ann", "--job", "J-7", *sets(SIZE)]


def keep(app: HilcellApp, name: str) -> None:
    """Look at a picture, and write it where pictures are wanted."""
    picture = app.export_screenshot(title="hilcell tui")
    # Rich's fonts come from the net; a terminal's own will do.
    picture = re.sub(r"@font-face\s*{[^}]*}", "", picture)
    links = set(re.findall(r"https?://[^\"' )]+", picture))
    assert links <= {"http://www.w3.org/2000/svg", "https://www.textualize.io"}, links
    picture = re.sub(r"<!-- Generated with Rich .*?-->", "", picture)
    assert "</svg>" in picture
    if WANTED:
        (ROOT / WANTED / f"{name}.svg").write_text(picture, encoding="utf-8")


async def until(pilot: Pilot[int], words: str) -> None:
    """Wait until the screen shows words, a regular expression."""
    while not re.search(words, shown(app_of(pilot))):
        await pilot.pause(LOOK_S)


@asynccontextmanager
async def screen(runs: Path, run: str, size: tuple[int, int]) -> AsyncIterator[Pilot[int]]:
    """Show a run, without a terminal."""
    app = HilcellApp(Options(runs=runs, keymap=load_keys(None), glyphs=UNICODE, run=run))
    async with app.run_test(size=size) as pilot:
        yield pilot
        app.open_runs.leave()


def app_of(pilot: Pilot[int]) -> HilcellApp:
    assert isinstance(pilot.app, HilcellApp)
    return pilot.app


@asynccontextmanager
async def engine(runs: Path, *words: str) -> AsyncIterator[None]:
    order = [*HILCELL, "run", *words, "--runs", str(runs)]
    process = subprocess.Popen(order, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while not list(runs.glob("*/engine.json")):
            assert process.poll() is None
            await asyncio.sleep(LOOK_S)
        yield
    finally:
        process.terminate()
        process.wait()


@asynccontextmanager
async def cell_and_screen(
    runs: Path, values: Mapping[str, str], words: Sequence[str]
) -> AsyncIterator[tuple[Simulation, Pilot[int]]]:
    """Run an engine against a cell that stands beside it, and look at it."""
    with simulation(60.0, values) as cell:
        async with (
            engine(runs, *words, "--set", f"simulation.address={cell.control}"),
            screen(runs, "last", (80, 24)) as pilot,
        ):
            yield cell, pilot


@pytest.mark.wall
@pytest.mark.nightly  # by day the snapshots look at the same
def test_pictures_are_drawn(tmp_path: Path, golden: GoldenRuns) -> None:
    for name in ("live", "fault", "prompt", "done", "new"):
        (tmp_path / name).mkdir()
    asyncio.run(a_live_run(tmp_path / "live"))
    asyncio.run(a_fault(tmp_path / "fault"))
    asyncio.run(a_prompt(tmp_path / "prompt"))
    if WANTED:
        done = hilcell("run", "--runs", tmp_path / "done", *WORDS)
        assert done.returncode == 0, done.stderr
    else:
        golden["small"].copied_to(tmp_path / "done")
    asyncio.run(a_finished_run(tmp_path / "done"))
    asyncio.run(a_plan(tmp_path / "new"))
    with hall(tmp_path / "new", 40) as lines:
        asyncio.run(a_commissioning(tmp_path / "new", lines))


async def a_live_run(tmp_path: Path) -> None:
    async with (
        engine(tmp_path, "--speed", "60", *WORDS),
        screen(tmp_path, "last", (80, 24)) as pilot,
    ):
        await until(pilot, r"Robot grid +([5-9]|\d\d) of")
        assert "► RUNNING" in shown(app_of(pilot))
        keep(app_of(pilot), "screen-running")
        app_of(pilot).theme = "daylight"
        await pilot.pause(0.5)
        keep(app_of(pilot), "screen-running-light")


async def a_fault(tmp_path: Path) -> None:
    async with cell_and_screen(tmp_path, SIZE, WORDS) as (cell, pilot):
        await until(pilot, r"Robot grid +([2-9]|\d\d) of")
        assert cell.ask(do="fault", name="robot.e_stop", count=0)["ok"]
        await until(pilot, "space  resume")
        await until(pilot, "What to do")
        keep(app_of(pilot), "screen-fault")


async def a_prompt(tmp_path: Path) -> None:
    words = ("world-frame", *sets(BY_HAND), *WORDS)
    async with cell_and_screen(tmp_path, BY_HAND, words) as (cell, pilot):
        await until(pilot, "not visible")
        assert cell.ask(do="seat", place="F1")["ok"]
        await until(pilot, "reflector visible")
        keep(app_of(pilot), "screen-prompt")


async def a_finished_run(tmp_path: Path) -> None:
    async with screen(tmp_path, "last", (80, 24)) as pilot:
        await until(pilot, "● DONE")
        keep(app_of(pilot), "screen-done")
    async with screen(tmp_path, "last", (120, 36)) as pilot:
        await until(pilot, "● DONE")
        await pilot.press("p", "2")
        await until(pilot, "in rising order(.*\n)*.*■ corrected")
        keep(app_of(pilot), "screen-plots")
        app_of(pilot).theme = "daylight"
        await pilot.pause(1.0)  # twice a second at most it draws
        keep(app_of(pilot), "screen-plots-light")
    async with screen(tmp_path, "last", (140, 45)) as pilot:
        await until(pilot, "map: ")
        await pilot.pause(0.5)
        keep(app_of(pilot), "screen-wide")


async def a_plan(tmp_path: Path) -> None:
    async with screen(tmp_path, "", (80, 24)) as pilot:
        await until(pilot, "validated before and after")
        await pilot.press("enter")
        await until(pilot, "The robot and the rail will move")
        keep(app_of(pilot), "screen-plan")


async def a_commissioning(tmp_path: Path, lines: list[str]) -> None:
    async with commissioning(tmp_path) as pilot:
        work = await begun(pilot)
        await perform(pilot, work, lines, "rail")
        await until(pilot, "somebody at the E-stop")
        keep(app_of(pilot), "screen-commission")
        await pilot.press("escape")
        while work.at_work:
            await pilot.pause(LOOK_S)


def test_the_docs_show_every_picture() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    text = "\n".join(page.read_text("utf-8") for page in pages)
    for name in PICTURES:
        assert f"pictures/{name}.svg" in text, name
        assert (ROOT / "docs" / "pictures" / f"{name}.svg").is_file(), name
