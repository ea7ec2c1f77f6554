"""A re-calibration follows a known arm by a few poses, in five minutes, with a verdict."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

import fakes.in_process
from fakes.faults import Faults
from fakes.time import CellTime
from fakes.truth.arm_truth import Ripple
from fakes.truth.cell_truth import CellTruth
from fakes.truth.machine import cell_machine
from hilcell.calibration.file import Calibration, read_calibration, write_calibration
from hilcell.calibration.from_run import calibration_from_log
from hilcell.calibration.known_arm import seed_after, unfit
from hilcell.cell.file import Cell, load_cell
from hilcell.decoding import Json, typed
from hilcell.identification.known_arm import ArmChanged
from hilcell.journal.log import Log
from hilcell.model.events import ArmCarried, PosesChosen
from hilcell.ports import HilcellError
from hilcell.run.procedure import run_in_process
from procedures.calibrate import CALIBRATE
from procedures.robot_grid import planned_rad

pytestmark = pytest.mark.waits
MACHINE = 31


def cell_from(calibration: Path | None, name: str = "paper", **values: str) -> Cell:
    start = {} if calibration is None else {"plan.calibration": json.dumps(str(calibration))}
    return load_cell(name, {"plan.quick": "true"} | start | values)


def performed(folder: Path, cell: Cell, seed: int) -> tuple[Log, Json]:
    log = run_in_process(cell, CALIBRATE, seed=seed, machine_seed=MACHINE, folder=folder)
    return log, CALIBRATE.result(log)


def written(folder: Path, log: Log, name: str) -> Path:
    path = folder / f"{name}.json"
    write_calibration(calibration_from_log(log, name), path)
    return path


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("base")
    return written(folder, performed(folder, cell_from(None), 1)[0], "BASE")


@pytest.fixture(scope="module")
def again(base: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Log, Json]:
    folder = tmp_path_factory.mktemp("again")
    start = folder / "start.json"
    start.write_bytes(base.read_bytes())
    cell = cell_from(start)
    log = run_in_process(cell, CALIBRATE, seed=2, machine_seed=MACHINE, folder=folder)
    start.unlink()
    return written(folder, log, "AGAIN"), log, CALIBRATE.result(log)


class Changed(CellTruth):
    """The machine, whose arm was worked on."""

    zero_rad, gear, slip_mm = 0.0, 0, (0.0, 0.0, 0.0)

    def __init__(
        self, cell: Cell, seed: int, time: CellTime, faults: Faults, run_seed: int | None = None
    ) -> None:
        super().__init__(cell, seed, time, faults, run_seed)
        self.arm.lost_rad[1] += self.zero_rad
        self._slip_pose[:3, 3] += self.slip_mm
        if self.gear:
            other = Ripple(cell_machine(cell).transmission, np.random.default_rng(99))
            for row in ("amplitude_rad", "cycles", "phase_rad"):
                getattr(self.arm.ripple, row)[self.gear - 1] = getattr(other, row)[self.gear - 1]


@pytest.fixture
def changed(monkeypatch: pytest.MonkeyPatch) -> type[Changed]:
    class Own(Changed):
        pass

    monkeypatch.setattr(fakes.in_process, "CellTruth", Own)
    return Own


def test_it_is_planned_in_five_minutes_and_accepted(
    base: Path, again: tuple[Path, Log, Json]
) -> None:
    _, log, result = again
    plan = CALIBRATE.plan(cell_from(base), 2)
    assert plan.duration_s <= 300.0
    assert sum("carried" in note for note in plan.notes) == 4
    validation = result["validation"]
    assert validation["S1100"]["decision"]["outcome"] == "accepted"
    assert validation["others"]["decision"]["outcome"] == "accepted"
    assert validation["S1100"]["chosen"]["mean"] < 0.06
    known = result["known_arm"]
    assert (known["calibration"], known["poses"], known["changed"]) == ("BASE", 14, {})
    assert known["mount_mm"] < 0.06
    assert result["suspicions"] == []
    assert result["method"] == "kinematic"
    assert {"idw", "trilinear"} <= result["fit"]["refused"].keys()
    assert not log.select("grid")
    assert len(log.select("closing")) == 3


def test_its_run_is_whole_without_the_calibration_that_it_started_from(
    again: tuple[Path, Log, Json],
) -> None:
    """That is gone since the run ended."""
    path, log, _ = again
    assert [each.run for each in log.happened(ArmCarried)] == ["BASE"]
    assert not Path(log.cell.plan.calibration).exists()
    made = read_calibration(path)
    assert made.lost_motion == typed(log.happened(ArmCarried)[0].content, Calibration).lost_motion
    assert made.provenance.run == "AGAIN"
    assert len(made.provenance.points) == 14


def test_a_lost_zero_is_followed(base: Path, tmp_path: Path, changed: type[Changed]) -> None:
    changed.zero_rad = 5e-4
    _, result = performed(tmp_path, cell_from(base), 3)
    found = result["known_arm"]["changed"]
    assert found["zero of axis 2"] == pytest.approx(5e-4, rel=0.4)
    assert result["suspicions"] == []  # the tool follows the arm
    assert result["validation"]["S1100"]["chosen"]["mean"] < 0.06


@pytest.mark.parametrize("slip_mm", [(0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.3)])
def test_a_slipped_mount_is_suspected(
    base: Path, tmp_path: Path, changed: type[Changed], slip_mm: tuple[float, float, float]
) -> None:
    """No target shows it: the correction follows the reflector, and the drill is off."""
    changed.slip_mm = slip_mm
    _, result = performed(tmp_path, cell_from(base), 3)
    (found,) = result["suspicions"]
    assert (found["cause"], found["noticed_by"]) == ("mount slipped", "circles of run BASE")
    assert found["size"] == pytest.approx(0.3, abs=0.05)
    assert result["known_arm"]["mount_mm"] == pytest.approx(0.3, abs=0.05)


def test_another_gear_is_refused(base: Path, tmp_path: Path, changed: type[Changed]) -> None:
    changed.gear = 1
    with pytest.raises(ArmChanged, match=r"no longer that of BASE.*axis 1"):
        performed(tmp_path, cell_from(base), 4)


def test_a_chain_holds(again: tuple[Path, Log, Json], tmp_path: Path) -> None:
    path, _, _ = again
    log, result = performed(tmp_path, cell_from(path), 5)
    assert result["known_arm"]["calibration"] == "AGAIN"
    assert result["validation"]["others"]["chosen"]["covered"] >= 0.8
    made, before = calibration_from_log(log, "THIRD"), read_calibration(path)
    assert made.lost_motion == before.lost_motion
    lines = [line for line in made.budget.lines if line.how.endswith(", in an earlier run")]
    assert [line.name for line in lines] == ["Robot repeatability", "Approach direction"]
    assert all(line.how.count("earlier") == 1 for line in lines)


def test_links_of_a_chain_have_seeds_of_their_own(
    base: Path, again: tuple[Path, Log, Json]
) -> None:
    first, second = read_calibration(base), read_calibration(again[0])
    assert seed_after(first) == seed_after(read_calibration(base)) > 1
    assert seed_after(second) != seed_after(first)


def test_each_seed_goes_elsewhere(base: Path) -> None:
    cell = cell_from(base)
    one, other = planned_rad(cell, 1), planned_rad(cell, 2)
    assert len(one) == len(other) == cell.plan.known_poses
    assert np.abs(one[:, None] - other).max(axis=-1).min() > 1e-3
    np.testing.assert_array_equal(planned_rad(cell, 1), one)


def test_poses_are_those_of_the_plan(base: Path, again: tuple[Path, Log, Json]) -> None:
    _, log, _ = again
    chosen_deg = log.happened(PosesChosen)[0].joints_deg
    np.testing.assert_allclose(np.radians(chosen_deg), planned_rad(cell_from(base), 2), atol=1e-12)


def reasons(calibration: Calibration, **values: str) -> str:
    cell = load_cell("paper", {"plan.quick": "true"} | values)
    return "; ".join(unfit(calibration, cell))


def test_what_cannot_be_carried_is_refused_in_a_sentence(base: Path) -> None:
    found = read_calibration(base)
    assert not reasons(found)
    moved = {"grid.centre": "{ x_mm = 1900.0, y_mm = 0.0, z_mm = 950.0, b_deg = 75.0 }"}
    assert "leaves the calibrated volume by 50 mm" in reasons(found, **moved)
    turned = {"grid.centre": "{ x_mm = 1850.0, y_mm = 0.0, z_mm = 950.0, b_deg = 70.0 }"}
    assert "turn the tool by 5.0" in reasons(found, **turned)
    assert "turn the tool by 0.0 + 20" in reasons(found, **{"plan.tilt_deg": "20.0"})
    seats = {"robot.more_smr_mm": "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]"}
    assert "1 reflectors on the flange" in reasons(found, **seats)
    more = {"plan.grid_orientations": "[[20.0, 65.0, 0.0]]"}
    assert "measured with the whole grid" in reasons(found, **more)
    errors = np.zeros((3, 3))
    nominal = msgspec.structs.replace(
        found.model, name="nominal", parameters={"covariance_mm2": errors.tolist()}
    )
    assert "knows no arm" in reasons(msgspec.structs.replace(found, model=nominal))
    plain = found.model.parameters | {
        "decision": {"used": False, "reason": "not used"},
    }
    swept = msgspec.structs.replace(found.model, parameters=plain)
    assert "no curves of the gears" in reasons(msgspec.structs.replace(found, model=swept))


def test_a_full_plan_is_refused(base: Path) -> None:
    with pytest.raises(HilcellError, match=r"plan\.quick is false"):
        CALIBRATE.plan(cell_from(base, **{"plan.quick": "false"}), 1)


def test_another_robot_is_refused_before_anything_moves(base: Path, tmp_path: Path) -> None:
    found = read_calibration(base)
    made = found.provenance
    devices = [
        msgspec.structs.replace(each, serial="4711") if each.kind == "robot" else each
        for each in made.devices
    ]
    of_other = msgspec.structs.replace(
        found, provenance=msgspec.structs.replace(made, devices=devices)
    )
    path = tmp_path / "other.json"
    write_calibration(of_other, path)
    with pytest.raises(HilcellError, match="serial 4711, connected is"):
        performed(tmp_path, cell_from(path), 6)
