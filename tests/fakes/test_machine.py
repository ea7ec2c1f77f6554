from __future__ import annotations

from importlib import resources
from pathlib import Path

import msgspec
import pytest

from fakes.faults import Faults
from fakes.krl_controller import KrlController
from fakes.machine import load_machine, machine_of
from fakes.plant import Plant
from fakes.simulator import PaperCell
from fakes.time import PlantTime
from hilcell.cell import Cell, SimulationTable, load_cell
from hilcell.settings import SettingsError

FOLDER = resources.files("fakes.machines")


def test_a_cell_names_its_machine() -> None:
    models = [machine_of(load_cell(name)).model for name in ("paper", "hard", "six-r")]
    assert models == ["#KR210R2700_2 C4 FLR", "#KR210R2700_2 C4 FLR", "#SR12_1400"]


def test_the_controllers_identity_is_the_machines() -> None:
    cell = load_cell("six-r")
    plant = Plant(cell, 1, PlantTime(), Faults())
    controller = KrlController(cell, plant.robot, Faults())
    assert controller.read("$TRAFONAME[]").startswith('"#SR12_1400')
    assert controller.read("$KR_SERIALNO") == "500147"


def test_a_machine_file_of_ones_own_is_read_strictly(tmp_path: Path) -> None:
    text = (FOLDER / "paper.toml").read_text("utf-8")
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert load_machine(str(file)) == load_machine("paper")
    wrong = text.replace("rp_mm", "rp_m").replace("[0.0, 0.0, -1.0]", "[1.0, 1.0, 0.0]")
    file.write_text(wrong)
    with pytest.raises(SettingsError, match=r'3 problems[^$]*length 1[^$]*did you mean "rp_mm"'):
        load_machine(str(file))
    file.write_text(text.replace("[[joint]]", "[[joint]", 1))
    with pytest.raises(SettingsError, match=r"mine\.toml"):
        load_machine(str(file))


def test_an_unknown_machine_is_refused(cell: Cell) -> None:
    with pytest.raises(SettingsError, match=r"known are: hard, paper, six-r"):
        load_machine("papr")
    simulation = msgspec.structs.replace(simulation_of(cell), machine="papr")
    with pytest.raises(SettingsError, match=r"simulation\.machine 'papr'"):
        PaperCell(msgspec.structs.replace(cell, simulation=simulation), seed=1)


def simulation_of(cell: Cell) -> SimulationTable:
    assert cell.simulation is not None
    return cell.simulation
