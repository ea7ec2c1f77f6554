"""What a device last said, whether it moves now, and why it is lost."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hilcell.cell.devices import Devices, sweeping_robot
from hilcell.errors import EXIT_INTERNAL, DriverDefect, exit_code
from hilcell.ports import DeviceError, RailReading, TrackerReading
from hilcell.run import device_status
from hilcell.run.control import DeviceStatus
from hilcell.run.device_status import CellMonitor
from tests.clocks import DrivenClock
from tests.hilcell.run.bed import CELL
from tests.hilcell.run.rig import DeskRail, DeskRobot, DeskTracker, desk, hang


class Board:
    """Monitored desk devices."""

    def __init__(self) -> None:
        self.clock = DrivenClock()
        bare = desk(CELL, self.clock)
        assert isinstance(bare.rail, DeskRail)
        assert isinstance(bare.robot, DeskRobot)
        assert isinstance(bare.tracker, DeskTracker)
        self.rail, self.robot, self.tracker = bare.rail, bare.robot, bare.tracker
        self.monitor = CellMonitor(bare, self.clock, CELL)
        self.devices = self.monitor.devices

    def of(self, name: str) -> DeviceStatus:
        return self.monitor.status()[name]


@pytest.fixture
def board() -> Board:
    return Board()


def test_a_reading_of_the_rail_lights_rail_and_strip(board: Board) -> None:
    board.devices.rail.read()
    for name, text in (("rail", "1100.00 mm, held"), ("strip", "1100.00 mm")):
        device = board.of(name)
        assert (device.state, device.text, device.reason) == ("fresh", text, "")
        assert device.age_s == 0.0
    assert board.of("robot").state == "unknown"


def test_a_robot_that_sweeps_moves(board: Board) -> None:
    class Sweeping(DeskRobot):
        @contextmanager
        def sweep(self, *order: float) -> Iterator[Any]:
            yield order

    devices = Devices(board.rail, Sweeping(CELL, board.clock), board.tracker)
    monitor = CellMonitor(devices, board.clock, CELL)
    moving = []
    with sweeping_robot(monitor.devices.robot).sweep(0, 1.0, 0.1):
        moving.append(monitor.robot.moving)
    assert [*moving, monitor.robot.moving] == [True, False]


PLACE_MM = np.array([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("returned", "named"),
    [
        (lambda reading: None, "NoneType"),
        (lambda reading: replace(reading, xyz_mm=PLACE_MM[:2]), r"\(2,\)"),
        (lambda reading: replace(reading, taken_s=5.0), "5.000 s"),
        (lambda reading: reading.nosuch, "test_device_status.py, line"),
    ],
)
def test_what_is_no_reading_is_a_defect_of_the_driver(
    board: Board,
    returned: Callable[[TrackerReading], object],
    named: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    measure = board.tracker.measure
    monkeypatch.setattr(board.tracker, "measure", lambda *words: returned(measure(*words)))
    with pytest.raises(DriverDefect, match=f"Tracker: .*{named}") as caught:
        board.devices.tracker.measure(PLACE_MM, "SMR", 1)
    assert exit_code(caught.value) == EXIT_INTERNAL
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("returned", [None, "Identity", [None]])
def test_what_is_no_list_of_identities_is_a_defect_of_the_driver(
    board: Board, returned: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("rail", "robot", "tracker"):
        monkeypatch.setattr(getattr(board, name), "connect", lambda: returned)
        with pytest.raises(DriverDefect, match=name.title()):
            getattr(board.devices, name).connect()


def test_ages_grow(board: Board) -> None:
    board.devices.rail.read()
    board.clock.pc_at_s += 3.5
    assert board.of("rail").age_s == 3.5


@pytest.mark.parametrize(
    ("names", "move"),
    [
        (("rail", "strip"), lambda devices: devices.rail.move_to(5.0)),
        (("rail", "strip"), lambda devices: devices.rail.home()),
        (("robot",), lambda devices: devices.robot.move_to(np.zeros(6), 10.0)),
    ],
)
def test_a_device_under_way_moves(
    board: Board,
    names: tuple[str, ...],
    move: Callable[[Any], object],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entered, release = threading.Event(), threading.Event()
    wait = hang(entered, release)
    for device, name in ((board.rail, "move_to"), (board.rail, "home"), (board.robot, "move_to")):
        real = getattr(device, name)
        monkeypatch.setattr(device, name, lambda *args, real=real: (wait(), real(*args))[1])
    thread = threading.Thread(target=move, args=(board.devices,))
    thread.start()
    entered.wait()
    states = {name: board.of(name).state for name in ("rail", "strip", "robot", "tracker")}
    release.set()
    thread.join()
    assert {name for name, state in states.items() if state == "moving"} == set(names)
    assert all(board.of(name).state != "moving" for name in names)


def test_a_device_that_fails_is_lost_until_it_answers(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone() -> None:
        raise DeviceError("HC-B02", "Robot", "read", "no answer")

    board.devices.robot.read()
    with monkeypatch.context() as patched:
        patched.setattr(board.robot, "read", gone)
        with pytest.raises(DeviceError, match="no answer"):
            board.devices.robot.read()
        device = board.of("robot")
        assert (device.state, device.reason) == ("lost", "Robot: read: no answer")
        assert device.age_s is not None  # the last good reading's
    board.devices.robot.read()
    assert board.of("robot").state == "fresh"


def test_refresh_reads_what_grows_old_and_no_oftener(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, reads, real = 1e3, list[float](), board.rail.read

    def read() -> RailReading:
        reads.append(now_s)
        return real()

    monkeypatch.setattr(board.rail, "read", read)
    monkeypatch.setattr(device_status, "time", SimpleNamespace(monotonic=lambda: now_s))
    began_s = now_s
    for passed_s in (0.0, 0.25, 0.5, 0.75, 1.0, 3.0, 3.25, 3.5):
        now_s = began_s + passed_s
        board.monitor.refresh()
    assert [each_s - began_s for each_s in reads] == [0.0, 0.5, 1.0, 3.0, 3.5]
