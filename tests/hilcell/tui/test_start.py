"""The page for a new run: a plan that follows the fields, its checks, and a start that asks."""

from __future__ import annotations

import asyncio
from datetime import timedelta

import pytest
from msgspec.structs import replace
from textual.widgets import Input

from hilcell.cell.file import load_cell
from hilcell.errors import HilcellError
from hilcell.model.plan import PlannedStep
from hilcell.run.order import Order
from hilcell.tui import process
from hilcell.tui.screens import start as text
from hilcell.tui.screens.start import PlanSummary, StartScreen
from hilcell.tui.terminal import UNICODE
from tests.hilcell.tui.all_screens import PLAN, isolated
from tests.hilcell.tui.recording_app import (
    RUNS,
    Press,
    RecordingApp,
    Stage,
    options,
    press,
    run_app,
    settle,
    text_of,
    type_ahead,
    until,
)
from tests.hilcell.tui.sample_runs import BEGAN
from tests.hilcell.tui.views import drawn

__all__ = ["isolated"]

pytestmark = pytest.mark.usefixtures("isolated")
SIZE = (80, 24)


def planned(monkeypatch: pytest.MonkeyPatch) -> list[Order]:
    """Return the requests whose plans are computed; the plan names its procedure."""
    asked: list[Order] = []

    async def dry_run(request: Order) -> process.DryRun:
        asked.append(request)
        return replace(PLAN, procedure=request.procedure, simulated=True)

    monkeypatch.setattr(process, "dry_run", dry_run)
    return asked


def test_the_plan_follows_the_fields(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = planned(monkeypatch)

    async def act(app: Stage, pilot: Press) -> None:
        assert [each.procedure for each in asked] == ["calibrate"]
        assert asked[0].runs == RUNS  # where it looks for a calibration
        await press(pilot, "down")
        assert asked[-1].procedure == "home"
        assert "start: robot and rail will move in simulation only" in text_of(app)

    run_app(act, size=SIZE)


def test_who_runs_it_and_for_what_job_plans_nothing_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = planned(monkeypatch)

    async def act(app: Stage, pilot: Press) -> None:
        before = len(asked)
        await press(pilot, "tab", "A", "n", "n")
        assert app.screen.query_one("#operator", Input).value == "Ann"
        await press(pilot, "tab", "J", "7", "enter")
        assert isinstance(app.screen, PlanSummary)
        await press(pilot, "enter")
        assert len(asked) == before

    (engine,) = run_app(act, size=SIZE).engines
    assert {"--operator=Ann", "--job=J7"} <= set(engine[1])


def test_a_re_calibration_is_a_field_of_the_form(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = planned(monkeypatch)

    async def act(app: Stage, pilot: Press) -> None:
        assert (asked[-1].start, asked[-1].seed) == (None, None)
        app.screen.query_one("#from", Input).value = "current"
        await press(pilot, "enter")
        assert (asked[-1].start, asked[-1].seed) == ("current", None)
        await press(pilot, "enter")

    (engine,) = run_app(act, size=SIZE).engines
    assert "--from=current" in engine[1]
    assert not any(word.startswith("--seed") for word in engine[1])


def test_a_plan_of_earlier_fields_is_never_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: dict[str, asyncio.Event] = {}

    async def dry_run(request: Order) -> process.DryRun:
        event = waits.setdefault(request.procedure, asyncio.Event())
        await event.wait()
        return replace(PLAN, points=333 if request.procedure == "home" else 999)

    monkeypatch.setattr(process, "dry_run", dry_run)

    def total(app: RecordingApp) -> str:
        return "".join(line for line in text_of(app).splitlines() if " all " in line)

    async def run() -> None:
        app = RecordingApp(options(RUNS))
        async with app.run_test(size=SIZE) as pilot:
            await until(pilot, lambda: "calibrate" in waits)
            type_ahead(app, "down")
            await until(pilot, lambda: "home" in waits)
            waits["home"].set()
            await until(pilot, lambda: " 333 " in total(app))
            waits["calibrate"].set()  # late: its fields are no more
            await settle(pilot)
            assert " 333 " in total(app)

    asyncio.run(run())


def test_a_refused_plan_has_its_reasons_and_starts_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(_: Order) -> process.DryRun:
        raise HilcellError("refused before anything moves\nvalidate: 3 targets out of reach")

    monkeypatch.setattr(process, "dry_run", refuse)

    async def act(app: Stage, pilot: Press) -> None:
        assert "▲ validate: 3 targets" in text_of(app)
        assert "Enter  does nothing: the plan is refused" in text_of(app)
        await press(pilot, "enter")
        assert isinstance(app.screen, StartScreen)
        assert "not started: see the checks" in text_of(app)

    assert run_app(act, size=SIZE).engines == []


def test_enter_asks_and_only_a_yes_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    planned(monkeypatch)

    async def act(app: Stage, pilot: Press) -> None:
        await press(pilot, "enter")
        assert isinstance(app.screen, PlanSummary)
        assert app.engines == []
        await press(pilot, "q", "enter", "enter")

    app = run_app(act, size=SIZE)
    assert len(app.engines) == 1


# -- as text ---------------------------------------------------------------------------------------

CHECKED = text.Checked(replace(PLAN, simulated=True), "", load_cell("paper"), BEGAN)


@pytest.mark.parametrize("rows", [4, 9, 20])
def test_the_plan_fits_and_ends_with_the_sum(rows: int) -> None:
    lines = CHECKED.plan_lines(UNICODE).lines(37, rows)
    assert len(lines) <= rows
    assert lines[-1].plain.split() == ["all", "7", "steps", "21", "2:42"]
    assert any("more steps" in line.plain for line in lines) == (rows < 8)  # six do something


def test_what_to_see_to_names_the_nests() -> None:
    said = drawn(CHECKED.before_lines(attended=True))
    assert "Reflectors in F1 F2 F3, B1 B2, P1 to P8, clean; one on the tool." in said
    by_hand = replace(load_cell("paper").layout, reflectors="by_hand")
    cell = replace(load_cell("paper"), layout=by_hand)
    said = drawn(text.Checked(PLAN, "", cell, BEGAN).before_lines(attended=False))
    assert "One reflector" in said
    assert "Unattended: a question waits" in said


def test_the_end_is_a_time_of_day_where_time_is_real() -> None:
    end = BEGAN + timedelta(seconds=PLAN.duration_s)
    assert f"{end:%H:%M}" in CHECKED.end_line("1").plain
    assert "takes 2:42 of the cell's time" in CHECKED.end_line("100").plain
    real = text.Checked(replace(PLAN, simulated=False), "", None, BEGAN)
    assert "ends about" in real.end_line("100").plain
    assert text.Checked().end_line("1").plain == ""


def test_a_real_cell_has_no_simulation_on_its_page() -> None:
    real = text.Checked(replace(PLAN, simulated=False, rail=False), "", None, BEGAN)
    for line in (real.banner(UNICODE), real.start_line):
        assert "SIMULATION" not in drawn(line)
    assert "start: robot will move" in drawn(real.start_line)
    assert "SIMULATION" in drawn(CHECKED.banner(UNICODE))


def test_a_form_that_cannot_be_built_ends_its_test(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    async def run() -> None:
        app = RecordingApp(options(RUNS))
        async with app.run_test(size=SIZE) as pilot:
            await until(pilot, lambda: False)

    monkeypatch.setattr(text.Checked, "before_lines", fail)
    with pytest.raises((AssertionError, ZeroDivisionError)):
        asyncio.run(run())


def test_the_mark_of_a_simulation_is_never_cut() -> None:
    for width in range(40, 100):
        assert drawn(CHECKED.start_line, width).endswith("▒ SIMULATION ▒")


def test_a_cell_without_a_rail_parks_its_robot() -> None:
    fixed = text.Checked(replace(PLAN, rail=False), "", load_cell("fixed"), BEGAN)
    lines = drawn(fixed.plan_lines(UNICODE), 37).splitlines()
    assert lines[1].startswith(" 1 Park the robot")
    assert not any("rail" in line for line in lines)
    assert drawn(CHECKED.plan_lines(UNICODE), 37).splitlines()[1].startswith(" 1 Home the rail")


def test_a_refused_plan_names_steps_and_points_in_words() -> None:
    refused = (
        "calibrate refused before anything moves\n"
        "robot-grid: grid/0-0-4: out of reach\n"
        "sign-check: no target"
    )
    said = text.Checked(refused=refused).refusal_lines
    assert said == [
        "Calibration refused before anything moves",
        "Robot grid: grid point 0-0-4: out of reach",
        "Sign check: no target",
    ]
    assert text.Checked(refused="plan.x: unknown key").refusal_lines == ["plan.x: unknown key"]


def test_the_question_names_the_steps_that_do_nothing_in_words() -> None:
    step = PlannedStep(name="station-frames", points=0, duration_s=0.0, note="on the floor")
    plan = replace(PLAN, steps=[step])
    said = PlanSummary.text(Order(cell="fixed", runs=RUNS), plan).plain
    assert "Station frames: on the floor" in said
