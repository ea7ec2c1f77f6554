"""The order of steps, and the questions before anything moves."""

from pathlib import Path
from queue import Queue
from typing import NoReturn

import pytest
from msgspec.structs import replace

from hilcell.cell.devices import load_entry
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.tables import UNPLACED_MM
from hilcell.commission.dialogue import TypedDialogue
from hilcell.commission.first_steps import drawing
from hilcell.commission.page import CommissioningPage
from hilcell.commission.record import Check, Commissioned, StepRecord
from hilcell.commission.sequence import NAMES, STEPS, Step
from hilcell.commission.steps import (
    Commissioning,
    StepEnded,
    check_proved,
    motions,
    steps_to_perform,
    unproved,
)
from hilcell.errors import HilcellError
from hilcell.journal.log import Log
from hilcell.run.procedure import Procedure, announced


def proved(cell: Path, *names: str) -> Path:
    """Return a cell file whose record has these steps proved."""
    cell.write_text('name = "hall"\n')
    for name in names:
        step = StepRecord(step=name, ended="", operator="", holds=True, checks=[])
        Commissioned.read(cell).add(step, cell)
    return cell


def test_commissioning_goes_on_with_the_first_unproved_step(tmp_path: Path) -> None:
    cell = proved(tmp_path / "hall.toml", *NAMES[:3])
    assert [step.name for step in steps_to_perform(cell, "", "")] == NAMES[3:]


@pytest.mark.parametrize(("first", "only"), [("base", ""), ("", "base"), ("", "proof")])
def test_no_step_is_performed_before_those_it_rests_on(
    first: str, only: str, tmp_path: Path
) -> None:
    cell = proved(tmp_path / "hall.toml", *NAMES[:3])
    with pytest.raises(SettingsError, match=r"rail, robot, tracker.* must be proved before it"):
        steps_to_perform(cell, first, only)


def test_one_proved_step_is_repeated_alone(tmp_path: Path) -> None:
    cell = proved(tmp_path / "hall.toml", *NAMES[:5])
    assert [step.name for step in steps_to_perform(cell, "", "rail")] == ["rail"]
    assert [step.name for step in steps_to_perform(cell, "rail", "")] == NAMES[3:]


def test_a_draft_of_assumed_places_drives_nothing_else(tmp_path: Path) -> None:
    check_proved(tmp_path / "hall.toml")  # no record: a person has written it
    draft = proved(tmp_path / "hall.toml", *NAMES[:-1])
    with pytest.raises(HilcellError, match="has not proved proof yet"):
        check_proved(draft)
    check_proved(proved(tmp_path / "hall.toml", *NAMES))
    assert unproved(tmp_path / "hall.toml") == []


def test_a_value_that_was_edited_since_its_proof_drives_nothing(tmp_path: Path) -> None:
    cell = proved(tmp_path / "hall.toml", *NAMES)
    signs = Check(what="", found="", expected="", holds=True, values={"rail.scale": -1.0})
    step = StepRecord(step="rail", ended="", operator="", holds=True, checks=[signs])
    Commissioned.read(cell).add(step, cell)
    cell.write_text('name = "hall"\n[rail]\nscale = -1.0\n')
    check_proved(cell)
    cell.write_text('name = "hall"\n[rail]\nscale = 1.0\n')
    with pytest.raises(HilcellError, match=r"rail\.scale differ from what commissioning has"):
        check_proved(cell)
    assert [step.name for step in steps_to_perform(cell, "", "")] == NAMES[NAMES.index("rail") :]


def test_volumes_that_are_named_and_not_proved_drive_nothing(tmp_path: Path) -> None:
    cell = tmp_path / "hall.toml"  # without a record: a person has written it
    cell.write_text('[volumes]\nfile = "volumes.csv"\n')
    with pytest.raises(HilcellError, match=r"there is no \[\[keep_out\]\] yet"):
        check_proved(cell)
    cell.write_text('[volumes]\nfile = "volumes.csv"\n[[keep_out]]\nname = "floor"\n')
    check_proved(cell)


def test_nothing_is_left_once_all_is_proved(tmp_path: Path) -> None:
    cell = proved(tmp_path / "hall.toml", *NAMES)
    assert steps_to_perform(cell, "", "") == []
    with pytest.raises(SettingsError, match="expected --only or --from, got both"):
        steps_to_perform(cell, "base", "rail")


def test_the_room_of_a_slide_is_asked_for_until_its_travel_has_a_place() -> None:
    rail = next(step for step in STEPS if step.name == "rail")
    cell = load_cell("paper")
    assert rail.confirms(cell) == ""
    draft = replace(
        cell,
        rail=replace(cell.rail, travel_min_mm=UNPLACED_MM - 885.0, travel_max_mm=UNPLACED_MM + 885),
        station=[
            replace(each, rail_mm=UNPLACED_MM + n, strip_mm=UNPLACED_MM + n)
            for n, each in enumerate(cell.station)
        ],
        survey=replace(cell.survey, from_mm=UNPLACED_MM, to_mm=UNPLACED_MM + 300.0),
    )
    assert "885 mm each way" in rail.confirms(draft)


def test_a_cell_without_a_rail_has_no_steps_of_one(tmp_path: Path) -> None:
    cell = proved(tmp_path / "floor.toml", *NAMES[:3])
    cell.write_text('name = "hall"\n[layout]\nbase = {x_mm = 0.0, y_mm = 0.0, z_mm = 0.0}\n')
    left = [step.name for step in steps_to_perform(cell, "", "")]
    assert left == ["robot", "tracker", "base", *NAMES[NAMES.index("stations") + 1 :]]
    with pytest.raises(SettingsError, match="unknown step 'rail'"):
        steps_to_perform(cell, "", "rail")


@pytest.mark.parametrize("step", [step for step in STEPS if step.procedure], ids=lambda s: s.name)
def test_a_step_of_the_rail_is_a_run_of_the_rail(step: Step) -> None:
    assert step.of_rail == load_entry("procedures", step.procedure).of_rail


LATER = NAMES.index("self-stop")


@pytest.mark.parametrize(
    ("driver", "words"),
    [("canopen", "--only self-stop"), ("kuka-e1", "no `jog_until_lost`")],
)
def test_a_self_stop_that_is_put_off_hinders_nothing(
    driver: str, words: str, tmp_path: Path
) -> None:
    cell = proved(tmp_path / "hall.toml", *NAMES[:LATER])
    cell.write_text(f'name = "hall"\n[rail]\ndriver = "{driver}"\n')
    said: list[str] = []
    lines: Queue[str | None] = Queue()
    for line in ("perhaps", "not now"):
        lines.put(line)

    def run(procedure: str) -> NoReturn:
        raise AssertionError(procedure)

    work = Commissioning(cell, TypedDialogue(lines, said.append), "Ada", run)
    assert work.perform(STEPS[LATER : LATER + 1])
    assert words in said[-1]
    assert [step.name for step in steps_to_perform(cell, "", "")] == NAMES[LATER:]
    proved(cell, *NAMES[LATER + 1 :])
    check_proved(cell)
    assert unproved(cell) == []
    assert CommissioningPage(cell).not_proved()[0].startswith("self-stop: ")
    assert [step.name for step in steps_to_perform(cell, "", "self-stop")] == ["self-stop"]


def test_a_self_stop_that_has_failed_hinders_and_cannot_be_put_off(tmp_path: Path) -> None:
    cell = proved(tmp_path / "hall.toml", *NAMES)
    failed = StepRecord(step="self-stop", ended="", operator="", holds=False, checks=[])
    Commissioned.read(cell).add(failed, cell)
    with pytest.raises(HilcellError, match="has not proved self-stop yet"):
        check_proved(cell)
    work = Commissioning(cell, TypedDialogue(Queue(), print), "Ada", lambda name: ("", Log([])))
    assert not work._is_put_off(STEPS[LATER])


@pytest.mark.parametrize("step", [step for step in STEPS if step.procedure], ids=lambda s: s.name)
def test_the_question_names_every_motion_and_the_speeds(step: Step) -> None:
    procedure: Procedure = load_entry("procedures", step.procedure)
    cell = load_cell("paper")
    question = motions(cell, procedure)
    moving = [each for each in procedure.steps if announced(each, cell) != "nothing"]
    assert bool(question) == bool(moving)
    for each in moving:
        assert f"  {announced(each, cell)} (needs {each.needs})\n" in question
    if moving:
        assert "the slide at 250 mm/s, the robot at 30 %" in question
        on_the_floor = motions(load_cell("fixed"), procedure)
        assert "the slide at" not in on_the_floor
        assert step.of_rail or "  the slide" not in on_the_floor


def test_a_calibration_of_a_robot_on_the_floor_moves_no_slide() -> None:
    by_hand = load_cell("fixed", {"layout.reflectors": "by_hand"})
    question = motions(by_hand, load_entry("procedures", "calibrate"))
    assert "slide" not in question
    assert "  the robot to random targets in the cube (needs" in question
    assert "tracker's head" not in question  # nobody turns it over
    assert "tracker's head" in motions(load_cell("fixed"), load_entry("procedures", "calibrate"))


@pytest.mark.parametrize(
    ("code", "words"),
    [(4, "was stopped; the same command goes on"), (3, "mend the cause, then the same command")],
)
def test_a_run_that_was_stopped_has_no_cause_to_mend(code: int, words: str) -> None:
    ended = StepEnded("commission-base", code)
    assert ended.exit_code == code
    assert words in str(ended)


def test_the_question_says_how_far_and_where_to() -> None:
    question = motions(load_cell("paper"), load_entry("procedures", "commission-proof"))
    for words in (
        "its safe pose (A1 ",
        "the slide to its reference at 100 mm/s",
        "the slide to S",
        "axis 1 from -75 to 75 deg, axis 6 from -165 to 165 deg",
        "the corners of its cube, 900 x 900 x 900 mm, at 30 %",
    ):
        assert words in question


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("name,x_mm,y_mm,z_mm\nF1,0,0,0\nF2,1,0,0\n", "expected 3 or more nests, got 2"),
        ("name,x_mm,y_mm\nF1,0,0\n", "name,x_mm,y_mm,z_mm"),
        ("name,x_mm,y_mm,z_mm\nF1,0,0,nan\nF2,1,0,0\nF3,0,1,0\n", "line 2: z_mm is 'nan'"),
        ("", "nests.csv"),
    ],
)
def test_a_drawing_of_nests_is_a_list_like_the_others(text: str, why: str, tmp_path: Path) -> None:
    file = tmp_path / "nests.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=why):
        drawing(str(file))
    file.write_text("name;x_mm;y_mm;z_mm\nF1;0,5;0;0\n\nF2;1500;0;0\nF3;0;1500;0\n")
    assert drawing(str(file))[0] == {"name": "F1", "x_mm": 0.5, "y_mm": 0.0, "z_mm": 0.0}
