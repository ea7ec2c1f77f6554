from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from fakes.faults import Faults
from fakes.leica.emscon_server import EmsconDevice, EmsconServer
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.cell_truth import FLANGE, CellTruth
from hilcell.cell.file import Cell
from hilcell.geometry.kinematics import Array
from tests.fakes.wires import EmsconClient, connected, exactly

OK, NOT_INITIALIZED, NO_DISTANCE, NOT_READY, NO_RESULT = 0, 39, 37, 10004, 10009


@dataclass
class Tracker:
    truth: CellTruth
    faults: Faults
    server: EmsconServer
    client: EmsconClient

    def at(self, name: str) -> Array:
        return self.truth.tracker.reflectors()[name]


@contextlib.contextmanager
def running(cell: Cell, speed: float = math.inf) -> Iterator[Tracker]:
    faults, clock = Faults(), CellTime(speed)
    truth = CellTruth(cell, 1, clock, faults)
    server = EmsconServer(Site(cell, truth, faults, clock))
    with contextlib.closing(server):
        server.start()
        with connected(server.port) as wire:
            yield Tracker(truth, faults, server, EmsconClient(wire))


@pytest.fixture
def tracker(cell: Cell) -> Iterator[Tracker]:
    with running(cell) as found:
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
    with running(cell, speed=1e4) as tracker:
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
