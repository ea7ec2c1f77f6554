"""The emScon server to a plain and to an independent client: settings, measurements, streams."""

from __future__ import annotations

import contextlib
import math
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace

import CESAPI.command
import CESAPI.connection
import numpy as np
import pytest
from CESAPI.command import CommandSync
from CESAPI.connection import Connection
from CESAPI.packet import ES_LU_Millimeter, StationaryModeDataT, SystemUnitsDataT

from fakes.faults import Faults
from fakes.leica.emscon_server import EmsconDevice, EmsconServer, SampleStream
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import FLANGE, CellTruth
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.kinematics import Array
from tests.fakes.conftest import Served, served
from tests.fakes.wires import EmsconClient, exactly

OK, NOT_INITIALIZED, NO_DISTANCE, NOT_READY, NO_RESULT = 0, 39, 37, 10004, 10009


Tracker = Served[EmsconServer, EmsconClient]


@pytest.fixture
def tracker(cell: Cell) -> Iterator[Tracker]:
    with served(EmsconServer, EmsconClient, cell) as found:
        yield found


@pytest.fixture
def ready(tracker: Tracker) -> Tracker:
    tracker.client.ready()
    return tracker


def test_golden_bytes(tracker: Tracker) -> None:
    wire = tracker.client.wire
    wire.sendall(bytes.fromhex("0c0000000000000031000000"))
    assert exactly(wire, 16).hex() == "10000000010000003100000027000000"  # 39: not initialised
    wire.sendall(bytes.fromhex("0c0000000000000007000000"))
    assert exactly(wire, 16).hex() == "10000000000000000700000000000000"
    assert exactly(wire, 12).hex() == "0c0000000800000097000000"  # 151: initialisation changed
    wire.sendall(bytes.fromhex("0c0000000000000001000000"))
    assert exactly(wire, 56)[:16].hex() == "38000000000000000100000000000000"
    wire.sendall(bytes.fromhex("0c0000000000000042000000"))
    assert exactly(wire, 32)[:16].hex() == "20000000000000004200000000000000"


def test_golden_find_and_measure(ready: Tracker) -> None:
    at = ready.at("F1")
    wire = ready.client.wire
    assert ready.client.ask(58, "3d", *at)[0] == OK  # point the laser there
    found = bytes.fromhex("14000000000000003f000000000000000070a740")
    wire.sendall(found)  # about 3000 mm
    status, _ = ready.client.reply(63)
    assert status == NO_DISTANCE  # F1 is farther away than that
    wire.sendall(found[:12] + struct.pack("<d", float(np.linalg.norm(at))))
    assert ready.client.reply(63)[0] == OK
    assert ready.client.packet() == (8, bytes.fromhex("1b000000"))
    wire.sendall(bytes.fromhex("0c0000000000000031000000"))
    assert exactly(wire, 16).hex() == "10000000000000003100000000000000"
    assert exactly(wire, 12).hex() == "0c000000080000001a000000"  # busy
    result = exactly(wire, 156)
    assert result[:20].hex() == "9c0000000200000000000000" + 8 * "00"
    assert exactly(wire, 12).hex() == "0c000000080000001b000000"  # measurement ready again
    values = struct.unpack("<17d", result[20:])
    np.testing.assert_allclose(values[:3], at, atol=0.06)
    assert 0.005 < values[6] < 0.05  # stdTotal
    assert values[6] == pytest.approx(np.linalg.norm(values[3:6]))
    assert 22 <= values[14] <= 24
    assert 1000 < values[15] < 1020
    assert 40 < values[16] < 50


def test_lengths_are_metres_until_units_are_set(tracker: Tracker) -> None:
    client = tracker.client
    assert client.ask(7)[0] == OK
    assert client.ask(40, "i", 3)[0] == OK
    assert struct.unpack("<5I", client.ask(6)[1]) == (0, 0, 0, 0, 0)
    at_m = tracker.at("P1") / 1000
    assert client.ask(55, "3di", *at_m, 1)[0] == OK
    client.send(49)
    np.testing.assert_allclose(client.result()[:3], at_m, atol=6e-5)
    assert client.ask(5, "5I", 1, 1, 0, 0, 0)[0] == OK
    assert struct.unpack("<5I", client.ask(6)[1]) == (1, 1, 0, 0, 0)
    client.send(49)
    np.testing.assert_allclose(client.result()[:3], at_m * 1000, atol=0.06)
    horizontal_deg, _ = struct.unpack("<2d", client.ask(66)[1])
    assert horizontal_deg == pytest.approx(math.degrees(math.atan2(at_m[1], at_m[0])), abs=1e-6)


def test_left_handed_axes_flip_both_ways(ready: Tracker) -> None:
    at = ready.at("F1")
    assert ready.client.ask(26, "I", 2)[0] == OK
    values = ready.client.measure(at[0], -at[1], at[2])
    np.testing.assert_allclose(values[:3], at * [1, -1, 1], atol=0.06)


def test_it_searches_within_the_radius_that_was_set(ready: Tracker) -> None:
    beside = ready.at("F1") + [0.0, 0.0, 20.0]
    assert ready.client.ask(55, "3di", *beside, 1)[0] == NO_DISTANCE
    for radius_mm, status in ((19.0, NO_DISTANCE), (21.0, OK)):
        assert ready.client.ask(43, "di", radius_mm, 10_000)[0] == OK
        assert ready.client.ask(55, "3di", *beside, 1)[0] == status


def test_settings_are_read_back(ready: Tracker) -> None:
    client = ready.client
    for put, get, form, values in (
        (20, 21, "3d", None),
        (22, 23, "2d", (1.00027, 1.00028)),
        (24, 25, "I", (0,)),
        (26, 27, "I", (0,)),
        (28, 29, "2i", (2000, 1)),
        (40, 41, "i", (2,)),
        (43, 44, "di", (30.0, 10_000)),
        (47, 48, "I8i", (2, 0, 0, 0, 1, 0, 1, 0, 0)),
        (80, 81, "2I", (0, 0)),
    ):
        sent = values or (22.5, 1013.25, 45.0)
        assert client.ask(put, form, *sent)[0] == OK
        assert client.packet()[0] == 8  # and every client receives it
        found = struct.unpack("<" + form, client.ask(get)[1])
        if values is not None:
            assert found == pytest.approx(sent)


def test_wrong_parameters_are_refused(ready: Tracker) -> None:
    for command, form, values, status in (
        (5, "5I", (3, 0, 0, 0, 0), 4),
        (20, "3d", (150.0, 1013.0, 40.0), 57),
        (20, "3d", (math.nan, 1013.0, 40.0), 57),
        (24, "I", (9,), 2),
        (26, "I", (6,), 4),
        (28, "2i", (5, 1), 12),
        (40, "i", (9,), 4),
        (43, "di", (-1.0, 10), 12),
        (63, "d", (0.0,), 12),
        (40, "", (), 3),
        (999, "", (), 2),
    ):
        assert ready.client.ask(command, form, *values)[0] == status


def test_recorded_measurements_are_no_streams(
    ready: Tracker, cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ready.truth, "streams", None)
    device = EmsconDevice(Site(cell, ready.truth, Faults(), ready.truth.time))
    for mode, status in ((0, OK), (1, 2)):
        (answer,) = device.handle(struct.pack("<iIII", 16, 0, 24, mode))
        assert isinstance(answer, bytes)
        assert struct.unpack_from("<I", answer, 12) == (status,)


def test_reflectors_by_number_and_name(ready: Tracker) -> None:
    ready.client.send(42)
    found = {}
    for _ in range(3):
        status, body = ready.client.reply(42)
        total, number, _, offset, name = struct.unpack("<iiId64s", body)
        assert (status, total) == (OK, 3)
        found[number] = (name.decode("utf-16-le").rstrip("\0"), offset)
    assert found[3] == ("SMR 1.5in", 19.05)


def test_wrong_reflector_shows_in_the_range(ready: Tracker) -> None:
    at = ready.at("F1")
    right = np.linalg.norm(ready.client.measure(*at)[:3])
    assert ready.client.ask(40, "i", 1)[0] == OK
    wrong = np.linalg.norm(ready.client.measure(*at)[:3])
    assert abs(wrong - right) > 5.0


def test_identity(ready: Tracker) -> None:
    body = ready.client.ask(1)[1]
    assert struct.unpack("<4I3iI2i", body)[-1] == EmsconDevice.SERIAL
    info = struct.unpack("<I64s5i3d2i2dI2i", ready.client.ask(132)[1])
    assert info[1].decode("utf-16-le").rstrip("\0") == "AT401 (simulated)"
    assert info[2] == EmsconDevice.SERIAL


def test_measures_nothing_that_moves(ready: Tracker) -> None:
    at = ready.at(FLANGE)
    assert ready.client.ask(55, "3di", *at, 1)[0] == OK
    ready.truth.robot.move(np.radians([-60, -60, 60, 30, -60, 90]), 0.2)
    assert ready.client.ask(49)[0] == OK
    assert ready.client.reply(49)[0] == NO_RESULT


def test_go_and_measure(ready: Tracker) -> None:
    at = ready.at("P3")
    ready.client.send(135, "3d", *at)
    np.testing.assert_allclose(ready.client.result()[:3], at, atol=0.06)
    assert ready.client.ask(135, "3d", *(at + 500.0))[0] == NOT_READY


def test_other_commands(ready: Tracker) -> None:
    assert ready.client.ask(55, "3di", *ready.at("F2"), 1)[0] == OK
    assert struct.unpack("<Ii", ready.client.ask(122)[1])[1] & (65536 | 2048) == 65536 | 2048
    assert struct.unpack("<I", ready.client.ask(2)[1]) == (2,)
    assert struct.unpack("<I", ready.client.ask(98)[1]) == (1,)
    assert ready.client.ask(142)[1].startswith(b"3.8.0")
    assert ready.client.ask(52)[0] == OK
    assert ready.client.ask(53)[0] == OK
    assert ready.client.ask(54)[0] == OK
    assert ready.client.ask(49)[0] == NOT_READY  # in the bird bath nothing is tracked


def test_measuring_takes_cell_time(ready: Tracker) -> None:
    assert ready.client.ask(28, "2i", 5000, 1)[0] == OK
    before = ready.truth.time.now_s()
    ready.client.measure(*ready.at("F1"))
    assert 5.0 < ready.truth.time.now_s() - before < 7.0


def test_a_late_result(ready: Tracker) -> None:
    assert ready.client.ask(55, "3di", *ready.at("F1"), 1)[0] == OK
    ready.faults.set("tracker.late_result")
    ready.client.send(49)
    kinds = [ready.client.packet()[0] for _ in range(4)]
    assert kinds == [8, 0, 8, 8]  # locked on, acknowledged, measuring, ready: and no result
    late = ready.client.measure(*ready.at("F2"))  # the result of F1 comes first
    np.testing.assert_allclose(late[:3], ready.at("F1"), atol=0.06)
    np.testing.assert_allclose(ready.client.result()[:3], ready.at("F2"), atol=0.06)


def test_wire_faults(ready: Tracker) -> None:
    at = ready.at("F1")
    for fault in ("tracker.split_packet", "tracker.glued_packets"):
        ready.faults.set(fault)
        np.testing.assert_allclose(ready.client.measure(*at)[:3], at, atol=0.06)
    ready.faults.set("tracker.status_storm", 300)
    np.testing.assert_allclose(ready.client.measure(*at)[:3], at, atol=0.06)


def test_split_and_glued_commands(ready: Tracker) -> None:
    ask = bytes.fromhex("0c0000000000000002000000")
    for byte in ask:
        ready.client.wire.sendall(bytes([byte]))
    assert ready.client.reply(2)[0] == OK
    ready.client.wire.sendall(ask * 4)
    assert [ready.client.reply(2)[0] for _ in range(4)] == [OK] * 4


def test_absurd_command_ends_the_connection(ready: Tracker) -> None:
    ready.client.wire.sendall(struct.pack("<iII", 2**30, 0, 2))
    with pytest.raises((EOFError, ConnectionError)):
        exactly(ready.client.wire, 10_000)


def test_paced_measurement_can_be_stopped_and_is_busy_meanwhile(cell: Cell) -> None:
    with served(EmsconServer, EmsconClient, cell, 1e4) as tracker:
        client = tracker.client
        client.ready()
        assert client.ask(55, "3di", *tracker.at("F1"), 1)[0] == OK
        tracker.truth.time.speed = 1e-3  # a measurement takes minutes
        assert client.ask(49)[0] == OK
        assert client.ask(2)[0] == 1  # busy
        assert client.ask(52)[0] == OK


def test_news_of_the_air_come_glued_to_every_seventh_result(ready: Tracker) -> None:
    client, kinds = ready.client, []
    assert client.ask(55, "3di", *ready.at("F1"), 1)[0] == OK
    while client.packet()[1] != struct.pack("<I", 27):  # until the search has ended
        pass
    for _ in range(14):
        client.send(49)
        changes = []
        while (packet := client.packet())[0] != 2:
            if packet[0] == 8:
                changes.append(struct.unpack("<I", packet[1])[0])
        assert client.packet() == (8, struct.pack("<I", 27))
        kinds.append(changes)
    assert [number for number, changes in enumerate(kinds, 1) if 2 in changes] == [7, 14]


@pytest.fixture
def command(tracker: Tracker, monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandSync]:
    """An independent client of the protocol."""
    soon = SimpleNamespace(  # in place of 0.2 s, and of a limit that a busy PC passes
        sleep=lambda _s: threading.Event().wait(0.002), time=lambda: 0.0
    )
    for module in (CESAPI.command, CESAPI.connection):
        monkeypatch.setattr(module, "time", soon)
    connection = Connection()
    connection.connect("127.0.0.1", tracker.server.port)
    try:
        yield CommandSync(connection)
    finally:
        connection.disconnect()


@pytest.mark.waits
def test_a_measurement_from_first_to_last(command: CommandSync, tracker: Tracker) -> None:
    assert command.GetSystemStatus().lTrackerSerialNumber == EmsconDevice.SERIAL
    command.Initialize()
    units = SystemUnitsDataT()
    units.lenUnitType = ES_LU_Millimeter
    command.SetUnits(units)
    assert command.GetUnits().unitsSettings.lenUnitType == ES_LU_Millimeter
    command.SetCoordinateSystemType(0)
    stationary = StationaryModeDataT()
    stationary.lMeasTime, stationary.bUseADM = 1000, 1
    command.SetStationaryModeParams(stationary)
    command.SetReflector(3)
    assert command.GetReflector().iInternalReflectorId == 3
    at = tracker.at("F2")
    command.GoPosition(1, *at)
    result = command.StartMeasurement()
    np.testing.assert_allclose((result.dVal1, result.dVal2, result.dVal3), at, atol=0.06)
    assert 0 < result.dStdTotal < 0.05
    assert 22 <= result.dTemperature <= 24
    with pytest.raises(Exception, match="status 4"):
        command.SetReflector(77)


# -- streams ------

START, STOP, MODE, PARAMETERS, GET_PARAMETERS = 49, 52, 24, 30, 31
OUT_OF_RANGE = 12
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
def streaming(cell: Cell, speed: float = math.inf) -> Iterator[Streaming]:
    with served(EmsconServer, EmsconClient, cell, speed) as found:
        found.client.ready()
        yield Streaming(found.truth, found.truth.time, found.faults, found.client)


@pytest.fixture
def stream(cell: Cell) -> Iterator[Streaming]:
    with streaming(cell) as found:
        yield found


def test_samples_come_as_cell_time_passes(stream: Streaming) -> None:
    stream.start()
    at_mm = stream.truth.tracker.reflectors()[FLANGE]
    stream.pass_time(1.005)
    times_s, xyz_mm, sizes = stream.stop()
    assert len(times_s) == 100
    np.testing.assert_allclose(np.diff(times_s), 0.01, atol=1.5e-6)
    assert sizes[:5] == [8, 3, 12, 5, 9]
    assert np.linalg.norm(xyz_mm - at_mm, axis=1).max() < 0.1
    assert 0.005 < xyz_mm.std(axis=0).max() < 0.02  # noise, a new one for each sample


def test_the_clock_is_the_tracker_s_own(stream: Streaming) -> None:
    truth = stream.truth.streams
    stream.start(separation_ms=1000)
    began_s = stream.time.now_s()
    stream.pass_time(10_000.0)
    times_s, _, _ = stream.stop()
    assert times_s[0] - 1.0 == pytest.approx(truth.device_s(began_s), abs=1e-5)
    assert times_s[0] > 2000.0
    assert 0 < abs(truth.drift) < 3.1e-5
    assert len(times_s) == math.floor(10_000.0 * (1.0 + truth.drift))


def test_a_packet_may_wait_for_the_next(stream: Streaming) -> None:
    """The fifth packet, samples 29 to 37, is late."""
    stream.start()
    stream.pass_time(0.385)
    stream.client.send(98)
    assert len(stream.until(1, 98)[0]) == 8 + 3 + 12 + 5
    assert len(stream.stop()[0]) == 9 + 1


SAMPLES_MM = [[4310.083555, 734.212459, 741.205437], [4213.508629, 909.940104, 435.281048]]


@pytest.mark.parametrize("leaps_s", [[0.01] * 60, [0.157, 0.001, 0.442], [0.6]])
def test_the_same_samples_at_any_time_of_asking(cell: Cell, leaps_s: list[float]) -> None:
    faults, time = Faults(), CellTime()
    truth = CellTruth(cell, 1, time, faults)
    truth.robot.move(truth.robot.state().joints_rad + 0.1, 0.2)
    xyz_mm: list[Array] = []

    def pack(_times_s: Array, found_mm: Array) -> bytes:
        xyz_mm.append(found_mm)
        return b""

    samples = SampleStream(
        truth=truth.streams,
        time=time,
        faults=faults,
        followed=truth.streams.follow(FLANGE),
        pack=pack,
        separation_s=0.01,
        points=0,
        lost=lambda: None,
    )
    for leap_s in (*leaps_s, 0.005):
        time.advance(leap_s)
        samples.due()
    samples.end()
    found_mm = np.vstack(xyz_mm)
    assert found_mm.shape == (60, 3)
    np.testing.assert_allclose(found_mm[[7, 42]], SAMPLES_MM, atol=1e-6)


def test_a_sample_s_truth_is_that_of_its_own_time(stream: Streaming) -> None:
    """Moved, overridden, braked and moved again before anybody asks."""
    truth, time = stream.truth, stream.time
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


def test_a_broken_beam_ends_it_with_a_status_change(stream: Streaming) -> None:
    stream.start()
    stream.faults.set("tracker.stream_break", after=20)
    stream.pass_time(1.0)
    times_s, _, _ = stream.until(8, BEAM_LOST)
    assert len(times_s) == 20
    stream.pass_time(1.0)
    assert len(stream.stop()[0]) == 0
    assert stream.client.ask(START)[0] == 10004


def test_out_of_sight_is_out_of_the_stream() -> None:
    with streaming(load_cell("paper", {"layout.reflectors": "by_hand"})) as stream:
        stream.truth.place_reflector(FLANGE)
        stream.start()
        stream.truth.place_reflector("")
        stream.pass_time(1.0)
        assert len(stream.until(8, BEAM_LOST)[0]) == 0


def test_paced_time_streams_by_itself(cell: Cell) -> None:
    with streaming(cell, speed=200.0) as stream:
        stream.start(points=60)
        times_s, _, _ = stream.until(8, READY)
        np.testing.assert_allclose(np.diff(times_s), 0.01, atol=1.5e-6)
        assert len(times_s) == 60


def test_while_it_streams_a_poll_is_an_exchange(stream: Streaming) -> None:
    robot = stream.truth.robot
    stream.start()
    robot.move(robot.state().joints_rad + 0.2, 0.01)
    before_s = stream.time.now_s()
    robot.poll()
    assert stream.time.now_s() - before_s == pytest.approx(CellTime.EXCHANGE_S)
    stream.stop()
    before_s = stream.time.now_s()
    robot.poll()
    assert stream.time.now_s() - before_s > 10 * CellTime.EXCHANGE_S


def test_an_impossible_separation_is_refused(stream: Streaming) -> None:
    for separation_ms in (0, -1, 100_001):
        assert stream.client.ask(PARAMETERS, "4i", separation_ms, 0, 0, 0)[0] == OUT_OF_RANGE
    assert stream.client.ask(GET_PARAMETERS) == (OK, struct.pack("<4i", 500, 0, 0, 0))


def carried(tracker: Tracker) -> str:
    """Let go of the beam; return the nest that it is on once it can be measured again."""
    assert tracker.client.ask(54)[0] == OK
    for _ in range(10):
        tracker.client.send(49)
        if tracker.client.reply(49)[0] == OK:
            at = np.array(tracker.client.result()[:3])
            off_mm = {
                name: float(np.linalg.norm(at - where))
                for name, where in tracker.truth.tracker.reflectors().items()
            }
            nest = min(off_mm, key=off_mm.__getitem__)
            assert off_mm[nest] < 0.1
            return nest
    raise AssertionError("nobody came")


def test_a_person_carries_the_beam_to_one_nest_after_another(ready: Tracker) -> None:
    layout = ready.truth.cell.layout
    fixed = {nest.name for nest in layout.fixed_nests}
    nests = [*fixed, "flange", *(nest.name for nest in layout.slide)]
    began_s = ready.truth.time.now_s()
    order = [carried(ready) for _ in range(2 * len(nests))]
    assert set(order[: len(fixed)]) == fixed
    assert order[len(fixed)] == "flange"
    assert set(order[: len(nests)]) == set(nests)
    assert order[len(nests) :] == order[: len(nests)]
    each_s = (ready.truth.time.now_s() - began_s) / len(order)
    assert 4.0 < each_s < 20.0  # a few seconds of cell time, besides the way to the bird bath
    with served(EmsconServer, EmsconClient, ready.truth.cell) as again:
        again.client.ready()
        assert [carried(again) for _ in nests] == order[: len(nests)]  # of the same seed


def test_the_tracker_takes_the_beam_back_by_pointing(ready: Tracker) -> None:
    assert ready.client.ask(54)[0] == OK
    assert ready.client.ask(55, "3di", *ready.at("P1"), 1)[0] == OK
    ready.truth.time.advance(60.0)
    ready.client.send(49)
    np.testing.assert_allclose(ready.client.result()[:3], ready.at("P1"), atol=0.06)
    horizontal, zenith = struct.unpack("<2d", ready.client.ask(66)[1])
    x, y, z = ready.at("P1")
    assert (horizontal, zenith) == pytest.approx(
        (math.atan2(y, x), math.acos(z / math.hypot(x, y, z)))
    )
