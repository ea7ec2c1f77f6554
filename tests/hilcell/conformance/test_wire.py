"""Wires that fail on demand, before a server and before a serial line that answer all they hear."""

from __future__ import annotations

import os
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from hilcell.conformance import wire
from hilcell.conformance.wire import Line, Wires
from tests.drivers.peers import Server
from tests.fakes.wires import exactly

WAIT_S = 5.0
QUIET_S = 0.2


def echo(connection: socket.socket) -> None:
    while data := connection.recv(4096):
        connection.sendall(data)


@contextmanager
def client(wires: Wires) -> Iterator[socket.socket]:
    port = wires.options["port"]
    assert isinstance(port, int)
    with socket.create_connection(("127.0.0.1", port), WAIT_S) as link:
        yield link


def nothing_comes(link: socket.socket) -> None:
    link.settimeout(QUIET_S)
    with pytest.raises(TimeoutError):
        link.recv(100)
    link.settimeout(WAIT_S)


@pytest.fixture
def wires() -> Iterator[Wires]:
    with Server(echo) as server:
        found = Wires({"host": "127.0.0.1", "port": server.port})
        yield found
        found.close()


def test_bytes_pass(wires: Wires) -> None:
    with client(wires) as link:
        link.sendall(b"ask")
        assert link.recv(100) == b"ask"


@pytest.mark.parametrize("mode", ["mute", "hold", "blackhole"])
def test_answers_do_not_come(wires: Wires, mode: str) -> None:
    with client(wires) as link:
        wires.set(mode)
        link.sendall(b"ask")
        nothing_comes(link)


def test_an_old_answer_comes_once_more_ahead_of_the_next_one(wires: Wires) -> None:
    with client(wires) as link:
        wires.set("keep")
        link.sendall(b"old")
        assert link.recv(100) == b"old"
        wires.straight()
        link.sendall(b"mid")
        assert link.recv(100) == b"mid"
        wires.set("again")
        link.sendall(b"new")
        assert exactly(link, 6) == b"oldnew"
        link.sendall(b"end")
        assert exactly(link, 3) == b"end"
        nothing_comes(link)


def test_held_answers_come_later(wires: Wires) -> None:
    with client(wires) as link:
        wires.set("hold")
        link.sendall(b"ask")
        nothing_comes(link)
        wires.straight()
        assert link.recv(100) == b"ask"


def test_an_old_answer_comes_as_the_first_one_to_the_next_question(
    wires: Wires, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wire, "BEHIND_S", 1e3)
    with client(wires) as link:
        wires.hold_after(1)
        link.sendall(b"one")
        assert link.recv(100) == b"one"
        link.sendall(b"two")
        nothing_comes(link)
        wires.set("behind")
        nothing_comes(link)
        link.sendall(b"three")
        assert exactly(link, 8) == b"twothree"
        link.sendall(b"four")
        assert link.recv(100) == b"four"


def test_an_old_answer_comes_though_nobody_asks(wires: Wires) -> None:
    with client(wires) as link:
        wires.set("hold")
        link.sendall(b"ask")
        nothing_comes(link)
        wires.set("behind")
        assert link.recv(100) == b"ask"


def test_answers_come_in_pieces_as_noise_and_rewritten(wires: Wires) -> None:
    with client(wires) as link:
        wires.set("pieces")
        found: list[bytes] = []
        while len(found) < 2:  # a busy PC may read all pieces at once; never every time
            found = []
            link.sendall(b"answer")
            while sum(map(len, found)) < len(b"answer"):
                found.append(link.recv(100))
            assert b"".join(found) == b"answer"
        wires.set("garbage")
        link.sendall(b"answer")
        assert link.recv(100) == b"tttttt"
        wires.straight()
        wires.rewrite(b"swe", b"SWE")
        link.sendall(b"answer")
        assert link.recv(100) == b"anSWEr"


def test_nobody_is_there_and_comes_back(wires: Wires) -> None:
    with client(wires) as link:
        link.sendall(b"ask")
        assert link.recv(100) == b"ask"
        wires.refuse()
        with pytest.raises(ConnectionResetError):
            link.recv(100)
    with pytest.raises(ConnectionRefusedError), client(wires):
        pass
    wires.admit()
    with client(wires) as link:
        link.sendall(b"ask")
        assert link.recv(100) == b"ask"


def test_a_url_leads_through_and_another_device_may_be_behind() -> None:
    with Server(echo) as one, Server(lambda link: link.sendall(b"other")) as other:
        wires = Wires({"channel": f"socket://127.0.0.1:{one.port}", "baud": "115200"})
        try:
            assert wires.options["baud"] == "115200"
            wires.lead_to({"channel": f"socket://127.0.0.1:{other.port}"})
            port = int(str(wires.options["channel"]).rpartition(":")[2])
            with socket.create_connection(("127.0.0.1", port), WAIT_S) as link:
                assert link.recv(100) == b"other"
        finally:
            wires.close()


def test_a_serial_line() -> None:
    near, far = os.openpty()
    tty.setraw(far)
    answering = threading.Thread(target=_answer, args=(near,))
    answering.start()
    wires = Wires({"channel": f"{os.ttyname(far)}@9600"})
    try:
        path, _, baud = str(wires.options["channel"]).partition("@")
        assert baud == "9600"
        ask = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(ask, b"ask\n")
        assert os.read(ask, 100) == b"ask\n"
        wires.refuse()
        with pytest.raises(OSError, match=r"."):
            _until_gone(lambda: os.read(ask, 100))
        os.close(ask)
        assert not os.path.exists(path)  # noqa: PTH110 - the path is a link whose end is gone
        wires.admit()
        ask = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(ask, b"end\n")
        assert os.read(ask, 100) == b"end\n"
        os.close(ask)
    finally:
        wires.close()
        os.close(far)
        answering.join(WAIT_S)
        os.close(near)
    assert all(isinstance(each, Line) for each in wires.all)


def _answer(near: int) -> None:
    while (data := os.read(near, 100)) != b"end\n":
        os.write(near, data)
    os.write(near, data)


def _until_gone(read: Callable[[], bytes]) -> None:
    while read():
        pass
    raise OSError("gone")


def test_a_part_with_a_table_of_its_own_has_its_wire() -> None:
    with Server(echo) as one, Server(echo) as other:
        part = {"driver": "serial", "channel": f"socket://127.0.0.1:{other.port}"}
        wires = Wires({"host": "127.0.0.1", "port": one.port, "strip": part})
        try:
            strip = wires.options["strip"]
            assert isinstance(strip, dict)
            assert strip["driver"] == "serial"
            port = int(strip["channel"].rpartition(":")[2])
            assert port != other.port
            wires.rewrite(b"a", b"b")
            with socket.create_connection(("127.0.0.1", port), WAIT_S) as link:
                link.sendall(b"a")
                assert link.recv(100) == b"b"
                wires.drop()
                with pytest.raises(ConnectionResetError):
                    link.recv(100)
        finally:
            wires.close()
