"""The wires to a controller of Universal Robots: RTDE (states in, registers out) and dashboard.

RTDE is big-endian. Package ``size u16 of the whole, type u8, payload``. A recipe names the fields
of data packages once; then they carry its number and the values in its order. The controller
answers a missing field with NOT_FOUND, an input of another client with IN_USE.

Integer registers 24 .. 27 and float registers 24 .. 30 are those of ``script/hilcell.script``.
Input register 28 numbers the requests for a fresh state: a state with the number of a request was
taken after it.

The controller sends a package at every cycle and drops those that no client fetches. The thread
that requests a state fetches them; at other times a thread here empties the buffer. A package that
waited in a buffer, or in transit, is not fresh.
"""

from __future__ import annotations

import math
import secrets
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from itertools import islice, takewhile
from typing import Self

import numpy as np

from drivers.device_errors import ROBOT, ProtocolError
from drivers.supervision import Deadline, ignore_stop, on_failure, polls, state_error
from drivers.wires import TcpLink, TextLines
from hilcell.geometry.frames import from_rotvec, matrix
from hilcell.ports import Array, DeviceError
from hilcell.sanitize import clean

VERSION = 2  # of the protocol
FORMATS = {  # of the types that fields used here may have
    "BOOL": "?",
    "UINT8": "B",
    "INT32": "i",
    "UINT32": "I",
    "UINT64": "Q",
    "DOUBLE": "d",
    "VECTOR6D": "6d",
}
_HEAD = struct.Struct(">HB")

Numbers = tuple[int | float, ...]


class Kind(IntEnum):
    """Types of packages."""

    VERSION = 86
    CONTROLLER_VERSION = 118
    TEXT = 77
    DATA = 85
    OUTPUTS = 79
    INPUTS = 73
    START = 83
    PAUSE = 80


def encode(kind: Kind, payload: bytes = b"") -> bytes:
    return _HEAD.pack(_HEAD.size + len(payload), kind) + payload


@dataclass(frozen=True)
class Recipe:
    """Fields of data packages in their order, with their types, under the controller's number."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @staticmethod
    def request(kind: Kind, names: Sequence[str], head: bytes = b"") -> bytes:
        return encode(kind, head + ",".join(names).encode("ascii"))

    @classmethod
    def from_answer(cls, names: Sequence[str], payload: bytes) -> Recipe:
        """Return the recipe that an answer sets up; types may be ``NOT_FOUND`` or ``IN_USE``."""
        types = tuple(payload[1:].decode("ascii", "replace").split(","))
        if not payload or len(types) != len(names):
            raise ProtocolError(f"{len(types)} types for {len(names)} fields")
        return cls(payload[0], tuple(names), types)

    def lacking(self, why: str) -> list[str]:
        """Return the fields with this type: ``NOT_FOUND`` or ``IN_USE``."""
        return [name for name, each in zip(self.names, self.types, strict=True) if each == why]

    def unlike(self) -> list[str]:
        """Return the fields whose type is none of which they can be read, with their types."""
        fields = zip(self.names, self.types, strict=True)
        return [
            f"{name} ({kind})"
            for name, kind in fields
            if kind not in FORMATS or (kind == "VECTOR6D") != (name in _SIX)
        ]

    def decode(self, payload: bytes) -> dict[str, Numbers]:
        """Return the numbers of a data package by field; raises `ProtocolError`, also for NaN."""
        layout = self._layout
        if len(payload) != layout.size or payload[0] != self.number:
            raise ProtocolError(
                f"a data package of {len(payload)} bytes by recipe {payload[:1].hex() or 'none'} "
                f"came, expected {layout.size} bytes by recipe {self.number:02x}"
            )
        flat = layout.unpack(payload)
        numbers = iter(flat[1:])
        sizes = zip(self.names, self.types, strict=True)
        found = {
            name: tuple(islice(numbers, 6 if kind == "VECTOR6D" else 1)) for name, kind in sizes
        }
        if not math.isfinite(sum(flat)):
            for name, each in found.items():
                if not all(map(math.isfinite, each)):
                    raise ProtocolError(f"{name} is {', '.join(map(str, each))}")
        return found

    def encode(self, values: Mapping[str, Numbers]) -> bytes:
        flat = [number for name in self.names for number in values[name]]
        return encode(Kind.DATA, self._layout.pack(self.number, *flat))

    @cached_property
    def _layout(self) -> struct.Struct:
        return struct.Struct(">B" + "".join(FORMATS[each] for each in self.types))


class Packages:
    """Puts the packages of a stream of bytes together, however they were split or glued."""

    LONGEST = 4096

    def __init__(self) -> None:
        self._bytes = b""

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield type and payload of each package completed by ``data``; raises `ProtocolError`."""
        self._bytes += data
        while len(self._bytes) >= _HEAD.size:
            size, kind = _HEAD.unpack_from(self._bytes)
            if not _HEAD.size <= size <= self.LONGEST:
                raise ProtocolError(
                    f"a package of {size} bytes, {_HEAD.size} to {self.LONGEST} are possible"
                )
            if len(self._bytes) < size:
                return
            payload, self._bytes = self._bytes[_HEAD.size : size], self._bytes[size:]
            yield kind, payload


_TOOL = tuple(f"output_double_register_{n}" for n in range(24, 30))
_SIX = ("actual_q", "actual_qd", "actual_TCP_pose")
ECHO = "input_int_register_28"
OUTPUTS = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_pose",
    "robot_mode",
    "safety_status",
    "runtime_state",
    "target_speed_fraction",
    *(f"output_int_register_{n}" for n in range(24, 28)),
    *_TOOL,
    ECHO,
)
INPUTS = (
    *(f"input_int_register_{n}" for n in range(24, 28)),
    *(f"input_double_register_{n}" for n in range(24, 31)),  # the joints, and the speed
)


RUNNING, NORMAL = 7, 1  # valid states
ROBOT_MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "confirm safety",
    2: "booting",
    3: "power off",
    4: "power on",
    5: "idle, brakes closed",
    6: "backdrive",
    8: "updating firmware",
}
# Status, its text, its alarm.
SAFETY: dict[int, tuple[str, str]] = {
    2: ("reduced", "HC-B61"),
    3: ("protective stop", "HC-B62"),
    4: ("recovery", "HC-B65"),
    5: ("safeguard stop", "HC-B11"),
    6: ("system emergency stop", "HC-B10"),
    7: ("robot emergency stop", "HC-B10"),
    8: ("violation", "HC-B63"),
    9: ("fault", "HC-B64"),
}


class Runtime(IntEnum):
    """States of the program, whichever plays."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


@dataclass(frozen=True, slots=True, eq=False)
class UrState:
    """One data package. It arrived between ``after_s`` and ``by_s`` (monotonic)."""

    after_s: float
    by_s: float
    timestamp_s: float  # by the controller's clock
    joints_rad: Array  # (6,)
    speeds_rad_s: Array  # (6,)
    tcp: Array  # (6,), m and rad
    robot_mode: int  # whether the arm is on
    safety_status: int
    runtime_state: int  # whether a program plays
    speed_fraction: float  # the place of the speed slider, 0 to 1
    acknowledged: int  # the number of the last motion that has ended
    error: int  # of the script, in that motion
    session: int  # the number of the script that plays
    count: int  # of the script's loop
    tool: Array  # (6,), mm and rad
    echo: int  # the number of the last question that had reached the controller

    @classmethod
    def checked(cls, numbers: dict[str, Numbers], after_s: float, by_s: float) -> Self:
        """Return the state that a data package's numbers mean; raises `ProtocolError`."""
        for name in (*_SIX, *_TOOL):
            if not sum(map(abs, numbers[name])) <= 1e6:  # m, rad, rad/s
                raise ProtocolError(f"{name} is {', '.join(map(str, numbers[name]))}")
        joints, speeds, tcp = (np.array(numbers[name]) for name in _SIX)
        return cls(
            after_s,
            by_s,
            timestamp_s=numbers["timestamp"][0],
            joints_rad=joints,
            speeds_rad_s=speeds,
            tcp=tcp,
            robot_mode=int(numbers["robot_mode"][0]),
            safety_status=int(numbers["safety_status"][0]),
            runtime_state=int(numbers["runtime_state"][0]),
            speed_fraction=numbers["target_speed_fraction"][0],
            acknowledged=int(numbers["output_int_register_24"][0]),
            error=int(numbers["output_int_register_25"][0]),
            session=int(numbers["output_int_register_26"][0]),
            count=int(numbers["output_int_register_27"][0]),
            tool=np.array([numbers[name][0] for name in _TOOL]) * ([1000.0] * 3 + [1.0] * 3),
            echo=int(numbers[ECHO][0]),
        )

    @property
    def pose(self) -> Array:
        """Return the pose of the TCP (4, 4) in mm."""
        return matrix(from_rotvec(self.tcp[3:]), self.tcp[:3] * 1000.0)

    def problem(self, *, moving: bool) -> DeviceError | None:
        """Return the error of a state that forbids to continue; ``moving`` makes it a fault.

        Causes come before their consequences: a protective stop ends the script as well.
        """
        number = self.safety_status
        if number != NORMAL:
            words, code = SAFETY.get(number, ("unknown", "HC-B65"))
            expected = f"{NORMAL} (normal)"
            return state_error(
                code, "safety_status", f"{number} ({words})", expected, moving=moving
            )
        number = self.robot_mode
        if number != RUNNING:
            found = f"{number} ({ROBOT_MODES.get(number, 'unknown')})"
            return state_error("HC-B13", "robot_mode", found, f"{RUNNING} (running)", moving=moving)
        share = self.speed_fraction
        if not share > 0.0:
            found = f"{share:g}"
            return state_error("HC-B16", "target_speed_fraction", found, "above 0", moving=moving)
        return None

    @property
    def runtime(self) -> str:
        known = {each.value: each.name.lower() for each in Runtime}
        return f"runtime_state is {self.runtime_state} ({known.get(self.runtime_state, 'unknown')})"


@dataclass(frozen=True, slots=True)
class Order:
    """The values of the registers that command the script."""

    NOTHING, MOVE_JOINTS = 0, 1  # commands
    GO, BRAKE = 0, 1  # stop; the number of its session also ends a script

    sequence: int
    target_rad: Array
    speed_rad_s: float
    stop: int = GO
    command: int = MOVE_JOINTS

    def registers(self, life: int) -> dict[str, Numbers]:
        """Return the numbers of the inputs; another ``life`` is the PC's heartbeat."""
        integers = (self.sequence, self.command, life, self.stop)
        floats = (*self.target_rad.tolist(), self.speed_rad_s)
        return {name: (each,) for name, each in zip(INPUTS, (*integers, *floats), strict=True)}


class UrLink:
    """One connection. Writes and ``end_script`` may come from any thread, all else from one."""

    POLYSCOPE = "PolyScope 3.12, 5.6 or later"
    MAX_NUMBER = 1_000_000_000  # of a motion, a heartbeat, a question
    ANSWER_S = 3.0
    SILENT_S = 1.0  # without a package
    FETCH_S = 0.01  # a single poll of the link, so that a stop is noticed in time
    IDLE_S = 0.1  # between two fetches while no thread asks
    KEPT = 4096  # packages
    SIZE = 65536
    JOIN_S = 2.0

    def __init__(self, host: str, port: int, rate_hz: float, check: Callable[[], None]) -> None:
        """Set the exchange up and start it; raises `DeviceError`."""
        self._check, self._rate_hz = check, rate_hz
        check()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._empty, name="rtde", daemon=True)
        self._link = TcpLink(ROBOT, host, port, ignore_stop)  # it asks for a stop itself
        self._packages, self._arrived = Packages(), deque[tuple[int, bytes]]()
        self._fetching = threading.Lock()
        self._states: deque[UrState] = deque(maxlen=self.KEPT)
        self._emptied_s = 0.0  # when the buffer was last empty
        self._failure: DeviceError | None = None
        self._writing, self._life = threading.Lock(), 0
        self._order, self._ending = Order(0, np.zeros(6), 0.0, command=Order.NOTHING), 0
        # The register has the last number of the connection before.
        self._question = secrets.randbelow(self.MAX_NUMBER) + 1
        with on_failure(self._link.close):
            self._set_up()
        self._thread.start()

    def fresh(self, *, patiently: bool = False) -> UrState:
        """Return a state that the controller took after this call began, however late it comes.

        ``patiently`` waits on when a stop was asked for. Raises `DeviceError`.
        """
        self._question = self._question % self.MAX_NUMBER + 1
        seen_s = time.monotonic()
        with self._writing:
            self._link.send(self._echo.encode({ECHO: (self._question,)}), "ask for a state")
        for _ in polls(self.ANSWER_S):
            newest = self.following(seen_s, patiently=patiently)[-1]
            if newest.echo == self._question:
                return newest
            seen_s = newest.by_s
        found = f"no package after question {self._question} within {self.ANSWER_S:.0f} s"
        raise self._link.broken("receive", f"{found}: {ECHO} is {newest.echo}")

    def next(self) -> UrState:
        """Return a state that arrived after this call began; raises `DeviceError`."""
        begun_s = seen_s = time.monotonic()
        while True:
            newest = self.following(seen_s)[-1]
            if newest.after_s >= begun_s:
                return newest
            seen_s = newest.by_s

    def following(self, by_s: float, *, patiently: bool = False) -> list[UrState]:
        """Wait for states fetched after a time (monotonic); return all of these."""
        for last in polls(self.SILENT_S):
            if not patiently:
                self._check()
            with self._fetching:
                found = self._since(by_s)
                if not found and self._failure is None:
                    self._fetch(0.0 if last else self.FETCH_S)
                    found = self._since(by_s)
            if found:
                return found
            if self._failure is not None:
                raise self._failure
        raise self._link.broken("receive", f"no package for {self.SILENT_S:.1f} s")

    def write(self, order: Order) -> None:
        """Write the registers, with the next heartbeat; raises `DeviceError`."""
        with self._writing:
            self._life = self._life % self.MAX_NUMBER + 1
            self._order = order
            self._write()

    def end_script(self, session: int) -> None:
        """Have the script of a session brake and end; no later write takes that back.

        Gives no heartbeat. Raises `DeviceError`.
        """
        with self._writing:
            self._ending = session
            self._write()

    def close(self) -> None:
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(self.JOIN_S)
        self._link.close()

    def _write(self) -> None:
        order = replace(self._order, stop=self._ending or self._order.stop)
        self._link.send(self._inputs.encode(order.registers(self._life)), "write registers")

    # -- setting up ---------------------------------------------------------------------------

    def _set_up(self) -> None:
        if not self._accepts(Kind.VERSION, struct.pack(">H", VERSION)):
            raise self._unsupported(f"version {VERSION} of RTDE is refused")
        version = self._ask(Kind.CONTROLLER_VERSION, encode(Kind.CONTROLLER_VERSION))
        if len(version) != 16:
            found = f"a controller version of {len(version)} bytes, expected 16"
            raise self._no_rtde(Kind.CONTROLLER_VERSION, found)
        self._outputs = self._recipe(Kind.OUTPUTS, OUTPUTS, struct.pack(">d", self._rate_hz))
        self._inputs = self._recipe(Kind.INPUTS, INPUTS)
        self._echo = self._recipe(Kind.INPUTS, (ECHO,))
        if not self._accepts(Kind.START):
            raise self._unsupported("the exchange is not started")

    def _accepts(self, kind: Kind, payload: bytes = b"") -> bool:
        answer = self._ask(kind, encode(kind, payload))
        if len(answer) != 1:
            raise self._no_rtde(kind, f"an answer of {len(answer)} bytes, expected 1")
        return answer == b"\x01"

    def _recipe(self, kind: Kind, names: tuple[str, ...], head: bytes = b"") -> Recipe:
        answer = self._ask(kind, Recipe.request(kind, names, head))
        try:
            recipe = Recipe.from_answer(names, answer)
        except ProtocolError as error:
            raise self._link.broken("set up", str(error)) from error
        if lacking := recipe.lacking("NOT_FOUND"):
            raise self._unsupported(f"the controller has no {', '.join(lacking)}")
        if held := recipe.lacking("IN_USE"):
            raise ROBOT.refused(
                "HC-B68", "connect", f"another client writes {', '.join(held)}", expected="no other"
            )
        if unlike := recipe.unlike():
            raise self._unsupported(f"unexpected type of {', '.join(unlike)}")
        return recipe

    def _ask(self, kind: Kind, request: bytes) -> bytes:
        self._link.send(request, kind.name.lower())
        for last in polls(self.ANSWER_S):
            self._check()
            try:
                if not self._arrived:
                    data = self._link.receive(self.SIZE, Deadline(0.0 if last else self.FETCH_S))
                    self._arrived.extend(self._packages.feed(data))
            except ProtocolError as error:
                raise self._no_rtde(kind, str(error)) from error
            while self._arrived:
                found, payload = self._arrived.popleft()
                if found == kind:
                    return payload
        raise self._no_rtde(kind, f"no answer within {self.ANSWER_S:.0f} s")

    def _unsupported(self, found: str) -> DeviceError:
        return ROBOT.refused("HC-B69", "connect", found, expected=self.POLYSCOPE)

    def _no_rtde(self, kind: Kind, found: str) -> DeviceError:
        return self._link.broken(kind.name.lower(), f"{found}; is rtde_port that of RTDE?")

    # -- fetching -----------------------------------------------------------------------------

    def _empty(self) -> None:
        """Fetch packages that no thread asks for, until `close`."""
        while not self._closing.wait(self.IDLE_S):
            if self._fetching.acquire(blocking=False):
                try:
                    self._fetch(0.0)
                finally:
                    self._fetching.release()

    def _fetch(self, wait_s: float) -> None:
        """Decode what has arrived, or arrives within a time; a failure is stored."""
        if self._failure is not None:
            return
        try:
            looked_s = time.monotonic()
            data = self._link.receive(self.SIZE, Deadline(0.0))
            if not data:
                self._emptied_s = looked_s
                data = self._link.receive(self.SIZE, Deadline(wait_s)) if wait_s else b""
            self._arrived.extend(self._packages.feed(data))
            by_s = time.monotonic()
            while self._arrived:
                kind, payload = self._arrived.popleft()
                if kind == Kind.DATA:
                    numbers = self._outputs.decode(payload)
                    self._states.append(UrState.checked(numbers, self._emptied_s, by_s))
        except ProtocolError as error:
            expected = "a state of the robot"
            self._failure = ROBOT.failed("HC-B26", "receive", str(error), expected=expected)
        except DeviceError as error:
            self._failure = error

    def _since(self, by_s: float) -> list[UrState]:
        newer = takewhile(lambda state: state.by_s > by_s, reversed(self._states))
        return list(newer)[::-1]


class Dashboard:
    """A connection to the dashboard server: one line asks, one line answers.

    It greets each connection with a line. ``stop`` ends the running program, and the robot brakes.
    Call ``ask`` from one thread, ``send`` from any.
    """

    ANSWER_S = 3.0

    GREETING = "Connected: Universal Robots Dashboard Server"

    def __init__(self, host: str, port: int, check: Callable[[], None]) -> None:
        try:
            self._link = TcpLink(ROBOT, host, port, check)
        except DeviceError as error:
            if isinstance(error.__cause__, ConnectionRefusedError):  # the controller itself answers
                error.act = (
                    "wait until PolyScope runs; allow the dashboard server in its security "
                    "settings, and compare dashboard_port. Not supported: PolyScope X, which has "
                    "no dashboard server"
                )
            raise
        self._lines = TextLines(self._link, end=b"\n")
        with on_failure(self._link.close):
            greeting = self._lines.receive(Deadline(self.ANSWER_S))
            found = (
                f"no answer within {self.ANSWER_S:.0f} s" if greeting is None else clean(greeting)
            )
            if not found.startswith(self.GREETING):
                raise self._link.broken(
                    "connect", f"{found}; is dashboard_port that of the dashboard server?"
                )

    def ask(self, command: str) -> str:
        """Return the answer to a command; raises `DeviceError`."""
        self._lines.send(command, command)
        line = self._lines.receive(Deadline(self.ANSWER_S))
        if line is None:
            raise self._link.broken(command, f"no answer within {self.ANSWER_S:.0f} s")
        return clean(line)

    def answer_to(self, question: str) -> str | None:
        """Return the answer to a question, None where this PolyScope does not have the question."""
        answer = self.ask(question)
        return None if answer.casefold().startswith("could not understand") else answer

    def send(self, command: str) -> None:
        """Send a command without waiting for its answer."""
        self._link.reply_pending = True
        self._lines.send(command, command)

    def last_answer(self, deadline: Deadline) -> str | None:
        """Return the last answer that has come to what was sent, None where none has."""
        line = self._lines.receive(deadline)
        while (newer := self._lines.receive(Deadline(0.0))) is not None:
            line = newer
        return None if line is None else clean(line)

    def is_open(self) -> bool:
        """Whether the controller has not closed the connection meanwhile, as of one that idles."""
        try:
            self._lines.drop_pending()
        except DeviceError:
            return False
        return True

    def close(self) -> None:
        self._link.close()
