from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

import fakes.host as by_hand
from fakes.simulator import Control, PaperCell, ReplayCell, SimulatedClock
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.kinematics import forward
from hilcell.ports import DeviceError, HilcellError, Stopped
from tests.fakes.rail_bench import until
from tests.fakes.wires import C3Client, EmsconClient, connected

PARENT = """
import sys
from fakes.simulator import PaperCell
from hilcell.cell.file import load_cell
cell = PaperCell(load_cell("paper"), seed=1)
print(cell._process.pid, flush=True)
sys.stdin.read()
"""


@pytest.fixture
def simulated(cell: Cell) -> Iterator[PaperCell]:
    simulated = PaperCell(cell, seed=3, truth=True)
    yield simulated
    simulated.close()


def simulated_by(cell: Cell, **changed: str) -> Cell:
    assert cell.simulation is not None
    simulation = msgspec.structs.replace(cell.simulation, **changed)
    return msgspec.structs.replace(cell, simulation=simulation)


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def port(options: dict[str, object]) -> int:
    found = options["port"]
    assert isinstance(found, int)
    return found


POSES = [[0.0, -75.0, 100.0, 0.0, -40.0, 0.0], [20.0, -60.0, 90.0, 10.0, -50.0, 30.0]]


def test_truth_is_the_papers(simulated: PaperCell, cell: Cell) -> None:
    with Control(simulated.address) as control:
        truth = control.ask("truth", joints_deg=[POSES[0], POSES[1]])
    errors = np.array(truth["errors_mm"])
    assert errors.shape == (2, 3)
    assert 0.2 < np.linalg.norm(errors, axis=1).mean() < 3.0
    nominal = forward(cell.robot.arm(), np.radians(cell.robot.home_deg))
    at_mm = np.array(truth["T_W_B"]) @ np.append(nominal[:3, 3], 1.0)
    assert 0.05 < np.linalg.norm(at_mm[:3] - truth["flange_mm"]) < 4.0


def test_truth_is_kept_unless_the_cell_was_started_for_it(cell: Cell) -> None:
    with (
        contextlib.closing(PaperCell(cell, seed=1)) as simulated,
        Control(simulated.address) as control,
    ):
        for question in ("truth", "travel"):
            with pytest.raises(DeviceError) as kept:
                control.ask(question)
            assert "--truth" in kept.value.found
        assert control.ask("now")["now_s"] >= 0.0


def test_travel_of_slide_and_axes_since_it_was_last_asked(simulated: PaperCell) -> None:
    with (
        Control(simulated.address) as control,
        connected(port(simulated.options["robot"])) as wire,
    ):
        first = control.ask("travel")
        assert first["slide"]["excursion_mm"] == 0.0
        C3Client(wire).go(1, [10.0, -90.0, 90.0, 0.0, -30.0, -4.0])
        travel = control.ask("travel")
    assert travel["axes"]["excursion_deg"] == pytest.approx([10.0, 0.0, 0.0, 0.0, 0.0, 4.0])
    assert 0.0 < travel["axes"]["moving_s"] <= travel["now_s"] - first["now_s"]


def test_stepped_clock_waits_at_once(simulated: PaperCell) -> None:
    clock = simulated.clock(threading.Event())
    before = clock.now_s()
    clock.wait(3600.0)
    assert clock.now_s() - before == pytest.approx(3600.0)


class Waits(threading.Event):
    """A stop that notes how long it is waited for."""

    def __init__(self) -> None:
        super().__init__()
        self.s: list[float | None] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.s.append(timeout)
        return self.is_set()


def test_a_clock_waits_at_its_pace_and_stops(simulated: PaperCell) -> None:
    stop = Waits()
    with Control(simulated.address) as control:
        paced = SimulatedClock(control, 100.0, stop)
        paced.wait(20.0)
        assert stop.s == [0.2]
        for clock in (simulated.clock(stop), paced):
            clock.check()
            stop.set()
            for act in (clock.check, lambda clock=clock: clock.wait(1e6)):
                with pytest.raises(Stopped):
                    act()
            stop.clear()


def test_attaches_to_a_running_cell_and_leaves_it_running(cell: Cell, simulated: PaperCell) -> None:
    attached = PaperCell(simulated_by(cell, address=simulated.address), seed=99)
    assert attached.options == simulated.options
    attached.clock(threading.Event()).wait(7.0)
    attached.close()
    assert simulated.clock(threading.Event()).now_s() >= 7.0


def test_nobody_at_the_address_is_said_so(cell: Cell) -> None:
    with pytest.raises(DeviceError) as gone:
        PaperCell(simulated_by(cell, address="127.0.0.1:1"), seed=1)
    assert gone.value.code == "HC-C18"


@pytest.mark.parametrize("address", ["x", "127.0.0.1:", "127.0.0.1:65536"])
def test_what_is_no_address_is_refused(cell: Cell, address: str) -> None:
    with pytest.raises(SettingsError):
        PaperCell(simulated_by(cell, address=address), seed=1)


def test_faults_over_the_control_channel(simulated: PaperCell) -> None:
    with (
        Control(simulated.address) as control,
        connected(port(simulated.options["robot"])) as wire,
    ):
        robot = C3Client(wire)
        control.ask("fault", name="robot.mode_t1")
        assert robot.read("$MODE_OP") == "#T1"
        control.ask("clear", name="robot.mode_t1")
        assert robot.read("$MODE_OP") == "#T1"  # the fault is over, its consequence stays
        control.ask("clear")
        assert robot.read("$MODE_OP") == "#EX"
        with pytest.raises(DeviceError, match=r"robot\.mode_t1"):
            control.ask("fault", name="robot.mode_t2")
        for do, asked in (("wait", {"s": math.inf}), ("wait", {"s": -1.0}), ("fly", {})):
            with pytest.raises(DeviceError):
                control.ask(do, **asked)


def test_faults_file_is_checked_before_and_used(cell: Cell, tmp_path: Path) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nname = "robot.deselectd"\n')
    with pytest.raises(SettingsError, match=r"robot\.deselected"):
        PaperCell(cell, seed=1, faults=str(file))
    file.write_text('[[fault]]\nname = "robot.deselected"\n')
    with (
        contextlib.closing(PaperCell(cell, seed=1, faults=str(file))) as simulated,
        connected(port(simulated.options["robot"])) as wire,
    ):
        assert C3Client(wire).read("$PRO_STATE1") == "#P_FREE"


def test_ends_on_quit_and_is_missed(cell: Cell) -> None:
    simulated = PaperCell(cell, seed=1)
    clock = simulated.clock(threading.Event())
    with Control(simulated.address) as control:
        control.ask("quit")

    def gone() -> bool:
        try:
            clock.now_s()
        except DeviceError as error:
            return error.code == "HC-C18"
        return False

    until(gone)
    simulated.close()
    simulated.close()  # twice does no harm


@pytest.mark.process
def test_process_dies_with_its_parent() -> None:
    """A parent that is killed has no chance to close anything; its stdin pipe just ends."""
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert parent.stdin is not None
    assert parent.stdout is not None
    with parent.stdin, parent.stdout:
        child = int(parent.stdout.readline())
        assert alive(child)
        assert os.getsid(child) != os.getsid(parent.pid)  # ctrl-C does not reach it
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        until(lambda: not alive(child) or _is_zombie(child))


def _is_zombie(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] == "Z"


@pytest.mark.parametrize("order", ["", "{}", json.dumps({"cell": {"name": "x"}})])
def test_module_by_hand_refuses_a_wrong_order(
    order: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reads, writes = os.pipe()
    os.write(writes, f"{order}\n".encode())
    monkeypatch.setattr(by_hand, "STDIN", reads)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    assert by_hand.main() == 2
    os.close(reads)
    os.close(writes)
    assert capsys.readouterr().err


def data_file(tmp_path: Path, rows: int = 3) -> Path:
    lines = ["pose,target,j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg,x_mm,y_mm,z_mm"]
    for pose in range(rows):
        joints = ",".join(f"{angle + pose:.6f}" for angle in POSES[0])
        lines += [
            f"{pose},SMR{smr},{joints},{3000 + 100 * smr}.25,{pose}.5,{-10 * pose}"
            for smr in (1, 2, 3)
        ]
    file = tmp_path / "data.csv"
    file.write_text("\n".join(lines) + "\n")
    return file


def replayed(cell: Cell, data: str) -> Cell:
    return simulated_by(cell, simulator="replay", data=data)


def test_replay_gives_the_recorded_figures(cell: Cell, tmp_path: Path) -> None:
    simulated = ReplayCell(replayed(cell, str(data_file(tmp_path))), seed=1)
    with (
        contextlib.closing(simulated),
        connected(port(simulated.options["robot"])) as robot_wire,
        connected(port(simulated.options["tracker"])) as tracker_wire,
    ):
        robot, tracker = C3Client(robot_wire), EmsconClient(tracker_wire)
        tracker.ready()
        for pose in (2, 0, 1):
            robot.go(10 + pose, [angle + pose for angle in POSES[0]])
            for smr in (3, 1):
                near = (3000.0 + 100 * smr, pose + 5.0, -10.0 * pose)
                xyz = tracker.measure(*near)[:3]
                assert xyz == (3000.25 + 100 * smr, pose + 0.5, -10.0 * pose)
        robot.go(99, [angle + 0.3 for angle in POSES[0]])
        assert tracker.ask(55, "3di", 3100.0, 0.0, 0.0, 1)[0] != 0  # not recorded


def test_replay_without_or_with_bad_data_is_refused(cell: Cell, tmp_path: Path) -> None:
    with pytest.raises(SettingsError) as refused:
        ReplayCell(replayed(cell, ""), seed=1)
    assert refused.value.source == "simulation.data"
    file = tmp_path / "bad.csv"
    file.write_text("pose,target\n")
    with pytest.raises(HilcellError, match=r"bad\.csv"):
        ReplayCell(replayed(cell, str(file)), seed=1)
