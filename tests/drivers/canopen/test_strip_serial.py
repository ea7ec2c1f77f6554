"""A strip's sensor on a serial line: bytes as in the maker's manual, and lines that fail."""

from __future__ import annotations

import os
import tty
from collections.abc import Iterator

import pytest

from drivers import supervision
from drivers.strips import LOST, SerialStrip, StripFeed, StripOptions
from hilcell.ports import DeviceError, DeviceRefused, Stopped
from tests.drivers.peers import WireTime, in_thread, wire_time
from tests.drivers.strip_peer import StripPeer


@pytest.fixture(autouse=True)
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    return wire_time(monkeypatch, supervision)


def never() -> None:
    pass


def strip_for(channel: str, serial: int = 0) -> SerialStrip:
    options = StripOptions(driver="serial", channel=channel, serial=serial)
    return SerialStrip(options, WireTime())


@pytest.fixture
def peer() -> Iterator[StripPeer]:
    with StripPeer() as peer:
        yield peer


@pytest.fixture
def strip(peer: StripPeer) -> Iterator[SerialStrip]:
    strip = strip_for(peer.channel)
    yield strip
    strip.close()


def test_identity_and_readings(peer: StripPeer, strip: SerialStrip) -> None:
    identity = strip.connect()
    assert (identity.kind, identity.model) == ("strip", "MSAC501SN3-08Bit")
    assert (identity.serial, identity.firmware) == ("1234567", "V1.00-Nov 03 2015")
    assert strip.read(never) == (110_042, 0)
    peer.counts, peer.register = lambda: -120, 0x03
    assert strip.read(never) == (-120, 3)
    assert "too far" in strip.alarm_text(3)


def test_a_real_line_is_a_pty_in_two_pieces() -> None:
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

    strip = strip_for(f"{os.ttyname(theirs)}@19200")
    with in_thread(serve):
        strip.connect()
        assert strip.read(never) == (42, 0)
    strip.close()
    os.close(ours)
    os.close(theirs)


def test_another_sensor_is_refused(peer: StripPeer) -> None:
    with pytest.raises(DeviceRefused, match="1234567"):
        strip_for(peer.channel, serial=8).connect()


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
    peer: StripPeer, strip: SerialStrip, time: WireTime, answer: bytes, code: str
) -> None:
    strip.connect()
    peer.spoil = lambda command, good: answer if command == b"Z" else good
    if not answer.endswith(b"\r"):
        time.silence(0.1)
    with pytest.raises(DeviceError) as caught:
        strip.read(never)
    assert caught.value.code == code


def test_a_stop_ends_the_wait(peer: StripPeer, strip: SerialStrip) -> None:
    strip.connect()

    def stopped() -> None:
        raise Stopped("stop")

    with pytest.raises(Stopped):
        strip.read(stopped)


def test_no_line_is_an_alarm_of_its_own() -> None:
    with pytest.raises(DeviceError) as caught:
        strip_for("/dev/serial/by-id/none").connect()
    assert caught.value.code == "HC-S11"


def test_a_lost_line_shows_in_the_polls_and_is_opened_again_when_asked_to(
    peer: StripPeer, strip: SerialStrip, time: WireTime
) -> None:
    feed = StripFeed(strip)
    feed.connect()
    assert feed.poll(never) == (110_042, 0)
    peer.silent = True
    time.silence(0.1)
    assert feed.poll(never) == (110_042, LOST)
    time.silence(0.0)
    peer.silent = False
    assert feed.poll(never) == (110_042, LOST)  # a late answer would be the next question's
    assert peer.connections == 1
    feed.mend()
    assert feed.poll(never) == (110_042, 0)
    assert peer.connections == 2
    feed.close()


def test_answers_are_counted_over_a_line_that_was_lost(peer: StripPeer, strip: SerialStrip) -> None:
    feed = StripFeed(strip)
    feed.connect()
    feed.poll(never)
    before = feed.statistics()
    assert (before.frames, before.bad_lines) == (5, 0)
    peer.spoil = lambda command, good: b"+nan>\r" if command == b"Z" else good
    assert feed.poll(never)[1] == LOST
    peer.spoil = lambda _command, good: good
    feed.mend()
    feed.poll(never)
    feed.close()
    assert (feed.statistics().frames, feed.statistics().bad_lines) == (10, 1)
    feed.connect()
    assert feed.statistics().frames == 3
    feed.close()
