from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from fakes.faults import Faults
from fakes.leica.emscon_server import EmsconServer, SampleStream
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import FLANGE, CellTruth
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.kinematics import Array
from tests.fakes.wires import EmsconClient, connected

START, STOP, MODE, PARAMETERS, GET_PARAMETERS = 49, 52, 24, 30, 31
OK, OUT_OF_RANGE = 0, 12
READY, BEAM_LOST = 27, 25


@dataclass
class Streaming:
    truth: CellTruth
    time: CellTime
    faults: Faults
    client: EmsconClient

    def pass_time(self, duration_s: float) -> None:
        self.time.advance(duration_s)
        self.time.catch_up()

    def start(self, separation_ms: int = 10, points: int = 0) -> None:
        """Follow the reflector on the flange."""
        client = self.client
        assert client.ask(55, "3di", *self.truth.tracker.reflectors()[FLANGE], 1)[0] == OK
        assert client.ask(MODE, "I", 1)[0] == OK
        assert client.ask(PARAMETERS, "4i", separation_ms, points, 0, 0)[0] == OK
        assert client.ask(START)[0] == OK

    def until(self, kind: int, first: int) -> tuple[Array, Array, list[int]]:
        """Return times, positions and sizes of the packets before one that begins so."""
        times_s: list[float] = []
        xyz_mm: list[tuple[float, ...]] = []
        sizes: list[int] = []
        while True:
            found, rest = self.client.packet()
            if (found, struct.unpack_from("<I", rest)[0]) == (kind, first):
                return np.array(times_s), np.array(xyz_mm), sizes
            if found == 3:
                status, count, mode = struct.unpack_from("<Iii", rest)
                assert (status, mode, len(rest)) == (OK, 1, 40 + 36 * count)
                for bad, s, us, *xyz in struct.iter_unpack("<iii3d", rest[40:]):
                    assert bad == OK
                    times_s.append(s + us * 1e-6)
                    xyz_mm.append(tuple(xyz))
                sizes.append(count)

    def stop(self) -> tuple[Array, Array, list[int]]:
        self.client.send(STOP)
        return self.until(0, STOP)


@contextlib.contextmanager
def running(cell: Cell, speed: float = math.inf) -> Iterator[Streaming]:
    faults, time = Faults(), CellTime(speed)
    truth = CellTruth(cell, 1, time, faults)
    server = EmsconServer(Site(cell, truth, faults, time))
    with contextlib.closing(server):
        server.start()
        with connected(server.port) as wire:
            client = EmsconClient(wire)
            client.ready()
            yield Streaming(truth, time, faults, client)


@pytest.fixture
def tracker(cell: Cell) -> Iterator[Streaming]:
    with running(cell) as found:
        yield found


def test_samples_come_as_cell_time_passes(tracker: Streaming) -> None:
    tracker.start()
    at_mm = tracker.truth.tracker.reflectors()[FLANGE]
    tracker.pass_time(1.005)
    times_s, xyz_mm, sizes = tracker.stop()
    assert len(times_s) == 100
    np.testing.assert_allclose(np.diff(times_s), 0.01, atol=1.5e-6)
    assert sizes[:5] == [8, 3, 12, 5, 9]
    assert np.linalg.norm(xyz_mm - at_mm, axis=1).max() < 0.1
    assert 0.005 < xyz_mm.std(axis=0).max() < 0.02  # noise, a new one for each sample


def test_the_clock_is_the_tracker_s_own(tracker: Streaming) -> None:
    truth = tracker.truth.streams
    tracker.start(separation_ms=1000)
    began_s = tracker.time.now_s()
    tracker.pass_time(10_000.0)
    times_s, _, _ = tracker.stop()
    assert times_s[0] - 1.0 == pytest.approx(truth.device_s(began_s), abs=1e-5)
    assert times_s[0] > 2000.0
    assert 0 < abs(truth.drift) < 3.1e-5
    assert len(times_s) == math.floor(10_000.0 * (1.0 + truth.drift))


def test_a_packet_may_wait_for_the_next(tracker: Streaming) -> None:
    """The fifth packet, samples 29 to 37, is late."""
    tracker.start()
    tracker.pass_time(0.385)
    tracker.client.send(98)
    assert len(tracker.until(1, 98)[0]) == 8 + 3 + 12 + 5
    assert len(tracker.stop()[0]) == 9 + 1


SAMPLES_MM = [[4310.028578, 734.154198, 741.170459], [4213.508629, 909.940104, 435.281048]]


@pytest.mark.parametrize("leaps_s", [[0.01] * 60, [0.157, 0.001, 0.442], [0.6]])
def test_the_same_samples_at_any_time_of_asking(cell: Cell, leaps_s: list[float]) -> None:
    faults, time = Faults(), CellTime()
    truth = CellTruth(cell, 1, time, faults)
    truth.robot.move(truth.robot.state().joints_rad + 0.1, 0.2)
    xyz_mm: list[Array] = []

    def pack(_times_s: Array, found_mm: Array) -> bytes:
        xyz_mm.append(found_mm)
        return b""

    stream = SampleStream(
        truth.streams,
        time,
        faults,
        truth.streams.follow(FLANGE),
        pack,
        separation_s=0.01,
        points=0,
        lost=lambda: None,
    )
    for leap_s in (*leaps_s, 0.005):
        time.advance(leap_s)
        stream.due()
    stream.end()
    found_mm = np.vstack(xyz_mm)
    assert found_mm.shape == (60, 3)
    np.testing.assert_allclose(found_mm[[7, 42]], SAMPLES_MM, atol=1e-6)


def test_a_sample_s_truth_is_that_of_its_own_time(tracker: Streaming) -> None:
    """Moved, overridden, braked and moved again before anybody asks."""
    truth, time = tracker.truth, tracker.time
    robot, seen = truth.robot, []
    truth.streams.follow(FLANGE)

    def note() -> None:
        seen.append((time.now_s(), truth.reflectors_in_world()[FLANGE]))

    for change in (
        lambda: robot.move(robot.state().joints_rad + 0.2, 0.05),
        lambda: robot.override(0.1),
        robot.brake,
        lambda: robot.move(robot.state().joints_rad - 0.1, 0.05),
    ):
        change()
        for _ in range(5):
            time.advance(0.037)
            note()
        time.advance(0.001)  # lost motion flips at the very moment at which the next begins
    times_s = np.array([at_s for at_s, _ in seen])
    found_mm = truth.path_in_world(FLANGE, times_s)
    np.testing.assert_allclose(found_mm, [at_mm for _, at_mm in seen], atol=1e-9)


def test_a_broken_beam_ends_it_with_a_status_change(tracker: Streaming) -> None:
    tracker.start()
    tracker.faults.set("tracker.stream_break", after=20)
    tracker.pass_time(1.0)
    times_s, _, _ = tracker.until(8, BEAM_LOST)
    assert len(times_s) == 20
    tracker.pass_time(1.0)
    assert len(tracker.stop()[0]) == 0
    assert tracker.client.ask(START)[0] == 10004


def test_out_of_sight_is_out_of_the_stream() -> None:
    with running(load_cell("paper", {"layout.reflectors": "by_hand"})) as tracker:
        tracker.truth.place_reflector(FLANGE)
        tracker.start()
        tracker.truth.place_reflector("")
        tracker.pass_time(1.0)
        assert len(tracker.until(8, BEAM_LOST)[0]) == 0


def test_paced_time_streams_by_itself(cell: Cell) -> None:
    with running(cell, speed=200.0) as tracker:
        tracker.start(points=60)
        times_s, _, _ = tracker.until(8, READY)
        np.testing.assert_allclose(np.diff(times_s), 0.01, atol=1.5e-6)
        assert len(times_s) == 60


def test_while_it_streams_a_poll_is_an_exchange(tracker: Streaming) -> None:
    robot = tracker.truth.robot
    tracker.start()
    robot.move(robot.state().joints_rad + 0.2, 0.01)
    before_s = tracker.time.now_s()
    robot.poll()
    assert tracker.time.now_s() - before_s == pytest.approx(CellTime.EXCHANGE_S)
    tracker.stop()
    before_s = tracker.time.now_s()
    robot.poll()
    assert tracker.time.now_s() - before_s > 10 * CellTime.EXCHANGE_S


def test_an_impossible_separation_is_refused(tracker: Streaming) -> None:
    for separation_ms in (0, -1, 100_001):
        assert tracker.client.ask(PARAMETERS, "4i", separation_ms, 0, 0, 0)[0] == OUT_OF_RANGE
    assert tracker.client.ask(GET_PARAMETERS) == (OK, struct.pack("<4i", 500, 0, 0, 0))
