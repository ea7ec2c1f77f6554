"""Wires of bytes and of lines: a real pseudo terminal and a real socket, used alike."""

from __future__ import annotations

import os
import pty
import socket
import tty
from collections.abc import Iterator
from contextlib import suppress

import pytest

from drivers.device_errors import TRACKER
from drivers.supervision import Deadline
from drivers.wires import Link, TextLines, open_link
from hilcell.ports import DeviceError
from hilcell.wire.channel import SerialLine, Socket, parse_channel

PATIENT_S = 600.0


class Far:
    """The other end of a wire."""

    def __init__(self, link: Link, file: int) -> None:
        self.link, self._file = link, file

    def says(self, data: bytes) -> None:
        os.write(self._file, data)

    def hears(self) -> bytes:
        return os.read(self._file, 4096)

    def hang_up(self) -> None:
        with suppress(OSError):
            os.close(self._file)


@pytest.fixture(params=["serial", "socket"])
def far(request: pytest.FixtureRequest) -> Iterator[Far]:
    if request.param == "serial":
        file, inner = pty.openpty()
        tty.setraw(inner)
        link = open_link(TRACKER, os.ttyname(inner), lambda: None)
        os.close(inner)
    else:
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
            link = open_link(TRACKER, f"socket://127.0.0.1:{port}", lambda: None)
            file = server.accept()[0].detach()
    end = Far(link, file)
    yield end
    link.close()
    link.close()
    end.hang_up()


@pytest.mark.parametrize(
    ("channel", "place"),
    [
        ("socket://10.0.0.7:1212", Socket("10.0.0.7", 1212)),
        ("/dev/serial/by-id/usb-1", SerialLine("/dev/serial/by-id/usb-1", 115_200)),
        ("COM3@9600", SerialLine("COM3", 9600)),
    ],
)
def test_a_channel_is_a_socket_or_a_serial_line(channel: str, place: object) -> None:
    assert parse_channel(channel) == place


@pytest.mark.parametrize(
    "channel", ["", "@9600", "COM3@fast", "COM3@", "http://x:1", "socket://x", "socket://x:99999"]
)
def test_other_channels_are_refused(channel: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - its words are for people
        parse_channel(channel)


def test_lines_go_out_whole_and_come_in_however_they_are_split(far: Far) -> None:
    lines = TextLines(far.link)
    lines.send("%R1Q,0,1:", "ask")
    assert far.hears() == b"%R1Q,0,1:\r\n"
    far.says(b"\r\n%R1P,0,1:0\r")
    far.says(b"\n%R1P,0,2")
    assert lines.receive(Deadline(PATIENT_S)) == "%R1P,0,1:0"
    assert lines.receive(Deadline(0.0)) is None
    far.says(b":13\nrest")
    assert lines.receive(Deadline(PATIENT_S)) == "%R1P,0,2:13"


def test_what_was_pending_is_dropped(far: Far) -> None:
    lines = TextLines(far.link)
    far.says(b"late\r\nhalf")
    assert lines.receive(Deadline(PATIENT_S)) == "late"
    lines.drop_pending()
    far.says(b" a line\r\n")
    assert lines.receive(Deadline(PATIENT_S)) == "a line"


def test_bytes_that_are_no_text_are_an_error_that_names_the_baud_rate(far: Far) -> None:
    lines = TextLines(far.link)
    far.says(b"\x86\xf8\x00~\r\n")
    with pytest.raises(DeviceError) as caught:
        lines.receive(Deadline(PATIENT_S))
    assert caught.value.code == "HC-T02"


def test_a_line_without_an_end_is_an_error(far: Far) -> None:
    lines = TextLines(far.link)
    far.says(b"x" * (TextLines.MAX_LINE // 2))
    while lines.unended < TextLines.MAX_LINE // 2:
        assert lines.receive(Deadline(0.0)) is None
    far.says(b"x" * (TextLines.MAX_LINE // 2 + 1))
    with pytest.raises(DeviceError):
        lines.receive(Deadline(PATIENT_S))


def test_a_wire_that_dies_in_mid_byte_is_lost(far: Far) -> None:
    lines = TextLines(far.link)
    far.says(b"%R1P,0,")
    assert lines.receive(Deadline(0.0)) is None
    far.hang_up()
    with pytest.raises(DeviceError) as caught:
        lines.receive(Deadline(PATIENT_S))
    assert caught.value.code == "HC-T02"


def test_a_wire_that_was_closed_is_lost(far: Far) -> None:
    far.link.close()
    with pytest.raises(DeviceError) as received:
        far.link.receive(10, Deadline(PATIENT_S))
    with pytest.raises(DeviceError) as sent:
        far.link.send(b"x", "ask")
    assert received.value.code == sent.value.code == "HC-T02"


def test_a_silent_wire_ends_the_wait_by_a_stop() -> None:
    file, inner = pty.openpty()
    asked = iter([None, None, None])

    def check() -> None:
        if next(asked, "stop") == "stop":
            raise KeyboardInterrupt

    link = open_link(TRACKER, os.ttyname(inner), check)
    with pytest.raises(KeyboardInterrupt):
        link.receive(10, Deadline(60.0))
    link.close()
    os.close(inner)
    os.close(file)


def test_a_serial_line_that_is_not_there_is_named() -> None:
    with pytest.raises(DeviceError, match="9600") as caught:
        open_link(TRACKER, "/dev/serial/by-id/none@9600", lambda: None)
    assert caught.value.code == "HC-T01"


def test_a_serial_line_that_is_pulled_out_is_named_as_that() -> None:
    file, inner = pty.openpty()
    link = open_link(TRACKER, os.ttyname(inner), lambda: None)
    os.close(inner)
    os.close(file)
    for act in (lambda: link.send(b"x", "ask"), lambda: link.receive(9, Deadline(PATIENT_S))):
        with pytest.raises(DeviceError) as caught:
            act()
        assert caught.value.code == "HC-T02"
    link.close()


def test_a_serial_line_has_one_owner() -> None:
    file, inner = pty.openpty()
    first = open_link(TRACKER, os.ttyname(inner), lambda: None)
    with pytest.raises(DeviceError) as caught:
        open_link(TRACKER, os.ttyname(inner), lambda: None)
    assert caught.value.code == "HC-T01"
    first.close()
    os.close(inner)
    os.close(file)
