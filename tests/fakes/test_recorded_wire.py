"""A recorded wire over real sockets."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from drivers.kuka.robot_c3 import decode_body, encode_write
from fakes.replay.dialects import Dialect, dialects_of
from fakes.replay.event_time import EventTime
from fakes.replay.recorded_wire import RecordedWire, exchanges
from fakes.wires import Listener
from hilcell.wire.channel import Socket, parse_channel
from hilcell.wire.recording import Piece


@contextmanager
def wire(*connections: tuple[bytes, bytes]) -> Iterator[tuple[str, int]]:
    """Serve connections that were open at once, each with one question and its answer."""
    pieces = [Piece.of(0.1 * n, n, "open") for n in range(1, len(connections) + 1)]
    for n, (asked, answer) in enumerate(connections, 1):
        pieces += [Piece.of(n, n, ">", asked), Piece.of(n + 0.5, n, "<", answer)]
    pieces += [Piece.of(9, n, "end") for n in range(1, len(connections) + 1)]
    served = RecordedWire(pieces, Dialect(), EventTime(), "here")
    served.start()
    with closing(served):
        place = parse_channel(served.channel)
        assert isinstance(place, Socket)
        yield place.host, place.port


def test_connections_are_served_in_the_order_in_which_they_were_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A busy PC may run the thread of the second one first."""
    second, serve = threading.Event(), Listener._run
    one, two = socket.socket(), socket.socket()
    one.bind(("127.0.0.1", 0))
    first = one.getsockname()

    def run_later(self: Listener, client: socket.socket) -> None:
        if client.getpeername() == first:
            second.wait()
        serve(self, client)

    monkeypatch.setattr(Listener, "_run", run_later)
    with wire((b"first\n", b"1\n"), (b"second\n", b"2\n")) as place, one, two:
        try:
            one.connect(place)
            two.connect(place)
            two.sendall(b"second\n")
            assert two.recv(9) == b"2\n"
        finally:
            second.set()
        one.sendall(b"first\n")
        assert one.recv(9) == b"1\n"


def test_an_idle_connection_is_kept_alive_by_what_another_was_asked() -> None:
    with (
        wire((b"mode\nmode\n", b"1\n"), (b"stop\n", b"2\n")) as place,
        socket.create_connection(place),
        socket.create_connection(place) as two,
    ):
        two.sendall(b"mode\n")
        assert two.recv(9) == b"1\n"


def test_a_robot_takes_a_sign_of_life_that_was_never_given() -> None:
    """A motion that is over within the time of one, as it was recorded."""
    c3 = dialects_of("kuka-c3")[""]
    (reply,) = c3.alive(encode_write(7, "$TIMER[10]", "-1500"))
    assert reply[:4] == bytes((0, 7, 0, len(reply) - 4))
    assert decode_body(7, reply[4:]).value == "-1500"
    assert c3.alive(encode_write(8, "HC_STOP", "TRUE")) == []


def test_a_sign_of_life_lets_no_recorded_time_pass() -> None:
    """A late PC gives one earlier than was recorded; one that was never answered stays silent."""
    c3 = dialects_of("kuka-c3")[""]
    sign = encode_write(7, "$TIMER[10]", "-1500")
    (reply,) = c3.alive(sign)
    given = [Piece.of(5, 1, ">", sign), Piece.of(5, 1, "<", reply)]
    assert [each.asked for each in exchanges(given, c3)] == [b""]
    assert [each.asked for each in exchanges(given[:1], c3)] == [b"", sign]
