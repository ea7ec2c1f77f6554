"""Orders for engines: the words typed into the form, whatever they are, reach the command whole."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.commands.cli import whole_parser
from hilcell.errors import HilcellError
from hilcell.sanitize import clean
from hilcell.tui.process import StartedEngine, dry_run, run_command, start_engine
from hilcell.tui.screens.start import Entries

# No terminal types NUL or half a letter; argparse drops a lone --.
TYPED = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])).filter(
    lambda text: text != "--"  # which argparse takes for the end of options
)
ENTRIES = Entries(
    cell="paper", procedure="home", operator="", job="", seed="1", speed="", attended=True
)
RUNS = Path("r")


@settings(max_examples=25)
@given(operator=TYPED, job=TYPED, attended=st.booleans())
def test_names_reach_the_command_whole(operator: str, job: str, attended: bool) -> None:
    entries = replace(ENTRIES, operator=operator, job=job, attended=attended)
    found = whole_parser().parse_args(["run", *entries.order((("a.b", "c"),), RUNS).command_line()])
    assert (found.operator, found.job) == (clean(operator), clean(job))
    assert (found.cell, found.procedure, found.seed) == ("paper", "home", 1)
    assert found.settings == [("a.b", "c")]
    assert found.unattended is not attended


@pytest.mark.parametrize("name", ["--unattended", "-x", "---", "=", "a b", "[/nope]"])
def test_names_that_look_like_options_are_names(name: str) -> None:
    order = replace(ENTRIES, operator=name, job=name).order((), RUNS)
    found = whole_parser().parse_args(["run", *order.command_line()])
    assert (found.operator, found.job, found.unattended) == (name, name, False)


def test_speed_is_named_only_where_it_is_chosen() -> None:
    assert "--speed" not in " ".join(ENTRIES.order((), RUNS).command_line())
    assert replace(ENTRIES, speed="10").order((), RUNS).speed == 10.0


def test_a_seed_that_is_none_is_refused_in_words() -> None:
    with pytest.raises(HilcellError, match=r"^seed: .*-1"):
        replace(ENTRIES, seed="-1").order((), RUNS)


@pytest.mark.process
def test_commands_are_processes_whose_refusals_say_why(tmp_path: Path) -> None:
    """A value that is refused comes without the usage of a command."""
    plan = asyncio.run(dry_run(ENTRIES.order((), tmp_path)))
    assert (plan.procedure, bool(plan.steps)) == ("home", True)
    with pytest.raises(HilcellError) as refused:
        asyncio.run(run_command("run", "home", "--seed=-1"))
    assert str(refused.value).startswith("seed: ")
    assert "\n" not in str(refused.value)
    first, second = (start_engine(tmp_path, "r", ["run", "nothing"]) for _ in range(2))
    for engine in (first, second):
        assert "--screen" in cast("list[str]", engine.process.args)  # moves before its eyes alone
        assert "'nothing'" in engine.wait_for_end()
    assert first.log_file != second.log_file


class Ended:
    """A process that has ended."""

    def __init__(self, code: int) -> None:
        self._code = code

    def wait(self) -> int:
        """Return its exit code."""
        return self._code


def ended(folder: Path, code: int) -> StartedEngine:
    return StartedEngine(cast("Any", Ended(code)), folder / "engine-1.log")


@pytest.mark.parametrize("code", [2, 5, 6, 7])
def test_an_end_outside_the_journal_is_reported(tmp_path: Path, code: int) -> None:
    (tmp_path / "journal.sqlite").touch()
    assert (
        ended(tmp_path, code)
        .wait_for_end()
        .endswith(f"exit {code}: {StartedEngine.EXIT_REASONS[code]}")
    )
    said = tmp_path / "engine-1.log"
    said.write_text("".join(f"line {number}\n" for number in range(100)))
    reported = ended(tmp_path, code).wait_for_end()
    assert len(reported.splitlines()) == 1, "the alarm's panel has the rest"
    (tmp_path / "journal.sqlite").unlink()
    reported = ended(tmp_path, code).wait_for_end()
    assert reported.endswith("line 98\nline 99")
    assert len(reported.splitlines()) == 7


def test_only_the_last_reason_is_reported(tmp_path: Path) -> None:
    said = tmp_path / "engine-1.log"
    said.write_text("connected\nhilcell: a notice\n25/1035 points\nhilcell: locked\nby a run\n")
    assert ended(tmp_path, 6).wait_for_end().endswith("exit 6: locked\nby a run")


@pytest.mark.parametrize("code", [0, 1, 3, 4])
def test_an_end_in_the_journal_is_not_reported_twice(tmp_path: Path, code: int) -> None:
    assert f"exit {code}" in ended(tmp_path, code).wait_for_end()
    (tmp_path / "journal.sqlite").touch()
    assert ended(tmp_path, code).wait_for_end() == ""


def test_an_engine_that_cannot_be_started_is_reported(tmp_path: Path) -> None:
    (tmp_path / "runs").touch()
    with pytest.raises(HilcellError, match="Not a directory"):
        start_engine(tmp_path / "runs", "r", [])
