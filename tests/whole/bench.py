"""The whole program as its users run it: commands, processes, pipes and sockets."""

from __future__ import annotations

import json
import math
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO, TextIOWrapper
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec
import pytest
from _pytest.mark import ParameterSet

from fakes.host import Host, Order
from fakes.simulator import PaperCell
from hilcell.cell.devices import start_simulation
from hilcell.cell.file import Cell, load_cell
from hilcell.commands.cli import main
from hilcell.invariants import check_invariants
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.journal.runs import JOURNAL, read_log
from hilcell.ports import SimulatedCell
from tests.whole.outputs import Outputs

Words = tuple[str | Path, ...]
HILCELL = [sys.executable, "-m", "hilcell"]
PAPER = Path(__file__).parents[2] / "hilcell/cells/paper.toml"
OUTPUTS = Outputs()
LIMIT_S = 200.0  # a busy machine may take long, and is not at fault
LOOK_S = 0.02  # between two looks at what lasts: without a wait they keep a processor busy

# A small calibration: every act of the real one, fewer points of each.
SMALL = {
    "plan.quick": "false",
    "grid.pitch_mm": "450.0",
    "validation.per_cell": "1",
    "validation.others": "8",
    "base_frame.points": "6",
    "layout.nest_samples": "2",
    "sweeps.enabled": "false",
    "validation.mean_tolerance_mm": "0.3",  # without sweeps the ripple stays
    "validation.max_tolerance_mm": "1.0",
}

# Three reflectors on the flange: the tool's orientation is measured, and in two orientations.
SEATS = {
    "robot.more_smr_mm": "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]",
    "plan.grid_orientations": "[[20.0, 65.0, 0.0]]",
    "validation.max_tolerance_deg": "0.1",
}

# A total station in the place of the laser tracker: what a cell file says of it.
TOTAL_STATION = {
    "tracker.driver": "leica-geocom",
    "tracker.max_std_mm": "3.0",
    "tracker.samples": "4",
    "base_frame.points": "24",
    "tracker.options.temperature_c": "23.0",
    "tracker.options.pressure_mbar": "1009.0",
    "uncertainty.tracker_limit_mm": "0.3",
    "uncertainty.tracker_limit_um_m": "2.0",
    "layout.max_tool_std_mm": "1.0",
    "validation.mean_tolerance_mm": "2.0",
    "validation.max_tolerance_mm": "4.0",
}


def judge(events: Iterable[dict[str, Any]]) -> list[str]:
    """Return the invariants that the events of a journal break, one line each."""
    verdicts = check_invariants(map(record_of, events))
    return [
        f"{name} at record {each.seq}: {each.what}"
        for name, verdict in verdicts.items()
        for each in verdict.broken
    ]


def record_of(event: dict[str, Any]) -> Record:
    head = ("run", "seq", "t", "kind")  # the rest is the record's body, and its key
    body = {name: value for name, value in event.items() if name not in head}
    key = "" if event["kind"] == "event" else body.pop("key", "")  # an event's is in its body
    return Record(event["seq"], event["t"], event["kind"], key, body)


def sets(values: Mapping[str, str]) -> list[str]:
    return [word for key, value in values.items() for word in ("--set", f"{key}={value}")]


def sweep(*values: object) -> list[ParameterSet]:
    """Mark the values of a sweep, or tuples of them, that only `make nightly` runs."""
    sets = (value if isinstance(value, tuple) else (value,) for value in values)
    return [pytest.param(*each, marks=pytest.mark.nightly) for each in sets]


def hilcell(*words: str | Path, limit_s: float = LIMIT_S) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*HILCELL, *map(str, words)], capture_output=True, text=True, timeout=limit_s, check=False
    )


class _Heard(BytesIO):
    """Output of a run with --json, of which every event is heard before the run goes on."""

    def __init__(self, hear: Callable[[dict[str, Any]], object]) -> None:
        super().__init__()
        self._hear = hear

    def write(self, line: Any, /) -> int:
        count = super().write(line)
        self._hear(json.loads(line))
        return count


def command(
    *words: str | Path, hear: Callable[[dict[str, Any]], object] | None = None
) -> subprocess.CompletedProcess[str]:
    """Do the same in this process: quicker, where nothing depends on a process of its own.

    With ``hear`` each event of a run with --json is heard while the run stands still. A run that
    breaks an invariant fails the test.
    """
    done = performed(*words, hear=hear)
    if words[:1] == ("run",) and "--json" in words and "--dry-run" not in words:
        assert broken(done.stdout) == []
    return done


def performed(
    *words: str | Path, hear: Callable[[dict[str, Any]], object] | None = None
) -> subprocess.CompletedProcess[str]:
    """Do a command, and judge nothing."""
    heard = BytesIO() if hear is None else _Heard(hear)
    out, err = (TextIOWrapper(to, "utf-8", write_through=True) for to in (heard, BytesIO()))
    with OUTPUTS.to(out, err):
        try:
            code = main([str(word) for word in words])
        except SystemExit as refused:  # of a command line that makes no sense
            code = int(refused.code or 0)
    said = [each.buffer.getvalue().decode() for each in (out, err)]
    return subprocess.CompletedProcess(words, code, *said)


@dataclass(frozen=True)
class Ran:
    """A run that was performed: its folder, and the output of its command."""

    folder: Path
    done: subprocess.CompletedProcess[str]

    @property
    def runs(self) -> Path:
        return self.folder.parent

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        return events(self.done.stdout)

    @cached_property
    def log(self) -> Log:
        """Return its journal, read again; tests copy what they change."""
        return read_log(self.folder)

    @property
    def end(self) -> dict[str, Any]:
        return end_of(self.done)

    @property
    def result(self) -> dict[str, Any]:
        result: dict[str, Any] = self.end["result"]
        return result


def ran(
    runs: Path,
    procedure: str,
    values: Mapping[str, str] = MappingProxyType({}),
    *words: str | Path,
    name: str = "x",
    hear: Callable[[dict[str, Any]], object] | None = None,
) -> Ran:
    """Perform a procedure in this process, unattended; ``values`` are those of its cell file."""
    where = ("--unattended", "--json", "--runs", runs, "--name", name)
    return Ran(runs / name, command("run", procedure, *where, *sets(values), *words, hear=hear))


def corrected(
    calibration: str | Path, targets: Path, station: str, out: Path, *words: str | Path
) -> subprocess.CompletedProcess[str]:
    return command("compensate", calibration, targets, "--station", station, "-o", out, *words)


def shop_cell(folder: Path) -> Path:
    """Write the paper's cell as one of real devices: a cell file without a simulator."""
    cell = folder / "shop.toml"
    cell.write_text(PAPER.read_text("utf-8").split("[simulation]")[0])
    return cell


def shop_values(rail: str, robot: object, tracker: object) -> dict[str, str]:
    """Return values of that cell file: the rail's channel, and ports of robot and tracker."""
    return {
        "name": "shop",
        "serial": "HC-7",
        "rail.options.channel": rail,
        "robot.options.port": str(robot),
        "tracker.options.port": str(tracker),
        "settle.rail_s": "0.0",
        "rail.standstill_dwell_s": "0.05",
    }


def events(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def broken(printed: str) -> list[str]:
    """Return the invariants that a whole journal breaks, as --json prints it; [] for a part.

    A line without a number was printed where the journal took no record.
    """
    found = events(printed) if '"seq":1,' in printed.partition("\n")[0] else []
    return judge(each for each in found if "seq" in each)


def journal(runs: Path, name: str) -> list[dict[str, Any]]:
    """Return the events of a run's whole journal, which breaks no invariant."""
    found = events(command("watch", name, "--runs", runs, "--json").stdout)
    assert judge(found) == []
    return found


def end_of(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """Return the end event of a run with --json, which is its last line."""
    assert done.stdout, done.stderr
    last = events(done.stdout)[-1]
    assert last["kind"] == "end"
    assert last["exit"] == done.returncode
    return last


class Engine:
    """A run in the background whose events can be awaited."""

    def __init__(self, *words: str | Path, program: Sequence[str] = HILCELL) -> None:
        self.process = subprocess.Popen(
            [*program, *map(str, words), "--json"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.events: list[dict[str, Any]] = []

    def until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Read events until one matches; the pytest time limit bounds the wait."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.events.append(json.loads(line))
            if wanted(self.events[-1]):
                return self.events[-1]
        self.rest()
        raise AssertionError(f"the run ended first: {self.events[-1:]}\n{self.errors}")

    def kill(self) -> list[dict[str, Any]]:
        """Kill -9 and return all events that were printed, the torn last line left out."""
        self.process.send_signal(signal.SIGKILL)
        return self.rest()

    def rest(self) -> list[dict[str, Any]]:
        # communicate() would miss what the line iterator has read ahead.
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        lines = self.process.stdout.readlines()
        self.errors = self.process.stderr.read()
        self.process.wait(LIMIT_S)
        self.process.stdout.close()
        self.process.stderr.close()
        self.events += [json.loads(line) for line in lines if line.endswith("\n")]
        return self.events

    @property
    def run(self) -> str:
        return str(self.events[0]["run"])


@dataclass(frozen=True)
class Simulation:
    """A simulated cell that outlives its engines."""

    addresses: Mapping[str, Any]
    control: str

    @property
    def shop(self) -> dict[str, str]:
        """Return values by which a cell file of real devices reaches the simulated ones."""
        at = self.addresses
        return shop_values(at["rail"]["channel"], at["robot"]["port"], at["tracker"]["port"])

    def strike(self, name: str, value: object = True, **more: object) -> None:
        assert self.ask(do="fault", name=name, value=value, **more)["ok"]

    def ask(self, **request: object) -> dict[str, Any]:
        """Send one request over the control channel."""
        host, port = self.control.split(":")
        with socket.create_connection((host, int(port)), timeout=10) as link:
            link.sendall(json.dumps(request).encode() + b"\n")
            answer: dict[str, Any] = json.loads(link.makefile("rb").readline())
        return answer


class OwnCell:
    """The simulated cell that a run starts for itself; ``at_start`` are faults that wait in it."""

    def __init__(self) -> None:
        self.at_start: list[dict[str, Any]] = []
        self.strike: Callable[..., None]

    def start(self, cell: Cell, **words: Any) -> SimulatedCell | None:
        """Do what `hilcell.cell.devices.start_simulation` does."""
        found = start_simulation(cell, **words)
        assert isinstance(found, PaperCell)
        self.strike = Simulation({}, found.address).strike
        for fault in self.at_start:
            self.strike(**fault)
        return found


@contextmanager
def simulation(
    speed: float = math.inf,
    values: Mapping[str, str] | None = None,
    *,
    name: str = "paper",
    faults: str = "",
    seed: int = 1,
    truth: bool = False,
) -> Iterator[Simulation]:
    """Run the simulated cell in threads of the test; ``values`` are those of its cell file.

    ``seed`` is the machine's; with ``truth`` it tells where everything really is.

    As a process of its own it would take the time to start one.
    """
    cell: dict[str, Any] = msgspec.to_builtins(load_cell(name, values))
    given = {key: value for key, value in cell.items() if value is not None}
    stepped = None if math.isinf(speed) else speed
    host = Host(Order(cell=given, seed=seed, speed=stepped, faults=faults, truth=truth))
    serving = threading.Thread(target=host.run, name="simulated cell")
    serving.start()
    try:
        addresses = host.addresses()
        found = Simulation(addresses, addresses["control"])
        found.ask(do="now")  # the last to serve, so all threads are there
        yield found
    finally:
        host.end()
        serving.join()


@contextmanager
def sim_command(*words: str, cwd: Path | None = None) -> Iterator[Simulation]:
    """Run ``hilcell sim`` beside the test."""
    process = subprocess.Popen(
        [*HILCELL, "sim", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=cwd,
    )
    try:
        assert process.stdout is not None
        addresses = json.loads(process.stdout.readline())
        yield Simulation(addresses, str(addresses["control"]))
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=20)


def wait_gone(pid: int, limit_s: float = 20.0) -> None:
    """Wait until a process that is not our child has ended."""
    deadline = time.monotonic() + limit_s
    while Path(f"/proc/{pid}").exists() and "Z" not in state_of(pid):
        assert time.monotonic() < deadline, f"process {pid} lives on"
        time.sleep(0.01)


def state_of(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return "Z"


def children(pid: int) -> list[int]:
    """Return the processes that ``pid`` started."""
    found = []
    for entry in (path.name for path in Path("/proc").iterdir()):
        if entry.isdigit():
            try:
                stat = Path(f"/proc/{entry}/stat").read_text().rsplit(")", 1)[1].split()
            except OSError:
                continue
            if int(stat[1]) == pid:
                found.append(int(entry))
    return found


def cut(whole: Path, folder: Path, seq: int) -> None:
    """Copy a run's journal as it was when record ``seq`` had just become durable."""
    folder.mkdir()
    source = sqlite3.connect(whole / JOURNAL)
    copy = sqlite3.connect(folder / JOURNAL)
    source.backup(copy)
    source.close()
    copy.executescript("DROP TRIGGER IF EXISTS record_is_never_deleted")
    copy.execute("DELETE FROM record WHERE seq > ?", (seq,))
    copy.commit()
    copy.close()
