"""``resume`` judges a journal only while it holds its run's lock."""

import json
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import msgspec
import pytest

from hilcell import __version__
from hilcell.cell.file import load_cell
from hilcell.commands import run as command
from hilcell.commands.cli import main
from hilcell.commands.run import awaited_motion
from hilcell.journal.journal import Journal, Record, read_journal
from hilcell.journal.runs import JOURNAL, EngineFile
from hilcell.run.cell_lock import lock_of_name, locked
from hilcell.run.control import Status
from hilcell.run.engine import Ending, Engine
from hilcell.run.run_plan import Changes
from tests.hilcell.alarms.journals import event, log_of, state
from tests.hilcell.report.journals import Writer
from tests.whole.bench import command as command_of


def left(folder: Path, **plan: Any) -> Path:
    """Leave a run in the middle."""
    return Writer(folder, **({"versions": {"hilcell": __version__}} | plan)).began().left()


def test_a_run_that_another_engine_finishes_meanwhile_is_not_begun_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = left(tmp_path / "r")

    @contextmanager
    def last(path: Path, what: str, run: str) -> Iterator[None]:
        """Lock once the other engine has ended."""
        journal = Journal(folder / JOURNAL, "r", create=False)
        journal.append("state", "", {"machine": "run", "to": "finished"})
        journal.append("end", "", {"state": "finished", "exit": 0, "result": {}})
        journal.close()
        with locked(path, what, run):
            yield

    monkeypatch.setattr("hilcell.run.engine.locked", last)
    assert main(["resume", "r", "--unattended", "--runs", str(tmp_path)]) == 2
    assert read_journal(folder / JOURNAL)[-1].kind == "end"


@pytest.mark.parametrize("named", ["runs/r", "other/link", "."])
def test_a_run_has_one_lock_by_whatever_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: str
) -> None:
    folder = left(tmp_path / "runs" / "r")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "link").symlink_to(folder)
    monkeypatch.chdir(folder if named == "." else tmp_path)
    with locked(lock_of_name(tmp_path / "runs", "paper"), "cell paper", "r"):
        assert main(["resume", named, "--unattended"]) == 6


STEP = "step 1 of 1, home, moves"


class Terminal(StringIO):
    """Somebody at a terminal."""

    def isatty(self) -> bool:
        return True


def resumed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, answer: str | None, *words: str
) -> tuple[int, list[Changes]]:
    """Resume a run with somebody at a terminal; return the exit code, and what went on."""
    proceed_refusal: list[Changes] = []

    def perform(self: Engine, noted: object) -> Ending:
        proceed_refusal.append(self.plan.changes)
        return Ending(0, None)

    monkeypatch.setattr(Engine, "_perform", perform)
    if answer is not None:
        monkeypatch.setattr(sys, "stdin", Terminal(answer))
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    return main(["resume", "r", "--runs", str(folder.parent), *words]), proceed_refusal


def records(folder: Path) -> list[Record]:
    """Return the records of a run but for those of its order, which each session has."""
    return [each for each in read_journal(folder / JOURNAL) if each.body.get("what") != "order"]


@pytest.mark.parametrize(
    ("simulated", "words", "answer", "code"),
    [
        (True, (), "y\n", 0), (True, (), "\n", 4), (True, (), "no\n", 4), (True, (), "", 4),
        (True, (), None, 0), (True, ("--unattended",), "", 0), (True, ("--screen",), "", 0),
        (False, (), None, 2), (False, ("--unattended",), None, 0), (False, ("--screen",), None, 0),
        (False, (), "yes\n", 0), (False, (), "y\n", 4), (False, (), "yess\n", 4),
    ],
)  # fmt: skip
def test_a_resume_says_what_moves_and_asks_where_somebody_can_be_asked(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    simulated: bool,
    words: tuple[str, ...],
    answer: str | None,
    code: int,
) -> None:
    """A real robot does not go on where nobody can be, and only after a whole "yes"."""
    folder = left(tmp_path / "r", simulated=simulated)
    before = read_journal(folder / JOURNAL)
    found, went_on = resumed(folder, monkeypatch, answer, *words)
    assert (found, len(went_on)) == (code, int(code == 0))
    if code == 0 and (words or answer is None):
        assert went_on == [Changes([], can_ask="--screen" in words)]
    said = capsys.readouterr().err
    asked = answer is not None and not words
    assert (STEP in said) is (asked or (simulated and not words))
    assert ("SIMULATED" in said) is simulated or words
    assert ("--unattended" in said) is (code == 2)
    assert records(folder) == before


def test_a_run_that_has_a_copy_beside_it_says_so_when_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = left(tmp_path / "r")
    shutil.copytree(folder, tmp_path / "copy")
    assert resumed(folder, monkeypatch, "y\n")[0] == 0
    said = " ".join(capsys.readouterr().err.split())
    assert f"copy and r in {tmp_path} are one run; only r continues" in said
    shutil.rmtree(tmp_path / "copy")
    assert resumed(folder, monkeypatch, "y\n")[0] == 0
    assert "are one run" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("simulated", "screens", "unattended", "words", "code"),
    [
        (False, 0, False, (), 2),
        (False, 0, False, ("--unattended",), 0),
        (False, 1, False, (), 0),
        (False, 0, True, (), 0),
        (True, 0, False, (), 0),
    ],
)
def test_a_live_run_is_let_go_on_by_the_same_rule(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    simulated: bool,
    screens: int,
    unattended: bool,
    words: tuple[str, ...],
    code: int,
) -> None:
    folder = left(tmp_path / "r", simulated=simulated)
    ordered: list[str] = []

    def order(folder: Path, command: str, *, key: str = "", until: int = 0) -> Status:
        ordered.append(command)
        return Status(state="paused", screens=screens, unattended=unattended)

    monkeypatch.setattr(command, "order", order)
    monkeypatch.setattr(command, "live_engine", lambda folder: EngineFile(1, "here"))
    assert main(["resume", "r", "--runs", str(folder.parent), *words]) == code
    assert ("proceed" in ordered) is (code == 0)


MOTION = "rail (canopen): the slide moves from 300.00 to 320.00 mm at 25 mm/s"


def live(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], *life: str, **status: Any
) -> tuple[int, list[str]]:
    """Resume a live real run that has announced a motion; return the exit code and the orders."""
    journal = Journal(left(folder, simulated=False) / JOURNAL, "r", create=False)
    journal.append("event", "", {"what": "announced", "motion": MOTION})
    for to in life:
        journal.append("state", "", {"machine": "run", "to": to, "reason": f"waits: {MOTION}"})
    journal.close()
    ordered: list[str] = []

    def order(folder: Path, command: str, *, key: str = "", until: int = 0) -> Status:
        ordered.append(command)
        return Status(**status)

    monkeypatch.setattr(command, "order", order)
    monkeypatch.setattr(command, "live_engine", lambda folder: EngineFile(1, "here"))
    return main(["resume", "r", "--runs", str(folder.parent), *words]), ordered


@pytest.mark.parametrize("words", [(), ("--unattended",)])
@pytest.mark.parametrize("watching", [{"screens": 1}, {"unattended": True}, {}])
def test_a_real_motion_that_was_announced_waits_for_a_typed_word(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    watching: dict[str, Any],
) -> None:
    found = live(
        tmp_path / "r", monkeypatch, words, "pausing", "paused", state="paused", **watching
    )
    assert found == (2, ["status"])
    said = capsys.readouterr().err
    assert MOTION in said
    assert "hilcell resume r" in said


def test_a_motion_under_way_is_named_and_nothing_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", Terminal("yes\n"))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    life = ("pausing", "paused", "running")
    assert live(tmp_path / "r", monkeypatch, (), *life, state="running") == (0, ["status"])
    said = capsys.readouterr().err
    assert MOTION in said
    assert '"yes"' not in said


@pytest.mark.parametrize(
    ("words", "state", "code"),
    [((), "checking", 0), (("--unattended",), "running", 0), ((), "stopping", 2)],
)
def test_a_run_that_works_is_said_to_work_and_never_to_continue(
    words: tuple[str, ...],
    state: str,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert live(tmp_path / "r", monkeypatch, words, state, state=state) == (code, ["status"])
    said = capsys.readouterr().err
    assert f"run r is {state} in process 1 since 20" in said
    assert "hilcell watch r" in said
    assert "continues" not in said


CHANGE = f"hilcell 0.0.1 began this run, this is {__version__}"


@pytest.mark.parametrize("words", [("--unattended",), ()])
def test_another_version_is_refused_where_nobody_can_be_asked(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
) -> None:
    """A pipe is nobody: a script that waits for an answer waits for ever."""
    folder = left(tmp_path / "r", versions={"hilcell": "0.0.1"})
    assert resumed(folder, monkeypatch, None, *words) == (2, [])
    refusal = capsys.readouterr().err
    assert CHANGE in refusal
    assert "--accept-changes" in refusal
    proceed_refusal = [Changes([CHANGE], accepted=True, can_ask=False)]
    assert resumed(folder, monkeypatch, None, *words, "--accept-changes") == (0, proceed_refusal)


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "is missing; "), ("name = 3", "has changed, and is not valid: ")],
)
def test_a_cell_file_that_is_gone_or_spoilt_is_named_with_what_to_do(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    content: str | None,
    words: str,
) -> None:
    file = tmp_path / "mycell.toml"
    if content is not None:
        file.write_text(content)
    folder = left(tmp_path / "r", cell_file=str(file))
    assert resumed(folder, monkeypatch, None) == (2, [])
    refusal = capsys.readouterr().err
    assert f"cell file {file} {words}" in refusal
    assert "the run keeps the cell that it began with" in refusal
    assert "put back what was there" in refusal
    assert "built in" not in refusal


def test_at_a_terminal_another_version_is_agreed_to_and_journalled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = left(tmp_path / "r", versions={"hilcell": "0.0.1"})
    assert resumed(folder, monkeypatch, "n\n") == (4, [])
    assert resumed(folder, monkeypatch, "y\n") == (0, [Changes()])
    assert CHANGE in capsys.readouterr().err
    last = records(folder)[-1].body
    assert last == {"what": "changes accepted", "changes": [CHANGE], "by": "the operator"}


def listed(runs: Path) -> dict[str, object]:
    """Return a list's words on the only run there."""
    (found,) = json.loads(command_of("runs", "--runs", runs, "--json").stdout)["runs"]
    return {key: found[key] for key in ("state", "verdict", "exit")}


@pytest.mark.parametrize("driver", ["robot", "tracker", "rail"])
def test_a_driver_that_is_not_installed_on_this_pc_is_to_be_installed(
    driver: str, tmp_path: Path
) -> None:
    cell = msgspec.to_builtins(load_cell("paper"))
    cell[driver]["driver"] = "mine"
    folder = left(tmp_path / "r", cell=cell)
    before, state = read_journal(folder / JOURNAL), listed(tmp_path)
    done = command_of("resume", "r", "--unattended", "--runs", tmp_path)
    assert done.returncode == 2
    assert f"{driver}.driver: 'mine'" in done.stderr
    assert read_journal(folder / JOURNAL) == before
    assert listed(tmp_path) == state
    assert state == {"state": "running, engine gone", "verdict": "", "exit": None}


# -- a person agrees to the motion that was announced last, and to none that was agreed to ---------


RUNNING = state("running")
FIRST, SECOND = (event("announced", motion=motion) for motion in ("A1 turns", "A6 turns"))


def test_the_motion_that_a_run_waits_for_is_the_last_that_nobody_has_agreed_to() -> None:
    assert awaited_motion(log_of(RUNNING)) == ""
    assert awaited_motion(log_of(RUNNING, FIRST, state("paused"))) == "A1 turns"
    assert awaited_motion(log_of(RUNNING, FIRST, state("paused"), RUNNING)) == ""
    assert awaited_motion(log_of(RUNNING, FIRST, RUNNING, SECOND, state("paused"))) == "A6 turns"
