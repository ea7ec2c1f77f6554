"""Slow work runs in threads; full garbage collections wait until nothing moves."""

from __future__ import annotations

import asyncio
import gc
import threading

import pytest

from hilcell.tui.process import GarbageCollector, run_in_thread


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
