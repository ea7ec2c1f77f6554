"""The edited cell file, and the record beside it."""

from pathlib import Path
from queue import Queue

import pytest

from hilcell.cell.settings import SettingsError
from hilcell.commission.cell_text import CellText
from hilcell.commission.dialogue import TypedDialogue, number
from hilcell.commission.record import Check, Commissioned, StepRecord
from hilcell.errors import HilcellError

WRITTEN = """\
# Hall 3, by the window.
name = "hall"  # as on the door

[rail]
speed_mm_s = 100.0  # the belt is new

[rail.options]
drive_node = 5
"""


def test_a_person_s_comments_order_and_values_stay() -> None:
    text = CellText(WRITTEN)
    text.set("rail.options.counts_per_mm", -500.0, "by a jog")
    text.set("rail.speed_mm_s", 100.0, "never written: the value is there")
    text.set("tracker.pose", {"x_mm": 1.0, "a_deg": 2.0}, "by three nests")
    text.set("station", [{"name": "S1", "rail_mm": 0.0}], "assumed")
    stations = [{"name": "S1", "rail_mm": 1.0}, {"name": "S2", "rail_mm": 2.0}]
    text.set("station", stations, "by the strip")
    lines = text.text.splitlines()
    assert lines[: len(WRITTEN.splitlines()) - 1] == WRITTEN.splitlines()[:-1]
    assert "counts_per_mm = -500.0 # by a jog" in lines
    assert "pose = {x_mm = 1.0, a_deg = 2.0} # by three nests" in lines
    assert [line for line in lines if line == "[[station]]"] == ["[[station]]"] * 2
    assert "assumed" not in text.text
    assert 'name = "S1" # by the strip' in lines
    assert CellText(text.text).values == text.values


def test_one_row_of_an_array_of_tables_is_changed_by_its_number() -> None:
    text = CellText("[[robot.joint]]\nmin_deg = -90.0  # stop\n\n[[robot.joint]]\nmin_deg = 0.0\n")
    text.set("robot.joint.1.min_deg", -5.0)
    assert text.get("robot.joint.1.min_deg") == -5.0
    assert text.get("robot.joint.0.min_deg") == -90.0
    assert text.get("robot.joint.2.min_deg") is None
    assert "# stop" in text.text


def test_rows_are_added_and_those_of_a_person_keep_their_comments() -> None:
    text = CellText("[[keep_out]]\nname = 'floor'  # swept daily\n\n[rail]\nspeed_mm_s = 100.0\n")
    rows = [{"name": "floor", "frame": "world"}, {"name": "fence", "centre": {"x_mm": 1.0}}]
    for number_of, row in enumerate(rows):
        text.set(f"keep_out.{number_of}", row, "by a list")
    assert text.get("keep_out") == rows
    assert CellText(text.text).values == text.values
    assert "# swept daily" in text.text
    assert "[[keep_out]] # by a list" in text.text
    empty = CellText()
    empty.set("keep_out.0", rows[0])
    assert empty.values == {"keep_out": rows[:1]}


def test_a_text_that_is_no_toml_is_refused() -> None:
    with pytest.raises(SettingsError, match="not valid TOML"):
        CellText("name = ")


def step(name: str, value: float, *, holds: bool = True) -> StepRecord:
    check = Check(
        what="scale", found="1", expected="1", holds=holds, values={"rail.options.scale": value}
    )
    return StepRecord(step=name, ended="", operator="", holds=holds, checks=[check])


def test_a_step_is_proved_while_the_file_has_its_values(tmp_path: Path) -> None:
    cell, text = tmp_path / "hall.toml", CellText(WRITTEN)
    assert Commissioned.read(cell).status("rail", text) == "open"
    Commissioned.read(cell).add(step("rail", 2.0, holds=False), cell)
    assert Commissioned.read(cell).status("rail", text) == "failed"
    Commissioned.read(cell).add(step("rail", 2.0), cell)
    text.set("rail.options.scale", 2.0)
    assert Commissioned.read(cell).status("rail", text) == "proved"
    text.set("rail.options.scale", 3.0)
    assert Commissioned.read(cell).status("rail", text) == "changed"
    Commissioned.read(cell).add(step("base", 3.0), cell)  # proves another value of the same key
    assert Commissioned.read(cell).status("rail", text) == "proved"
    text.set("rail.options.scale", 4.0)
    assert Commissioned.read(cell).status("rail", text) == "proved", "the value is that of base now"
    assert Commissioned.read(cell).status("base", text) == "changed"


STEP = '{"step": "%s", "ended": "", "operator": "", "holds": true, "checks": []}'


@pytest.mark.parametrize(
    ("record", "why"),
    [
        ('{"form": 1, "steps": [', "damaged: .*move this file away to begin again"),
        ('{"form": 2, "steps": []}', "damaged: .*form"),
        ('{"steps": [%s]}' % (STEP % "rails"), "step 'rails' is unknown, expected one of devices"),
        ('{"cell": "barn"}', "of a cell with name 'barn', expected 'hall' as in hall.toml"),
        ('{"cell": "hall", "serial": "2"}', "of a cell with serial '2', expected '1'"),
    ],
)
def test_a_wrong_record_is_refused(record: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "hall.toml").write_text('name = "hall"\nserial = "1"\n')
    (tmp_path / "hall.commissioning.json").write_text(record)
    with pytest.raises(SettingsError, match=why):
        Commissioned.read(tmp_path / "hall.toml")


def test_a_record_that_cannot_be_read_is_named() -> None:
    with pytest.raises(SettingsError, match=r"cannot be read: File name too long"):
        Commissioned.read(Path("a" * 245 + ".toml"))  # its record has too long a name


def asked(*lines: str | None) -> tuple[TypedDialogue, list[str]]:
    queue: Queue[str | None] = Queue()
    for line in lines:
        queue.put(line)
    said: list[str] = []
    return TypedDialogue(queue, said.append), said


def test_an_answer_out_of_range_is_asked_for_again() -> None:
    dialogue, said = asked("nan", "-1", "five", "12.5")
    assert dialogue.ask("how far?", number(0.0, 100.0, "mm")) == 12.5
    assert [line for line in said if line.startswith("expected")] == [
        "expected 0 .. 100 mm, got nan",
        "expected 0 .. 100 mm, got -1",
        "expected a number in mm, got 'five'",
    ]


@pytest.mark.parametrize(
    ("real", "answer", "agreed"),
    [
        (True, "yes", True),
        (True, "y", False),
        (True, "", False),
        (False, "", True),
        (False, "n", False),
    ],
)
def test_real_devices_move_by_the_whole_word(real: bool, answer: str, agreed: bool) -> None:
    dialogue, _ = asked()
    dialogue.real = real
    assert dialogue.agrees(answer) is agreed


def test_an_answer_typed_before_its_question_moves_no_real_device() -> None:
    lines: Queue[str | None] = Queue()
    lines.put("yes\n")
    dialogue = TypedDialogue(lines, lambda _: None)
    dialogue.drop_typed_ahead()
    assert lines.empty()
    dialogue.real = False
    lines.put("yes\n")
    dialogue.drop_typed_ahead()
    assert dialogue.agree("clear?"), "a script answers a simulated cell beforehand"


def test_the_end_of_input_ends_the_dialogue() -> None:
    dialogue, _ = asked(None)
    for _ in range(2):
        with pytest.raises(HilcellError, match="the input has ended"):
            dialogue.agree("clear?")
