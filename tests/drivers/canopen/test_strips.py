"""A strip's sensor on a CAN bus or a serial line of its own, by itself and under a rail."""

from __future__ import annotations

import os
import struct
import tty
from collections.abc import Iterator
from functools import partial
from typing import Any

import msgspec
import pytest

from drivers.canopen.rail import CanopenRail
from drivers.strips import LOST, CanopenStrip, SerialStrip, StripOptions, StripReader
from drivers.supervision import ignore_stop
from hilcell.ports import DeviceRefused, Stopped, StripLost
from tests.drivers.canopen.can_peer import DISABLED, STRIP, CanPeer, u8, u32
from tests.drivers.canopen.rail_bed import BedRail, RailTime
from tests.drivers.peers import WireTime, in_thread, refusal, soon
from tests.drivers.strip_peer import StripPeer


def canopen_options(peer: CanPeer, **more: Any) -> StripOptions:
    return StripOptions(driver="canopen", channel=peer.channel, **more)


def serial_options(channel: str, serial: int = 0) -> StripOptions:
    return StripOptions(driver="serial", channel=channel, serial=serial)


@pytest.fixture
def on_bus(peer: CanPeer, time: RailTime) -> Iterator[CanopenStrip]:
    strip = CanopenStrip(canopen_options(peer), time)
    yield strip
    strip.close()
    strip.close()


@pytest.fixture
def sensor() -> Iterator[StripPeer]:
    with StripPeer() as sensor:
        yield sensor


@pytest.fixture
def on_line(sensor: StripPeer, time: RailTime) -> Iterator[SerialStrip]:
    strip = SerialStrip(serial_options(sensor.channel), WireTime())
    yield strip
    strip.close()


@pytest.mark.parametrize(
    ("strip", "found"),
    [
        ({"driver": "serial", "channel": "/dev/a", "node": 7}, "node"),
        ({"driver": "canopen", "channel": "can1"}, None),
        ({"driver": "canopen", "interface": "socketcan", "channel": "can1"}, None),
        ({"driver": "canopen", "channel": "socket://a"}, "channel"),
        ({"driver": "canopen", "channel": "socket://gateway:3000"}, "needs no table"),
        ({"driver": "canopen", "channel": "can1", "serial": 8}, "strip_serial"),
    ],
)
def test_options(strip: dict[str, Any], found: str | None) -> None:
    values = {
        "channel": "socket://gateway:3000",
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
        "strip": strip,
        "strip_serial": strip.get("serial", 0),
    }
    if found is None:
        assert msgspec.convert(values, CanopenRail.Options).strip is not None
    else:
        with pytest.raises(msgspec.ValidationError, match=found):
            msgspec.convert(values, CanopenRail.Options)


# -- on a CAN bus -----------------------------------------------------------------------------


def test_a_sensor_on_a_bus_has_identity_readings_alarms_and_counts(
    peer: CanPeer, on_bus: CanopenStrip
) -> None:
    identity = on_bus.connect()
    assert (identity.kind, identity.serial) == ("strip", "4711")
    assert identity.address == f"{peer.channel} node {STRIP}"
    assert on_bus.read(ignore_stop) == (50_000, 0)
    peer.axis.position, peer.alarms = -1200, 1
    assert on_bus.read(ignore_stop) == (-120, 1)
    frames = on_bus.statistics().frames
    assert frames > 10
    # Nothing is sent that could move a drive.
    assert {cob_id for cob_id, _ in peer.heard} <= {0x000, 0x080, 0x600 + STRIP}
    assert {data[1] for data in peer.frames(0x000)} == {STRIP}
    on_bus.close()
    assert on_bus.statistics().frames >= frames
    refusal(lambda: on_bus.read(ignore_stop))


@pytest.mark.parametrize(
    ("more", "found"),
    [({"serial": 8}, "0x1267"), ({"product": 7}, "0x406"), ({"counts_per_mm": 1e3}, "10000 nm")],
)
def test_another_sensor_on_a_bus_is_refused(
    peer: CanPeer, time: RailTime, more: dict[str, Any], found: str
) -> None:
    with pytest.raises(DeviceRefused, match=found):
        CanopenStrip(canopen_options(peer, **more), time).connect()
    assert peer.nmt[STRIP] != 5


def test_the_measuring_step_may_be_absent(peer: CanPeer, time: RailTime) -> None:
    del peer.objects[STRIP][0x6005, 1]
    peer.objects[STRIP][0x1018, 4] = u32(99)
    strip = CanopenStrip(canopen_options(peer, serial=99, counts_per_mm=50.0), time)
    assert strip.connect().serial == "99"
    strip.close()


def test_a_sensor_without_an_object_for_its_alarms_has_them_in_its_emergencies(
    peer: CanPeer, on_bus: CanopenStrip
) -> None:
    peer.unmappable.add(0x6503)
    on_bus.connect()

    def reads(alarms: int) -> bool:
        return on_bus.read(ignore_stop) == (50_000, alarms)

    assert reads(0)
    for code, register, alarms in ((0x7305, 0x21, 1), (0x0000, 0, 0)):
        peer.send(0x080 + STRIP, struct.pack("<HB5x", code, register))
        assert soon(partial(reads, alarms))


def test_a_sensor_that_is_reset_falls_silent_or_leaves_the_bus_is_lost(
    peer: CanPeer, on_bus: CanopenStrip, time: RailTime
) -> None:
    feed = StripReader(on_bus)
    causes = (
        (lambda: peer.send(0x700 + STRIP, u8(0)), "boot-up"),
        (lambda: peer.nmt.__setitem__(STRIP, 0x7F), "not operational"),
        (peer.server.drop, "link lost"),
    )
    time.silence()
    for strike, text in causes:
        feed.connect()
        assert feed.poll(ignore_stop) == (50_000, 0)
        strike()
        soon(lambda: bool(feed.poll(ignore_stop)[1] & LOST))
        assert text in feed.alarm_text(LOST)
        peer.server.drop()
        feed.reconnect()
        assert feed.poll(ignore_stop) == (50_000, 0)
    feed.close()


def test_a_stop_ends_the_wait_for_a_bus(
    peer: CanPeer, on_bus: CanopenStrip, time: RailTime
) -> None:
    on_bus.connect()
    peer.nmt[STRIP] = 0x7F
    peer.on_sync = time.stop.set
    with pytest.raises(Stopped):
        on_bus.read(time.check)


def test_a_rail_has_drive_and_strip_on_two_buses(peer: CanPeer, time: RailTime) -> None:
    with CanPeer() as drive_bus:
        drive_bus.silent.add(STRIP)
        rail = BedRail(drive_bus, time, strip=canopen_options(peer), strip_counts_per_mm=3.0)
        drive_bus.on_sync = lambda: vars(peer.axis).update(
            position=drive_bus.axis.position, passed_s=drive_bus.axis.passed_s
        )
        identities = rail.connect()
        assert [each.kind for each in identities] == ["drive", "strip"]
        channels = [each.address.split()[0] for each in identities]
        assert channels == [drive_bus.channel, peer.channel]
        rail.home()
        rail.move_to(700.0)
        assert rail.settle().strip_mm == pytest.approx(700.0, abs=0.02)
        peer.nmt[STRIP] = 0x7F
        rail.hold()
        assert rail.settle().strip_mm == pytest.approx(700.0, abs=0.02)  # it was opened again
        frames = rail.statistics().frames
        rail.close()
        assert rail.statistics().frames >= frames > 100


# -- on a serial line -------------------------------------------------------------------------


def test_a_sensor_on_a_line_has_identity_and_readings(
    sensor: StripPeer, on_line: SerialStrip
) -> None:
    identity = on_line.connect()
    assert (identity.kind, identity.model) == ("strip", "MSAC501SN3-08Bit")
    assert (identity.serial, identity.firmware) == ("1234567", "V1.00-Nov 03 2015")
    assert on_line.read(ignore_stop) == (110_042, 0)
    sensor.counts, sensor.register = lambda: -120, 0x03
    assert on_line.read(ignore_stop) == (-120, 3)
    assert "too far" in on_line.alarm_text(3)


def test_a_real_line_answers_in_two_pieces() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    answers = {b"A0": b"MSAC501>\r", b"A1": b"V1>\r", b"A2": b"7>\r", b"Z": b"+0000042>\r"}
    asked: list[bytes] = []

    def serve() -> None:
        while b"Z" not in asked:
            command = os.read(ours, 1)
            command += os.read(ours, 1) if command == b"A" else b""
            asked.append(command)
            for piece in (answers[command][:2], answers[command][2:]):
                os.write(ours, piece)
        assert os.read(ours, 1) == b"X"
        os.write(ours, b"0x00>\r")

    strip = SerialStrip(serial_options(f"{os.ttyname(theirs)}@19200"), WireTime())
    with in_thread(serve):
        strip.connect()
        assert strip.read(ignore_stop) == (42, 0)
    strip.close()
    os.close(ours)
    os.close(theirs)


def test_another_sensor_on_a_line_is_refused(sensor: StripPeer, time: RailTime) -> None:
    with pytest.raises(DeviceRefused, match="1234567"):
        SerialStrip(serial_options(sensor.channel, serial=8), time).connect()


@pytest.mark.parametrize(
    ("answer", "code"),
    [
        (b"?\r", "HC-S13"),
        (b"+000x042>\r", "HC-S13"),
        (b"+0110042\r", "HC-S13"),
        (b"+nan>\r", "HC-S13"),
        (b"\xff\xfe\x80\r", "HC-S12"),
        (b"+011", "HC-S12"),
        (b"", "HC-S12"),
    ],
)
def test_an_answer_of_another_form_is_no_reading(
    sensor: StripPeer, on_line: SerialStrip, time: RailTime, answer: bytes, code: str
) -> None:
    on_line.connect()
    sensor.spoil = lambda command, good: answer if command == b"Z" else good
    if not answer.endswith(b"\r"):
        time.silence(0.1)
    assert refusal(lambda: on_line.read(ignore_stop)).code == code


def test_a_stop_ends_the_wait_for_a_line(on_line: SerialStrip) -> None:
    on_line.connect()

    def stopped() -> None:
        raise Stopped("stop")

    with pytest.raises(Stopped):
        on_line.read(stopped)


def test_a_line_that_does_not_exist_is_an_alarm_of_its_own(time: RailTime) -> None:
    strip = SerialStrip(serial_options("/dev/serial/by-id/none"), time)
    assert refusal(strip.connect).code == "HC-S11"


def test_a_lost_line_shows_in_the_polls_and_is_opened_again_when_asked_to(
    sensor: StripPeer, on_line: SerialStrip, time: RailTime
) -> None:
    feed = StripReader(on_line)
    feed.connect()
    assert feed.poll(ignore_stop) == (110_042, 0)
    sensor.silent = True
    time.silence(0.1)
    assert feed.poll(ignore_stop) == (110_042, LOST)
    time.silence(0.0)
    sensor.silent = False
    assert feed.poll(ignore_stop) == (110_042, LOST)  # a late answer would be the next question's
    assert sensor.connections == 1
    feed.reconnect()
    assert feed.poll(ignore_stop) == (110_042, 0)
    assert sensor.connections == 2
    feed.close()


def test_answers_are_counted_over_a_line_that_was_lost(
    sensor: StripPeer, on_line: SerialStrip
) -> None:
    feed = StripReader(on_line)
    feed.connect()
    feed.poll(ignore_stop)
    before = feed.statistics()
    assert (before.frames, before.bad_lines) == (5, 0)
    sensor.spoil = lambda command, good: b"+nan>\r" if command == b"Z" else good
    assert feed.poll(ignore_stop)[1] == LOST
    sensor.spoil = lambda _command, good: good
    feed.reconnect()
    feed.poll(ignore_stop)
    feed.close()
    assert (feed.statistics().frames, feed.statistics().bad_lines) == (10, 1)
    feed.connect()
    assert feed.statistics().frames == 3
    feed.close()


def test_a_rail_has_its_strip_on_a_line(peer: CanPeer, sensor: StripPeer, time: RailTime) -> None:
    sensor.counts = lambda: peer.axis.position // 10
    line = serial_options(sensor.channel)
    rail = BedRail(peer, time, strip=line, strip_counts_per_mm=3.0)
    drive, strip = rail.connect()
    assert (drive.kind, strip.serial) == ("drive", "1234567")
    rail.home()
    rail.move_to(700.0)
    assert rail.settle().strip_mm == 700.0
    rail.hold()
    sensor.silent = True
    time.silence()
    assert isinstance(refusal(rail.read), StripLost)
    time.silence(0.0)
    rail.move_to(800.0)  # no motion asks the strip
    sensor.silent = False
    rail.hold()
    assert rail.settle().strip_mm == 800.0
    sensor.register = 1
    error = refusal(rail.read)
    assert (type(error), error.fields["alarms"]) == (StripLost, 1)
    sensor.register = 0
    rail.move_to(700.0)
    time.stop.set()
    rail.close()  # its wait for the strip is no wait of the run, which is over
    assert peer.axis.state == DISABLED
