"""A strip's sensor on a serial line: bytes as in the maker's manual, and lines that fail."""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Iterator

import pytest

from drivers.strips import serial as strip_serial
from drivers.strips.serial import SerialStrip
from drivers.strips.strip import LOST, StripFeed, StripOptions
from hilcell.ports import DeviceError, DeviceRefused, Stopped
from tests.clocks import DrivenClock
from tests.drivers.strip_peer import StripPeer


def never() -> None:
    pass


def strip_for(channel: str, serial: int = 0) -> SerialStrip:
    options = StripOptions(driver="serial", channel=channel, serial=serial)
    return SerialStrip(options, DrivenClock())


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strip_serial, "REPLY_S", 0.1)


@pytest.fixture
def peer() -> Iterator[StripPeer]:
    with StripPeer() as peer:
        yield peer


def test_identity_and_readings(peer: StripPeer) -> None:
    strip = strip_for(peer.channel)
    identity = strip.connect()
    assert (identity.kind, identity.model) == ("strip", "MSAC501SN3-08Bit")
    assert (identity.serial, identity.firmware) == ("1234567", "V1.00-Nov 03 2015")
    assert strip.read(never) == (110_042, 0)
    peer.counts, peer.register = lambda: -120, 0x03
    assert strip.read(never) == (-120, 3)
    assert strip.alarm_text(3).startswith("the head is too far from the strip; the absolute")
    strip.close()


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

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    strip = strip_for(f"{os.ttyname(theirs)}@19200")
    strip.connect()
    assert strip.read(never) == (42, 0)
    thread.join(10)
    strip.close()
    os.close(ours)
    os.close(theirs)


def test_another_sensor_is_refused(peer: StripPeer) -> None:
    with pytest.raises(DeviceRefused, match="strip sensor 1234567, wanted 8"):
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
def test_an_answer_of_another_form_is_no_reading(peer: StripPeer, answer: bytes, code: str) -> None:
    strip = strip_for(peer.channel)
    strip.connect()
    peer.spoil = lambda command, good: answer if command == b"Z" else good
    with pytest.raises(DeviceError) as caught:
        strip.read(never)
    assert caught.value.code == code
    strip.close()


def test_a_stop_ends_the_wait(peer: StripPeer) -> None:
    strip = strip_for(peer.channel)
    strip.connect()

    def stopped() -> None:
        raise Stopped("stop")

    with pytest.raises(Stopped):
        strip.read(stopped)
    strip.close()


def test_no_line_is_an_alarm_of_its_own() -> None:
    with pytest.raises(DeviceError) as caught:
        strip_for("/dev/serial/by-id/none").connect()
    assert caught.value.code == "HC-S11"


def test_a_lost_line_shows_in_the_polls_and_is_opened_again_when_asked_to(
    peer: StripPeer,
) -> None:
    feed = StripFeed(strip_for(peer.channel))
    feed.connect()
    assert feed.poll(never) == (110_042, 0)
    peer.silent = True
    assert feed.poll(never) == (110_042, LOST)
    peer.silent = False
    assert feed.poll(never) == (110_042, LOST)  # a late answer would be the next question's
    assert "did not answer" in feed.alarm_text(LOST)
    assert peer.connections == 1
    feed.mend()
    assert feed.poll(never) == (110_042, 0)
    assert peer.connections == 2
    feed.close()


def test_answers_are_counted_over_a_line_that_was_lost(peer: StripPeer) -> None:
    feed = StripFeed(strip_for(peer.channel))
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
