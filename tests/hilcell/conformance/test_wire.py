"""Relays that fail on demand, before a server and a serial line that answer all they receive."""

from __future__ import annotations

import os
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

from hilcell.wire import relay as wire
from hilcell.wire.channel import SerialLine
from hilcell.wire.relay import Acceptor, Relays, SerialRelay
from tests.drivers.peers import Server
from tests.fakes.wires import exactly


class Looks:
    """The time of a wire, which stands; counts how often the wire looks at it, once a round."""

    def __init__(self) -> None:
        self.now_s, self._rounds, self._changed = 0.0, 0, threading.Condition()

    def monotonic(self) -> float:
        with self._changed:
            self._rounds += 1
            self._changed.notify_all()
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        """Let no time pass."""

    def taken(self) -> None:
        """Wait until the wire has taken what had come: three rounds have begun since."""
        with self._changed:
            wanted = self._rounds + 3  # the first may have looked before, the third has handled
            self._changed.wait_for(lambda: self._rounds >= wanted)


@pytest.fixture(autouse=True)
def looks(monkeypatch: pytest.MonkeyPatch) -> Looks:
    looks = Looks()
    monkeypatch.setattr(wire, "time", looks)
    monkeypatch.setattr(wire.Relay, "POLL_S", 0.001)
    monkeypatch.setattr(wire.SocketEnd, "LEAVE_S", 60.0)  # on however slow a PC
    return looks


class Echo:
    """Answers all that it hears."""

    def __init__(self) -> None:
        self._answered = threading.Semaphore(0)
        self.ended = 0

    def __call__(self, connection: socket.socket) -> None:
        with suppress(ConnectionResetError):
            while data := connection.recv(4096):
                connection.sendall(data)
                self._answered.release()
        self.ended += 1
        connection.shutdown(socket.SHUT_RDWR)

    def heard(self, link: socket.socket, data: bytes) -> None:
        """Send data, and wait until it is answered on the wire's far side."""
        link.sendall(data)
        self._answered.acquire()


@contextmanager
def client(wires: Relays) -> Iterator[socket.socket]:
    port = wires.options["robot"]["port"]
    assert isinstance(port, int)
    with socket.create_connection(("127.0.0.1", port)) as link:
        yield link


@pytest.fixture
def echo() -> Echo:
    return Echo()


@pytest.fixture
def wires(echo: Echo) -> Iterator[Relays]:
    with Server(echo) as server:
        found = Relays({"robot": {"host": "127.0.0.1", "port": server.port}})
        yield found
        found.close()


@pytest.fixture
def link(wires: Relays) -> Iterator[socket.socket]:
    with client(wires) as link:
        yield link


def said(link: socket.socket, data: bytes) -> bytes:
    """Send data; return the answer."""
    link.sendall(data)
    return link.recv(100)


def test_bytes_pass(link: socket.socket) -> None:
    assert said(link, b"ask") == b"ask"


@pytest.mark.parametrize(("mode", "later"), [("mute", b"end"), ("hold", b"askend")])
def test_answers_do_not_come_or_come_later(
    wires: Relays, link: socket.socket, echo: Echo, looks: Looks, mode: str, later: bytes
) -> None:
    wires.set_mode(mode)
    echo.heard(link, b"ask")
    looks.taken()
    wires.pass_all()
    link.sendall(b"end")
    assert exactly(link, len(later)) == later


def test_what_is_kept_comes_first_whenever_the_mode_changes(
    wires: Relays, link: socket.socket, echo: Echo, looks: Looks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread changed it while an answer was read: that one overtook what was kept."""
    (proxy,) = wires.all
    wires.set_mode("hold")
    echo.heard(link, b"ask")
    looks.taken()
    read, passed = proxy._received, list[bytes]()

    def received(end: wire.End) -> bytes:
        passed.append(read(end))
        if passed == [b"end", b"end"]:  # the question, and now its answer
            wires.pass_all()
        return passed[-1]

    monkeypatch.setattr(proxy, "_received", received)
    link.sendall(b"end")
    assert exactly(link, 6) == b"askend"


def test_requests_are_swallowed(wires: Relays, link: socket.socket, looks: Looks) -> None:
    assert said(link, b"one") == b"one"
    wires.set_mode("blackhole")
    link.sendall(b"ask")
    looks.taken()
    wires.pass_all()
    assert said(link, b"end") == b"end"


def test_an_old_answer_comes_once_more_ahead_of_the_next_one(
    wires: Relays, link: socket.socket
) -> None:
    wires.set_mode("keep")
    assert said(link, b"old") == b"old"
    wires.pass_all()
    assert said(link, b"mid") == b"mid"
    wires.set_mode("again")
    link.sendall(b"new")
    assert exactly(link, 6) == b"oldnew"
    assert said(link, b"end") == b"end"


def test_an_old_answer_comes_as_the_first_one_to_the_next_question(
    wires: Relays, link: socket.socket, echo: Echo, looks: Looks
) -> None:
    wires.hold_after(1)
    echo.heard(link, b"one")
    assert link.recv(100) == b"one"
    echo.heard(link, b"two")
    looks.taken()
    wires.set_mode("behind")
    looks.taken()
    link.setblocking(False)
    with pytest.raises(BlockingIOError):
        link.recv(100)
    link.setblocking(True)
    link.sendall(b"three")
    assert exactly(link, 8) == b"twothree"
    assert said(link, b"four") == b"four"


def test_an_old_answer_comes_though_nobody_asks(
    wires: Relays, link: socket.socket, echo: Echo, looks: Looks
) -> None:
    wires.set_mode("hold")
    echo.heard(link, b"ask")
    looks.taken()
    wires.set_mode("behind")
    looks.taken()
    looks.now_s = 1e3
    assert link.recv(100) == b"ask"


def test_answers_come_in_pieces_as_noise_and_rewritten(wires: Relays, link: socket.socket) -> None:
    wires.set_mode("pieces")
    link.sendall(b"answer")
    assert exactly(link, 6) == b"answer"
    wires.set_mode("garbage")
    assert said(link, b"answer") == b"tttttt"
    wires.pass_all()
    wires.rewrite(b"swe", b"SWE")
    assert said(link, b"answer") == b"anSWEr"


def test_nobody_is_there_and_comes_back(wires: Relays, link: socket.socket) -> None:
    assert said(link, b"ask") == b"ask"
    wires.refuse()
    with pytest.raises(ConnectionResetError):
        link.recv(100)
    with pytest.raises(ConnectionRefusedError), client(wires):
        pass
    wires.admit()
    with client(wires) as again:
        assert said(again, b"ask") == b"ask"


def test_a_url_leads_through_and_another_device_may_be_behind() -> None:
    with Server(Echo()) as one, Server(lambda link: link.sendall(b"other")) as other:
        of_one = {"rail": {"channel": f"socket://127.0.0.1:{one.port}", "node": 5}}
        with closing(Relays(of_one)) as wires:
            assert wires.options["rail"]["node"] == 5
            wires.lead_to({"rail": {"channel": f"socket://127.0.0.1:{other.port}"}})
            port = int(str(wires.options["rail"]["channel"]).rpartition(":")[2])
            with socket.create_connection(("127.0.0.1", port)) as link:
                assert link.recv(100) == b"other"


def test_a_part_with_a_table_of_its_own_has_its_wire() -> None:
    with Server(Echo()) as one, Server(Echo()) as other:
        part = {"driver": "serial", "channel": f"socket://127.0.0.1:{other.port}"}
        stated = {"rail": {"host": "127.0.0.1", "port": one.port, "strip": part}}
        with closing(Relays(stated)) as wires:
            strip = wires.options["rail"]["strip"]
            assert isinstance(strip, dict)
            assert strip["driver"] == "serial"
            port = int(strip["channel"].rpartition(":")[2])
            assert port != other.port
            wires.rewrite(b"a", b"b")
            with socket.create_connection(("127.0.0.1", port)) as link:
                assert said(link, b"a") == b"b"
                wires.drop()
                assert link.recv(100) == b""


def test_a_door_that_is_closed_has_handed_its_last_client_on() -> None:
    entering, on, handed = threading.Event(), threading.Event(), list[socket.socket]()

    def entered(near: socket.socket) -> None:
        entering.set()
        on.wait()
        handed.append(near)

    door = Acceptor(entered)
    with socket.create_connection(("127.0.0.1", door.port)):
        entering.wait()
        closing = threading.Thread(target=door.close)
        closing.start()
        closing.join(0.05)
        assert closing.is_alive()
        on.set()
        closing.join()
        handed.pop().close()


def test_a_device_has_seen_the_end_of_what_is_dropped(wires: Relays, echo: Echo) -> None:
    for times in range(1, 20):
        with client(wires) as link:
            assert said(link, b"a") == b"a"
        with client(wires):
            pass  # the wire may not have taken it yet
        wires.drop()
        assert echo.ended >= times
        ended = echo.ended
        with client(wires) as link:
            assert said(link, b"b") == b"b"
            assert echo.ended == ended


def test_a_serial_line() -> None:
    near, far = os.openpty()
    tty.setraw(far)
    answering = threading.Thread(target=_answer, args=(near,))
    answering.start()
    wires = Relays({"tracker": {"channel": f"{os.ttyname(far)}@9600"}})
    try:
        path, _, baud = str(wires.options["tracker"]["channel"]).partition("@")
        assert baud == "9600"
        ask = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(ask, b"ask\n")
        assert os.read(ask, 100) == b"ask\n"
        wires.refuse()
        with pytest.raises(OSError, match=r"."):
            _until_gone(lambda: os.read(ask, 100))
        os.close(ask)
        assert not Path(path).is_symlink()
        wires.admit()
        ask = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(ask, b"end\n")
        assert os.read(ask, 100) == b"end\n"
        os.close(ask)
    finally:
        wires.close()
        os.close(far)
        answering.join()
        os.close(near)
    assert all(isinstance(each, SerialRelay) for each in wires.all)


@pytest.fixture
def line() -> Iterator[SerialRelay]:
    near, far = os.openpty()
    line = SerialRelay(SerialLine(os.ttyname(far)))
    yield line
    line.close()
    os.close(near)
    os.close(far)


def test_nothing_of_an_unplugged_line_is_left_to_read_the_next_one(
    line: SerialRelay, looks: Looks, monkeypatch: pytest.MonkeyPatch
) -> None:
    entered, joined = threading.Event(), threading.Event()

    def held() -> float:
        entered.set()
        joined.wait()
        return 0.0

    class Pump:
        def __init__(self, thread: threading.Thread) -> None:
            self._thread = thread

        def join(self) -> None:
            joined.set()
            self._thread.join()

    monkeypatch.setattr(line, "_threads", [Pump(each) for each in line._threads])
    monkeypatch.setattr(looks, "monotonic", held)
    threads = threading.active_count()
    entered.wait()  # its pump is in the middle of a round
    line.refuse()
    left = threading.active_count()
    joined.set()
    assert left == threads - 1


def test_a_line_that_nobody_reads_loses_what_comes_and_can_be_unplugged(
    line: SerialRelay, looks: Looks
) -> None:
    line.mode = "flood"
    for _ in range(40):  # of 4096 bytes each: more than a pseudo terminal keeps
        looks.taken()
    line.refuse()
    assert not Path(line.path).is_symlink()


def _answer(near: int) -> None:
    while (data := os.read(near, 100)) != b"end\n":
        os.write(near, data)
    os.write(near, data)


def _until_gone(read: Callable[[], bytes]) -> None:
    while read():
        pass
    raise OSError("gone")
