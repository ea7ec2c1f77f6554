"""Robot Web Services and the position stream of one ABB controller, as a PC meets them.

Generation 1 by 3HAC050973: HTTP, digest login, cookies of a session. Generation 2 by 3HAC073675:
HTTPS with a certificate signed by itself, basic login. Which one follows from
``robot.options.web_services``. At most 70 sessions; 503 beyond. The stream is EGM's: a datagram in
4 ms to the port of the PC that the system parameters state, while the program runs; some are lost,
doubled or late, which ones depends on their numbers alone.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import re
import secrets
import socket
import ssl
import struct
import threading
import time
from importlib import resources
from typing import Any, NamedTuple, Protocol
from urllib.parse import parse_qs, unquote

import numpy as np

from fakes.abb.controller import DEVICE, AbbController, RapidError
from fakes.site import Site
from fakes.truth.transforms import Array
from fakes.wires import HOST, RECEIVE, Answers, Listener, Segments, Server

USER, PASSWORD, REALM = "Default User", "robotics", "validusers@robapi.abb"
CERTIFICATE = "simulated.pem"
NOT_TLS = b"HTTP/1.1 400 Bad Request\r\nContent-Length: 22\r\n\r\nsent to the HTTPS port"
SYMBOL_FAULT = -1073414146
MINUS_01 = "-01"  # a number as RobotWare 7.20 writes it in events, which is no JSON


class Request(NamedTuple):
    """A request with its query and its form."""

    method: str
    path: str
    query: dict[str, str]
    headers: dict[str, str]
    form: dict[str, str]
    target: str  # path with query as they came


class Reply(NamedTuple):
    """An answer: objects of a state, or None for no content."""

    status: int
    states: list[dict[str, Any]] | None = None
    headers: tuple[str, ...] = ()


class Client(Protocol):
    """A connection."""

    def recv(self, size: int, /) -> bytes: ...
    def sendall(self, data: bytes, /) -> None: ...
    def settimeout(self, value: float | None, /) -> None: ...


class TlsClient:
    """The server's end of TLS over a socket, which stays the listener's to close."""

    def __init__(self, client: socket.socket, context: ssl.SSLContext) -> None:
        self._client, self.settimeout = client, client.settimeout
        self._in, self._out = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._in, self._out, server_side=True)

    def recv(self, size: int, /) -> bytes:
        while True:
            try:
                return self._tls.read(size)
            except ssl.SSLWantReadError:
                self._flush()
            except ssl.SSLError as error:
                if error.reason == "HTTP_REQUEST":
                    self._client.sendall(NOT_TLS)
                self._flush()
                raise OSError("TLS") from error
            data = self._client.recv(RECEIVE)
            if not data:
                return b""
            self._in.write(data)

    def sendall(self, data: bytes, /) -> None:
        self._tls.write(data)
        self._flush()

    def _flush(self) -> None:
        if data := self._out.read():
            self._client.sendall(data)


class Sessions:
    """Sessions: cookies, digest challenges, and which one has the mastership."""

    MOST = 70

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.open: set[str] = set()
        self._nonces: dict[str, int] = {}  # the last count of each
        self.holder = ""  # session with the mastership

    def of(self, cookies: str) -> str | None:
        """Return the session of a request, a new one where it has none; None if there are 70."""
        known = re.search(r"-http-session-=([0-9a-f]+)", cookies)
        with self._lock:
            if known and known[1] in self.open:
                return known[1]
            if len(self.open) >= self.MOST:
                return None
            name = secrets.token_hex(8)
            self.open.add(name)
            return name

    def end(self, session: str) -> None:
        with self._lock:
            self.open.discard(session)
            if self.holder == session:
                self.holder = ""

    def forget_challenges(self) -> None:
        """Let every login expire: the next request of each connection is challenged again."""
        with self._lock:
            self._nonces.clear()

    def challenge(self) -> str:
        nonce = secrets.token_hex(16)
        with self._lock:
            self._nonces[nonce] = 0
        return (
            f'WWW-Authenticate: Digest realm="{REALM}", domain="/", qop="auth", nonce="{nonce}", '
            'opaque="799d5", algorithm="MD5", stale="FALSE"'
        )

    def admits(self, request: Request, generation: int) -> bool:
        """Whether the request has a good login."""
        given = request.headers.get("authorization", "")
        if generation > 1:
            pair = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()
            return given == f"Basic {pair}"
        values = {k: q or p for k, q, p in re.findall(r'(\w+)=(?:"([^"]*)"|([^\s,]+))', given)}
        with self._lock:
            count = int(values.get("nc", "0"), 16)
            last = self._nonces.get(values.get("nonce", ""))
            if last is None or count <= last:
                return False
            self._nonces[values["nonce"]] = count
        secret = _md5(f"{USER}:{REALM}:{PASSWORD}")
        asked = _md5(f"{request.method}:{request.target}")
        middle = ":".join(values.get(name, "") for name in ("nonce", "nc", "cnonce", "qop"))
        good = _md5(f"{secret}:{middle}:{asked}")
        same_target = values.get("uri") == request.target
        return values.get("username") == USER and same_target and values.get("response") == good


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


class Resources:
    """The resources of the web services."""

    def __init__(
        self, controller: AbbController, sessions: Sessions, generation: int, stream_port: int
    ) -> None:
        self._controller, self._sessions, self._generation = controller, sessions, generation
        self.stream_host, self.stream_port = HOST, stream_port

    def answer(self, request: Request, session: str) -> Reply:
        action = request.query.get("action", "")
        path = request.path
        if self._generation == 1 and action:
            path = f"{path}/{action}"
        if request.method == "POST":
            return self._write(path, request.form, session, request.query)
        return self._read(path, session)

    # -- reading ------------------------------------------------------------------------------

    def _read(self, path: str, session: str) -> Reply:
        if path == "/logout":
            self._sessions.end(session)
            return Reply(200, [])
        if name := self._symbol(path):
            return self._symbol_value(name)
        states = self._fixed(path, session)
        if states is None and path.startswith("/rw/motionsystem/mechunits/ROB_1/"):
            states = self._position(path.rpartition("/")[2])
        return Reply(404) if states is None else Reply(200, states)

    def _fixed(self, path: str, session: str) -> list[dict[str, Any]] | None:
        controller = self._controller
        state_path = "ctrlstate" if self._generation == 1 else "ctrl-state"
        holder = self._holder(session)
        single: dict[str, list[dict[str, Any]]] = {
            f"/rw/panel/{state_path}": [_item("pnl-ctrlstate", ctrlstate=controller.panel)],
            "/rw/panel/opmode": [_item("pnl-opmode", opmode=controller.mode)],
            "/rw/panel/speedratio": [_item("pnl-speedratio", speedratio=f"{controller.ratio:g}")],
            "/rw/rapid/execution": [
                _item(
                    "rap-execution",
                    ctrlexecstate="running" if controller.running else "stopped",
                    cycle="once",
                )
            ],
            "/rw/motionsystem": [
                _item("ms", **{"absacc-active": "ON" if controller.absolute else "OFF"})
            ],
            f"/rw/mastership/{self._domain}": [_item("msh-resource", **holder)],
        }
        if path in single:
            return single[path]
        if path == "/ctrl/identity":
            names = {"ctrl-name": "IRB", "ctrl-id": controller.serial}
            return [_item("ctrl-identity-info", **names, **{"ctrl-type": controller.kind})]
        if path == "/rw/system/robottype":
            return [_item("sys-robottype", **{"robot-type": controller.model})]
        if path == "/rw/system":
            options = [_item("sys-option-li", option=each) for each in controller.options]
            version = "6.15.01.00" if self._generation == 1 else "7.15.0"
            return [
                _item("sys-system-li", rwversion=version),
                _item("sys-options-li", options=options),
            ]
        if path == "/rw/elog/0":
            entries = [
                _item("elog-message-li", msgtype=str(kind), code=str(code), title=title)
                | {"_title": f"/rw/elog/0/{place}", "argv": [{"type": "long", "value": MINUS_01}]}
                for place, (kind, code, title) in enumerate(controller.log, start=1)
            ]
            return entries[::-1]
        if arm := re.fullmatch(r"/rw/cfg/MOC/ARM/instances/rob1_([1-6])", path):
            low, high = np.radians(controller.limits_deg[int(arm[1]) - 1])
            bounds = {"lower_joint_bound": f"{low:.6g}", "upper_joint_bound": f"{high:.6g}"}
            return [_instance(f"rob1_{arm[1]}", bounds)]
        kind = "COM_TRP" if self._generation == 1 else "UDPUC_HOST"
        instances = f"/rw/cfg/SIO/{kind}/instances"
        if path in (instances, f"{instances}/{DEVICE}"):
            spelt = "RemoteAdress" if self._generation == 1 else "RemoteAddress"
            values = {"Name": DEVICE, "Type": "UDPUC", spelt: self.stream_host}
            values["RemotePortNumber"] = str(self.stream_port)
            return [_instance(DEVICE, values)]
        return None

    def _position(self, what: str) -> list[dict[str, Any]] | None:
        pose, joints_deg = self._controller.pose_and_joints()
        if what == "jointtarget":
            axes = {f"rax_{n}": f"{each:.6g}" for n, each in enumerate(joints_deg, start=1)}
            return [_item("ms-jointtarget", **axes)]
        if what == "robtarget":
            names = ("x", "y", "z", "q1", "q2", "q3", "q4")
            found = [*pose[:3, 3], *quaternion(pose[:3, :3])]
            values = {n: f"{each:.7g}" for n, each in zip(names, found, strict=True)}
            return [_item("ms-robtargets", **values)]
        return None

    def _symbol_value(self, name: str) -> Reply:
        value = self._controller.read_symbol(name)
        if value is None:
            return Reply(404, [{"code": str(SYMBOL_FAULT), "msg": "RAPID symbol was not found"}])
        return Reply(200, [_item("rap-data", value=value)])

    def _symbol(self, path: str) -> str:
        form = r"/rw/rapid/symbol/data/RAPID/T_ROB1/hilcell/(\w+)(?:/set)?"
        if self._generation > 1:
            form = r"/rw/rapid/symbol/RAPID/T_ROB1/hilcell/(\w+)/data"
        found = re.fullmatch(form, path)
        return found[1] if found else ""

    # -- writing ------------------------------------------------------------------------------

    def _write(self, path: str, form: dict[str, str], session: str, query: dict[str, str]) -> Reply:
        controller = self._controller
        if path == "/rw/rapid/execution/stop":
            controller.stop()
            return Reply(204)
        if self._foreign(session) or controller.mode != "AUTO":
            text = "Operation rejected: mastership is held by another client"
            return Reply(403, [{"code": "-1073445859", "msg": text}])
        if path == f"/rw/mastership/{self._domain}/request":
            self._sessions.holder = session
            return Reply(204)
        if path == f"/rw/mastership/{self._domain}/release":
            self._sessions.holder = ""
            return Reply(204)
        implicit = self._generation == 1 or query.get("mastership") == "implicit"
        if self._sessions.holder != session and not implicit:
            return Reply(403, [{"code": "-1073445859", "msg": "Mastership is required"}])
        return self._write_rapid(path, form)

    def _write_rapid(self, path: str, form: dict[str, str]) -> Reply:
        controller = self._controller
        if name := self._symbol(path):
            try:
                known = controller.write_symbol(name, form.get("value", ""))
            except RapidError:
                return Reply(400, [{"code": str(SYMBOL_FAULT), "msg": "Invalid value"}])
            return Reply(204 if known else 404)
        action = "set-pp-routine" if self._generation == 1 else "routine"
        if path == f"/rw/rapid/tasks/T_ROB1/pcp/{action}":
            done = controller.set_pointer(form.get("routine", ""))
        elif path == "/rw/rapid/execution/start":
            done = controller.start()
        else:
            return Reply(404)
        return Reply(204) if done else Reply(403, [{"code": "-1073445881", "msg": "Rejected"}])

    @property
    def _domain(self) -> str:
        return "rapid" if self._generation == 1 else "edit"

    def _foreign(self, session: str) -> bool:
        if self._controller.pendant_has_mastership:
            return True
        return self._sessions.holder not in ("", session)

    def _holder(self, session: str) -> dict[str, str]:
        if self._controller.pendant_has_mastership or self._controller.mode != "AUTO":
            return {"mastership": "local", "application": "FlexPendant", "location": "TPU"}
        if self._sessions.holder:
            own = str(self._sessions.holder == session).upper()
            names = {"application": "RWS", "location": "", "alias": "", "uid": "61"}
            return {"mastership": "remote", **names, "mastershipheldbyme": own}
        return {"mastership": "nomaster"}


def _instance(name: str, values: dict[str, str]) -> dict[str, Any]:
    """Return an instance of system parameters."""
    attributes = [
        {"_type": "cfg-ia-t-li", "_title": name, "value": value} for name, value in values.items()
    ]
    return _item("cfg-dt-instance", attrib=attributes) | {"_title": name}


def _item(kind: str, **values: Any) -> dict[str, Any]:
    return {"_type": kind, "_title": kind.partition("-")[2], **values}


def quaternion(R: Array) -> Array:
    """Return the quaternion (4,) of a rotation (3, 3), real part first."""
    outer = np.array(
        [
            [R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [0, R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
            [0, 0, R[1, 1] - R[0, 0] - R[2, 2], R[1, 2] + R[2, 1]],
            [0, 0, 0, R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    _, vectors = np.linalg.eigh(outer, UPLO="U")
    best: Array = vectors[:, -1]
    return best if best[0] >= 0 else -best


class WebSession:
    """One connection to the web services."""

    LONGEST = 65_536

    def __init__(self, client: Client, server: AbbServer) -> None:
        self._client, self._server = client, server
        self._segments = Segments(client.sendall)
        self._pending, self._last = b"", b""

    def serve(self) -> None:
        while (request := self._request()) is not None:
            if not self._send(request, self._reply(request)):
                return

    def _reply(self, request: Request) -> Reply:
        server = self._server
        server.controller.asked()
        if not server.sessions.admits(request, server.generation):
            challenge = (
                server.sessions.challenge()
                if server.generation == 1
                else (f'WWW-Authenticate: Basic realm="{REALM}"')
            )
            return Reply(401, None, (challenge,))
        session = server.sessions.of(request.headers.get("cookie", ""))
        if session is None:
            return Reply(503)
        reply = server.resources.answer(request, session)
        cookies = (f"Set-Cookie: -http-session-={session}; path=/; httponly",)
        return Reply(reply.status, reply.states, (*cookies, "Set-Cookie: ABBCX=17; path=/"))

    def _send(self, request: Request, reply: Reply) -> bool:
        """Send an answer; return whether the connection stays open."""
        body = b""
        if reply.states is not None and reply.status != 204:
            body = json.dumps(self._document(reply)).replace(f'"{MINUS_01}"', MINUS_01).encode()
        elif reply.status >= 400:
            body = b"<html><body>error</body></html>"
        reasons = {200: "OK", 204: "No Content", 401: "Unauthorized", 403: "Forbidden"}
        kind = "application/json" if self._server.generation == 1 else "application/hal+json;v=2.0"
        lines = [f"HTTP/1.1 {reply.status} {reasons.get(reply.status, 'Error')}", *reply.headers]
        lines += [f"Content-Type: {kind}", "Cache-Control: no-cache"]
        if reply.status != 204:
            lines.append(f"Content-Length: {len(body)}")
        answer = "\r\n".join([*lines, "", ""]).encode() + body
        if self._server.faults.strikes("robot.glued_reply"):
            answer = self._last + answer
        self._last = answer
        stays = self._server.answers.send(self._client, self._segments, answer)  # type: ignore[arg-type]
        self._server.time.catch_up()
        return stays

    def _document(self, reply: Reply) -> dict[str, Any]:
        links = {"base": {"href": "http://127.0.0.1/rw/"}}
        if reply.status >= 400:
            status = (reply.states or [{}])[0]
            if self._server.generation == 1:
                return {"_links": links, "_embedded": {"status": status}}
            return {"_links": links, "status": status}
        if self._server.generation == 1:
            return {"_links": links, "_embedded": {"_state": reply.states}}
        return {"_links": links, "state": reply.states}

    def _request(self) -> Request | None:
        head = self._until(b"\r\n\r\n")
        if head is None:
            if self._pending.startswith(b"\x16\x03"):  # TLS to a server without it
                self._client.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")
            return None
        first, *lines = head.decode("latin-1").split("\r\n")
        method, _, rest = first.partition(" ")
        target = rest.rpartition(" ")[0]
        headers = {}
        for line in lines:
            name, _, value = line.partition(":")
            headers[name.casefold()] = value.strip()
        length = int(headers.get("content-length", "0"))
        while len(self._pending) < length:
            if not (data := self._client.recv(RECEIVE)):
                return None
            self._pending += data
        body, self._pending = self._pending[:length], self._pending[length:]
        path, _, query = target.partition("?")
        return Request(
            method, unquote(path), _form(query), headers, _form(body.decode("latin-1")), target
        )

    def _until(self, end: bytes) -> bytes | None:
        while end not in self._pending:
            data = self._client.recv(RECEIVE)
            self._pending += data
            foreign = self._pending.startswith(b"\x16\x03")
            if not data or foreign or len(self._pending) > self.LONGEST:
                return None
        found, _, self._pending = self._pending.partition(end)
        return found


def _form(text: str) -> dict[str, str]:
    return {name: values[-1] for name, values in parse_qs(text, keep_blank_values=True).items()}


def varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def message(number: int, contents: bytes) -> bytes:
    """Return a field that is a message."""
    return varint(number << 3 | 2) + varint(len(contents)) + contents


def plain(number: int, value: int) -> bytes:
    """Return a field that is a whole number."""
    return varint(number << 3) + varint(value)


def egm_robot(
    number: int, time_s: float, joints_deg: Array, *, motors_on: bool, running: bool
) -> bytes:
    """Return a datagram EgmRobot of a position stream; joints (6,)."""
    joints = b"".join(b"\x09" + struct.pack("<d", each) for each in joints_deg)
    seconds, micro = divmod(round(time_s * 1e6), 1_000_000)
    clock = plain(1, seconds) + plain(2, micro)
    data = 2
    header = plain(1, number) + plain(2, round(1000 * time_s) % (1 << 32)) + plain(3, data)
    positions = message(1, joints) + message(4, clock)
    return (
        message(1, header)
        + message(2, positions)
        + message(3, positions)
        + message(4, plain(1, 1 if motors_on else 2))
        + message(5, plain(1, 2))
        + plain(6, 0)
        + message(8, plain(1, 2 if running else 1))
    )


class Stream:
    """Sends the position stream; the controller is the client of the PC's port."""

    LOST_EVERY, DOUBLED_EVERY, LATE_EVERY = 97, 61, 43
    PACED_S, STEPPED_S = 0.004, 0.002  # between two datagrams; the PC waits for them in the latter

    def __init__(self, site: Site, controller: AbbController) -> None:
        self._faults = site.faults
        self._controller, self._closing = controller, threading.Event()
        self._every_s = self.STEPPED_S if site.time.stepped else self.PACED_S
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((HOST, 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind((HOST, 0))
            self.port: int = free.getsockname()[1]
        self.off_deg = np.zeros(6)  # of the stream of another robot
        self._thread = threading.Thread(target=self._run, name="position stream", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """End the thread; a second close does nothing."""
        self._closing.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join()
        self._socket.close()

    def vanish(self) -> None:
        self._closing.set()

    def _run(self) -> None:
        number, held = 0, b""
        due_s = time.monotonic()
        while not self._closing.is_set():
            due_s = max(due_s + self._every_s, time.monotonic())
            self._closing.wait(due_s - time.monotonic())
            if not self._controller.running:
                number = 0
                continue
            number += 1
            if silent_s := self._faults.amount("robot.stream_silent"):
                self._closing.wait(silent_s)
            time_s, joints_deg = self._controller.measured()
            datagram = egm_robot(
                number,
                time_s,
                joints_deg + self.off_deg,
                motors_on=self._controller.motors_on,
                running=self._controller.running,
            )
            if number % self.LOST_EVERY == 0:
                continue
            if number % self.LATE_EVERY == 0 and not held:
                held = datagram
                continue
            copies = 2 if number % self.DOUBLED_EVERY == 0 else 1
            for each in [datagram] * copies + ([held] if held else []):
                with contextlib.suppress(OSError):  # nobody listens
                    self._socket.sendto(each, (HOST, self.port))
            held = b""
            if self._faults.strikes("robot.second_stream"):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                    other.sendto(datagram, (HOST, self.port))


class AbbServer(Server):
    """Serves one controller; only the port of its web services can be chosen."""

    def __init__(self, site: Site, port: int = 0) -> None:
        stated = site.cell.robot.options
        self.generation = int(stated.get("web_services", 1))
        self.controller, self.faults, self.time = AbbController(site), site.faults, site.time
        self.sessions, self.stream = Sessions(), Stream(site, self.controller)
        self.resources = Resources(
            self.controller, self.sessions, self.generation, self.stream.port
        )
        self._context: ssl.SSLContext | None = None
        listener = Listener("web services", self._serve, limit=80, port=port, vanish=self._vanish)
        address: dict[str, object] = {"host": HOST, "port": listener.port}
        if self.generation > 1:
            self._context, address["certificate_sha256"] = certificate()
        self._listener = listener
        super().__init__(address, listener, restore=self.controller.restore)
        self.answers = Answers(self.faults, self._closing)

    def start(self) -> None:
        super().start()
        self.stream.start()

    def close(self) -> None:
        self.stream.close()
        super().close()

    def _vanish(self) -> None:
        self.stream.vanish()
        self._listener.hang_up()

    def _serve(self, client: socket.socket) -> None:
        wire: Client = client if self._context is None else TlsClient(client, self._context)
        WebSession(wire, self).serve()


def certificate() -> tuple[ssl.SSLContext, str]:
    """Return the context of the simulated controller's certificate, and its fingerprint."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    with resources.as_file(resources.files("fakes.abb") / CERTIFICATE) as path:
        context.load_cert_chain(path)
        text = path.read_text("ascii")
    body = text[text.index("-----BEGIN CERTIFICATE-----") :]
    return context, hashlib.sha256(ssl.PEM_cert_to_DER_cert(body)).hexdigest()


serve = AbbServer
