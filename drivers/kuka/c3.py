"""C3 Bridge Interface Protocol 1.5 and KUKAVARPROXY: variables of a KUKA controller by name.

Big-endian. Request ``tag u16, length u16 of the rest, type u8, name length u16, name`` and, to
write, ``value length u16, value``; reply ``tag, length, type, value length, value, error u16, ok``.
The two servers fill the error field differently, so only the last byte says success. A reply that
comes after its deadline would answer the next question, so tags are compared and a connection that
missed a reply is never used again.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.supervision import Patience
from drivers.wires.tcp import Alarms, TcpLink
from hilcell.ports import DeviceError

MAX_NAME = 250
MAX_BODY = 4096
REPLY_S = 2.0
ALARMS = Alarms(unreachable="HC-B01", lost="HC-B02")
_HEADER = struct.Struct(">HH")


class C3Error(ValueError):
    """Bytes that are no reply of the protocol."""


@dataclass(frozen=True, slots=True)
class Reply:
    """One reply: ``ok`` is the last byte alone."""

    tag: int
    kind: int
    value: str
    error: int
    ok: bool


def encode_read(tag: int, name: str) -> bytes:
    """Return the request to read ``name``."""
    return _request(tag, 0, name, b"")


def encode_write(tag: int, name: str, value: str) -> bytes:
    """Return the request to write ``value`` into ``name``."""
    text = value.encode("latin-1")
    return _request(tag, 1, name, struct.pack(">H", len(text)) + text)


def _request(tag: int, kind: int, name: str, rest: bytes) -> bytes:
    text = name.encode("ascii")
    if not 0 < len(text) <= MAX_NAME or len(rest) > MAX_BODY:
        raise C3Error(f"{name[:40]!r} or its value is too long for one request")
    body = struct.pack(">BH", kind, len(text)) + text + rest
    return _HEADER.pack(tag, len(body)) + body


def decode_header(header: bytes) -> tuple[int, int]:
    """Return tag and length of the body, which has to be read next."""
    tag, length = _HEADER.unpack(header)
    if not 6 <= length <= MAX_BODY:
        raise C3Error(f"a reply of {length} bytes is announced, 6 to {MAX_BODY} are possible")
    return tag, length


def decode_body(tag: int, body: bytes) -> Reply:
    """Return the reply that ``body`` carries."""
    kind, size = struct.unpack_from(">BH", body)
    if size != len(body) - 6:
        raise C3Error(f"a value of {size} bytes in a body of {len(body)}")
    (error,) = struct.unpack_from(">H", body, 3 + size)
    return Reply(tag, kind, body[3 : 3 + size].decode("latin-1"), error, body[-1] == 1)


class C3Connection:
    """One connection, one request in flight; a lock lets a keep-alive share it."""

    def __init__(self, device: str, host: str, port: int, check: Callable[[], None]) -> None:
        self._link = TcpLink(device, host, port, check, ALARMS)
        self._device = device
        self._lock = threading.Lock()
        self._tag = 0
        self._received = b""
        self._dead = ""
        self.used_s = time.monotonic()

    def read(self, name: str) -> str:
        """Return the text of a variable; raises `DeviceError`."""
        return self._exchange(f"read {name}", lambda tag: encode_read(tag, name)).value

    def knows(self, name: str) -> bool:
        """Whether the controller lets a variable be read."""
        return self._reply(f"read {name}", lambda tag: encode_read(tag, name)).ok

    def write(self, name: str, value: str) -> None:
        """Write a variable and wait for the acknowledgement; raises `DeviceError`."""
        self._exchange(f"write {name}", lambda tag: encode_write(tag, name, value))

    def write_unheard(self, name: str, value: str, patience_s: float = 0.05) -> None:
        """Write without waiting for the reply; the connection is good for nothing afterwards.

        A request in flight is given ``patience_s`` to end, because some servers lose a second
        request that arrives in the same segment; then the bytes go out all the same.
        """
        held = self._lock.acquire(timeout=patience_s)
        self._link.unheard = True
        try:
            self._link.send(encode_write(self._next_tag(), name, value), f"write {name}")
            self._dead = f"{name} was written without waiting for its reply"
        finally:
            if held:
                self._lock.release()

    def close(self) -> None:
        """Close the connection."""
        self._link.close()

    def _next_tag(self) -> int:
        self._tag = self._tag % 0xFFFF + 1
        return self._tag

    def _exchange(self, operation: str, encode: Callable[[int], bytes]) -> Reply:
        reply = self._reply(operation, encode)
        if not reply.ok:
            raise DeviceError(
                "HC-B03",
                self._device,
                operation,
                f"refused with error {reply.error}",
                act="is the variable declared, and the controller up? see docs/hardware.md",
                fields={"error": reply.error},
            )
        return reply

    def _reply(self, operation: str, encode: Callable[[int], bytes]) -> Reply:
        with self._lock:
            if self._dead:
                raise self._link.broken(operation, self._dead)
            tag = self._next_tag()
            self._dead = f"{operation} was never answered"
            self._link.send(encode(tag), operation)
            reply = self._receive(operation, tag)
            self._dead = ""
            self.used_s = time.monotonic()
        return reply

    def _receive(self, operation: str, tag: int) -> Reply:
        patience = Patience(REPLY_S)
        try:
            self._await(_HEADER.size, operation, patience)
            found, length = decode_header(self._received[: _HEADER.size])
            if found != tag:
                raise C3Error(f"a reply with tag {found} came, {tag} was asked")
            end = _HEADER.size + length
            self._await(end, operation, patience)
            body, self._received = self._received[_HEADER.size : end], self._received[end:]
            return decode_body(tag, body)
        except C3Error as error:
            self._dead = str(error)
            raise self._link.broken(operation, str(error)) from error

    def _await(self, size: int, operation: str, patience: Patience) -> None:
        while len(self._received) < size:
            piece = self._link.receive(_HEADER.size + MAX_BODY, patience)
            if not piece:
                raise self._link.broken(operation, f"no answer within {REPLY_S:.1f} s")
            self._received += piece
