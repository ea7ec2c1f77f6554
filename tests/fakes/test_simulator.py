from __future__ import annotations

import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from fakes.simulator import Control, PaperCell, ReplayCell
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array, forward
from hilcell.ports import DeviceError, HilcellError, Stopped
from tests.fakes.wires import C3Client, EmsconClient, connected

DEADLINE_S = 10.0
PARENT = """
import time
from fakes.simulator import PaperCell
from hilcell.cell.file import load_cell
cell = PaperCell(load_cell("paper"), seed=1)
print(cell._process.pid, flush=True)
time.sleep(60)
"""


@pytest.fixture
def simulated(cell: Cell) -> Iterator[PaperCell]:
    simulated = PaperCell(cell, seed=3, truth=True)
    yield simulated
    simulated.close()


def within_deadline(done: Callable[[], bool]) -> bool:
    ends_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < ends_s:
        if done():
            return True
        time.sleep(0.01)
    return False


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


def points_of(simulated: PaperCell, poses_deg: list[list[float]]) -> Array:
    """Return what the tracker measures of the flange at each pose, and two nests, (N, 3)."""
    found = []
    with (
        Control(simulated.address) as control,
        connected(port(simulated.options["robot"])) as robot_wire,
        connected(port(simulated.options["tracker"])) as tracker_wire,
    ):
        robot, tracker = C3Client(robot_wire), EmsconClient(tracker_wire)
        tracker.ready()
        for number, pose in enumerate(poses_deg, 1):
            robot.go(number, pose)
            truth = control.ask("truth")
            into = inverse(np.array(truth["T_W_L"]))
            for name in ("flange", "F1", "P2"):
                near = apply(into, np.array([truth["reflectors_mm"][name]]))[0]
                found.append(tracker.measure(*near)[:3])
    return np.array(found)


POSES = [[0.0, -75.0, 100.0, 0.0, -40.0, 0.0], [20.0, -60.0, 90.0, 10.0, -50.0, 30.0]]


def test_same_seed_gives_the_same_figures(cell: Cell, simulated: PaperCell) -> None:
    first = points_of(simulated, POSES)
    again = PaperCell(cell, seed=3, truth=True)
    try:
        second = points_of(again, POSES)
    finally:
        again.close()
    assert np.array_equal(first, second)


def test_rail_is_on_its_bus(simulated: PaperCell) -> None:
    where = str(simulated.options["rail"]["channel"]).removeprefix("socket://")
    host, _, number = where.partition(":")
    with socket.create_connection((host, int(number)), DEADLINE_S) as wire:
        wire.sendall(b"C\rS6\rO\r")
        assert wire.recv(100)


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
    simulated = PaperCell(cell, seed=1)
    try:
        with Control(simulated.address) as control:
            with pytest.raises(DeviceError, match=r"keeps its truth.*sim --truth"):
                control.ask("truth")
            assert control.ask("now")["now_s"] >= 0.0
    finally:
        simulated.close()


def test_stepped_clock_waits_at_once(simulated: PaperCell) -> None:
    clock = simulated.clock(threading.Event())
    before = clock.now_s()
    began = time.monotonic()
    clock.wait(3600.0)
    assert time.monotonic() - began < 2.0
    assert clock.now_s() - before == pytest.approx(3600.0)


def test_many_clocks_share_one_connection(simulated: PaperCell) -> None:
    clocks = [simulated.clock(threading.Event()) for _ in range(150)]
    assert all(clock.now_s() >= 0.0 for clock in clocks)


def test_clock_stops(simulated: PaperCell) -> None:
    stop = threading.Event()
    clock = simulated.clock(stop)
    clock.check()
    stop.set()
    with pytest.raises(Stopped):
        clock.check()
    with pytest.raises(Stopped):
        clock.wait(1.0)


def test_paced_clock_runs_at_its_speed_and_stops_at_once(cell: Cell) -> None:
    simulated = PaperCell(cell, seed=1, speed=100.0)
    try:
        stop = threading.Event()
        clock = simulated.clock(stop)
        before, began = clock.now_s(), time.monotonic()
        clock.wait(20.0)
        assert 0.2 <= time.monotonic() - began < 2.0
        assert clock.now_s() - before >= 20.0
        timer = threading.Timer(0.05, stop.set)
        timer.start()
        began = time.monotonic()
        with pytest.raises(Stopped):
            clock.wait(1e6)
        assert time.monotonic() - began < 2.0
        timer.join()
    finally:
        simulated.close()


def test_attaches_to_a_running_cell_and_leaves_it_running(cell: Cell, simulated: PaperCell) -> None:
    assert cell.simulation is not None
    there = msgspec.structs.replace(cell.simulation, address=simulated.address)
    attached = PaperCell(msgspec.structs.replace(cell, simulation=there), seed=99)
    assert attached.options == simulated.options
    attached.clock(threading.Event()).wait(7.0)
    attached.close()
    assert simulated.clock(threading.Event()).now_s() >= 7.0


def test_nobody_at_the_address_is_said_so(cell: Cell) -> None:
    assert cell.simulation is not None
    nowhere = msgspec.structs.replace(cell.simulation, address="127.0.0.1:1")
    with pytest.raises(DeviceError, match=r"nobody answers at 127.0.0.1:1: .*`hilcell sim`"):
        PaperCell(msgspec.structs.replace(cell, simulation=nowhere), seed=1)


@pytest.mark.parametrize("address", [":::", "x", "127.0.0.1:", "127.0.0.1:-1", "127.0.0.1:65536"])
def test_what_is_no_address_is_refused(cell: Cell, address: str) -> None:
    assert cell.simulation is not None
    there = msgspec.structs.replace(cell.simulation, address=address)
    with pytest.raises(SettingsError, match=r"HOST:PORT is wanted, found '" + re.escape(address)):
        PaperCell(msgspec.structs.replace(cell, simulation=there), seed=1)


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
        with pytest.raises(DeviceError, match="did you mean"):
            control.ask("fault", name="robot.mode_t2")
        for wrong in (math.inf, -1.0):
            with pytest.raises(DeviceError):
                control.ask("wait", s=wrong)
        with pytest.raises(DeviceError, match="one of addresses"):
            control.ask("fly")


def test_faults_file_is_checked_before_and_used(cell: Cell, tmp_path: Path) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nname = "robot.deselectd"\n')
    with pytest.raises(SettingsError, match="did you mean"):
        PaperCell(cell, seed=1, faults=str(file))
    file.write_text('[[fault]]\nname = "robot.deselected"\n')
    simulated = PaperCell(cell, seed=1, faults=str(file))
    try:
        with connected(port(simulated.options["robot"])) as wire:
            assert C3Client(wire).read("$PRO_STATE1") == "#P_FREE"
    finally:
        simulated.close()


def test_ends_on_quit_and_is_missed(cell: Cell) -> None:
    simulated = PaperCell(cell, seed=1)
    clock = simulated.clock(threading.Event())
    with Control(simulated.address) as control:
        control.ask("quit")

    def gone() -> bool:
        try:
            clock.now_s()
        except DeviceError as error:
            return "has ended" in str(error) or "does not answer" in str(error)
        return False

    assert within_deadline(gone)
    simulated.close()
    simulated.close()  # twice does no harm


def test_process_dies_with_its_parent(cell: Cell) -> None:
    """A parent that is killed has no chance to close anything; its stdin pipe just ends."""
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            PARENT,
        ],
        stdout=subprocess.PIPE,
    )
    assert parent.stdout is not None
    with parent.stdout:
        child = int(parent.stdout.readline())
        assert alive(child)
        assert os.getsid(child) != os.getsid(parent.pid)  # ctrl-C does not reach it
        parent.send_signal(signal.SIGKILL)
        parent.wait(DEADLINE_S)
        assert within_deadline(lambda: not alive(child) or _is_zombie(child))


def _is_zombie(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] == "Z"


def test_module_by_hand_refuses_a_wrong_order() -> None:
    for order in ("", "{}", json.dumps({"cell": {"name": "x"}})):
        ran = subprocess.run(
            [sys.executable, "-m", "fakes"],
            input=order + "\n",
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
        assert ran.returncode == 2
        assert "Traceback" not in ran.stderr
        assert ran.stderr


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
    assert cell.simulation is not None
    return msgspec.structs.replace(
        cell, simulation=msgspec.structs.replace(cell.simulation, simulator="replay", data=data)
    )


def test_replay_gives_the_recorded_figures(cell: Cell, tmp_path: Path) -> None:
    simulated = ReplayCell(replayed(cell, str(data_file(tmp_path))), seed=1)
    try:
        with (
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
    finally:
        simulated.close()


def test_replay_without_or_with_bad_data_is_refused(cell: Cell, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"simulation\.data"):
        ReplayCell(replayed(cell, ""), seed=1)
    file = tmp_path / "bad.csv"
    file.write_text("pose,target\n")
    with pytest.raises(HilcellError, match=r"bad\.csv"):
        ReplayCell(replayed(cell, str(file)), seed=1)
