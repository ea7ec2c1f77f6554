"""Answers to SYNCs through a gateway that is slow or loses frames."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from typing import cast

import pytest

from drivers.canopen import process_image
from drivers.canopen.can_link import CanLink, LinkTime
from drivers.canopen.process_image import REPLY_S, Inbox, Pdo, Transmission
from drivers.supervision import ignore_stop
from tests.clocks import DrivenClock

PDO = Pdo(0x1800, 0x185, Transmission.EVERY_SYNC, (0x6064,), "<i")
POLL_S = 0.02


class SlowLink:
    """Each SYNC is answered with its own time (ms), ``late_s`` after it; some answers are lost."""

    def __init__(self, clock: DrivenClock) -> None:
        self.clock, self.time = clock, LinkTime(clock)
        self.late_s = 0.0
        self.lost: deque[bool] = deque()
        self._answers: deque[tuple[float, int]] = deque()
        self._take: Callable[[int, bytearray, float], None] | None = None

    def subscribe(self, _cob_id: int, callback: Callable[[int, bytearray, float], None]) -> None:
        self._take = callback

    def send(self, _cob_id: int, _data: bytes) -> None:
        if not (self.lost and self.lost.popleft()):
            now_s = self.clock.pc_s()
            self._answers.append((now_s + self.late_s, round(1000 * now_s)))

    def stray(self) -> None:
        """Hand out a value that no SYNC asked for."""
        assert self._take is not None
        data = struct.pack(PDO.layout, round(1000 * self.clock.pc_s()) - 100)
        self._take(PDO.cob_id, bytearray(data), self.clock.pc_s())

    def check(self) -> None:
        """Let time pass, and hand out what has arrived by then."""
        self.clock.wait(POLL_S)
        now_s = self.time.listened_s = self.time.emptied_s = self.clock.pc_s()
        while self._take is not None and self._answers and self._answers[0][0] <= now_s:
            data = struct.pack(PDO.layout, self._answers.popleft()[1])
            self._take(PDO.cob_id, bytearray(data), now_s)


@pytest.fixture
def link() -> SlowLink:
    return SlowLink(DrivenClock())


@pytest.fixture
def inbox(link: SlowLink, monkeypatch: pytest.MonkeyPatch) -> Inbox:
    monkeypatch.setattr(process_image, "POLL_S", 0.0)  # time passes by the link's looks alone
    return Inbox(cast("CanLink", link), (PDO,))


def asked(link: SlowLink, inbox: Inbox) -> tuple[float, float, float]:
    """Return when a reading was asked for, sampled, and said to be taken."""
    began_s = link.clock.pc_s()
    values, taken_s = inbox.refresh(ignore_stop)
    return began_s, values[PDO.cob_id][0] / 1000, taken_s


@pytest.mark.parametrize("late_s", [0.0, 0.12, 0.25, 0.35])
def test_a_reading_was_sampled_after_it_was_asked_for(
    link: SlowLink, inbox: Inbox, late_s: float
) -> None:
    link.late_s = late_s
    for _ in range(20):
        began_s, sampled_s, taken_s = asked(link, inbox)
        assert began_s <= sampled_s + 1e-3
        assert taken_s <= sampled_s + 1e-3


def test_a_lost_answer_costs_one_more_sync_and_one_more_wait(link: SlowLink, inbox: Inbox) -> None:
    link.lost.append(True)
    took_s = []
    for _ in range(4):
        began_s, sampled_s, _ = asked(link, inbox)
        assert began_s <= sampled_s + 1e-3
        took_s.append(link.clock.pc_s() - began_s)
    assert max(took_s[:2]) < REPLY_S + 5 * POLL_S
    assert max(took_s[2:]) < 3 * POLL_S


def test_a_pdo_that_no_sync_asked_for_answers_no_later_sync(link: SlowLink, inbox: Inbox) -> None:
    asked(link, inbox)
    link.late_s = 0.12
    link.stray()
    began_s, sampled_s, _ = asked(link, inbox)
    assert began_s <= sampled_s + 1e-3
