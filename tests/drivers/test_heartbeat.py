"""The heartbeat of a busy PC, and of one whose worker hangs; measured on the wire."""

from __future__ import annotations

import contextlib
import ctypes
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest

from drivers.canopen.can_link import RECENT_S
from drivers.canopen.node_watch import PC_HEARTBEAT_LIMIT_MS
from drivers.canopen.rail import LATE_S
from hilcell.commands.run import SWITCH_S
from hilcell.ports import DeviceError
from tests.drivers.can_peer import CanPeer
from tests.drivers.peers import WAIT_S
from tests.drivers.rail_bed import rail_for

BUSY_S = 0.6
BEAT = 0x77F


class Cell:
    """A rail on its wire; the slide stands in the middle of a motion until it is let go."""

    def __init__(self, peer: CanPeer, monkeypatch: pytest.MonkeyPatch) -> None:
        self.beats_s: list[float] = []
        self.moves, self.let_go = threading.Event(), threading.Event()
        self.peer, self.rail = peer, rail_for(peer)
        original = peer._frame

        def note(cob_id: int, data: bytes) -> None:
            if cob_id == BEAT:
                self.beats_s.append(time.monotonic())
            original(cob_id, data)

        monkeypatch.setattr(peer, "_frame", note)
        peer.on_sync = self._hold

    def _hold(self) -> None:
        self.peer.axis.frozen = bool(self.peer.axis.steps) and not self.let_go.is_set()
        if self.peer.axis.frozen:
            self.moves.set()

    def worst_gap_s(self) -> float:
        """Return the longest time without a beat since connect, up to now."""
        return max(b - a for a, b in pairwise([*self.beats_s, time.monotonic()]))


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Iterator[Cell]:
    with CanPeer() as peer:
        cell = Cell(peer, monkeypatch)
        cell.rail.connect()
        cell.beats_s.append(time.monotonic())
        yield cell
        with contextlib.suppress(DeviceError):
            cell.rail.close()


def hold_the_interpreter() -> None:
    """Call C as `numpy` or a parser does, without giving the interpreter away."""
    ctypes.PyDLL(None).usleep(round(BUSY_S * 1e6))


def spin() -> None:
    end_s = time.monotonic() + BUSY_S
    while time.monotonic() < end_s:
        pass


@pytest.fixture
def switching() -> Iterator[None]:
    """Let threads change as in the engine's process."""
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    yield
    sys.setswitchinterval(before_s)


@pytest.mark.usefixtures("switching")
@pytest.mark.parametrize("load", [[hold_the_interpreter], [spin] * 4])
def test_a_busy_interpreter_neither_loses_the_drive_nor_the_motion(
    cell: Cell, load: list[Callable[[], None]]
) -> None:
    def work() -> None:
        assert cell.moves.wait(WAIT_S)
        threads = [threading.Thread(target=each) for each in load]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(WAIT_S)
        cell.let_go.set()

    worker = threading.Thread(target=work)
    worker.start()
    cell.rail.move_to(1100.0)
    worker.join(WAIT_S)
    assert cell.rail.read().position_mm == 1100.0
    assert cell.worst_gap_s() < PC_HEARTBEAT_LIMIT_MS / 1000


def test_a_worker_that_hangs_in_motion_ends_the_beat_and_is_named(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs, goes_on = threading.Event(), threading.Event()
    failures: list[DeviceError] = []

    def hang(_duration_s: float) -> None:
        if cell.moves.is_set():
            hangs.set()
            assert goes_on.wait(WAIT_S)

    def move() -> None:
        try:
            cell.rail.move_to(1100.0)
        except DeviceError as error:
            failures.append(error)

    monkeypatch.setattr(cell.rail._clock, "wait", hang)
    worker = threading.Thread(target=move)
    worker.start()
    assert hangs.wait(WAIT_S)
    hung_s = time.monotonic()
    while time.monotonic() - hung_s <= LATE_S + 0.05:
        threading.Event().wait(0.01)
    assert cell.beats_s[-1] - hung_s < 0.5
    goes_on.set()
    worker.join(WAIT_S)
    assert failures
    assert failures[0].found.startswith("PC late: 0.")
    assert cell.peer.quick_stopped.wait(WAIT_S)


def test_the_beat_goes_on_while_nothing_moves(cell: Cell) -> None:
    cell.let_go.set()
    cell.rail.move_to(600.0)
    begun = len(cell.beats_s)
    end_s = time.monotonic() + WAIT_S
    while len(cell.beats_s) < begun + 12 and time.monotonic() < end_s:  # nobody looks at the slide
        threading.Event().wait(0.01)
    assert len(cell.beats_s) >= begun + 12


def test_nothing_is_started_by_a_reading_that_is_old(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.let_go.set()
    image = cell.rail._image
    assert image is not None
    image.refresh(lambda: None)
    monkeypatch.setattr(image, "_taken_s", time.monotonic() - 0.6)
    sent = len(cell.peer.frames(0x205))
    with pytest.raises(DeviceError, match=r"PC late: the reading to move by is 0\.6 s old"):
        image.control(0x000F)
    assert len(cell.peer.frames(0x205)) == sent
    image.control(0x0000)  # a word that takes the power away always goes out


def emergency(cell: Cell) -> DeviceError:
    """Return the error of a drive that reports a lost heartbeat."""
    cell.let_go.set()
    cell.peer.send(0x085, struct.pack("<HB5x", 0x8130, 0x11))
    end_s = time.monotonic() + WAIT_S
    while time.monotonic() < end_s:
        try:
            cell.rail.read()
        except DeviceError as error:
            return error
    raise AssertionError("no error")


def test_a_pause_of_the_pc_is_named_before_what_the_drive_reports_of_it(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = cell.rail._link
    assert link is not None
    monkeypatch.setattr(link, "_send_beat", lambda _cob_id: None)
    assert link._beat_s is not None
    link._beat_s -= 2.0
    error = emergency(cell)
    assert error.code == "HC-R44"
    assert error.found.startswith("PC late: its heartbeat paused for 2.")
    assert error.found.endswith("so node 5 reports 0x8130 (heartbeat or life guard error)")
    assert error.act.startswith("give the engine a PC of its own")


def test_a_heartbeat_that_was_lost_on_the_wire_is_the_drives_word(cell: Cell) -> None:
    error = emergency(cell)
    assert error.code == "HC-R25"
    assert error.found.startswith("node 5: EMCY 0x8130")


def test_a_pause_is_remembered_for_a_while_only(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = cell.rail._link
    assert link is not None
    send, now_s = link._send_beat, time.monotonic()
    monkeypatch.setattr(link, "_send_beat", lambda _cob_id: None)
    link._beat_s = now_s - 2.0
    send(BEAT)
    send(BEAT)
    assert 2.0 <= link.pause_s < 2.5
    link._paused_s -= RECENT_S
    assert link.pause_s < 1.0
