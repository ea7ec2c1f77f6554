"""The Nth write of a run fails, for each N: exit 7, all that was acknowledged is kept, resume ends.

(Fault 65 of campaigns/faults; the way of SQLite's own tests.)
"""

import sqlite3
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from hilcell.commands.cli import main
from hilcell.journal.journal import Record, read_journal
from hilcell.journal.runs import JOURNAL
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure

POINTS = 3
INSERT = "INSERT INTO record"
KINDS = ("nothing of it stored", "stored all the same")  # an error that comes back says neither


class Disk:
    """Counts the records that are written, and fails one of them and all that follow."""

    def __init__(self, nth: int, stored: bool) -> None:
        self.nth, self.stored = nth, stored
        self.count = 0

    def connect(self, monkeypatch: pytest.MonkeyPatch) -> None:
        factory = partial(Connection, disk=self)
        monkeypatch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=factory))


class Connection(sqlite3.Connection):
    def __init__(self, *words: Any, disk: Disk, **options: Any) -> None:
        super().__init__(*words, **options)
        self._disk = disk

    def execute(self, sql: str, parameters: Any = (), /) -> sqlite3.Cursor:
        if not sql.startswith(INSERT):
            return super().execute(sql, parameters)
        self._disk.count += 1
        if self._disk.count < self._disk.nth:
            return super().execute(sql, parameters)
        if self._disk.count == self._disk.nth and self._disk.stored:
            super().execute(sql, parameters)
        raise sqlite3.OperationalError("disk I/O error")


def whole(records: list[Record], points: int) -> None:
    """The run came to its end, and each point is there once."""
    keys = [record.key for record in records if record.kind == "point"]
    assert keys == [f"p/{number}" for number in range(points)]
    assert (records[-1].kind, records[-1].body["exit"]) == ("end", 0)


def desk_run(bed: Bed, acknowledged: list[Record]) -> int:
    """Run, or resume, and take what is acknowledged."""
    runner = bed.runner(procedure(Points(POINTS)))
    bed.journal.listen(acknowledged.append)
    try:
        return runner.run()
    finally:
        bed.journal.close()


def records_of_a_run(folder: Path) -> int:
    folder.mkdir()
    bed = Bed(folder)
    assert desk_run(bed, []) == 0
    return len(read_journal(bed.path))


@pytest.mark.parametrize("stored", [False, True], ids=KINDS)
def test_each_write_of_a_run_may_fail(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stored: bool
) -> None:
    total = records_of_a_run(tmp_path / "whole")
    for nth in range(2, total + 1):  # the first is the plan: nothing has begun
        (tmp_path / str(nth)).mkdir()
        bed, acknowledged = Bed(tmp_path / str(nth)), list[Record]()
        with monkeypatch.context() as patch:
            disk = Disk(nth, stored)
            disk.connect(patch)
            assert desk_run(bed, acknowledged) == 7, nth
        assert disk.count >= nth
        assert bed.rail.closed == 1
        kept = read_journal(bed.path)
        assert kept[1 : 1 + len(acknowledged)] == acknowledged
        assert len(kept) - 1 - len(acknowledged) == int(stored), nth
        resumed = Bed(tmp_path / str(nth))
        over = any(record.kind == "end" for record in kept)
        if not over:
            desk_run(resumed, [])
            whole(read_journal(bed.path), POINTS)


HOME_WRITES = 25  # about the records of a run of `home`; a later one does not fail


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    "writes",
    [(1, 12), pytest.param(range(1, HOME_WRITES), marks=pytest.mark.nightly)],
    ids=["some", "all"],
)
def test_a_command_whose_write_fails_is_resumed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    writes: Iterable[int],
) -> None:
    for nth in writes:
        name = f"r{nth}"
        with monkeypatch.context() as patch:
            disk = Disk(nth, stored=False)
            disk.connect(patch)
            code = main(["run", "home", "--name", name, "--runs", str(tmp_path)])
        err = capsys.readouterr().err
        assert "Traceback" not in err
        assert code == (7 if disk.count >= nth else 0), err
        if code == 7:
            assert "disk I/O error" in err
        kept = read_journal(tmp_path / name / JOURNAL)
        assert len(kept) == min(nth - 1, disk.count)
        if code == 7 and kept:
            assert main(["resume", name, "--unattended", "--runs", str(tmp_path)]) == 0, nth
            assert read_journal(tmp_path / name / JOURNAL)[-1].body["exit"] == 0
