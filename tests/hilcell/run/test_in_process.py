"""A run without wires: the same figures as over wires, and the same refusals."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from fakes.in_process import DirectRobot, DirectTracker
from hilcell.cell.devices import load_entry
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.journal.log import Log
from hilcell.ports import Array, DeviceError, HilcellError, TrackerReading
from hilcell.run.procedure import Procedure, run_in_process
from tests.whole.bench import SMALL
from tests.whole.golden import GoldenRuns

pytestmark = pytest.mark.waits
CALIBRATE: Procedure = load_entry("procedures", "calibrate")
HOME: Procedure = load_entry("procedures", "home")
NOISE_MM = 0.05  # of one visit: repeatability and tracker, as both runs measure it


def performed(folder: Path, values: Mapping[str, str] = SMALL, machine: int = 1) -> Log:
    cell = load_cell("paper", values)
    return run_in_process(cell, CALIBRATE, seed=1, machine_seed=machine, folder=folder)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return performed(tmp_path_factory.mktemp("direct"))


def of_targets(result: Mapping[str, Any], what: str) -> list[float]:
    """Return the mean errors at the grid's station and at the others."""
    return [result["validation"][at][what]["mean"] for at in ("S1100", "others")]


def test_it_agrees_with_the_run_over_wires(log: Log, golden: GoldenRuns) -> None:
    """Both measure the one machine; each visit has a scatter of its own."""
    wires, direct = golden["small"].result, CALIBRATE.result(log)
    assert direct["points"] == wires["points"]
    targets = direct["validation"]["S1100"]["points"]
    for what, share in (("before", 1.0), ("idw", 2.0), ("chosen", 2.0)):
        # A correction has the scatter of its own grid in it as well.
        limit_mm = 3.0 * share * np.sqrt(2.0 / targets) * NOISE_MM
        assert of_targets(direct, what) == pytest.approx(of_targets(wires, what), abs=limit_mm)
    for name, station in wires["stations"].items():
        T = np.array(direct["stations"][name]["T_W_S"])
        assert T[:3, 3] == pytest.approx(np.array(station["T_W_S"])[:3, 3], abs=0.1)


def test_the_same_seeds_are_the_same_digits(log: Log, tmp_path: Path) -> None:
    assert CALIBRATE.result(performed(tmp_path)) == CALIBRATE.result(log)


def test_another_machine_is_another_result(log: Log, tmp_path: Path) -> None:
    other = CALIBRATE.result(performed(tmp_path, machine=2))
    assert of_targets(other, "before") != pytest.approx(
        of_targets(CALIBRATE.result(log), "before"), abs=1e-6
    )


def test_a_reading_that_is_no_number_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = DirectTracker.measure

    def spoilt(self: DirectTracker, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        reading = measure(self, near_mm, reflector, samples)
        return dataclasses.replace(reading, xyz_mm=reading.xyz_mm * np.nan)

    monkeypatch.setattr(DirectTracker, "measure", spoilt)
    with pytest.raises(HilcellError, match="nan"):
        performed(tmp_path)


def test_what_cannot_be_reached_is_one_error(tmp_path: Path) -> None:
    """Every refusal of every act in one message, before anything is measured."""
    far = "{ x_mm = 3850.0, y_mm = 0.0, z_mm = 950.0, b_deg = 75.0 }"
    with pytest.raises(HilcellError, match="calibrate") as found:
        performed(tmp_path, SMALL | {"grid.centre": far})
    assert found.value.code == "HC-C10"
    assert len(str(found.value).splitlines()) > 1
    assert list(tmp_path.iterdir()) == []


def test_a_cell_of_real_devices_is_refused(tmp_path: Path) -> None:
    cell = msgspec.structs.replace(load_cell("paper"), simulation=None)
    with pytest.raises(SettingsError, match="real"):
        run_in_process(cell, HOME, seed=1, machine_seed=1, folder=tmp_path)


def with_forearm(cell: Cell, by_mm: float) -> Cell:
    """Return the cell with a forearm that was typed wrong; the controller knows the right one."""
    joints = list(cell.robot.joint)
    joints[3] = msgspec.structs.replace(joints[3], d_mm=joints[3].d_mm + by_mm)
    return msgspec.structs.replace(cell, robot=msgspec.structs.replace(cell.robot, joint=joints))


@pytest.mark.parametrize("by_mm", [5.0, -1.0])
def test_a_controller_with_another_forearm_is_refused_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by_mm: float
) -> None:
    monkeypatch.setattr(DirectRobot, "move_to", None)
    with pytest.raises(DeviceError) as found:
        run_in_process(
            with_forearm(load_cell("paper"), by_mm),
            HOME,
            seed=1,
            machine_seed=1,
            folder=tmp_path,
        )
    assert found.value.code == "HC-B36"
    fits = found.value.fields["fits"]
    assert isinstance(fits, dict)
    assert fits["d_mm of joint 4"] == pytest.approx(-by_mm, abs=0.01)


def test_links_of_a_factory_are_journalled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = DirectRobot.read
    monkeypatch.setattr(
        DirectRobot, "read", lambda robot: dataclasses.replace(read(robot), by_factory_links=True)
    )
    for by_mm, found in ((0.0, False), (1.2, True)):
        cell = with_forearm(load_cell("paper"), by_mm)
        log = run_in_process(cell, HOME, seed=1, machine_seed=1, folder=tmp_path)
        assert log.by_factory_links == found
