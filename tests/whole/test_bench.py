"""What the tests of whole runs share works as they need it."""

from __future__ import annotations

import sqlite3
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from io import StringIO
from pathlib import Path

from hilcell.journal.journal import read_journal
from hilcell.journal.runs import JOURNAL
from tests.whole.golden import GoldenRuns
from tests.whole.outputs import Outputs


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


def test_each_thread_writes_to_its_own_and_a_worker_to_the_first() -> None:
    outputs, before = Outputs(), (sys.stdout, sys.stderr)
    run, order, err = StringIO(), StringIO(), StringIO()
    with ThreadPoolExecutor(1) as worker, ThreadPoolExecutor(1) as beside:
        first = outputs.to(run, err)
        first.__enter__()
        try:
            other = outputs.to(order, err)
            beside.submit(other.__enter__).result()
            print("run")
            beside.submit(print, "order").result()
            worker.submit(print, "worker").result()
        finally:
            first.__exit__(None, None, None)
        beside.submit(print, "order, later").result()
        beside.submit(other.__exit__, None, None, None).result()
    assert run.getvalue() == "run\nworker\n"
    assert order.getvalue() == "order\norder, later\n"
    assert (sys.stdout, sys.stderr) == before
