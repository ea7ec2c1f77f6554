"""A PC that is late excuses its devices; it does not move by readings that it has not seen."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from drivers.canopen import pdo, sdo
from drivers.canopen.can_link import PAUSE_S, CanLink, LinkTime
from drivers.canopen.rail import CanopenRail
from tests.clocks import DrivenClock
from tests.drivers.can_peer import CanPeer
from tests.drivers.rail_bed import rail_for


def test_link_time_counts_a_pause_of_the_pc_as_a_short_one() -> None:
    link_time = LinkTime(DrivenClock())
    start_s = link_time.counted_s
    link_time.emptied(start_s + 0.02, 1.0)
    assert link_time.listened_s == pytest.approx(0.02)
    link_time.emptied(start_s + 100.0, 2.0)
    assert link_time.listened_s == pytest.approx(0.02 + PAUSE_S)
    assert link_time.emptied_s == 2.0


def test_a_bus_that_is_never_empty_does_not_stop_the_time() -> None:
    link_time = LinkTime(DrivenClock(pc_at_s=1.0))
    start_s = link_time.counted_s
    for frame in range(3000):
        link_time.behind(start_s + frame / 1000)
    assert link_time.listened_s == pytest.approx(2 * PAUSE_S)
    assert link_time.emptied_s == 1.0, "what comes now may have waited since then"


class DeafReceiver:
    """Keeps the receiving thread from looking, for longer than any deadline of a wire."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.pause_s = 0.0
        original = CanLink._next

        def late(link: CanLink) -> object:
            pause_s, self.pause_s = self.pause_s, 0.0
            time.sleep(pause_s)  # this is the load: a thread that does not run
            return original(link)

        monkeypatch.setattr(CanLink, "_next", late)


@pytest.mark.parametrize(
    "ask", [lambda rail: rail.read(), lambda rail: rail._drive._sdo.read(0x6081)]
)
def test_an_answer_that_waits_in_a_late_pc_is_no_missing_answer(
    monkeypatch: pytest.MonkeyPatch, ask: Callable[[CanopenRail], object]
) -> None:
    for module, name, value in (
        (pdo, "REPLY_S", 0.1),
        (sdo, "REPLY_S", 0.1),
        (sdo, "LATE_S", 0.01),
    ):
        monkeypatch.setattr(module, name, value)  # all tries together are shorter than the pause
    deaf = DeafReceiver(monkeypatch)
    with CanPeer() as peer:
        rail = rail_for(peer)
        rail.connect()
        deaf.pause_s = 0.5
        ask(rail)
        rail.close()


def test_a_reading_that_has_waited_in_a_late_pc_is_asked_for_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    deaf = DeafReceiver(monkeypatch)
    with CanPeer() as peer:
        rail = rail_for(peer)
        rail.connect()
        began = len(peer.frames(0x080))

        def strike() -> None:
            if len(peer.frames(0x080)) == began + 1:
                deaf.pause_s = 0.4

        peer.on_sync = strike
        assert rail._image is not None
        reading = rail._image.refresh(lambda: None)
        assert time.monotonic() - reading.taken_s <= pdo.STALE_S
        assert len(peer.frames(0x080)) == began + 2
        rail.close()
