"""The position stream: golden bytes by egm.proto, and datagrams lost, doubled, late or foreign."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.abb.egm import PositionStream, parse
from drivers.device_errors import ProtocolError
from drivers.supervision import ignore_stop
from tests.drivers.peers import kind, refusal

JOINTS_DEG = [1.5, -2.0, 3.0, 0.0, 90.0, -180.0]


def joints(values: list[float]) -> bytes:
    return b"".join(b"\x09" + struct.pack("<d", each) for each in values)


def datagram(
    number: bytes = b"\x05", values: list[float] = JOINTS_DEG, state: int = 1, kind: bytes = b"\x02"
) -> bytes:
    """Return EgmRobot, byte by byte by the field numbers of egm.proto."""
    header = b"\x08" + number + b"\x10\xe8\x07" + b"\x18" + kind  # tm = 1000
    clock = b"\x08\x07\x10\xa0\xc2\x1e"  # 7 s, 500 000 us
    axes = joints(values)
    feedback = b"\x0a" + bytes([len(axes)]) + axes + b"\x22" + bytes([len(clock)]) + clock
    return (
        b"\x0a" + bytes([len(header)]) + header
        + b"\x12" + bytes([len(feedback)]) + feedback
        + b"\x22\x02\x08" + bytes([state])
        + b"\x2a\x02\x08\x02"  # mciState
        + b"\x30\x00"  # mciConvergenceMet
        + b"\x42\x02\x08\x02"  # rapidExecState
        + b"\x51" + struct.pack("<d", 0.5)  # utilizationRate
    )  # fmt: skip


def test_golden_bytes() -> None:
    sample = parse(datagram())
    assert sample.number == 5
    assert np.degrees(sample.joints_rad).tolist() == pytest.approx(JOINTS_DEG)
    assert sample.device_s == pytest.approx(7.5)
    assert (sample.motors_on, sample.running) == (True, True)
    assert not parse(datagram(state=2)).motors_on
    assert parse(datagram(b"\xff\xff\xff\xff\x0f")).number == 2**32 - 1


def test_an_older_robotware_has_the_header_s_time_alone() -> None:
    axes = joints(JOINTS_DEG)
    feedback = b"\x0a" + bytes([len(axes)]) + axes
    header = b"\x08\x05\x10\xe8\x07\x18\x02"
    found = parse(
        b"\x0a" + bytes([len(header)]) + header + b"\x12" + bytes([len(feedback)]) + feedback
    )
    assert found.device_s == 1.0


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        datagram()[:20],
        datagram(kind=b"\x01"),
        datagram(values=[*JOINTS_DEG[:5], math.nan]),
        datagram(values=[*JOINTS_DEG[:5], -1e308]),
        datagram(values=JOINTS_DEG[:5]),
        b"\x03\x01",
        b"\xff" * 12,
        b"\x12\x80\x80\x80\x80\x80\x80\x80\x80\x80\x80\x80\x01",
        b"\x08\x01",
    ],
)
def test_other_bytes_are_no_sample(bad: bytes) -> None:
    with pytest.raises(ProtocolError):
        parse(bad)


@given(st.binary(max_size=120), st.integers(0, 150))
def test_any_bytes_are_a_sample_or_refused(noise: bytes, at: int) -> None:
    whole = datagram()
    for each in (noise, whole[:at] + noise, whole[:at] + noise + whole[at + len(noise) :]):
        with contextlib.suppress(ProtocolError):
            sample = parse(each)
            assert sample.joints_rad.shape == (6,)
            assert math.isfinite(sample.device_s)


@contextlib.contextmanager
def stream() -> Iterator[tuple[PositionStream, socket.socket, tuple[str, int]]]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    found = PositionStream(port, ignore_stop)
    with (
        contextlib.closing(found),
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot,
    ):
        robot.bind(("127.0.0.1", 0))
        yield found, robot, ("127.0.0.1", port)


def test_lost_doubled_and_late_datagrams() -> None:
    with stream() as (found, robot, to):
        for number in (b"\x05", b"\x06", b"\x06", b"\x09", b"\x08", b"\x0a"):
            robot.sendto(datagram(number), to)
        assert [each.number for each in found.following()] == [5, 6, 9, 10]
        assert found.lost == 2


def test_the_count_goes_on_beyond_32_bits() -> None:
    with stream() as (found, robot, to):
        for number in (b"\xff\xff\xff\xff\x0f", b"\x00", b"\x01"):
            robot.sendto(datagram(number), to)
        assert [each.number for each in found.following()] == [2**32 - 1, 0, 1]


def test_a_fresh_sample_is_none_that_waited() -> None:
    with stream() as (found, robot, to):
        robot.sendto(datagram(b"\x05"), to)
        assert found.newest().number == 5
        robot.sendto(datagram(b"\x06"), to)
        robot.sendto(datagram(b"\x07"), to)
        found.SILENT_S = 0.0
        assert refusal(found.fresh).code == "HC-B85"


def test_two_controllers_at_one_port() -> None:
    with stream() as (found, robot, to), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        robot.sendto(datagram(b"\x05"), to)
        assert found.newest().number == 5
        other.sendto(datagram(b"\x06"), to)
        error = refusal(found.newest)
    assert error.code == "HC-B85"
    assert error.expected == "one controller"


def test_a_port_that_another_program_has() -> None:
    with stream() as (found, _, _):
        error = refusal(lambda: PositionStream(found.port, ignore_stop))
    assert error.code == "HC-B85"
    assert str(found.port) in error.found


def test_a_datagram_that_is_no_position() -> None:
    with stream() as (found, robot, to):
        robot.sendto(b"hello", to)
        assert refusal(found.newest).code == "HC-B26"


def test_a_silent_stream() -> None:
    with stream() as (found, _, _):
        found.SILENT_S = 0.0
        assert kind(refusal(found.newest))[1] == "HC-B85"
