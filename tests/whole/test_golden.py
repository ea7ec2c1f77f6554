"""Runs that the tests share."""

import sqlite3
from contextlib import closing
from pathlib import Path

from hilcell.journal.journal import read_journal
from hilcell.journal.runs import JOURNAL
from tests.whole.golden import GoldenRuns


def test_a_run_is_copied_whole_while_another_worker_reads_it(
    tmp_path: Path, golden: GoldenRuns
) -> None:
    run = golden["small"]
    with closing(sqlite3.connect(run.folder / JOURNAL)) as reader:
        reader.execute("BEGIN")
        reader.execute("SELECT count(*) FROM sqlite_master").fetchone()
        assert (run.folder / f"{JOURNAL}-wal").exists()
        copy = run.copied_to(tmp_path)
    assert [each.name for each in copy.glob(f"{JOURNAL}*")] == [JOURNAL]
    assert read_journal(copy / JOURNAL) == read_journal(run.folder / JOURNAL)
