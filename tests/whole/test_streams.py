"""Slow sweeps with the tracker streaming, over the wires of a simulated cell of its own process."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fakes.simulator import Control, PaperCell
from hilcell.cell.file import load_cell
from hilcell.geometry.kinematics import forward
from hilcell.identification.axis_motion import SweepStream
from hilcell.journal.journal import read_journal
from hilcell.journal.log import Log
from hilcell.journal.stream_file import FOLDER, read_stream
from hilcell.ports import Array, DeviceError, NoReading, Stopped
from tests.fakes.wires import C3Client, EmsconClient, connected
from tests.whole.sweeper import KEY, START_RAD, Engine, engine, order

pytestmark = pytest.mark.waits

CELL = load_cell("paper")
# In paced time a PC may be late.
PACED = pytest.param(20.0, marks=[pytest.mark.wall, pytest.mark.nightly])
speeds = pytest.mark.parametrize("speed", [np.inf, PACED])
STATIONARY, CONTINUOUS = 0, 1
GET_MODE = 25


class Cell:
    """A simulated cell, seen by its wires and its control channel."""

    def __init__(self, simulated: PaperCell) -> None:
        self.options, self.address = simulated.options, simulated.address
        with Control(self.address) as control, self._wire("robot") as wire:
            client = C3Client(wire)
            client.start(1, np.degrees(START_RAD).tolist())
            while client.read("HC_ACK") != "1":
                pass
            truth = control.ask("truth")
        T_L_W = np.linalg.inv(np.array(truth["T_W_L"]))
        self.near_mm: Array = (T_L_W @ np.append(truth["flange_mm"], 1.0))[:3]

    def _wire(self, name: str) -> Any:
        port = self.options[name]["port"]
        assert isinstance(port, int)
        return connected(port)

    def variables(self, *names: str) -> list[str]:
        with self._wire("robot") as wire:
            client = C3Client(wire)
            return [client.read(name) for name in names]

    def mode(self) -> int:
        with self._wire("tracker") as wire:
            _, body = EmsconClient(wire).ask(GET_MODE)
            return int(struct.unpack("<I", body)[0])

    def is_restored(self) -> bool:
        override = self.variables("$OV_PRO", "HC_OV_OLD")
        return (override, self.mode()) == (["100", "0"], STATIONARY)


@contextmanager
def simulated_cell(speed: float = np.inf) -> Iterator[Cell]:
    simulated = PaperCell(CELL, seed=1, speed=speed, truth=True)
    try:
        yield Cell(simulated)
    finally:
        simulated.close()


@pytest.fixture
def cell() -> Iterator[Cell]:
    with simulated_cell() as found:
        yield found


def files(folder: Path) -> list[str]:
    return sorted(path.suffix for path in (folder / FOLDER).glob("*"))


def swept(cell: Cell, folder: Path, degrees: float = 4.0) -> tuple[SweepStream, Engine]:
    with engine(cell.address, folder) as found:
        record = found.bench.sweep(order(cell.near_mm, degrees))
        return read_stream(folder, record), found


@speeds
def test_a_sweep_is_recorded_whole(tmp_path: Path, speed: float) -> None:
    with simulated_cell(speed) as cell:
        data, found = swept(cell, tmp_path)
        assert cell.is_restored()
    check_one_motion(data)
    steps_s = np.diff(data.device_s)
    assert len(data.device_s) > 390
    assert np.abs(steps_s - 0.01).max() < 2e-6  # dense, in order, by the tracker's own clock
    assert bool(np.all(np.diff(data.asked_s.ravel()) >= 0))
    assert bool(np.all(data.window_s[:, 0] <= data.window_s[:, 1]))
    axis_rad = data.joints_rad[:, 0]
    assert bool(np.all(np.diff(axis_rad) > -1e-5))
    assert np.abs(data.joints_rad[:, 1:] - START_RAD[1:]).max() < 1e-5
    assert found.log.streams[KEY].samples == len(data.device_s)


def check_one_motion(data: SweepStream) -> None:
    # The reflector turns about axis 1 as fast as the joint does: both streams tell one motion.
    axis_rad = data.joints_rad[:, 0]
    middle_s = data.asked_s.mean(axis=1)
    inner = slice(len(axis_rad) // 4, -len(axis_rad) // 4)
    joint_rad_s = np.polyfit(middle_s[inner], axis_rad[inner], 1)[0]
    unsure_s = float(np.diff(data.asked_s[inner], axis=1).max())  # a pose is of then or then
    share = unsure_s / float(np.ptp(middle_s[inner]))
    beam = slice(len(data.xyz_mm) // 4, -len(data.xyz_mm) // 4)
    path_mm = np.linalg.norm(np.diff(data.xyz_mm[beam][::50], axis=0), axis=1).sum()
    times_s = data.device_s[beam][::50]
    speed_mm_s = path_mm / (times_s[-1] - times_s[0])
    radius_mm = float(np.linalg.norm(forward(CELL.robot.arm(), START_RAD)[:2, 3]))
    assert speed_mm_s / radius_mm == pytest.approx(joint_rad_s, rel=0.001 + share)


def test_a_recorded_sweep_is_not_made_again(cell: Cell, tmp_path: Path) -> None:
    swept(cell, tmp_path)
    before = cell.variables("HC_SEQ")
    with engine(cell.address, tmp_path) as found:
        assert found.bench.sweep(order(cell.near_mm)) == found.log.streams[KEY]
    assert cell.variables("HC_SEQ") == before


@speeds
def test_a_stop_in_the_middle(tmp_path: Path, speed: float) -> None:
    with simulated_cell(speed) as cell:
        with engine(cell.address, tmp_path) as found:
            found.at_wait, found.then = 5, found.stop_all
            with pytest.raises(Stopped):
                found.bench.sweep(order(cell.near_mm))
            while cell.variables("HC_STOP", "HC_ERR") != ["TRUE", "9"]:
                pass  # a stop waits for no answer; the test's time limit bounds this wait
            while not cell.is_restored():
                pass
        assert files(tmp_path) == []
        assert not found.log.streams
        with engine(cell.address, tmp_path) as again:
            assert again.bench.sweep(order(cell.near_mm)).samples > 390


@speeds
def test_a_beam_break_in_the_middle(tmp_path: Path, speed: float) -> None:
    with (
        simulated_cell(speed) as cell,
        engine(cell.address, tmp_path) as found,
        Control(cell.address) as control,
    ):
        control.ask("fault", name="tracker.stream_break", after=100)
        with pytest.raises(NoReading) as broken:
            found.bench.sweep(order(cell.near_mm))
        assert broken.value.code == "HC-T10"
        assert cell.is_restored()
        assert cell.variables("HC_STOP") == ["FALSE"]
        assert files(tmp_path) == []
        assert found.bench.sweep(order(cell.near_mm)).samples > 390
    assert files(tmp_path) == [".stream"]


def test_a_robot_fault_in_the_middle(cell: Cell, tmp_path: Path) -> None:
    with engine(cell.address, tmp_path) as found, Control(cell.address) as control:
        found.at_wait = 5
        found.then = lambda: control.ask("fault", name="robot.override_zero")
        with pytest.raises(DeviceError) as stopped:
            found.bench.sweep(order(cell.near_mm))
        assert stopped.value.code == "HC-B16"
    assert cell.mode() == STATIONARY
    assert cell.variables("$OV_PRO", "HC_OV_OLD") == ["0", "0"]  # the operator's, not ours


@pytest.mark.wall
def test_an_engine_killed_in_the_middle(cell: Cell, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "tests.whole.sweeper", cell.address, str(tmp_path)]
    process = subprocess.Popen([*words, *map(str, cell.near_mm)])
    while cell.variables("HC_OV_OLD") == ["0"] or files(tmp_path) == []:
        assert process.poll() is None
    while float(cell.variables("$AXIS_ACT")[0].split()[2].strip(",")) < -8.0:
        assert process.poll() is None
    process.kill()
    process.wait()
    assert cell.variables("$OV_PRO", "HC_OV_OLD", "HC_OV_SET") == ["95", "100", "95"]
    assert cell.mode() == CONTINUOUS
    assert files(tmp_path) == [".part"]
    with engine(cell.address, tmp_path) as found:
        assert cell.is_restored()
        assert not found.log.streams
        record = found.bench.sweep(order(cell.near_mm))
    assert files(tmp_path) == [".stream"]
    assert Log(read_journal(tmp_path / "journal.sqlite")).streams == {KEY: record}
