"""The RTDE connection to a Universal Robots controller: states in, registers out.

The controller sends a package at every cycle, asked or not, and drops those that nobody fetches.
The thread that asks for a state fetches them; while none does, a thread here empties the buffer.
A package that waited in a buffer, or on its way, is no fresh one. So each question for a fresh
state has a number, written into a register of its own: a state that has it was taken after that.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from itertools import takewhile

import numpy as np

from drivers.robot_errors import ALARMS, DEVICE
from drivers.supervision import Patience, go_on, on_failure
from drivers.universal_robots import rtde
from drivers.universal_robots.rtde import Kind, Packages, Recipe, RtdeError
from drivers.universal_robots.state import (
    ECHO,
    INPUTS,
    NOTHING,
    OUTPUTS,
    Order,
    UrState,
    unlike,
)
from drivers.wires.tcp import TcpLink
from hilcell.ports import DeviceError, DeviceRefused

ANSWER_S = 3.0
SILENT_S = 1.0  # without a package
LOOK_S = 0.01  # of one look: a single poll of the link, so that a stop is seen in time
IDLE_S = 0.1  # between two looks at a buffer whose packages nobody wants
KEPT = 4096  # packages
SIZE = 65536
JOIN_S = 2.0
MAX_LIFE = MAX_QUESTION = 1_000_000_000


class UrLink:
    """One connection. Writes and ``end_script`` may come from any thread, all else from one."""

    def __init__(self, host: str, port: int, rate_hz: float, check: Callable[[], None]) -> None:
        """Set the exchange up and start it; raises `DeviceError`."""
        self._check, self._rate_hz = check, rate_hz
        check()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._empty, name="rtde", daemon=True)
        self._link = TcpLink(DEVICE, host, port, go_on, ALARMS)  # it asks for a stop itself
        self._packages, self._arrived = Packages(), deque[tuple[int, bytes]]()
        self._fetching = threading.Lock()
        self._states: deque[UrState] = deque(maxlen=KEPT)
        self._emptied_s = 0.0  # when the buffer was last seen empty
        self._failure: DeviceError | None = None
        self._writing, self._life = threading.Lock(), 0
        self._order, self._ending = Order(0, np.zeros(6), 0.0, command=NOTHING), 0
        # The register keeps the last number of the connection before.
        self._question = secrets.randbelow(MAX_QUESTION) + 1
        with on_failure(self._link.close):
            self.version = self._set_up()
        self._thread.start()

    def fresh(self, *, patiently: bool = False) -> UrState:
        """Return a state that the controller took after this call began, however late it comes.

        ``patiently`` waits on when a stop was asked for. Raises `DeviceError`.
        """
        self._question = self._question % MAX_QUESTION + 1
        seen_s = time.monotonic()
        with self._writing:
            self._link.send(self._echo.encode({ECHO: (self._question,)}), "ask for a state")
        patience, over = Patience(ANSWER_S), False
        while True:
            newest = self._following(seen_s, patiently=patiently)[-1]
            if newest.echo == self._question:
                return newest
            if over:
                found = f"no package after question {self._question} within {ANSWER_S:.0f} s"
                raise self._link.broken("receive", f"{found}: {ECHO} is {newest.echo}")
            over, seen_s = patience.over(), newest.by_s

    def next(self) -> UrState:
        """Return a state that arrived after this call began; raises `DeviceError`."""
        begun_s = seen_s = time.monotonic()
        while True:
            newest = self._following(seen_s, patiently=False)[-1]
            if newest.after_s >= begun_s:
                return newest
            seen_s = newest.by_s

    def following(self, by_s: float, *, patiently: bool = False) -> list[UrState]:
        """Wait for states fetched after a time (monotonic); return all of these."""
        return self._following(by_s, patiently=patiently)

    def write(self, order: Order) -> None:
        """Write the registers, with the next sign of life; raises `DeviceError`."""
        with self._writing:
            self._life = self._life % MAX_LIFE + 1
            self._order = order
            self._write()

    def end_script(self, session: int) -> None:
        """Have the script of a session brake and end; no later write takes that back.

        Gives no sign of life. Raises `DeviceError`.
        """
        with self._writing:
            self._ending = session
            self._write()

    def close(self) -> None:
        """End the thread and the connection."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_S)
        self._link.close()

    def _write(self) -> None:
        order = replace(self._order, stop=self._ending or self._order.stop)
        self._link.send(self._inputs.encode(order.registers(self._life)), "write registers")

    # -- setting up ---------------------------------------------------------------------------

    def _set_up(self) -> str:
        if not rtde.accepted(self._ask(Kind.VERSION, rtde.request_version())):
            raise self._refused("HC-B69", f"version {rtde.VERSION} of RTDE is refused")
        version = rtde.controller_version(
            self._ask(Kind.CONTROLLER_VERSION, rtde.encode(Kind.CONTROLLER_VERSION))
        )
        asked = rtde.request_outputs(OUTPUTS, self._rate_hz)
        self._outputs = self._recipe(Kind.OUTPUTS, asked, OUTPUTS)
        if found := unlike(self._outputs):
            raise self._refused("HC-B69", f"unexpected type of {', '.join(found)}")
        self._inputs = self._recipe(Kind.INPUTS, rtde.request_inputs(INPUTS), INPUTS)
        self._echo = self._recipe(Kind.INPUTS, rtde.request_inputs((ECHO,)), (ECHO,))
        if not rtde.accepted(self._ask(Kind.START, rtde.encode(Kind.START))):
            raise self._refused("HC-B69", "the exchange is not started")
        return version

    def _recipe(self, kind: Kind, request: bytes, names: tuple[str, ...]) -> Recipe:
        answer = self._ask(kind, request)
        try:
            recipe = Recipe.from_answer(names, answer)
        except RtdeError as error:
            raise self._link.broken("set up", str(error)) from error
        if lacking := recipe.lacking(rtde.NOT_FOUND):
            raise self._refused("HC-B69", f"the controller has no {', '.join(lacking)}")
        if held := recipe.lacking(rtde.IN_USE):
            raise self._refused("HC-B68", f"another client writes {', '.join(held)}")
        return recipe

    def _ask(self, kind: Kind, request: bytes) -> bytes:
        """Return the payload of the answer of the same type."""
        self._link.send(request, kind.name.lower())
        patience, over = Patience(ANSWER_S), False
        while True:
            while self._arrived:
                found, payload = self._arrived.popleft()
                if found == kind:
                    return payload
            if over:
                raise self._no_rtde(kind, f"no answer within {ANSWER_S:.0f} s")
            self._check()
            over = patience.over()
            data = self._link.receive(SIZE, Patience(0.0 if over else LOOK_S))
            try:
                self._arrived.extend(self._packages.feed(data))
            except RtdeError as error:
                raise self._no_rtde(kind, str(error)) from error

    def _no_rtde(self, kind: Kind, found: str) -> DeviceError:
        return self._link.broken(kind.name.lower(), f"{found}; is rtde_port that of RTDE?")

    def _refused(self, code: str, found: str) -> DeviceRefused:
        act = {
            "HC-B68": "end the other program, or the fieldbus, that writes these registers",
            "HC-B69": "bring PolyScope up to date: 3.12, 5.6 or later",
        }[code]
        return DeviceRefused(code, DEVICE, "connect", found, act=act)

    # -- fetching -----------------------------------------------------------------------------

    def _empty(self) -> None:
        """Fetch what nobody wants, until `close`."""
        while not self._closing.wait(IDLE_S):
            if self._fetching.acquire(blocking=False):
                try:
                    self._fetch(0.0)
                finally:
                    self._fetching.release()

    def _following(self, by_s: float, *, patiently: bool) -> list[UrState]:
        patience = Patience(SILENT_S)
        while True:
            if not patiently:
                self._check()
            over = patience.over()
            with self._fetching:
                found = self._since(by_s)
                if not found and self._failure is None:
                    self._fetch(0.0 if over else LOOK_S)
                    found = self._since(by_s)
            if found:
                return found
            if self._failure is not None:
                raise self._failure
            if over:
                raise self._link.broken("receive", f"no package for {SILENT_S:.1f} s")

    def _fetch(self, wait_s: float) -> None:
        """Take what has arrived, or does within a time; a failure is kept."""
        if self._failure is not None:
            return
        try:
            looked_s = time.monotonic()
            data = self._link.receive(SIZE, Patience(0.0))
            if not data:
                self._emptied_s = looked_s
                data = self._link.receive(SIZE, Patience(wait_s)) if wait_s else b""
            self._arrived.extend(self._packages.feed(data))
            by_s = time.monotonic()
            while self._arrived:
                kind, payload = self._arrived.popleft()
                if kind == Kind.DATA:
                    numbers = self._outputs.decode(payload)
                    self._states.append(UrState.checked(numbers, self._emptied_s, by_s))
        except RtdeError as error:
            act = "restart the controller; resume"
            self._failure = DeviceError("HC-B26", DEVICE, "receive", str(error), act=act)
        except DeviceError as error:
            self._failure = error

    def _since(self, by_s: float) -> list[UrState]:
        newer = takewhile(lambda state: state.by_s > by_s, reversed(self._states))
        return list(newer)[::-1]
