"""Plain clients of the device servers, written from their manuals, not from the drivers."""

from __future__ import annotations

import select
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager

STATES = "timestamp,actual_q,robot_mode,output_int_register_24,output_int_register_25"
REGISTERS = [f"input_int_register_{n}" for n in range(24, 28)]
REGISTERS += [f"input_double_register_{n}" for n in range(24, 31)]


@contextmanager
def connected(port: int) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", port)) as wire:
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield wire


def exactly(wire: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        part = wire.recv(count - len(data))
        if not part:
            raise EOFError(data)
        data += part
    return data


def quiet(wire: socket.socket) -> bool:
    """Whether nothing has come that was not read."""
    return not select.select([wire], [], [], 0.0)[0]


class C3Client:
    def __init__(self, wire: socket.socket) -> None:
        self.wire = wire
        self.tag = 0

    def request(self, kind: int, name: str, value: str | None = None) -> tuple[str, bytes]:
        """Return the value and the three bytes of the footer."""
        self.send(kind, name, value)
        tag, length = struct.unpack("!HH", exactly(self.wire, 4))
        reply = exactly(self.wire, length)
        assert tag == self.tag
        (size,) = struct.unpack_from("!H", reply, 1)
        return reply[3 : 3 + size].decode(), reply[3 + size :]

    def send(self, kind: int, name: str, value: str | None = None) -> None:
        self.tag += 1
        body = struct.pack("!BH", kind, len(name)) + name.encode()
        if value is not None:
            body += struct.pack("!H", len(value)) + value.encode()
        self.wire.sendall(struct.pack("!HH", self.tag, len(body)) + body)

    def read(self, name: str) -> str:
        value, footer = self.request(0, name)
        assert footer[-1] == 1, name
        return value

    def write(self, name: str, value: str) -> None:
        assert self.request(1, name, value)[1][-1] == 1, name

    def start(self, number: int, joints_deg: list[float], percent: int = 30) -> None:
        axes = ", ".join(f"A{n} {angle:.6f}" for n, angle in enumerate(joints_deg, 1))
        self.write("HC_TGT", f"{{E6AXIS: {axes}}}")
        self.write("HC_VEL", str(percent))
        self.write("HC_CMD", "1")
        self.write("HC_SEQ", str(number))

    def go(self, number: int, joints_deg: list[float], percent: int = 30) -> int:
        """Return how many polls the motion took."""
        self.start(number, joints_deg, percent)
        for polls in range(100):
            if self.read("HC_ACK") == str(number):
                return polls
        raise AssertionError("never acknowledged")


class EmsconClient:
    def __init__(self, wire: socket.socket) -> None:
        self.wire = wire

    def send(self, command: int, form: str = "", *values: float) -> None:
        body = struct.pack("<" + form, *values)
        self.wire.sendall(struct.pack("<iII", 12 + len(body), 0, command) + body)

    def packet(self) -> tuple[int, bytes]:
        """Return type and rest of the next packet."""
        size, kind = struct.unpack("<iI", exactly(self.wire, 8))
        return kind, exactly(self.wire, size - 8)

    def reply(self, command: int) -> tuple[int, bytes]:
        """Return status and body of the reply to a command; other packets are passed over."""
        while True:
            kind, rest = self.packet()
            if kind in (0, 1) and struct.unpack_from("<I", rest)[0] == command:
                return struct.unpack_from("<I", rest, 4)[0], rest[8:]

    def ask(self, command: int, form: str = "", *values: float) -> tuple[int, bytes]:
        self.send(command, form, *values)
        return self.reply(command)

    def ready(self, reflector: int = 3) -> None:
        """Initialise, mm, the reflector that is mounted."""
        assert self.ask(7)[0] == 0
        assert self.ask(5, "5I", 1, 0, 0, 0, 0)[0] == 0
        assert self.ask(40, "i", reflector)[0] == 0

    def result(self) -> tuple[float, ...]:
        """Return the 17 doubles of the next single result."""
        while True:
            kind, rest = self.packet()
            if kind == 2:
                return struct.unpack("<17d", rest[12:])

    def measure(self, x_mm: float, y_mm: float, z_mm: float) -> tuple[float, ...]:
        assert self.ask(55, "3di", x_mm, y_mm, z_mm, 1)[0] == 0
        assert self.ask(49)[0] == 0
        return self.result()


class RtdeClient:
    """A plain client by the page."""

    def __init__(self, wire: socket.socket) -> None:
        self.wire = wire

    def package(self) -> tuple[int, bytes]:
        size, kind = struct.unpack("!HB", exactly(self.wire, 3))
        return kind, exactly(self.wire, size - 3)

    def ask(self, kind: int, payload: bytes = b"") -> bytes:
        self.wire.sendall(struct.pack("!HB", 3 + len(payload), kind) + payload)
        while (answer := self.package())[0] != kind:
            pass
        return answer[1]

    def begin(self, *, write: bool = True) -> None:
        assert self.ask(86, b"\x00\x02") == b"\x01"
        types = self.ask(79, struct.pack("!d", 125.0) + STATES.encode())
        assert types == b"\x01DOUBLE,VECTOR6D,INT32,INT32,INT32"
        if write:
            types = self.ask(73, ",".join(REGISTERS).encode())[1:]
            assert types.split(b",") == [b"INT32"] * 4 + [b"DOUBLE"] * 7
        assert self.ask(83) == b"\x01"

    def state(self) -> tuple[float, ...]:
        while (answer := self.package())[0] != 85:
            pass
        found: tuple[float, ...] = struct.unpack("!B7diii", answer[1])
        return found

    def write(self, sequence: int, life: int, joints: list[float], *, stop: int = 0) -> None:
        values = (1, sequence, 1, life, stop, *joints, 1.0)
        payload = struct.pack("!B4i7d", *values)
        self.wire.sendall(struct.pack("!HB", 3 + len(payload), 85) + payload)
