"""Simulated cells as the engine starts them: a process of their own, found by entry points.

The process ends with its parent (stdin closes) but not by a ctrl-C meant for the engine, which
needs it for its own safe stop: so it has its own session.
"""

from __future__ import annotations

import math
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from types import MappingProxyType
from typing import IO, Any, cast

import msgspec

from fakes.exercises import FaultExercise, cell_exercises
from fakes.faults import load_faults
from fakes.hall import draw_cell, sheet_of
from fakes.site import device_servers
from fakes.time import CountedTime
from fakes.traps import TRAPS, with_trap
from fakes.truth.machine import cell_machine
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.ports import DeviceError, Exercise, HilcellError, Stopped
from hilcell.sanitize import harmless


class PaperCell:
    """The paper's cell, or any other, on simulated hardware."""

    traps: Mapping[str, str] = MappingProxyType({name: trap.text for name, trap in TRAPS.items()})

    def __init__(
        self,
        cell: Cell,
        *,
        seed: int | None,
        run_seed: int | None = None,
        speed: float = math.inf,
        faults: str = "",
        truth: bool = False,
        trap: str = "",
        ports: Mapping[str, int] = MappingProxyType({}),
    ) -> None:
        """``ports``: of ``rail``, ``robot``, ``tracker`` and ``control``; others are free ones.

        ``trap``: set in the truth, of which the cell file knows nothing.
        """
        self.check(cell)
        attach = cell.simulation.address if cell.simulation is not None else ""
        if trap and not attach:
            cell = with_trap(cell, trap)
        self.exercises: Sequence[Exercise] = cell_exercises(cell)
        load_faults(faults)  # reports a wrong file here, completely
        self._process: subprocess.Popen[bytes] | None = None
        if "rail" in ports and not cell.has_rail:
            raise SettingsError("--ports", [f"rail: cell {cell.name} has no rail"])
        if attach and ports:
            raise SettingsError(
                "--ports", [f"simulation.address: the simulated cell at {attach} has its ports"]
            )
        if attach:
            self._control = Control(attach)
            answer = self._control.ask("addresses")
        else:
            order = {
                "cell": {k: v for k, v in msgspec.to_builtins(cell).items() if v is not None},
                "seed": seed,
                "run_seed": run_seed,
                "speed": None if math.isinf(speed) else speed,
                "faults": faults,
                "truth": truth,
                "ports": dict(ports),
            }
            self._process, self._words, answer = _start(msgspec.json.encode(order) + b"\n")
            self._control = Control(answer["control"])
        self.options: dict[str, dict[str, object]] = {
            name: answer.get(name, {}) for name in ("rail", "robot", "tracker")
        }
        self.address: str = attach or answer["control"]
        self._speed = math.inf if answer["speed"] is None else float(answer["speed"])

    @classmethod
    def check(cls, cell: Cell) -> None:
        if cell.simulation is not None and cell.simulation.address:
            _host_and_port(cell.simulation.address)
        else:
            cell_machine(cell)
            device_servers(cell)

    def clock(self, stop: threading.Event) -> SimulatedClock:
        return SimulatedClock(self._control, self._speed, stop)

    def strike(self, exercise: Exercise) -> None:
        """Inject a fault at its next occasion, also at rest."""
        if not isinstance(exercise, FaultExercise):
            raise HilcellError(f"exercise {exercise.title!r} does not exist in this simulated cell")
        self._control.ask(
            "fault",
            name=exercise.fault,
            value=exercise.value,
            count=exercise.count,
            at_rest=True,
        )

    def carry_reflector(self, near_mm: Sequence[float]) -> None:
        self._control.ask("carry", near_mm=near_mm)

    def pull_cable(self, device: str) -> None:
        """As `hilcell.ports.HasPerson`: after so many polls of the moving device."""
        polls = 300
        self._control.ask("fault", name=f"{device}.unplugged", after=polls)

    def heal(self) -> None:
        self._control.ask("clear")

    def close(self) -> None:
        self._control.close()
        if self._process is None:
            return
        process, self._process = self._process, None
        end_s = 5.0
        try:
            process.communicate(timeout=end_s)  # closes its stdin
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        with self._words as words:
            for line in _said(words).splitlines():
                print(harmless(line), file=sys.stderr)


class UnknownCell(PaperCell):
    """A hall that is drawn from the seed about the cell file; only its sheet is known."""

    PORTS: Mapping[str, int] = MappingProxyType(
        {"rail": 29540, "robot": 7000, "tracker": 29541, "control": 29542}
    )
    sheet: Mapping[str, str] = MappingProxyType({})  # of a hall that runs already

    def __init__(
        self,
        cell: Cell,
        *,
        seed: int | None,
        ports: Mapping[str, int] = MappingProxyType({}),
        **more: Any,
    ) -> None:
        """``ports`` that are not given are `PORTS`; 0 for a free one."""
        if cell.simulation is not None and cell.simulation.address:
            super().__init__(cell, seed=seed, ports=ports, **more)
            return
        seed = 1 if seed is None else seed
        drawn = draw_cell(cell, seed)
        super().__init__(drawn, seed=seed, ports={**self.PORTS, **ports}, **more)
        self.sheet = sheet_of(drawn, seed, self.options, self.address).files()


class ReplayCell(PaperCell):
    """Measured data in place of simulated physics: ``simulation.data`` names the CSV."""

    @classmethod
    def check(cls, cell: Cell) -> None:
        super().check(cell)
        if cell.simulation is None or not (cell.simulation.data or cell.simulation.address):
            raise SettingsError("simulation.data", ["missing; it names the CSV to replay"])


class SimulatedClock:
    """The time of a simulated cell; in stepped time waits return at once."""

    def __init__(self, control: Control, speed: float, stop: threading.Event) -> None:
        self._control, self._speed, self._stop = control, speed, stop
        stepped = math.isinf(speed)  # then the cell waits for its PC
        self.pc_s: Callable[[], float] = CountedTime().now_s if stepped else time.monotonic

    def now_s(self) -> float:
        return float(self._control.ask("now")["now_s"])

    def wait(self, duration_s: float) -> None:
        self.check()
        if math.isinf(self._speed):
            self._control.ask("wait", s=duration_s)
        else:
            self._stop.wait(duration_s / self._speed)
        self.check()

    def check(self) -> None:
        if self._stop.is_set():
            raise Stopped("a stop was asked for")


class Control(AbstractContextManager["Control"]):
    """A connection to a simulated cell's control channel; safe to use from several threads."""

    def __init__(self, address: str) -> None:
        self._lock = threading.Lock()
        self._address = address
        answer_s = 60.0  # a simulated cell waits for its PC, and the PC for the cell
        try:
            self._socket = socket.create_connection(_host_and_port(address), answer_s)
        except OSError as error:
            raise DeviceError(
                "HC-C18",
                "Simulated cell",
                "connect",
                f"nobody answers at {address}: {error}",
                act="start it with `hilcell sim` and give the address that it prints",
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._lines = self._socket.makefile("rb")

    def __exit__(self, *exception: object) -> None:
        self.close()

    def ask(self, do: str, **facts: object) -> dict[str, Any]:
        """Return the answer to a command; raises `DeviceError` if there is none."""
        with self._lock:
            try:
                self._socket.sendall(msgspec.json.encode({"do": do} | facts) + b"\n")
                line = self._lines.readline()
            except OSError as error:
                raise self._gone(do, error) from error
        if not line:
            raise self._gone(do, "it has ended")
        answer = msgspec.json.decode(line, type=dict[str, Any])
        if not answer["ok"]:
            raise DeviceError("HC-C18", "Simulated cell", do, str(answer["error"]))
        return answer

    def close(self) -> None:
        self._lines.close()
        self._socket.close()

    def _gone(self, do: str, reason: object) -> DeviceError:
        where = f"control channel {self._address} does not answer: {reason}"
        return DeviceError("HC-C18", "Simulated cell", do, where, act="start it again, then resume")


def _host_and_port(address: str) -> tuple[str, int]:
    known, last_port = re.fullmatch(r"([^:]+):(\d{1,5})", address, re.DOTALL), 65535
    if known is None or int(known[2]) > last_port:
        raise SettingsError("simulation.address", [f"expected HOST:PORT, got {address[:80]!r}"])
    return known[1], int(known[2])


def _start(order: bytes) -> tuple[subprocess.Popen[bytes], IO[bytes], dict[str, Any]]:
    """Start the process and return it with its stderr and its first line, decoded."""
    with ExitStack() as stack:
        words = stack.enter_context(tempfile.TemporaryFile())
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "fakes.host"],  # -P: no `fakes` of the working folder
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            start_new_session=True,
        )
        stdin, stdout = cast("IO[bytes]", process.stdin), cast("IO[bytes]", process.stdout)
        try:
            stdin.write(order)
            stdin.flush()
            line = stdout.readline()
        except OSError:
            line = b""
        if not line:
            process.communicate()
            what = f"simulated cell did not start (exit {process.returncode})"
            raise HilcellError(f"{what}:\n{_said(words)}")
        stack.pop_all()
    return process, words, msgspec.json.decode(line, type=dict[str, Any])


def _said(words: IO[bytes]) -> str:
    words.seek(0)
    longest = 2000
    return words.read().decode(errors="replace").strip()[-longest:]
