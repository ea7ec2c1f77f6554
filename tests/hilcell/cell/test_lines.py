"""All problems of a file at once, each with its line; never a wrong line."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import line_of

PAPER = (resources.files("hilcell.cells") / "paper.toml").read_text("utf-8")
WRONG = [  # the line as it is, as it becomes, and the problem
    ("speed_mm_s = 250.0", "speed_mm_s = -1.0", "rail.speed_mm_s: "),
    ("min_deg = -185.0", "min_deg = 190.0", "robot.joint[0]: min_deg"),
    ("reflector = ", "reflektor = ", "tracker.reflektor: "),
    ("pointing_s = 0.6", 'pointing_s = "fast"', "tracker.pointing_s: "),
    ('{ name = "F2"', '{ name = "F1"', "layout.floor[1].name: "),
    ('{ name = "P5"', '{ name = "P6"', "layout.slide[5].name: "),
    ("rail_mm = 1900.0", "rail_mm = 9900.0", "station[2].rail_mm: "),
    ('[grid]\nstation = "S1100"', '[grid]\nstation = "S1"', "grid.station: "),
]  # fmt: skip


def refused(path: Path, text: str, **changed: str) -> list[str]:
    path.write_text(text, "utf-8")
    with pytest.raises(SettingsError) as error:
        load_cell(str(path), {key.replace("__", "."): value for key, value in changed.items()})
    return error.value.problems


def test_eight_of_eight_problems_are_reported_with_their_lines(tmp_path: Path) -> None:
    text = PAPER
    for right, wrong, _ in WRONG:
        assert right in text, right
        text = text.replace(right, wrong, 1)
    path = tmp_path / "cell.toml"
    problems = refused(path, text)
    for right, wrong, problem in WRONG:
        (found,) = [each for each in problems if problem in each]
        source, line, _ = found.removeprefix(str(tmp_path)).split(":", 2)
        assert source == "/cell.toml"
        shown = "\n".join(text.split("\n")[int(line) - 1 : int(line) + 12])
        last = wrong.split("\n")[-1]
        first = {"min_deg = 190.0": "[[robot.joint]]", '{ name = "P6"': '{ name = "P6"'}
        assert shown.lstrip().startswith(first.get(last, last)), (right, found)
    assert len([each for each in problems if "station[2]" in each]) == 2  # rail and strip disagree
    missing = [each for each in problems if "tracker.reflector: missing" in each]
    assert len(missing) == 1


TEXT = '''\
# speed = 1 in a comment
name = "x" # speed = 2
text = """
speed = 3
[rail]
"""
[rail.options]
speed = 4
[rail]
speed = 5
pose = { x = 1.0, speed = 6 }
nests = [
  { x = 1 },
  { x = 2 }
]
[[robot.joint]]
a = 1
[[robot.joint]]
a = 2
"quoted" = 3
'''


def test_a_line_is_proven_or_none() -> None:
    lines = {
        "name": 2,
        "text": None,  # over several lines
        "speed": None,
        "rail.options": 7,
        "rail.options.speed": 8,
        "rail": None,  # it begins twice
        "rail.speed": 10,
        "rail.pose.speed": 11,
        "rail.nests": 12,
        "rail.nests[0].x": 13,
        "rail.nests[1]": 14,
        "robot.joint[1]": 18,
        "robot.joint[1].a": 19,
        "robot.joint[1].quoted": 20,
        "robot.joint[1].missing": 18,
        "station S1": None,
        "": None,
    }
    assert {path: line_of(TEXT, path) for path in lines} == lines


def test_a_value_from_the_command_line_has_no_line(tmp_path: Path) -> None:
    (problem,) = refused(tmp_path / "cell.toml", PAPER, rail__speed_mm_s="-1.0")
    assert problem.startswith("rail.speed_mm_s: ")


def test_a_table_that_cannot_be_read_hides_no_other(tmp_path: Path) -> None:
    text = PAPER.replace("speed_mm_s = 250.0", 'speed_mm_s = "x"').replace("[grid]", "[gird]")
    problems = refused(tmp_path / "cell.toml", text.replace('name = "P6"', 'name = "P5"'))
    for part in ("rail.speed_mm_s: ", "gird: ", "grid: ", "layout.slide[5].name: "):
        assert any(part in problem for problem in problems), part
