"""The index says what the journals say, quickly, and is never believed over one of them."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from hilcell.commands.cli import main
from hilcell.errors import HilcellError
from hilcell.journal import index
from hilcell.journal.index import NAME, RunRow, matches, read_index
from hilcell.journal.journal import Journal
from hilcell.journal.runs import JOURNAL, EngineFile, read_log, read_records, run_folders
from tests.hilcell.commands.finished_runs import MADE, finished, text_of
from tests.hilcell.report.journals import AFTER_MM, BEFORE_MM, Writer
from tests.whole.bench import command

SENT = {"points": 2, "points_sent": {"before": 2, "chosen": 2}}
PLACES = {
    "S300": SENT | {
        "before": {"mean": 9.0, "p95": 9.4, "max": 9.5},
        "chosen": {"mean": 8.0, "p95": 8.4, "max": 8.5},
    },
    "S1100": SENT | {
        "before": {"mean": 1.25, "p95": 2.0, "max": 2.5},
        "chosen": {"mean": 0.125, "p95": 0.3, "max": 0.5},
    },
}  # fmt: skip


def written(folder: Path, state: str = "finished", **plan: Any) -> Path:
    """Write a run whose journal has come to rest."""
    writer = Writer(folder, **plan).began()
    writer.validated("S1100", "before", BEFORE_MM).validated("S1100", "chosen", AFTER_MM)
    reason = "Tracker: measure: beam broken" if state == "faulted" else ""
    return settled(writer.ended(state, 3 if reason else 0, reason))


def settled(folder: Path) -> Path:
    """Let a journal look as if it was written some time ago."""
    journal = folder / JOURNAL
    journal.with_name(f"{JOURNAL}-wal").unlink(missing_ok=True)
    at_ns = journal.stat().st_mtime_ns - 60 * 10**9
    os.utime(journal, ns=(at_ns, at_ns))
    return folder


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Return a folder with a finished, a faulted and an abandoned run, and what is no run."""
    written(tmp_path / "1-finished", procedure="calibrate", job="J-1")
    written(tmp_path / "2-faulted", "faulted", operator="Bob", seed=12)
    settled(Writer(tmp_path / "3-abandoned").began().left())
    (tmp_path / "not-a-run").mkdir()
    (tmp_path / "notes.txt").write_text("none")
    return tmp_path


class Opened:
    """Counts which journals are read."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.names: list[str] = []
        monkeypatch.setattr(index, "read_records", self._read)

    def _read(self, folder: Path) -> Any:
        self.names.append(folder.name)
        return read_records(folder)

    def since(self) -> list[str]:
        names, self.names = sorted(self.names), []
        return names


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Opened:
    return Opened(monkeypatch)


def names(runs: Path) -> list[str]:
    return [row.name for row in read_index(runs)]


def test_rows_say_what_logs_say(runs: Path) -> None:
    for rows in (read_index(runs), read_index(runs)):  # read, then kept
        assert [row.name for row in rows] == ["3-abandoned", "2-faulted", "1-finished"]
        for row in rows:
            log = read_log(runs / row.name)
            assert (row.procedure, row.operator) == (log.inputs.procedure, log.inputs.operator)
            assert (row.cell, row.serial) == (log.cell.name, log.cell.serial)
            assert (row.state, row.points) == (log.states["run"], len(log.points))
            assert (row.job, row.seed) == (log.inputs.job, log.inputs.seed)
            assert row.exit == (None if log.end is None else log.end.exit)
            assert row.simulated
            assert not row.live
        abandoned, faulted, _ = rows
        assert faulted.reason == "Tracker: measure: beam broken"
        assert abandoned.condition == "running, engine gone"
        assert abandoned.ended == ""
        assert faulted.begun == f"{read_records(runs / '2-faulted')[0].t[:19]}Z"


@pytest.mark.parametrize("to", ["paused", "suspended"])
def test_a_run_that_waits_says_why(tmp_path: Path, to: str) -> None:
    writer = Writer(tmp_path / "waits").began()
    writer.state("run", to, reason="the screen was lost")
    (row,) = read_index(tmp_path)
    assert (row.state, row.reason) == (to, "the screen was lost")
    writer.state("run", "running")
    writer.left()
    (row,) = read_index(tmp_path)
    assert (row.state, row.reason) == ("running", "")


def test_a_run_of_which_there_is_a_plan_and_no_more_is_not_begun() -> None:
    row = msgspec.structs.replace(ROW, state="idle", exit=None, live=False)
    assert (row.condition, row.gone) == ("not begun", False)
    assert msgspec.structs.replace(row, live=True).condition == "idle"
    assert msgspec.structs.replace(row, exit=2).condition == "idle"


def test_a_run_that_the_devices_refused_is_no_fault() -> None:
    row = msgspec.structs.replace(ROW, state="faulted", exit=2, live=False)
    assert row.verdict == "refused"
    assert msgspec.structs.replace(row, exit=3).verdict == "faulted"
    unasked = msgspec.structs.replace(row, state="idle", exit=3)
    assert unasked.verdict == "not begun"


def test_only_what_changed_is_opened(runs: Path, opened: Opened) -> None:
    read_index(runs)
    assert opened.since() == ["1-finished", "2-faulted", "3-abandoned"]
    read_index(runs)
    assert opened.since() == ["3-abandoned"]
    written(runs / "4-new")
    shutil.rmtree(runs / "1-finished")
    assert names(runs) == ["4-new", "3-abandoned", "2-faulted"]
    assert opened.since() == ["3-abandoned", "4-new"]
    shutil.copytree(runs / "4-new", runs / "1-finished", copy_function=shutil.copyfile)
    read_index(runs)
    assert "1-finished" in opened.since()


def test_a_resumed_run_is_seen_though_its_file_is_as_it_was(runs: Path) -> None:
    read_index(runs)
    file = runs / "2-faulted" / JOURNAL
    before = file.stat()
    journal = Journal(file, "2-faulted", create=False)
    journal.append("state", "", {"machine": "run", "to": "checking"})
    assert (file.stat().st_mtime_ns, file.stat().st_size) == (before.st_mtime_ns, before.st_size)
    row = {row.name: row for row in read_index(runs)}["2-faulted"]
    assert (row.state, row.exit, row.ended, row.reason) == ("checking", None, "", "")
    journal.close()


@contextmanager
def engine(folder: Path) -> Iterator[None]:
    """Let an engine seem to listen for the run of ``folder``."""
    with tempfile.TemporaryDirectory() as private, socket.socket(socket.AF_UNIX) as server:
        address = f"{private}/control"
        server.bind(address)
        server.listen()
        (folder / "engine.json").write_bytes(msgspec.json.encode(EngineFile(os.getpid(), address)))
        yield


def test_a_live_run_is_told(runs: Path, opened: Opened) -> None:
    with engine(runs / "3-abandoned"):
        live = {row.name: row for row in read_index(runs)}["3-abandoned"]
        assert (live.live, live.condition) == (True, "running")
        assert matches(live, "state:live")
    opened.since()
    assert not any(row.live for row in read_index(runs))
    assert opened.since() == ["3-abandoned"]


def test_figures_are_of_the_grids_station(tmp_path: Path) -> None:
    bodies: dict[str, dict[str, Any]] = {
        "paper": {"validation": PLACES},
        "campaign": {
            "campaign": {
                "chosen": "hybrid",
                "methods": {
                    "nominal": {"mean_mm": 1.25, "p95_mm": 2.0, "max_mm": 2.5},
                    "hybrid": {"mean_mm": 0.125, "p95_mm": 0.3, "max_mm": 0.5},
                },
            }
        },
        "none": {"points": {"grid": 3}},
        "another's": {"validation": "passed"},
    }
    for name, result in bodies.items():
        writer = Writer(tmp_path / name).began()
        writer.journal.append("end", "", {"state": "finished", "exit": 0, "result": result})
        writer.left()
    found = {
        row.name: (row.before_mean_mm, row.chosen_mean_mm, row.chosen_max_mm)
        for row in read_index(tmp_path)
    }
    assert found["paper"] == found["campaign"] == (1.25, 0.125, 0.5)
    assert found["none"] == found["another's"] == (None, None, None)


def test_damaged_journals_are_told_and_read_again(runs: Path, opened: Opened) -> None:
    (runs / "2-faulted" / JOURNAL).write_bytes(b"not a database at all, by no means " * 30)
    (runs / "5-empty").mkdir()
    Journal(runs / "5-empty" / JOURNAL, "5-empty", create=True).close()
    writer = Writer(runs / "6-alien", seed="seven")
    writer.left()
    rows = {row.name: row for row in read_index(runs)}
    assert [name for name, row in rows.items() if not row.readable] == [
        "6-alien",
        "5-empty",
        "2-faulted",
    ]
    assert rows["5-empty"].state == "never began"
    assert "seed" in rows["6-alien"].reason
    assert all(row.begun.endswith("Z") for row in rows.values())
    opened.since()
    read_index(runs)
    assert {"2-faulted", "5-empty", "6-alien"} <= set(opened.since())


def garbage(file: Path) -> None:
    file.write_bytes(b"\x00garbage" * 4000)


def torn(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[4096:] = b"\xff" * (len(content) - 4096)
    file.write_bytes(content)


def other_rows(file: Path) -> None:
    change(file, "UPDATE run SET row = CAST('{\"name\": 5}' AS BLOB)")


def other_version(file: Path) -> None:
    change(file, "DROP TABLE run", "CREATE TABLE run (a, b)", "PRAGMA user_version = 77")


def change(file: Path, *commands: str) -> None:
    base = sqlite3.connect(file, isolation_level=None)
    for statement in commands:
        base.execute(statement)
    base.close()


@pytest.mark.parametrize("harm", [garbage, torn, other_rows, other_version, Path.unlink])
def test_a_damaged_index_is_made_again(runs: Path, opened: Opened, harm: Any) -> None:
    rows = read_index(runs)
    harm(runs / NAME)
    assert read_index(runs) == rows
    assert read_index(runs) == rows
    opened.since()
    assert read_index(runs) == rows
    assert opened.since() == ["3-abandoned"]


def test_a_place_where_no_index_can_be(runs: Path, opened: Opened) -> None:
    (runs / NAME).mkdir()
    assert len(read_index(runs)) == len(read_index(runs)) == 3
    assert len(opened.since()) == 6
    assert (runs / NAME).is_dir()


def test_an_index_that_another_holds(
    runs: Path, opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = read_index(runs)
    opened.since()
    monkeypatch.setattr(index, "BUSY_S", 0.01)
    holder = sqlite3.connect(runs / NAME, isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    assert read_index(runs) == rows
    assert len(opened.since()) == 3
    holder.execute("COMMIT")
    holder.close()
    assert read_index(runs) == rows
    assert opened.since() == ["3-abandoned"]


READ = """
import json, os, sys, urllib.parse  # what the library loads late, nobody may read later
from pathlib import Path
from hilcell.journal.index import read_index
from hilcell.run import control
LEAVE
print(json.dumps([row.state for row in read_index(Path(sys.argv[1]))]))
"""
READ_ONLY = READ.replace("LEAVE", "os.getuid() or os.setuid(65534)")  # root may write everywhere
READ = READ.replace("LEAVE", "")


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """Return a folder that other users can reach."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.mark.process
def test_a_folder_that_may_only_be_read(open_folder: Path) -> None:
    """Nothing may be written there, not even what SQLite wants beside a journal."""
    for name in ("1", "2"):
        folder = written(open_folder / name)
        (folder / JOURNAL).chmod(0o444)
        folder.chmod(0o555)
    open_folder.chmod(0o555)
    done = subprocess.run(
        [sys.executable, "-c", READ_ONLY, open_folder], capture_output=True, text=True, check=False
    )
    found = [path.name for path in open_folder.rglob("*") if path.is_file()]
    for folder in (open_folder, *open_folder.glob("?")):
        folder.chmod(0o755)
    assert done.stdout == '["finished", "finished"]\n', done.stderr
    assert found == [JOURNAL, JOURNAL]


@pytest.mark.process
def test_several_processes_at_once(tmp_path: Path) -> None:
    model = written(tmp_path / "model")
    runs = tmp_path / "runs"
    for number in range(30):
        settled(shutil.copytree(model, runs / f"{number:03d}"))
    readers = [
        subprocess.Popen([sys.executable, "-c", READ, runs], stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    for reader in readers:
        assert json.loads(reader.communicate()[0]) == ["finished"] * 30
    base = sqlite3.connect(runs / NAME)
    assert base.execute("SELECT count(*) FROM run").fetchone() == (30,)
    assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    base.close()


def test_strange_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strange = [os.fsdecode(b"not\xfftext"), "[b]bold[b]", "ESC\x1b[2J", "a'b\"c;--", "run\u202e"]
    for number, name in enumerate(strange):
        written(tmp_path / str(number)).rename(tmp_path / name)
    for _ in range(2):
        assert sorted(names(tmp_path)) == sorted(strange)
    assert main(["runs", "--runs", str(tmp_path)]) == 0
    assert not {"\x1b", "\u202e"} & {*capsys.readouterr().out}


def test_a_cell_whose_name_is_no_text_spoils_no_list(tmp_path: Path) -> None:
    written(tmp_path / "1-made", cell={"name": 5, "serial": 7, "grid": {"station": [1]}})
    (row,) = read_index(tmp_path)
    assert (row.state, row.cell, row.serial) == ("finished", "5", "7")
    assert matches(row, "cell:5")


def test_no_runs(tmp_path: Path) -> None:
    assert read_index(tmp_path / "none") == []
    assert read_index(tmp_path) == []
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(HilcellError, match=JOURNAL):
        read_index(written(tmp_path / "a") / JOURNAL)


ROW = RunRow(
    name="20261103-081500-calibrate-a1b2", begun="2026-11-03T08:15:00Z", state="faulted",
    ended="2026-11-03T09:00:00Z", reason="Rail: station S1100 not held", procedure="calibrate",
    cell="paper", serial="P-1", operator="Ann Ørsted", job="J-17", seed=12, simulated=True,
    points=64, exit=3,
)  # fmt: skip


def test_words_choose_runs() -> None:
    chosen = [
        "", "   ", "paper faulted 2026-11", "PAPER  Faulted", "ørsted", "a1b2", "j-17",
        "state:faulted operator:ann", "run:calibrate", "begun:2026-11-03", "seed:12", "points:64",
        "-finished", "-operator:bob paper", "rail:", "kind:simulated", "-", "state:", "-state:",
        "held -seed:1", "exit:3", "simulated",
    ]  # fmt: skip
    others = [
        "finished", "paper finished", "2026-12", "-faulted", "state:paper", "operator:bob",
        "-operator:ann", "seed:1", "points:6", "kind:real", "nowhere:faulted", "paper -paper",
        "live", "gone", "exit:0", "[b]",
    ]  # fmt: skip
    assert [words for words in (*chosen, *others) if matches(ROW, words)] == chosen


def test_the_command_keeps_its_keys(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (runs / "0-damaged").mkdir()
    (runs / "0-damaged" / JOURNAL).write_bytes(b"x" * 5000)
    assert main(["runs", "--json", "--runs", str(runs)]) == 0
    listed = json.loads(capsys.readouterr().out)["runs"]
    assert [each["run"] for each in listed] == [folder.name for folder in run_folders(runs)]
    assert list(listed[0]) == ["run", "state", "reason"]
    wanted = {
        "run": "2-faulted", "procedure": "home", "cell": "paper", "state": "faulted", "points": 8,
        "exit": 3, "simulated": True, "operator": "Bob", "job": "J-17", "live": False,
        "standing": None,
    }  # fmt: skip
    assert listed[2] | wanted == listed[2]
    assert listed[3]["state"] == "running, engine gone"
    assert listed[3]["exit"] is None


# -- A row of the index that is damaged is read again from its journal, and never believed ---------


STEP = 41  # bits from one flip to the next of the part: prime, so all places in a byte come


@pytest.fixture
def revoked(tmp_path: Path) -> Path:
    """Return the folder of a run that is revoked, and in the index so."""
    finished(tmp_path, "1-made", MADE)
    assert command("revoke", "1-made", "--runs", tmp_path, "--reason", "a nest").returncode == 0
    settled(tmp_path / "1-made")
    assert text_of(tmp_path / "1-made") == "revoked: a nest"
    return tmp_path / "1-made"


def stored(index: Path) -> tuple[int, int]:
    """Return where in the index's file its row is, from its name to its seal: bytes."""
    with closing(sqlite3.connect(index)) as base:
        ((name, stamp, row, seal),) = base.execute("SELECT * FROM run").fetchall()
    content = name.encode() + stamp.encode() + row + seal
    start = index.read_bytes().rindex(content)
    return start, start + len(content)


def flips(folder: Path, step: int) -> list[str | None]:
    """Return the statuses that were found with one bit of the row flipped."""
    index = folder.parent / NAME
    sound = index.read_bytes()
    first, last = stored(index)
    found = []
    for bit in range(8 * first, 8 * last, step):
        damaged = bytearray(sound)
        damaged[bit // 8] ^= 1 << bit % 8
        index.write_bytes(damaged)
        found.append(text_of(folder))
    return found


def test_a_flipped_bit_of_a_row_changes_no_standing(revoked: Path) -> None:
    assert set(flips(revoked, STEP)) == {"revoked: a nest"}


@pytest.mark.nightly
def test_no_flipped_bit_of_a_row_changes_a_standing(revoked: Path) -> None:
    assert set(flips(revoked, 1)) == {"revoked: a nest"}


def test_a_row_that_was_changed_with_care_is_no_row(revoked: Path) -> None:
    with closing(sqlite3.connect(revoked.parent / NAME)) as base, base:
        base.execute("UPDATE run SET row = CAST(replace(CAST(row AS TEXT), 'a nest', '') AS BLOB)")
    assert text_of(revoked) == "revoked: a nest"
    with closing(sqlite3.connect(revoked.parent / NAME)) as base, base:
        base.execute("UPDATE run SET seal = NULL")
    assert text_of(revoked) == "revoked: a nest"
