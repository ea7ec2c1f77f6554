"""Far sides of the drivers' wires, for tests: small servers on loopback that end by themselves."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, Generic, Protocol, TypeVar

import pytest

from hilcell.clock import WallClock
from hilcell.ports import DeviceError, Identity, Stopped
from tests.clocks import DrivenClock
from tests.fakes.wires import exactly

Handler = Callable[[socket.socket], None]
Answer = TypeVar("Answer")
A_LOOK_S = 0.02  # as in reality


def wall_clock() -> WallClock:
    """Return a clock that nothing stops."""
    return WallClock(threading.Event())


class WireTime(DrivenClock):
    """The cell's clock and the drivers' `time`: it passes by waits, and by looks at what is silent.

    So no answer is late, on however slow a PC.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stop = threading.Event()
        self._a_look_s = self._wire_s = 0.0
        self.busy: Callable[[], bool] = lambda: False  # while a peer is, looks take no time

    def silence(self, a_look_s: float = A_LOOK_S) -> None:
        """Let each look at a wire take a time from now on: a device answers no more."""
        self._a_look_s = a_look_s

    def behind(self, answer: Answer, a_look_s: float) -> Answer:
        """Return an answer, behind which looks take that long."""
        self.silence(a_look_s)
        return answer

    def wait(self, duration_s: float) -> None:
        super().wait(duration_s)
        self._wire_s += duration_s
        self.check()

    def check(self) -> None:
        if self.stop.is_set():
            raise Stopped("a stop was asked for")

    def monotonic(self) -> float:
        self._wire_s += 0.0 if self.busy() else self._a_look_s
        return self._wire_s

    def sleep(self, duration_s: float) -> None:
        self._wire_s += duration_s
        threading.Event().wait(0.001)  # other threads run


def wire_time(monkeypatch: pytest.MonkeyPatch, *modules: ModuleType) -> WireTime:
    """Return the time in which these modules of drivers wait for answers from now on."""
    time = WireTime()
    for module in modules:
        monkeypatch.setattr(module, "time", time)
    return time


class Server:
    """Serves every connection in a thread of its own until ``close``."""

    def __init__(self, handler: Handler) -> None:
        self._handler = handler
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._connections: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._accept = threading.Thread(target=self._serve, daemon=True)
        self._accept.start()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, data: bytes) -> None:
        """Send something unasked on every connection."""
        for connection in self._connections:
            connection.sendall(data)

    def drop(self) -> None:
        """Close all connections, keep listening."""
        for connection in self._connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """End everything."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.drop()
        for thread in (self._accept, *self._threads):
            thread.join()
        for connection in self._connections:
            connection.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._connections.append(connection)
                thread = threading.Thread(target=self._handle, args=(connection,), daemon=True)
                self._threads.append(thread)
                thread.start()

    def _handle(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError, EOFError):
            self._handler(connection)
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)


def scripted(script: list[tuple[bytes, list[bytes]]], surprises: list[bytes]) -> Handler:
    """Return a handler that expects each request byte for byte and answers in the given pieces.

    Other frames are appended to ``surprises``.
    """

    def handle(connection: socket.socket) -> None:
        for expected, pieces in script:
            found = exactly(connection, len(expected))
            if found != expected:
                surprises.append(found)
                return
            send_apart(connection, pieces)
        if more := connection.recv(1):  # until the far side closes
            surprises.append(more)

    return handle


def send_apart(connection: socket.socket, pieces: list[bytes]) -> None:
    """Send pieces that the far side mostly reads one by one."""
    for piece in pieces:
        connection.sendall(piece)
        threading.Event().wait(0.002)


@contextlib.contextmanager
def in_thread(act: Callable[[], object], *errors: type[Exception]) -> Iterator[list[Exception]]:
    """Act in a thread that has ended behind the block; yield those ``errors`` that it raises."""
    raised: list[Exception] = []

    def run() -> None:
        try:
            act()
        except errors as error:
            raised.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    yield raised
    thread.join()


class Device(Protocol):
    """What each driver has."""

    def connect(self) -> list[Identity]: ...

    def close(self) -> None: ...


P = TypeVar("P")
D = TypeVar("D", bound=Device)


class Bed(Generic[P, D]):
    """A peer, its time, and devices at it; behind the test they are closed, as far as they can."""

    def __init__(self, peer: P, time: WireTime, build: Callable[..., D]) -> None:
        self.peer, self.time, self._build = peer, time, build
        self._devices: list[D] = []

    def make(self, **options: Any) -> D:
        """Return a device, not connected."""
        self._devices.append(self._build(self.peer, self.time, **options))
        return self._devices[-1]

    def connect(self, **options: Any) -> D:
        device = self.make(**options)
        device.connect()
        return device

    def close(self) -> None:
        for device in self._devices:
            with contextlib.suppress(DeviceError, Stopped):
                device.close()


def always(answer: str) -> Callable[[str], str]:
    """Return a peer's answer to whatever is asked."""
    return lambda _: answer


def refusal(act: Callable[[], object]) -> DeviceError:
    """Return the error that an act raises."""
    with pytest.raises(DeviceError) as caught:
        act()
    return caught.value


def kind(error: DeviceError) -> tuple[type[DeviceError], str]:
    return type(error), error.code


def figure(error: DeviceError, field: str) -> float:
    """Return a number of an error's fields."""
    value = error.fields[field]
    assert isinstance(value, float)
    return value


def soon(holds: Callable[[], bool]) -> bool:
    """Wait until something holds; the pytest time limit bounds that."""
    while not holds():
        threading.Event().wait(0.002)
    return True
