"""HTTP of controllers: login, cookies, framing, and answers that belong to no request."""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.abb.http_channel import Digest, HttpChannel, Login, Trust, parse_head
from drivers.device_errors import ProtocolError
from drivers.supervision import ignore_stop
from hilcell.ports import DeviceError, Stopped
from tests.drivers.peers import Server, kind, refusal

OK = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}"
CHALLENGE = (
    'Digest realm="testrealm@host.com", qop="auth,auth-int", '
    'nonce="dcd98b7102dd2f0e8b11d0f600bfb0c093", opaque="5ccc069c403ebaf9f0171e9517f40e41"'
)


def test_the_digest_of_the_rfc() -> None:
    """RFC 2617, 3.5: the same calculation as RFC 7616 with MD5."""
    digest = Digest(CHALLENGE, Login("Mufasa", "Circle Of Life"))
    header = digest.header("GET", "/dir/index.html", "0a4f113b")
    assert 'response="6629fae49393a05397450978507c4ef1"' in header
    assert "nc=00000001" in header
    assert 'opaque="5ccc069c403ebaf9f0171e9517f40e41"' in header
    assert "nc=00000002" in digest.header("GET", "/dir/index.html")


@pytest.mark.parametrize(
    "challenge", ["", "Basic realm=x", 'Digest realm="x"', CHALLENGE + ", algorithm=SHA-256"]
)
def test_a_login_that_is_no_digest(challenge: str) -> None:
    with pytest.raises(ProtocolError):
        Digest(challenge, Login("user", "password"))


@pytest.mark.parametrize(
    "head", [b"", b"HTTP/2 200 OK", b"HTTP/1.1 20 OK", b"HTTP/1.1 200 OK\r\nno colon", b"\xff" * 9]
)
def test_a_head_that_is_no_http(head: bytes) -> None:
    with pytest.raises(ProtocolError):
        parse_head(head)


@given(st.binary(max_size=200))
def test_any_head_is_read_or_refused(noise: bytes) -> None:
    for head in (noise, b"HTTP/1.1 200 OK\r\n" + noise):
        with contextlib.suppress(ProtocolError):
            status, headers = parse_head(head)
            assert 0 <= status <= 999
            assert "set-cookie" in headers


def requests(wire: socket.socket) -> Iterator[bytes]:
    """Yield the head of each request without a body."""
    received = b""
    while data := wire.recv(4096):
        received += data
        while b"\r\n\r\n" in received:
            head, _, received = received.partition(b"\r\n\r\n")
            yield head


@contextlib.contextmanager
def channel(serve: Callable[[socket.socket], None]) -> Iterator[HttpChannel]:
    with Server(serve) as server:
        login = Login("user", "password")
        found = HttpChannel("127.0.0.1", server.port, None, login, {}, ignore_stop)
        with contextlib.closing(found):
            yield found


def answering(*answers: bytes) -> Callable[[socket.socket], None]:
    def serve(wire: socket.socket) -> None:
        left = iter(answers)
        for _ in requests(wire):
            wire.sendall(next(left))

    return serve


def test_bodies_by_length_and_in_chunks() -> None:
    chunked = (
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n3;x=y\r\nabc\r\n1\r\nd\r\n0\r\n\r\n"
    )
    with channel(answering(OK, chunked, b"HTTP/1.1 204 No Content\r\n\r\n", OK)) as found:
        bodies = [found.ask("GET", "/").body for _ in range(4)]
    assert bodies == [b"{}", b"abcd", b"", b"{}"]


def test_cookies_come_back() -> None:
    heads: list[bytes] = []

    def serve(wire: socket.socket) -> None:
        for head in requests(wire):
            heads.append(head)
            wire.sendall(
                b"HTTP/1.1 200 OK\r\nSet-Cookie: -http-session-=11::x; path=/; httponly\r\n"
                b"Set-Cookie: ABBCX=17; path=/\r\nContent-Length: 0\r\n\r\n"
            )

    with channel(serve) as found:
        found.ask("GET", "/")
        found.ask("GET", "/")
    assert b"Cookie" not in heads[0]
    assert b"Cookie: -http-session-=11::x; ABBCX=17" in heads[1]


def test_a_challenge_is_met_once() -> None:
    refused = f"HTTP/1.1 401 No\r\nWWW-Authenticate: {CHALLENGE}\r\nContent-Length: 0\r\n\r\n"
    with channel(answering(*[refused.encode()] * 2)) as found:
        error = refusal(lambda: found.ask("GET", "/"))
    assert error.code == "HC-B80"
    assert "password'" not in error.found


@pytest.mark.parametrize(
    "answer",
    [
        OK + OK,
        b"\x00\x01\x02garbage\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: -2\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: 99999999\r\n\r\n",
        b"HTTP/1.1 200 OK\r\n" + b"A: b\r\n" * 4000,
        b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n",
    ],
)
def test_an_answer_that_cannot_be_used_ends_the_use(answer: bytes) -> None:
    with channel(answering(answer, OK)) as found:
        assert refusal(lambda: found.ask("GET", "/")).code == "HC-B02"
        assert "not used any more" in refusal(lambda: found.ask("GET", "/")).found


@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 401 No\r\nWWW-Authenticate: Basic realm=x\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 301 Moved\r\nLocation: https://there/\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 406 Not\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 400 Bad\r\nContent-Length: 13\r\n\r\nsent to HTTPS",
        b"\x15\x03\x03\x00\x02\x02\x46",
    ],
)
def test_an_answer_of_the_other_web_services_says_which_key_to_change(answer: bytes) -> None:
    with channel(answering(answer)) as found:
        error = refusal(lambda: found.ask("GET", "/"))
    assert error.code == "HC-B88"
    assert "robot.options.web_services = 2 and robot.options.port = 443" in error.act


def test_an_answer_without_a_request_is_never_used() -> None:
    sent = threading.Event()

    def serve(wire: socket.socket) -> None:
        for n, _ in enumerate(requests(wire)):
            wire.sendall(OK)
            if n == 0:
                wire.sendall(OK)
                sent.set()

    with channel(serve) as found:
        with contextlib.suppress(DeviceError):
            found.ask("GET", "/")
        sent.wait(5.0)
        assert refusal(lambda: found.ask("GET", "/")).code == "HC-B02"


def test_the_answer_of_a_request_that_was_only_sent_is_passed_over() -> None:
    first = b"HTTP/1.1 500 No\r\nContent-Length: 1\r\n\r\nx"
    with channel(answering(first, OK)) as found:
        found.send("GET", "/stop", b"", "")
        assert found.ask("GET", "/").body == b"{}"


def test_a_connection_that_was_closed_meanwhile_is_opened_again() -> None:
    def serve(wire: socket.socket) -> None:
        for _ in requests(wire):
            wire.sendall(OK)

    with Server(serve) as server:
        login = Login("user", "password")
        found = HttpChannel("127.0.0.1", server.port, None, login, {}, ignore_stop)
        with contextlib.closing(found):
            for _ in range(3):
                assert found.ask("GET", "/").body == b"{}"
                server.drop()


def test_a_wait_ends_at_a_stop() -> None:
    stopped = threading.Event()

    def check() -> None:
        if stopped.is_set():
            raise Stopped("a stop was asked for")

    def serve(wire: socket.socket) -> None:
        for _ in requests(wire):
            stopped.set()

    with Server(serve) as server:
        found = HttpChannel("127.0.0.1", server.port, None, Login("u", "p"), {}, check)
        with contextlib.closing(found):
            with pytest.raises(Stopped):
                found.ask("GET", "/")
            stopped.clear()
            assert "given up" in refusal(lambda: found.ask("GET", "/")).found


# -- certificates ------------------------------------------------------------------------------


def serve_tls(wire: socket.socket) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    with resources.as_file(resources.files("fakes.abb") / "simulated.pem") as path:
        context.load_cert_chain(path)
    with contextlib.suppress(OSError), context.wrap_socket(wire, server_side=True) as secure:
        for head in requests(secure):
            assert b"Authorization: Basic dXNlcjpwYXNzd29yZA==" in head
            secure.sendall(OK)


def open_tls(port: int, trust: Trust) -> HttpChannel:
    return HttpChannel("127.0.0.1", port, trust, Login("user", "password"), {}, ignore_stop)


def test_the_stated_fingerprint_is_trusted_and_no_other() -> None:
    with Server(serve_tls) as server:
        error = refusal(lambda: open_tls(server.port, Trust()))
        assert kind(error)[1] == "HC-B81"
        fingerprint = error.found.split()[-1]
        with contextlib.closing(open_tls(server.port, Trust(fingerprint.upper()))) as found:
            assert found.ask("GET", "/").body == b"{}"
        wrong = refusal(lambda: open_tls(server.port, Trust("00" + fingerprint[2:])))
        assert (wrong.code, fingerprint in wrong.found) == ("HC-B81", True)


def test_an_authority_that_did_not_sign_it_is_refused(tmp_path: Path) -> None:
    with Server(serve_tls) as server:
        missing = refusal(lambda: open_tls(server.port, Trust(ca_file=str(tmp_path / "no.pem"))))
        ours = str(resources.files("fakes.abb") / "simulated.pem")
        other = refusal(lambda: open_tls(server.port, Trust(ca_file=ours)))
    assert {missing.code, other.code} == {"HC-B81"}  # the second has another host name
