"""Workers of a study that are gone, or that froze; processes on loopback."""

from __future__ import annotations

import os
import signal
from multiprocessing import active_children
from pathlib import Path

import pytest

from hilcell.study import cluster
from hilcell.study.case import packed
from hilcell.study.design import cases
from hilcell.study.errors import Cluster
from hilcell.study.study_file import cell_of
from tests.hilcell.study.studies import study
from tests.whole.dask_bench import READINGS, scheduler, worker


def test_workers_that_are_all_gone_or_a_scheduler_that_froze_are_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "LOOK_S", 0.1)
    monkeypatch.setattr(cluster, "WORKERS_S", 0.5)
    asked = study(tmp_path, READINGS, "machines = 9")
    waiting = ((case, packed(cell_of(asked, case.point.values))) for case in cases(asked))
    with (
        scheduler() as (address, frozen),
        worker(address) as last,
        cluster.workers_of(address, _say) as workers,
    ):
        rows = workers.measure(waiting)
        assert next(rows)[1]["state"] == "done"
        last.kill()
        with pytest.raises(Cluster, match=r"scheduler .* has had no worker for 0\.5 s"):
            list(rows)
        frozen.process.send_signal(signal.SIGSTOP)
        try:
            with pytest.raises(Cluster, match=r"scheduler .* is gone"):
                list(workers.measure(iter(())))
        finally:
            frozen.process.send_signal(signal.SIGCONT)


class Said(Exception):
    """What the user reads; it ends the study of a test."""


def _say(words: str) -> None:
    raise Said(words)


def test_a_worker_that_froze_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the middle of a study, where it may hold rows that nobody has read, and before one."""
    monkeypatch.setattr(cluster, "LOOK_S", 0.1)
    monkeypatch.setattr(cluster, "SILENT_S", 2.0)
    monkeypatch.setattr(cluster, "ANSWER_S", 1.0)
    asked = study(tmp_path, READINGS, "machines = 9")
    waiting = ((case, packed(cell_of(asked, case.point.values))) for case in cases(asked))
    drops = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "10s"}  # so that the test ends
    with scheduler(**drops) as (address, _), worker(address), worker(address) as frozen:
        at = frozen.named
        with cluster.workers_of(address, _say) as workers:
            rows = workers.measure(waiting)
            assert next(rows)[1]["state"] == "done"
            frozen.process.send_signal(signal.SIGSTOP)
            with pytest.raises(Said) as said:
                list(rows)
        assert str(said.value) == (
            f"scheduler {address}: worker {at} has not answered for 2 s; if it stays silent, its "
            "cases are measured by another, after 5 to 10 minutes, or once to twice the "
            "scheduler's worker-ttl"
        )
        with (
            pytest.raises(Cluster, match=f"worker {at} does not answer; end it, or wait"),
            cluster.workers_of(address, _say),
        ):
            raise AssertionError("it can be used")


@pytest.mark.nightly
def test_a_worker_of_this_pc_that_froze_is_restarted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask takes no shorter time than ten heartbeats, 5 s; no case is lost."""
    monkeypatch.setattr(cluster, "LOOK_S", 0.1)
    monkeypatch.setattr(cluster, "SILENT_S", 2.0)
    monkeypatch.setitem(cluster.SETTINGS, "distributed.scheduler.worker-ttl", "2s")
    asked = study(tmp_path, READINGS, "machines = 2")
    waiting = ((case, packed(cell_of(asked, case.point.values))) for case in cases(asked))
    said = list[str]()
    with cluster.local_workers(1, said.append) as workers:
        rows = workers.measure(waiting)
        found = [next(rows)]
        (process,) = [each for each in active_children() if each.name.startswith("Dask Worker")]
        assert process.pid is not None
        os.kill(process.pid, signal.SIGSTOP)
        found += rows
    assert sorted(case.number for case, _ in found) == [1, 2, 3, 4]
    assert {row["state"] for _, row in found} == {"done"}
    (words,) = said
    assert words.startswith("the local cluster: worker tcp://127.0.0.1:")
    assert words.endswith("its cases are measured by another, within 60 s")
