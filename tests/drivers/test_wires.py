"""Wires of bytes and of lines: pseudo terminals and sockets, also on a PC that was late."""

from __future__ import annotations

import os
import pty
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from types import SimpleNamespace

import pytest

from drivers import supervision
from drivers.device_errors import ROBOT, TRACKER
from drivers.kuka.robot_c3 import C3Connection
from drivers.kuka.robot_eki import EkiChannel
from drivers.supervision import Deadline, ignore_stop
from drivers.universal_robots.rtde import Dashboard
from drivers.wires import Link, TcpLink, TextLines, open_link
from hilcell.ports import DeviceError
from hilcell.wire.channel import SerialLine, Socket, parse_channel
from tests.drivers.peers import Server, refusal, wire_time

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


def test_pending_lines_are_dropped(far: Far) -> None:
    lines = TextLines(far.link)
    far.says(b"late\r\nhalf")
    assert lines.receive(Deadline(PATIENT_S)) == "late"
    lines.drop_pending()
    far.says(b" a line\r\n")
    assert lines.receive(Deadline(PATIENT_S)) == "a line"


def test_bytes_that_are_no_text_are_an_error_that_names_the_baud_rate(far: Far) -> None:
    lines = TextLines(far.link)
    far.says(b"\x86\xf8\x00~\r\n")
    assert refusal(lambda: lines.receive(Deadline(PATIENT_S))).code == "HC-T02"


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
    assert refusal(lambda: lines.receive(Deadline(PATIENT_S))).code == "HC-T02"


def test_a_wire_that_was_closed_is_lost(far: Far) -> None:
    far.link.close()
    assert refusal(lambda: far.link.receive(10, Deadline(PATIENT_S))).code == "HC-T02"
    assert refusal(lambda: far.link.send(b"x", "ask")).code == "HC-T02"


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
        assert refusal(act).code == "HC-T02"
    link.close()


def test_a_serial_line_has_one_owner() -> None:
    file, inner = pty.openpty()
    first = open_link(TRACKER, os.ttyname(inner), lambda: None)
    assert refusal(lambda: open_link(TRACKER, os.ttyname(inner), lambda: None)).code == "HC-T01"
    first.close()
    os.close(inner)
    os.close(file)


def keep_silent(connection: socket.socket) -> None:
    connection.recv(1)


def keep_until(end: threading.Event) -> Callable[[socket.socket], None]:
    """Return a device that neither reads nor answers until then."""

    def serve(_: socket.socket) -> None:
        end.wait()

    return serve


@contextmanager
def link_to(
    serve: Callable[[socket.socket], None], check: Callable[[], None] = lambda: None
) -> Iterator[TcpLink]:
    with Server(serve) as server, closing(TcpLink(ROBOT, "127.0.0.1", server.port, check)) as link:
        yield link


@pytest.fixture
def starved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every look comes five seconds after the one before."""
    now_s = iter(range(0, 100_000, 5))
    monkeypatch.setattr(supervision, "time", SimpleNamespace(monotonic=lambda: float(next(now_s))))


@pytest.mark.usefixtures("starved")
def test_an_answer_that_comes_before_the_next_look_is_taken() -> None:
    looks = 0
    asked = threading.Event()

    def answer(connection: socket.socket) -> None:
        asked.wait()
        connection.sendall(b"here")
        connection.recv(1)

    def check() -> None:
        nonlocal looks
        looks += 1
        if looks == 4:
            asked.set()

    with link_to(answer, check) as link:
        assert link.receive(10, Deadline(2.0)) == b"here"


@pytest.mark.usefixtures("starved")
def test_a_silent_device_is_silent_all_the_same() -> None:
    with link_to(keep_silent) as link:
        assert link.receive(10, Deadline(0.3)) == b""


def test_bytes_that_have_arrived_are_taken_though_the_time_is_up() -> None:
    sent = threading.Event()

    def speak(connection: socket.socket) -> None:
        connection.sendall(b"here")
        sent.set()
        connection.recv(1)

    with link_to(speak) as link:
        sent.wait()
        assert link.receive(10, Deadline(0.0)) == b"here"


def test_a_device_that_takes_no_bytes_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.wires.SEND_S", 0.05)
    end = threading.Event()

    with link_to(keep_until(end)) as link:  # it takes nothing
        assert refusal(lambda: link.send(bytes(64_000_000), "write HC_TGT")).code == "HC-B02"
        end.set()


def stop_by_c3(port: int) -> C3Connection:
    line = C3Connection("127.0.0.1", port, ignore_stop)
    line.write_without_reply("HC_STOP", "TRUE")
    return line


def stop_by_eki(port: int) -> EkiChannel:
    line = EkiChannel("127.0.0.1", port, "Robot", ignore_stop, b"")
    line.send_without_reply(b"<Stop/>")
    return line


def stop_by_dashboard(port: int) -> Dashboard:
    line = Dashboard("127.0.0.1", port, ignore_stop)
    line.send("stop")
    return line


@pytest.mark.parametrize("stop", [stop_by_c3, stop_by_eki, stop_by_dashboard])
def test_a_stop_without_an_answer_was_taken_when_its_line_is_closed(
    stop: Callable[[int], C3Connection | EkiChannel | Dashboard],
) -> None:
    taken = threading.Event()

    def take(connection: socket.socket) -> None:
        connection.sendall(f"{Dashboard.GREETING}\n".encode())
        while connection.recv(4):
            pass
        for _ in range(2):  # a line that is closed refuses the second
            connection.sendall(b"\n")
        taken.set()

    with Server(take) as server:
        line = stop(server.port)
        line.close()
        line.close()
    assert taken.is_set()


def test_a_device_that_never_closes_its_end_delays_no_close(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    time = wire_time(monkeypatch, supervision)
    time.silence(0.1)
    closed = threading.Event()

    with link_to(keep_until(closed)) as link:
        link.reply_pending = True
        link.close()
        closed.set()
