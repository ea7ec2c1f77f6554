"""``python -m benchmarks.stop [STOPS]``: from a screen's socket to the stop frames on the wires.

A real engine (runner, control channel, drivers) works on the simulated cell; a relay between them
notes when each stop frame passes. One engine process is stopped again and again, in every phase,
at a clock of speed 1 and as fast as it goes. Relay and engine share the machine: what is measured
is rather too long than too short. Beside it stands the bare measure: a byte to another process and
back, which tells how long this machine lets a process wait that does nothing else.
"""

from __future__ import annotations

import math
import random
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np

from benchmarks.words import parser
from drivers.leica import emscon
from hilcell.cell.devices import build_devices, start_simulation
from hilcell.cell.file import Cell, Nest, load_cell
from hilcell.journal.log import Log, RunJournal
from hilcell.journal.runs import JOURNAL, EngineFile
from hilcell.model.plan import PlannedStep, PlanRecord
from hilcell.model.point import PointId
from hilcell.ports import SimulatedCell
from hilcell.present.table import Table
from hilcell.run.cell_session import CellSession
from hilcell.run.control import Control
from hilcell.run.order import Attendance
from hilcell.run.procedure import Procedure
from hilcell.run.run_plan import RunPlan
from hilcell.run.runner import Runner

STOPS = 500
TARGET_MS = 20.0
BARE = 10  # round trips for every stop
ECHO = "import os\nwhile data := os.read(0, 1): os.write(1, data)"
PHASES = ("rail", "robot", "tracker", "prompt")
FRAMES = {
    "rail": b"t20560200",  # RPDO 1 of node 5, control word 0002h: quick stop
    "robot": b"HC_STOP\x00\x04TRUE",
    "tracker": emscon.encode(emscon.Command.STOP_MEASUREMENT),
}


# -- the engine's process -------------------------------------------------------------------------


class Phase:
    """A part that does one thing without end."""

    name = "phase"
    needs = moves = measures = yields = ""

    def __init__(self, phase: str) -> None:
        self.phase = phase

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, 0, 0.0)

    def result(self, log: Log) -> dict[str, Any]:
        return {}

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        if not session.rail_referenced():
            session.home_rail()
        for number in count():
            session.event("phase", phase=self.phase)
            getattr(self, self.phase)(session, number)

    def rail(self, bench: CellSession, number: int) -> None:
        bench.rail_to(900.0 if number % 2 else 1500.0)

    def robot(self, bench: CellSession, number: int) -> None:
        joints = np.radians(bench.cell.robot.home_deg)
        joints[0] = 1.0 if number % 2 else -1.0
        bench.robot_to(joints, "away")

    def tracker(self, bench: CellSession, number: int) -> None:
        bench.floor_nest_point(PointId("p", number=number), bench.cell.layout.floor[0])

    def prompt(self, bench: CellSession, number: int) -> None:
        nowhere = Nest(name="nowhere", x_mm=700.0, y_mm=700.0, z_mm=700.0)
        bench.floor_nest_point(PointId("q", number=number), nowhere)


class Place(msgspec.Struct):
    """Where an engine works: folder, and addresses of its devices."""

    folder: str
    control: str
    addresses: dict[str, dict[str, Any]]


def engine() -> None:
    """Run one phase for every line of stdin, each until it is stopped."""
    place = msgspec.json.decode(sys.stdin.buffer.readline(), type=Place)
    cell = load_cell("paper", {"simulation.address": place.control})
    simulated = start_simulation(cell, seed=1, speed=math.inf)
    assert simulated is not None
    for number, line in enumerate(sys.stdin):
        folder = Path(place.folder) / str(number)
        folder.mkdir()
        code = cycle(cell, simulated, place, folder, line.strip())
        print(code, flush=True)


def cycle(cell: Cell, simulated: SimulatedCell, place: Place, folder: Path, phase: str) -> int:
    with (
        running(cell, simulated, place.addresses, folder, Phase(phase)) as runner,
        closing(Control(folder, runner)),
    ):
        return runner.run()


@contextmanager
def running(
    cell: Cell,
    simulated: SimulatedCell,
    addresses: Mapping[str, Any],
    folder: Path,
    step: Any,
    *,
    unattended: bool = False,
) -> Iterator[Runner]:
    """Yield the runner of a procedure of one step, whose journal is in a folder."""
    stop = threading.Event()
    clock = simulated.clock(stop)
    with closing(RunJournal(folder / JOURNAL, folder.name, create=True)) as journal:
        journal.append("plan", "", msgspec.to_builtins(plan_of(cell, step.name)))
        procedure = Procedure(step.name, "", (step,), lambda result: Table((), ()))
        yield Runner(
            RunPlan(folder=folder, cell=cell, procedure=procedure, points=0),
            Attendance(unattended=unattended),
            journal,
            devices=build_devices(cell, addresses, clock),
            clock=clock,
            stop=stop,
        )


def plan_of(cell: Cell, name: str) -> PlanRecord:
    return PlanRecord(
        procedure=name,
        cell=msgspec.to_builtins(cell),
        digest=cell.digest,
        seed=1,
        machine_seed=1,
        cell_file=cell.name,
        speed=None,
        unattended=False,
        operator="",
        job="",
        simulated=True,
        versions={},
        settings={},
        steps=[PlannedStep(name, 0, 0.0)],
        points=0,
        duration_s=0.0,
    )


# -- the relay between engine and cell ------------------------------------------------------------


class Relay:
    """Hands bytes on and notes when a stop frame came by."""

    def __init__(self, name: str, host: str, port: int) -> None:
        self.seen_s = math.nan
        self._frame, self._far = FRAMES[name], (host, port)
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._socket.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            near, _ = self._socket.accept()
            far = socket.create_connection(self._far)
            for one, other, watch in ((near, far, True), (far, near, False)):
                one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self._pump, args=(one, other, watch), daemon=True).start()

    def _pump(self, one: socket.socket, other: socket.socket, watch: bool) -> None:
        tail = b""
        with suppress(OSError):
            while data := one.recv(65536):
                now_s = time.monotonic()
                other.sendall(data)
                if watch:
                    tail = (tail + data)[-200:]
                    if math.isnan(self.seen_s) and self._frame in tail:
                        self.seen_s = now_s
                        tail = b""
        for each in (one, other):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)


# -- the measurement ------------------------------------------------------------------------------


class Rig:
    """A simulated cell, the relays and an engine that is stopped again and again."""

    def __init__(self, folder: Path, speed: float) -> None:
        simulated = start_simulation(load_cell("paper"), seed=1, speed=speed)
        assert simulated is not None
        self._simulated = simulated
        addresses = {name: dict(each) for name, each in simulated.options.items()}
        rail_port = int(str(addresses["rail"]["channel"]).rpartition(":")[2])
        self.relays = {"rail": Relay("rail", "127.0.0.1", rail_port)}
        for name in ("robot", "tracker"):
            self.relays[name] = Relay(name, "127.0.0.1", int(str(addresses[name]["port"])))
            addresses[name]["port"] = self.relays[name].port
        addresses["rail"]["channel"] = f"socket://127.0.0.1:{self.relays['rail'].port}"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.stop", "--engine"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._echo = subprocess.Popen(
            [sys.executable, "-c", ECHO], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        )
        self._folder, self._cycles = folder, 0
        self._say(msgspec.json.encode(Place(str(folder), simulated.address, addresses)).decode())

    def _say(self, line: str) -> None:
        stdin = cast("Any", self._process.stdin)
        stdin.write(f"{line}\n")
        stdin.flush()

    def begin(self, phase: str) -> Path:
        """Let the engine run a phase; return the run's folder."""
        folder = self._folder / str(self._cycles)
        self._cycles += 1
        self._say(phase)
        return folder

    def arm(self) -> float:
        """Await new stop frames; return the time, s, from which they are counted."""
        for relay in self.relays.values():
            relay.seen_s = math.nan
        return time.monotonic()

    def frames_s(self, sent_s: float) -> dict[str, float]:
        """Wait for the engine's end; return when each device's stop frame came, s."""
        code = int(cast("Any", self._process.stdout).readline())
        assert code == 4, f"the engine ended with {code}"
        return {name: relay.seen_s - sent_s for name, relay in self.relays.items()}

    def stop(self, phase: str, rng: random.Random) -> dict[str, float]:
        """Return the time, s, from the screen's ``sendall`` to each device's stop frame."""
        folder = self.begin(phase)
        link = connected(folder / "engine.json")
        with link, link.makefile("rb") as answers:
            # A screen attends all the while, and has its stop on a connection of its own.
            with connected(folder / "engine.json") as screen:
                await_phase(screen, phase)
                time.sleep(rng.uniform(0.0, 0.6))
                sent_s = self.arm()
                link.sendall(b'{"command": "stop"}\n')
                answers.readline()
            return self.frames_s(sent_s)

    def bare(self) -> float:
        """Return the time, s, of a byte to another process and back."""
        began_s = time.monotonic()
        cast("Any", self._echo.stdin).write(b"x")
        cast("Any", self._echo.stdout).read(1)
        return time.monotonic() - began_s

    def close(self) -> None:
        self._echo.communicate()
        cast("Any", self._process.stdin).close()
        self._process.wait(30)
        self._simulated.close()


def connected(where: Path) -> socket.socket:
    deadline_s = time.monotonic() + 60.0
    while time.monotonic() < deadline_s:
        with suppress(OSError, msgspec.DecodeError):
            path = msgspec.json.decode(where.read_bytes(), type=EngineFile).socket
            link = socket.socket(socket.AF_UNIX)
            link.connect(path)
            return link
        time.sleep(0.005)
    raise TimeoutError(f"no engine at {where}")


def await_phase(screen: socket.socket, phase: str) -> None:
    """Wait until the engine does what is to be stopped."""
    moving = {"rail": "rail", "robot": "robot"}.get(phase)
    for status in statuses(screen):
        if phase == "prompt":
            if status["state"] == "suspended":
                return
        elif moving is not None:
            if status["devices"][moving]["state"] == "moving" and status["state"] == "running":
                return
        elif status["points"]:
            return
        time.sleep(0.01)


def statuses(screen: socket.socket) -> Iterator[dict[str, Any]]:
    with screen.makefile("rb") as answers:
        while True:
            screen.sendall(b'{"command": "status"}\n')
            yield msgspec.json.decode(answers.readline())


def report(name: str, taken_s: list[float]) -> None:
    ordered = sorted(1e3 * each for each in taken_s)
    p999 = ordered[math.ceil(0.999 * len(ordered)) - 1]
    verdict = "holds" if p999 <= TARGET_MS else "ABOVE"
    print(
        f"{name:20} {len(ordered):5}   median {statistics.median(ordered):5.2f}   "
        f"p99 {ordered[math.ceil(0.99 * len(ordered)) - 1]:6.2f}   p99.9 {p999:6.2f}   "
        f"max {ordered[-1]:6.2f} ms   {verdict} ({TARGET_MS:.0f} ms)"
    )


def main() -> None:
    words = parser(__doc__)
    words.add_argument("stops", type=int, nargs="?", default=STOPS, metavar="STOPS")
    stops = words.parse_args().stops
    rng = random.Random(1)
    for speed in (1.0, math.inf):
        with tempfile.TemporaryDirectory() as folder:
            rig = Rig(Path(folder), speed)
            taken: dict[str, list[float]] = {}
            bare: list[float] = []
            try:
                for number in range(stops // 2):
                    phase = PHASES[number % len(PHASES)]
                    frames = rig.stop(phase, rng)
                    assert not math.isnan(sum(frames.values())), f"{phase}: a frame is missing"
                    for name, value in frames.items():
                        taken.setdefault(f"frame of the {name}", []).append(value)
                    taken.setdefault(f"all, in: {phase}", []).append(max(frames.values()))
                    taken.setdefault("all", []).append(max(frames.values()))
                    bare += [rig.bare() for _ in range(BARE)]
            finally:
                rig.close()
        print(f"speed {'max' if math.isinf(speed) else speed:}")
        for name, values in sorted(taken.items()):
            report(name, values)
        report("bare round trip", bare)


if __name__ == "__main__":
    engine() if "--engine" in sys.argv else main()
