"""Engines as processes, work in threads, garbage collection."""

from __future__ import annotations

import asyncio
import gc
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.commands.cli import whole_parser
from hilcell.errors import HilcellError
from hilcell.sanitize import clean
from hilcell.tui.process import (
    GarbageCollector,
    StartedEngine,
    dry_run,
    run_command,
    run_in_thread,
    start_engine,
)
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


def test_what_is_returned_or_raised_comes_back() -> None:
    assert asyncio.run(run_in_thread(divmod, 7, 2)) == (3, 1)
    with pytest.raises(ZeroDivisionError):
        asyncio.run(run_in_thread(divmod, 7, 0))


def test_others_work_meanwhile() -> None:
    async def both() -> bool:
        came = threading.Event()
        waiting = asyncio.create_task(run_in_thread(came.wait))
        await asyncio.sleep(0)
        came.set()
        return await waiting

    assert asyncio.run(both())


def test_an_end_waits_for_nothing_that_was_given_up() -> None:
    """Neither does that of the program, whose last thread it may be."""
    go_on, ended = threading.Event(), threading.Event()

    def work() -> None:
        assert threading.current_thread().daemon
        go_on.wait()
        ended.set()

    async def give_up() -> None:
        task = asyncio.create_task(run_in_thread(work))
        await asyncio.sleep(0)
        task.cancel()

    asyncio.run(give_up())
    go_on.set()
    ended.wait()


@pytest.mark.parametrize("fails", [False, True])
def test_work_that_was_given_up_before_it_began_is_done(
    monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    begin, ended = threading.Event(), threading.Event()

    class Late(threading.Thread):
        def run(self) -> None:
            begin.wait()
            try:
                super().run()
            finally:
                ended.set()

    done: list[int] = []

    def work() -> None:
        done.append(1)
        if fails:
            raise ZeroDivisionError

    async def give_up() -> None:
        task = asyncio.create_task(run_in_thread(work))
        await asyncio.sleep(0)
        task.cancel()

    monkeypatch.setattr("hilcell.tui.process.threading.Thread", Late)
    asyncio.run(give_up())
    begin.set()
    ended.wait()
    assert done == [1]


def test_whole_collections_wait_until_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    collected: list[float] = []
    kept: list[str] = []
    for name in ("freeze", "unfreeze"):  # not really: the tests have frozen what is imported
        monkeypatch.setattr(gc, name, lambda name=name: kept.append(name))
    before = gc.get_threshold()
    collector = GarbageCollector(0.0)
    try:
        assert gc.get_threshold() == (*before[:2], GarbageCollector.NEVER)
        for at_rest, now_s in ((True, 1.0), (False, 40.0), (True, 41.0), (True, 42.0)):
            monkeypatch.setattr(gc, "collect", lambda now_s=now_s: collected.append(now_s))
            collector.tick(at_rest=at_rest, now_s=now_s)
        assert GarbageCollector.PERIOD_S > 2.0
        assert collected == [42.0]  # what ended at 41 is painted first
        assert kept == ["freeze"]
    finally:
        collector.end()
    assert kept == ["freeze", "unfreeze"]
    assert gc.get_threshold() == before
