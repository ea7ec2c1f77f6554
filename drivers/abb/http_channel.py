"""HTTP over one connection whose waits end at a stop; TLS, digest and basic login, cookies.

The standard library's client blocks in its reads, so this one reads a `drivers.wires.Link`. One
answer follows each request, in their order (RFC 9112, 9.3): bytes beyond the awaited answers belong
to no request, and after a request without its answer the next answer could be of either. Both end
the use of the connection. Digest: RFC 7616 with MD5 and ``qop="auth"``, as a controller asks for
it. TLS checks a certificate by its fingerprint, or by a certificate authority.
"""

from __future__ import annotations

import base64
import hashlib
import re
import secrets
import ssl
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from drivers.device_errors import ROBOT, ProtocolError
from drivers.supervision import Deadline, on_failure
from drivers.wires import Link, TcpLink
from hilcell.ports import DeviceError
from hilcell.sanitize import clean

RECEIVE = 65536
LONGEST_HEAD, LONGEST_BODY = 16_384, 8_000_000
UNAUTHORIZED, NO_CONTENT, NOT_MODIFIED, BAD_REQUEST, NOT_ACCEPTABLE = 401, 204, 304, 400, 406
TLS_ALERT = b"\x15\x03"  # RFC 8446, 5.1
PORTS = {1: 80, 2: 443}


@dataclass(frozen=True, slots=True)
class Trust:
    """Which certificate a controller may show: one with this fingerprint, or of this authority."""

    fingerprint: str = ""  # SHA-256, hexadecimal
    ca_file: str = ""


@dataclass(slots=True)
class Login:
    """User, password, and the cookies of the one session that several connections share."""

    user: str
    password: str
    cookies: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer; header names are in small letters."""

    status: int
    headers: Mapping[str, str]
    body: bytes


def other_generation(address: str, signs: str, other: int) -> DeviceError:
    """Return the error of a controller that speaks the ``other`` generation of web services."""
    return ROBOT.refused(
        "HC-B88",
        "connect",
        f"{address}: {signs}, as web services {other} do",
        expected=f"web services {3 - other}, by robot.options.web_services",
        act=f"set robot.options.web_services = {other} and robot.options.port = {PORTS[other]}; "
        f"where web services {3 - other} are right, the port is {PORTS[3 - other]}",
    )


class TlsLink(Link):
    """TLS over a link; any thread may send."""

    HANDSHAKE_S = 5.0

    def __init__(self, under: Link, host: str, trust: Trust, check: Callable[[], None]) -> None:
        super().__init__(ROBOT, under.address, check)
        self._under, self._lock = under, threading.Lock()
        self._in, self._out = ssl.MemoryBIO(), ssl.MemoryBIO()
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        if trust.ca_file:
            try:
                context.load_verify_locations(Path(trust.ca_file))
            except OSError as error:  # also of TLS
                raise self._untrusted(f"{trust.ca_file}: {error}", "a file of certificates") from (
                    error
                )
        else:
            # Controllers show certificates that they have signed themselves.
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        self._tls = context.wrap_bio(self._in, self._out, server_hostname=host)
        self._shake_hands()
        if not trust.ca_file:
            self._check_fingerprint(trust.fingerprint)

    def send(self, data: bytes, operation: str) -> None:
        with self._lock:
            self._tls.write(data)
            self._under.send(self._out.read(), operation)

    def close(self) -> None:
        self._under.close()

    def _poll(self, size: int, *, wait: bool) -> bytes:
        """Return decrypted bytes; the link under it waits."""
        if data := self._decrypted(size):
            return data
        self._in.write(self._under.receive(RECEIVE, Deadline(0.02 if wait else 0.0)))
        return self._decrypted(size)

    def _decrypted(self, size: int) -> bytes:
        with self._lock:
            try:
                return self._tls.read(size)
            except ssl.SSLWantReadError:
                return b""
            except ssl.SSLError as error:
                raise self.broken("receive", str(error)) from error

    def _shake_hands(self) -> None:
        deadline, piece = Deadline(self.HANDSHAKE_S), b""
        while True:
            try:
                self._tls.do_handshake()
            except ssl.SSLWantReadError:
                self._flush()
                piece = self._under.receive(RECEIVE, deadline)
                if not piece:
                    raise self.broken("connect", "no TLS answer") from None
                self._in.write(piece)
            except ssl.SSLCertVerificationError as error:
                found = f"{self.address}: {error.verify_message}"
                raise self._untrusted(found, "a certificate of robot.options.ca_file") from error
            except ssl.SSLError as error:
                if piece.startswith(b"HTTP/"):
                    raise other_generation(self.address, "it answers without TLS", 1) from error
                raise self.broken("connect", str(error)) from error
            else:
                self._flush()
                return

    def _flush(self) -> None:
        if data := self._out.read():
            self._under.send(data, "connect")

    def _check_fingerprint(self, expected: str) -> None:
        certificate = self._tls.getpeercert(binary_form=True) or b""
        found = hashlib.sha256(certificate).hexdigest()
        if found != re.sub("[: ]", "", expected).casefold():
            text = f"{self.address}: the certificate has the SHA-256 fingerprint {found}"
            raise self._untrusted(text, expected or "one in robot.options.certificate_sha256")

    @staticmethod
    def _untrusted(found: str, expected: str) -> DeviceError:
        return ROBOT.refused("HC-B81", "connect", found, expected=expected)


class Digest:
    """Answers to one challenge; each request has the next count."""

    def __init__(self, challenge: str, login: Login) -> None:
        """Read the value of a WWW-Authenticate header; raises `ProtocolError`."""
        pairs = re.findall(r'(\w+)=(?:"([^"]*)"|([^\s,]+))', challenge)
        values = {name.casefold(): quoted or plain for name, quoted, plain in pairs}
        if not challenge.casefold().startswith("digest ") or not {"realm", "nonce"} <= set(values):
            raise ProtocolError(f"login {clean(challenge)[:60]!r} is no digest")
        if (
            values.get("algorithm", "MD5").upper() != "MD5"
            or "auth" not in values.get("qop", "auth").split(",")[0]
        ):
            raise ProtocolError(f"login {clean(challenge)[:80]!r} is not MD5 with auth")
        self._values, self._login, self._count = values, login, 0

    def header(self, method: str, path: str, client_nonce: str = "") -> str:
        """Return the value of the Authorization header of a request."""
        self._count += 1
        realm, nonce = self._values["realm"], self._values["nonce"]
        count, client_nonce = f"{self._count:08x}", client_nonce or secrets.token_hex(8)
        secret = md5(f"{self._login.user}:{realm}:{self._login.password}")
        asked = md5(f"{method}:{path}")
        response = md5(f"{secret}:{nonce}:{count}:{client_nonce}:auth:{asked}")
        header = (
            f'Digest username="{self._login.user}", realm="{realm}", nonce="{nonce}", '
            f'uri="{path}", qop=auth, nc={count}, cnonce="{client_nonce}", response="{response}"'
        )
        opaque = self._values.get("opaque")
        return f'{header}, opaque="{opaque}"' if opaque is not None else header


def md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


class HttpChannel:
    """One connection. One thread asks; any thread may send a request without awaiting its answer.

    A connection that the controller has closed while nothing was asked is opened again.
    """

    ANSWER_S = 3.0

    def __init__(
        self,
        host: str,
        port: int,
        trust: Trust | None,
        login: Login,
        headers: Mapping[str, str],
        check: Callable[[], None],
    ) -> None:
        """``trust`` None: without TLS, and with digest login. ``headers`` are of each request."""
        self.address = f"{host}:{port}"
        self._host, self._port, self._trust, self._login = host, port, trust, login
        self._headers, self._check = headers, check
        self._lock = threading.Lock()  # of the order of requests
        self._digest: Digest | None = None
        self._link = self._open()
        self._received, self._dead = b"", ""
        self._sent = self._answered = 0

    def ask(self, method: str, path: str, body: bytes = b"", kind: str = "") -> Answer:
        """Send a request and return its answer; raises `DeviceError`.

        The controller's login challenge is met once.
        """
        operation = f"{method} {path.partition('?')[0]}"
        answer = self._exchange(method, path, body, kind, operation)
        if signs := self._foreign(answer):
            other = 2 if self._trust is None else 1
            raise other_generation(self.address, f"{operation} has the answer {signs}", other)
        if answer.status == UNAUTHORIZED and self._trust is None:
            try:
                self._digest = Digest(answer.headers.get("www-authenticate", ""), self._login)
            except ProtocolError as error:
                raise self._unusable(operation, str(error)) from error
            answer = self._exchange(method, path, body, kind, operation)
        if answer.status == UNAUTHORIZED:
            raise ROBOT.refused(
                "HC-B80",
                "connect",
                f"{self.address} refuses user {self._login.user!r} with its password",
                expected="a user of the controller's authorization system",
            )
        return answer

    def _foreign(self, answer: Answer) -> str:
        """Return the signs by which an answer is of the other generation, or ""."""
        login = answer.headers.get("www-authenticate", "").partition(" ")[0].casefold()
        status = answer.status
        if status == UNAUTHORIZED and login == ("basic" if self._trust is None else "digest"):
            return f"{status} with {login} login"
        to = answer.headers.get("location", "")
        if self._trust is None and 300 <= status < 400 and to.startswith("https:"):
            return f"{status} to {clean(to)[:60]}"
        if self._trust is None and status == BAD_REQUEST and b"HTTPS" in answer.body:
            return f"{status}, which asks for HTTPS"
        return f"{status}" if status == NOT_ACCEPTABLE else ""

    def send(self, method: str, path: str, body: bytes, kind: str) -> None:
        """Send a request whose answer is not awaited; callable from any thread."""
        with self._lock:
            self._send(method, path, body, kind, f"{method} {path}")

    def close(self) -> None:
        self._link.close()

    # -- requests -----------------------------------------------------------------------------

    def _open(self) -> Link:
        link: Link = TcpLink(ROBOT, self._host, self._port, self._check)
        if self._trust is None:
            return link
        with on_failure(link.close):
            return TlsLink(link, self._host, self._trust, self._check)

    def _exchange(self, method: str, path: str, body: bytes, kind: str, operation: str) -> Answer:
        if self._dead:
            raise self._link.broken(operation, f"not used any more: {self._dead}")
        self._take_unasked(operation)
        with self._lock:
            self._send(method, path, body, kind, operation)
            awaited = self._sent
        # An answer that is not awaited to its end leaves the connection without order.
        self._dead = f"the answer to {operation} was given up"
        deadline = Deadline(self.ANSWER_S)
        while True:
            answer = self._answer(method if self._answered == awaited - 1 else "", deadline)
            self._answered += 1
            if self._answered == awaited:
                break
        if self._received and self._answered == self._sent:
            raise self._unusable(operation, "more than one answer")
        self._dead = ""
        return answer

    def _take_unasked(self, operation: str) -> None:
        """Refuse bytes that came unasked; open a connection again that was closed meanwhile."""
        try:
            self._received += self._link.receive(RECEIVE, Deadline(0.0))
        except DeviceError:
            self._link.close()
            link = self._open()  # without the lock: a stop that comes meanwhile fails at once
            with self._lock:
                self._link, self._received, self._answered = link, b"", self._sent
            return
        if self._received and self._answered == self._sent:
            raise self._unusable(operation, "an answer came without a request")

    def _send(self, method: str, path: str, body: bytes, kind: str, operation: str) -> None:
        lines = [f"{method} {path} HTTP/1.1", f"Host: {self.address}"]
        lines += [f"{name}: {value}" for name, value in self._headers.items()]
        if self._trust is not None:
            pair = f"{self._login.user}:{self._login.password}".encode()
            lines.append(f"Authorization: Basic {base64.b64encode(pair).decode()}")
        elif self._digest is not None:
            lines.append(f"Authorization: {self._digest.header(method, path)}")
        if cookies := self._login.cookies:
            pairs = "; ".join(f"{name}={value}" for name, value in cookies.items())
            lines.append(f"Cookie: {pairs}")
        if kind:
            lines.append(f"Content-Type: {kind}")
        if body or method != "GET":
            lines.append(f"Content-Length: {len(body)}")
        head = "\r\n".join([*lines, "", ""]).encode("latin-1", "replace")
        self._link.send(head + body, operation)
        self._sent += 1

    # -- answers ------------------------------------------------------------------------------

    def _answer(self, method: str, deadline: Deadline) -> Answer:
        operation = method or "receive"
        try:
            head = self._until(b"\r\n\r\n", LONGEST_HEAD, deadline, operation)
            status, headers = parse_head(head)
            for name, value in re.findall(r"(?:^|\n)([^=;\s]+)=([^;\n]*)", headers["set-cookie"]):
                self._login.cookies[name] = value
            body = self._body(status, headers, deadline, operation)
        except ProtocolError as error:
            raise self._unusable(operation, str(error)) from error
        return Answer(status, headers, body)

    def _body(
        self, status: int, headers: Mapping[str, str], deadline: Deadline, operation: str
    ) -> bytes:
        if status in (NO_CONTENT, NOT_MODIFIED):
            return b""
        if headers.get("transfer-encoding", "").casefold() == "chunked":
            body = b""
            while True:
                size = self._until(b"\r\n", 20, deadline, operation).partition(b";")[0]
                length = number(size.decode("latin-1"), 16)
                if len(body) + length > LONGEST_BODY:
                    raise ProtocolError(f"a body of more than {LONGEST_BODY} bytes")
                body += self._take(length, deadline, operation)
                self._take(2, deadline, operation)
                if not length:
                    return body
        length = number(headers.get("content-length", "0"), 10)
        if length > LONGEST_BODY:
            raise ProtocolError(f"a body of {length} bytes, {LONGEST_BODY} are possible")
        return self._take(length, deadline, operation)

    def _until(self, end: bytes, longest: int, deadline: Deadline, operation: str) -> bytes:
        while (at := self._received.find(end)) < 0:
            if len(self._received) > longest:
                raise ProtocolError(f"{len(self._received)} bytes without an end")
            self._more(deadline, operation)
        found, self._received = self._received[:at], self._received[at + len(end) :]
        return found

    def _take(self, length: int, deadline: Deadline, operation: str) -> bytes:
        while len(self._received) < length:
            self._more(deadline, operation)
        found, self._received = self._received[:length], self._received[length:]
        return found

    def _more(self, deadline: Deadline, operation: str) -> None:
        piece = self._link.receive(RECEIVE, deadline)
        if not piece:
            started = f"; {len(self._received)} bytes of one came" if self._received else ""
            raise self._link.broken(operation, f"no answer within {self.ANSWER_S:.1f} s{started}")
        self._received += piece
        if self._trust is None and self._received.startswith(TLS_ALERT):
            raise other_generation(self.address, f"{operation} has an answer in TLS", 2)

    def _unusable(self, operation: str, found: str) -> DeviceError:
        self._dead = found
        return self._link.broken(operation, found)


def parse_head(head: bytes) -> tuple[int, dict[str, str]]:
    """Return status and headers; those of the same name on lines. Raises `ProtocolError`."""
    first, *lines = head.decode("latin-1").split("\r\n")
    status = re.fullmatch(r"HTTP/1\.[01] (\d{3})(?: .*)?", first)
    if status is None:
        raise ProtocolError(f"no HTTP: {first[:60]!r}")
    headers = {"set-cookie": ""}
    for line in lines:
        name, colon, value = line.partition(":")
        if not colon or not re.fullmatch(r"[!#-'*+.^-z|~0-9A-Z-]+", name):
            raise ProtocolError(f"no header: {line[:60]!r}")
        before = headers.get(name.casefold(), "")
        headers[name.casefold()] = f"{before}\n{value.strip()}" if before else value.strip()
    return int(status[1]), headers


def number(text: str, base: int) -> int:
    """Return a length; raises `ProtocolError`."""
    if not re.fullmatch("[0-9a-fA-F]{1,8}", text.strip()):
        raise ProtocolError(f"length {text[:20]!r} is no number")
    try:
        return int(text, base)
    except ValueError:
        raise ProtocolError(f"length {text[:20]!r} is no number") from None
