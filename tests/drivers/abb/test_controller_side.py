"""The module for the controller: the same names, numbers and errors as in the driver."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import drivers.abb
from drivers.abb.controller_side import MODULE_VERSION, NO_LOAD_KG, controller_side
from drivers.abb.robot_egm import BRAKED, LOST
from drivers.supervision import HEARTBEAT_TIMEOUT_S

FOLDER = Path(drivers.abb.__file__).parent
TEXT = (FOLDER / "rapid" / "hilcell.mod").read_text("ascii")


def test_the_module_has_the_version_life_and_errors_of_the_driver() -> None:
    assert f"CONST num hc_version:={MODULE_VERSION};" in TEXT
    assert f"CONST num hc_life_s:={HEARTBEAT_TIMEOUT_S:g};" in TEXT
    stated = re.findall(r"(?:hc_state\{5\}:=|hc_halt )(\d+);", TEXT)
    assert set(map(int, stated)) == {0, LOST, BRAKED}


def test_each_name_that_the_driver_uses_is_declared() -> None:
    used = set()
    for path in FOLDER.glob("*.py"):
        used |= set(re.findall(r"\bhc_[a-z]+", path.read_text("utf-8")))
    declared = set(re.findall(r"(?:PERS|CONST) \w+ (hc_\w+)", TEXT))
    assert used - declared == {"hc_main"}
    assert "PROC hc_main()" in TEXT


def test_names_are_short_enough_and_lines_ascii() -> None:
    """RAPID reference manual: an identifier has at most 32 characters."""
    assert max(map(len, re.findall(r"\w+", TEXT))) <= 32
    assert max(map(len, TEXT.splitlines())) <= 100


def test_blocks_are_closed() -> None:
    code = re.sub(r"!.*", "", TEXT)
    for begin, end in (("PROC", "ENDPROC"), ("FUNC", "ENDFUNC"), ("MODULE", "ENDMODULE")):
        begins = len(re.findall(rf"^\s*(?:LOCAL )?{begin} ", code, re.MULTILINE))
        assert begins == len(re.findall(rf"^\s*{end}$", code, re.MULTILINE)) > 0
    assert len(re.findall(r"^\s*IF .* THEN$", code, re.MULTILINE)) == code.count("ENDIF")
    assert code.count("WHILE") == 2 * code.count("ENDWHILE")


def test_nothing_is_raised_where_rapid_ends_the_program() -> None:
    """RAPID reference manual, RAISE: in a trap it is the system's error handler that takes it."""
    assert not re.search(r"\b(?:TRAP|RAISE|CONNECT)\b", re.sub(r"!.*", "", TEXT))


def test_tool_and_device_are_filled_in() -> None:
    side = controller_side(
        {"smr_mm": (98.0, -1.5, 127.0), "egm_device": "Mine", "host": "10.0.0.5"}
    )
    (module,) = side.files
    text = module.contents.decode("ascii")
    assert "hc_tool:=[TRUE,[[98.0000,-1.5000,127.0000],[1,0,0,0]]," in text
    assert 'hc_device:="Mine"' in text
    assert "TO BE FILLED IN" not in text
    assert not side.lacks
    assert any("10.0.0.5" in step for step in side.steps)
    assert any("`Mine`" in step for step in side.steps)


def test_the_load_is_none_until_a_person_enters_it() -> None:
    """The check stands before the stream and the first motion."""
    placeholder = f"[{NO_LOAD_KG:g},[0,0,0.001],[1,0,0,0],0,0,0]];"
    for options in ({}, {"smr_mm": (98.0, -1.5, 127.0)}):
        (module,) = controller_side(options).files
        (tool,) = re.findall(r"PERS tooldata hc_tool:=(.*)", module.contents.decode("ascii"))
        assert tool.endswith(f",[1,0,0,0]],{placeholder}")
    assert f"CONST num hc_no_load_kg:={NO_LOAD_KG:g};" in TEXT
    code = re.sub(r"!.*", "", TEXT)
    checked = re.search(r"IF hc_tool\.tload\.mass<=hc_no_load_kg THEN\s+TPWrite .*\s+EXIT;", code)
    assert checked is not None
    assert code.index("PROC hc_main()") < checked.start() < code.index("EGMGetId")


def test_without_a_cell_file_and_steps_say_what_is_to_be_filled_in() -> None:
    side = controller_side({})
    text = side.files[0].contents.decode("ascii")
    assert "hc_tool:=[TRUE,[[0,0,0]" in text
    assert "TO BE FILLED IN" in text[: text.index("hc_tool:=")].splitlines()[-2]
    (lacks,) = side.lacks
    assert "robot.smr_mm" in lacks
    assert any(lacks in step for step in side.steps)


def test_the_module_gives_its_identity_of_egm_back_and_ends_there() -> None:
    """3HAC073318: a controller has four. RobotWare 7.21 knows no StopMove with Quick."""
    code = re.sub(r"!.*", "", TEXT)
    assert re.search(r"ENDWHILE\s+EGMStreamStop hc_egm;\s+EGMReset hc_egm;\s+Stop;", code)
    assert "\\Quick" not in code


@pytest.mark.parametrize("device", ['x";Stop', "a b"])
def test_no_option_becomes_code(device: str) -> None:
    (module,) = controller_side({"egm_device": device}).files
    assert device.encode() not in module.contents
