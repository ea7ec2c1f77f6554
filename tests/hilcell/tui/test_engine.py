"""Orders for engines: the words typed into the form, whatever they are, reach the command whole."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.clean import clean
from hilcell.cli import _parser
from hilcell.errors import HilcellError
from hilcell.tui import engine
from hilcell.tui.engine import UNTOLD, Order, ask_hilcell, dry_run, untold

# No terminal types NUL or half a letter; argparse drops a lone --.
TYPED = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])).filter(
    lambda text: text != "--"
)


@settings(max_examples=25)
@given(operator=TYPED, job=TYPED, attended=st.booleans())
def test_names_reach_the_command_whole(operator: str, job: str, attended: bool) -> None:
    order = Order("paper", "calibrate", operator, job, attended=attended)
    found = _parser().parse_args(order.words())
    assert (found.operator, found.job) == (clean(operator), clean(job))
    assert (found.cell, found.procedure, found.seed) == ("paper", "calibrate", 1)
    assert found.unattended is not attended


@pytest.mark.parametrize("name", ["--unattended", "-x", "---", "=", "a b", "[/nope]"])
def test_names_that_look_like_options_are_names(name: str) -> None:
    found = _parser().parse_args(Order("paper", "home", name, name, settings=("a.b=c",)).words())
    assert (found.operator, found.job, found.unattended) == (name, name, False)
    assert found.set == [("a.b", "c")]


def test_speed_is_named_only_where_it_is_chosen() -> None:
    assert "--speed" not in " ".join(Order("paper", "home").words())
    assert _parser().parse_args(Order("paper", "home", speed="10").words()).speed == 10.0


def test_a_plan_comes_from_the_command_itself() -> None:
    plan = asyncio.run(dry_run(Order("paper", "home")))
    assert plan["procedure"] == "home"
    assert plan["steps"]


@pytest.mark.parametrize("order", [Order("nowhere", "home"), Order("paper", "home", seed="x")])
def test_a_refusal_says_why(order: Order) -> None:
    with pytest.raises(HilcellError, match=r"nowhere|seed"):
        asyncio.run(dry_run(order))


def test_what_a_command_says_in_its_last_breath_is_kept(tmp_path: Path) -> None:
    with pytest.raises(HilcellError, match="not in"):
        asyncio.run(ask_hilcell("show", "none", "--runs", str(tmp_path)))


def test_an_engine_says_its_last_words_to_a_file(tmp_path: Path) -> None:
    process = engine.start(tmp_path, "r", ["run", "nothing", "--runs", str(tmp_path)])
    assert process.wait(60) == 2
    assert "nothing" in untold(tmp_path / "r", 2)
    assert "No such file" in untold(tmp_path / "other", 0)


@pytest.mark.parametrize("code", [2, 5, 6, 7])
def test_an_end_that_no_journal_tells_is_told(tmp_path: Path, code: int) -> None:
    (tmp_path / "journal.sqlite").touch()
    said = tmp_path / "engine.log"
    said.touch()
    assert untold(tmp_path, code) == f"the engine ended, exit {code}: {UNTOLD[code]}"
    said.write_text("".join(f"line {number}\n" for number in range(100)))
    assert untold(tmp_path, code).endswith("line 98\nline 99")
    assert len(untold(tmp_path, code).splitlines()) == 7


@pytest.mark.parametrize("code", [0, 1, 3, 4])
def test_an_end_that_the_journal_tells_is_not_told_twice(tmp_path: Path, code: int) -> None:
    assert "No such file" in untold(tmp_path, code)
    (tmp_path / "journal.sqlite").touch()
    assert untold(tmp_path, code) == ""


def test_no_room_for_an_engine_is_told(tmp_path: Path) -> None:
    (tmp_path / "runs").touch()
    with pytest.raises(HilcellError, match=r"no engine was started: .*Not a directory"):
        engine.start(tmp_path / "runs", "r", [])
