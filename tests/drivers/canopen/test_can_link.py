"""The time of a CAN link on a late PC, and the heartbeat of a busy or a hanging one."""

from __future__ import annotations

import ctypes
import struct
import sys
import threading
import time as real_time
from collections.abc import Callable, Iterator
from itertools import count, pairwise
from types import SimpleNamespace

import pytest

from drivers.canopen import can_link
from drivers.canopen.can_link import CanLink, LinkTime, heartbeat_period_s, open_bus
from drivers.canopen.nodes import PC_HEARTBEAT_LIMIT_MS
from drivers.canopen.process_image import STALE_S
from hilcell.run.engine import SWITCH_S
from tests.clocks import DrivenClock
from tests.drivers.canopen.rail_bed import BedRail, RailBed
from tests.drivers.peers import figure, in_thread, refusal, soon, wall_clock


def test_link_time_counts_a_pause_of_the_pc_as_a_short_one() -> None:
    of_link = LinkTime(DrivenClock())
    start_s = of_link.counted_s
    of_link.emptied(start_s + 0.02, 1.0)
    assert of_link.listened_s == pytest.approx(0.02)
    of_link.emptied(start_s + 100.0, 2.0)
    assert of_link.listened_s == pytest.approx(0.02 + LinkTime.PAUSE_S)
    assert of_link.emptied_s == 2.0


def test_a_bus_that_is_never_empty_does_not_stop_the_time() -> None:
    of_link = LinkTime(DrivenClock(pc_at_s=1.0))
    start_s = of_link.counted_s
    for frame in range(3000):
        of_link.behind(start_s + frame / 1000)
    assert of_link.listened_s == pytest.approx(2 * LinkTime.PAUSE_S)
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
    bed: RailBed, monkeypatch: pytest.MonkeyPatch, ask: Callable[[BedRail], object], question: int
) -> None:
    now = DrivenClock()
    monkeypatch.setattr(can_link, "time", SimpleNamespace(monotonic=now.now_s))
    monkeypatch.setattr(can_link.LinkTime, "PAUSE_S", 0.1)
    pauses = pausing(monkeypatch, lambda: now.wait(3600.0))
    rail = bed.connect()
    asked = len(bed.peer.frames(question))
    pauses.set()
    ask(rail)
    assert len(bed.peer.frames(question)) == asked + 1


def test_a_reading_that_has_waited_in_a_late_pc_is_asked_for_again(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses = pausing(monkeypatch, lambda: bed.time.wait(0.4))
    rail = bed.connect()
    began = len(bed.peer.frames(0x080))
    bed.peer.on_sync = lambda: pauses.set() if len(bed.peer.frames(0x080)) == began + 1 else None
    assert rail._image is not None
    reading = rail._image.refresh(lambda: None)
    assert bed.time.pc_s() - reading.taken_s <= STALE_S
    assert len(bed.peer.frames(0x080)) == began + 2


BUSY_S = 0.6
BEAT = 0x77F


def hold_the_interpreter() -> None:
    """Call C as `numpy` or a parser does, without giving the interpreter away."""
    ctypes.PyDLL(None).usleep(round(BUSY_S * 1e6))


def spin() -> None:
    end_s = real_time.monotonic() + BUSY_S
    while real_time.monotonic() < end_s:
        pass


@pytest.fixture
def switching() -> Iterator[None]:
    """Let threads change as in the engine's process."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    yield
    sys.setswitchinterval(before_s)


@pytest.mark.wall
@pytest.mark.usefixtures("switching")
@pytest.mark.parametrize("load", [[hold_the_interpreter], [spin] * 4])
def test_a_busy_interpreter_neither_loses_the_drive_nor_the_motion(
    bed: RailBed, load: list[Callable[[], None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = bed.peer
    moves, let_go, original = threading.Event(), threading.Event(), peer._frame
    beats_s: list[float] = []

    def note(cob_id: int, data: bytes) -> None:
        if cob_id == BEAT:
            beats_s.append(real_time.monotonic())
        original(cob_id, data)

    def hold() -> None:
        """Let the slide stand in the middle of a motion until it is let go."""
        peer.axis.frozen = bool(peer.axis.steps) and not let_go.is_set()
        if peer.axis.frozen:
            moves.set()

    def work() -> None:
        moves.wait()
        threads = [threading.Thread(target=each) for each in load]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        let_go.set()

    monkeypatch.setattr(peer, "_frame", note)
    peer.on_sync = hold
    rail = BedRail(peer, bed.time, wall_clock())
    rail.connect()
    beats_s.append(real_time.monotonic())
    with in_thread(work):
        rail.move_to(509.0)  # three polls apart, a slide goes no further
    assert rail.read().position_mm == 509.0
    gaps_s = [after - before for before, after in pairwise([*beats_s, real_time.monotonic()])]
    assert max(gaps_s) < PC_HEARTBEAT_LIMIT_MS / 1000
    rail.close()


def test_a_worker_that_hangs_in_motion_is_named_and_the_slide_stopped(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    wait = bed.time.wait

    def hang(duration_s: float) -> None:
        wait(duration_s)
        if bed.peer.axis.steps:
            bed.time.pc_at_s += 0.9

    monkeypatch.setattr(bed.time, "wait", hang)
    rail = bed.connect()
    error = refusal(lambda: rail.move_to(1100.0))
    assert (error.code, error.fields["limit_s"]) == ("HC-R39", 0.8)
    assert 0.9 <= figure(error, "gap_s") < 1.0
    bed.peer.quick_stopped.wait()


def test_the_heartbeat_pauses_while_the_motion_is_unattended(bed: RailBed) -> None:
    asked, attended = count(), threading.Event()

    def attends() -> bool:
        next(asked)
        return attended.is_set()

    link = CanLink(open_bus("slcan", bed.peer.channel, 500_000), DrivenClock())
    link.start_heartbeat(127, attends, can_link.heartbeat_period_s(1_000_000))
    soon(lambda: next(asked) > 10)  # its own looks count, too
    assert len(bed.peer.frames(BEAT)) <= 1
    attended.set()
    soon(lambda: len(bed.peer.frames(BEAT)) > 3)
    link.close()


def test_nothing_is_started_by_a_reading_that_is_old(rail: BedRail) -> None:
    image = rail._image
    assert image is not None
    image.refresh(lambda: None)
    rail.time.pc_at_s += 0.6
    sent = len(rail.peer.frames(0x205))
    error = refusal(lambda: image.control(0x000F))
    assert (error.code, error.fields["limit_s"]) == ("HC-R39", 0.5)
    assert error.fields["age_s"] == pytest.approx(0.6)
    assert len(rail.peer.frames(0x205)) == sent
    image.control(0x0000)  # a word that takes the power away always goes out


@pytest.mark.parametrize(
    ("bitrate", "period_s"), [(10_000, 0.25), (20_000, 0.125), (50_000, 0.05), (1_000_000, 0.05)]
)
def test_heartbeats_leave_a_slow_bus_its_time(bitrate: int, period_s: float) -> None:
    assert heartbeat_period_s(bitrate) == period_s
    assert 3 * period_s < PC_HEARTBEAT_LIMIT_MS / 1000


@pytest.mark.parametrize(("pause_s", "code"), [(2.0, "HC-R44"), (0.0, "HC-R25")])
def test_a_pause_of_the_pc_is_named_before_what_the_drive_reports_of_it(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch, pause_s: float, code: str
) -> None:
    """A heartbeat that was lost on the wire is the drive's word."""
    monkeypatch.setattr(CanLink, "pause_s", pause_s)
    rail = bed.connect()
    bed.peer.send(0x085, struct.pack("<HB5x", 0x8130, 0x11))
    assert refusal(lambda: soon(lambda: not rail.read().still)).code == code


def test_a_pause_is_remembered_for_a_while_only(
    bed: RailBed, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = DrivenClock()
    monkeypatch.setattr(can_link, "time", SimpleNamespace(monotonic=now.now_s))
    link = CanLink(open_bus("slcan", bed.peer.channel, 500_000), now)
    for pause_s in (0.05, 2.0, 0.05):
        now.at_s += pause_s
        link._send_beat(BEAT)
    assert link.pause_s == pytest.approx(2.0)
    now.at_s += CanLink.RECENT_S
    link._send_beat(BEAT)
    now.at_s += 0.1
    assert link.pause_s == pytest.approx(CanLink.RECENT_S)
    link.close()
