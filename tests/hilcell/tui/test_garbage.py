"""The collector: whole collections only while nothing moves, and not one after the other."""

from __future__ import annotations

import gc

import pytest

from hilcell.tui.engine.background import FULL_COLLECTION_S, NEVER, GarbageCollector


def test_whole_collections_wait_until_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    collected: list[float] = []
    before = gc.get_threshold()
    collector = GarbageCollector(0.0)
    try:
        assert gc.get_threshold() == (*before[:2], NEVER)
        for at_rest, now_s in ((True, 1.0), (False, 40.0), (True, 41.0), (True, 42.0)):
            monkeypatch.setattr(gc, "collect", lambda now_s=now_s: collected.append(now_s))
            collector.tick(at_rest=at_rest, now_s=now_s)
        assert FULL_COLLECTION_S > 2.0
        assert collected == [41.0]
    finally:
        collector.end()
    assert gc.get_threshold() == before
