"""A PC that did not run is no reason to call a device silent."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from drivers import supervision
from drivers.device_errors import ROBOT
from drivers.kuka.robot_c3 import C3Connection
from drivers.kuka.robot_eki import EkiChannel
from drivers.supervision import Deadline, ignore_stop
from drivers.universal_robots.rtde import Dashboard
from drivers.wires import TcpLink
from hilcell.ports import DeviceError
from tests.drivers.peers import Server, wire_time


def keep_silent(connection: socket.socket) -> None:
    connection.recv(1)


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

    with Server(answer) as server:
        link = TcpLink(ROBOT, "127.0.0.1", server.port, check)
        assert link.receive(10, Deadline(2.0)) == b"here"
        link.close()


@pytest.mark.usefixtures("starved")
def test_a_silent_device_is_silent_all_the_same() -> None:
    with Server(keep_silent) as server:
        link = TcpLink(ROBOT, "127.0.0.1", server.port, lambda: None)
        assert link.receive(10, Deadline(0.3)) == b""
        link.close()


def test_what_has_arrived_is_taken_though_the_time_is_up() -> None:
    sent = threading.Event()

    def speak(connection: socket.socket) -> None:
        connection.sendall(b"here")
        sent.set()
        connection.recv(1)

    with Server(speak) as server:
        link = TcpLink(ROBOT, "127.0.0.1", server.port, lambda: None)
        sent.wait()
        assert link.receive(10, Deadline(0.0)) == b"here"
        link.close()


def test_a_device_that_takes_no_bytes_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.wires.SEND_S", 0.05)
    end = threading.Event()

    def take_nothing(_: socket.socket) -> None:
        end.wait()

    with Server(take_nothing) as server:
        link = TcpLink(ROBOT, "127.0.0.1", server.port, lambda: None)
        with pytest.raises(DeviceError) as caught:
            link.send(bytes(64_000_000), "write HC_TGT")
        assert caught.value.code == "HC-B02"
        end.set()
        link.close()


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
def test_a_stop_that_nobody_waits_for_was_taken_when_its_line_is_closed(
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


def test_a_device_that_never_closes_its_end_keeps_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    time = wire_time(monkeypatch, supervision)
    time.silence(0.1)
    closed = threading.Event()

    def keep(_: socket.socket) -> None:
        closed.wait()

    with Server(keep) as server:
        link = TcpLink(ROBOT, "127.0.0.1", server.port, lambda: None)
        link.reply_pending = True
        link.close()
        closed.set()
