"""Orders for engines: the words typed into the form, whatever they are, reach the command whole."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.clean import clean
from hilcell.commands.cli import whole_parser
from hilcell.errors import HilcellError
from hilcell.tui.engine import process
from hilcell.tui.engine.process import EXIT_REASONS, RunRequest, StartedEngine, dry_run, run_command

# No terminal types NUL or half a letter; argparse drops a lone --.
TYPED = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])).filter(
    lambda text: text != "--"
)


@settings(max_examples=25)
@given(operator=TYPED, job=TYPED, attended=st.booleans())
def test_names_reach_the_command_whole(operator: str, job: str, attended: bool) -> None:
    asked = RunRequest("paper", "calibrate", operator, job, attended=attended)
    found = whole_parser().parse_args(asked.arguments())
    assert (found.operator, found.job) == (clean(operator), clean(job))
    assert (found.cell, found.procedure, found.seed) == ("paper", "calibrate", 1)
    assert found.unattended is not attended


@pytest.mark.parametrize("name", ["--unattended", "-x", "---", "=", "a b", "[/nope]"])
def test_names_that_look_like_options_are_names(name: str) -> None:
    found = whole_parser().parse_args(
        RunRequest("paper", "home", name, name, settings=("a.b=c",)).arguments()
    )
    assert (found.operator, found.job, found.unattended) == (name, name, False)
    assert found.set == [("a.b", "c")]


def test_speed_is_named_only_where_it_is_chosen() -> None:
    assert "--speed" not in " ".join(RunRequest("paper", "home").arguments())
    assert (
        whole_parser().parse_args(RunRequest("paper", "home", speed="10").arguments()).speed == 10.0
    )


def test_a_plan_comes_from_the_command_itself() -> None:
    plan = asyncio.run(dry_run(RunRequest("paper", "home")))
    assert plan["procedure"] == "home"
    assert plan["steps"]


@pytest.mark.parametrize(
    "asked", [RunRequest("nowhere", "home"), RunRequest("paper", "home", seed="x")]
)
def test_a_refusal_says_why(asked: RunRequest) -> None:
    with pytest.raises(HilcellError, match=r"nowhere|seed"):
        asyncio.run(dry_run(asked))


def test_a_value_that_is_refused_comes_without_the_usage_of_a_command() -> None:
    with pytest.raises(HilcellError, match=r"^seed: a whole number") as refused:
        asyncio.run(dry_run(RunRequest("paper", "home", seed="-1")))
    assert "\n" not in str(refused.value)


def test_the_error_of_a_command_is_kept(tmp_path: Path) -> None:
    with pytest.raises(HilcellError, match="not in"):
        asyncio.run(run_command("show", "none", "--runs", str(tmp_path)))


def test_each_engine_has_a_log_file_of_its_own(tmp_path: Path) -> None:
    words = ["run", "nothing", "--runs", str(tmp_path)]
    first, second = (process.start_engine(tmp_path, "r", words) for _ in range(2))
    assert "'nothing' is not installed" in first.wait_for_end()
    assert first.log_file != second.log_file
    assert "'nothing' is not installed" in second.wait_for_end()


def ended(folder: Path, code: int) -> StartedEngine:
    """Return an engine that has ended so, without having run."""
    process = subprocess.Popen([sys.executable, "-c", f"raise SystemExit({code})"])
    return StartedEngine(process, folder / "engine-1.log")


@pytest.mark.parametrize("code", [2, 5, 6, 7])
def test_an_end_outside_the_journal_is_reported(tmp_path: Path, code: int) -> None:
    (tmp_path / "journal.sqlite").touch()
    assert (
        ended(tmp_path, code).wait_for_end()
        == f"the engine ended, exit {code}: {EXIT_REASONS[code]}"
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
    assert ended(tmp_path, 6).wait_for_end() == "the engine ended, exit 6: locked\nby a run"


@pytest.mark.parametrize("code", [0, 1, 3, 4])
def test_an_end_in_the_journal_is_not_reported_twice(tmp_path: Path, code: int) -> None:
    assert ended(tmp_path, code).wait_for_end() == f"the engine ended, exit {code}: no reason given"
    (tmp_path / "journal.sqlite").touch()
    assert ended(tmp_path, code).wait_for_end() == ""


def test_an_engine_that_cannot_be_started_is_reported(tmp_path: Path) -> None:
    (tmp_path / "runs").touch()
    with pytest.raises(HilcellError, match=r"no engine was started: .*Not a directory"):
        process.start_engine(tmp_path / "runs", "r", [])
