"""A PC that is late excuses its devices; it does not move by readings that it has not seen."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from drivers.canopen import can_link
from drivers.canopen.can_link import PAUSE_S, CanLink, LinkTime
from drivers.canopen.process_image import STALE_S
from drivers.canopen.rail import CanopenRail
from tests.clocks import DrivenClock
from tests.drivers.canopen.can_peer import CanPeer
from tests.drivers.canopen.rail_bed import RailTime, connected, peer, time

__all__ = ["peer", "time"]


def test_link_time_counts_a_pause_of_the_pc_as_a_short_one() -> None:
    of_link = LinkTime(DrivenClock())
    start_s = of_link.counted_s
    of_link.emptied(start_s + 0.02, 1.0)
    assert of_link.listened_s == pytest.approx(0.02)
    of_link.emptied(start_s + 100.0, 2.0)
    assert of_link.listened_s == pytest.approx(0.02 + PAUSE_S)
    assert of_link.emptied_s == 2.0


def test_a_bus_that_is_never_empty_does_not_stop_the_time() -> None:
    of_link = LinkTime(DrivenClock(pc_at_s=1.0))
    start_s = of_link.counted_s
    for frame in range(3000):
        of_link.behind(start_s + frame / 1000)
    assert of_link.listened_s == pytest.approx(2 * PAUSE_S)
    assert of_link.emptied_s == 1.0, "what comes now may have waited since then"


def pausing(monkeypatch: pytest.MonkeyPatch, pause: Callable[[], None]) -> threading.Event:
    """Return what, once it is set, makes the receiving thread pause before it looks next."""
    pauses, original = threading.Event(), CanLink._next

    def late(link: CanLink) -> object:
        if pauses.is_set():
            pauses.clear()
            pause()
        return original(link)

    monkeypatch.setattr(CanLink, "_next", late)
    return pauses


@pytest.mark.parametrize(
    ("ask", "question"),
    [
        (lambda rail: rail._image.refresh(lambda: None), 0x080),
        (lambda rail: rail._drive._sdo.read(0x6081), 0x605),
    ],
)
def test_an_answer_that_waits_in_a_late_pc_is_no_missing_answer(
    peer: CanPeer,
    time: RailTime,
    monkeypatch: pytest.MonkeyPatch,
    ask: Callable[[CanopenRail], object],
    question: int,
) -> None:
    now = DrivenClock()
    monkeypatch.setattr(can_link, "time", SimpleNamespace(monotonic=now.now_s))
    monkeypatch.setattr(can_link, "PAUSE_S", PAUSE_S)
    pauses = pausing(monkeypatch, lambda: now.wait(3600.0))
    with connected(peer, time) as rail:
        asked = len(peer.frames(question))
        pauses.set()
        ask(rail)
        assert len(peer.frames(question)) == asked + 1


def test_a_reading_that_has_waited_in_a_late_pc_is_asked_for_again(
    peer: CanPeer, time: RailTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses = pausing(monkeypatch, lambda: time.wait(0.4))
    with connected(peer, time) as rail:
        began = len(peer.frames(0x080))
        peer.on_sync = lambda: pauses.set() if len(peer.frames(0x080)) == began + 1 else None
        assert rail._image is not None
        reading = rail._image.refresh(lambda: None)
        assert time.pc_s() - reading.taken_s <= STALE_S
        assert len(peer.frames(0x080)) == began + 2
