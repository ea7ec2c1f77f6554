from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

import msgspec
import pytest

from fakes.faults import load_faults
from fakes.kuka.controller import KrlController
from fakes.simulator import PaperCell
from fakes.truth.machine import cell_machine, load_machine
from fakes.truth.sizes_page import page
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from tests.fakes.conftest import simulated_site

ROOT = Path(__file__).parents[2]
FOLDER = resources.files("fakes.truth.machines")


def test_a_cell_names_its_machine() -> None:
    models = [cell_machine(load_cell(name)).model for name in ("paper", "hard", "six-r")]
    assert models == ["#KR210R2700_2 C4 FLR", "#KR210R2700_2 C4 FLR", "#SR12_1400"]


def test_the_controllers_identity_is_the_machines() -> None:
    controller = KrlController(simulated_site(load_cell("six-r"))[0])
    assert controller.read("$TRAFONAME[]").startswith('"#SR12_1400')
    assert controller.read("$KR_SERIALNO") == "500147"


def test_a_machine_file_of_ones_own_is_read_strictly(tmp_path: Path) -> None:
    text = (FOLDER / "paper.toml").read_text("utf-8")
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert load_machine(str(file)) == load_machine("paper")
    wrong = text.replace("rp_mm", "rp_m").replace("[0.0, 0.0, -1.0]", "[1.0, 1.0, 0.0]")
    file.write_text(wrong)
    with pytest.raises(SettingsError) as refused:
        load_machine(str(file))
    assert len(refused.value.problems) == 3
    file.write_text(text.replace("[[joint]]", "[[joint]", 1))
    with pytest.raises(SettingsError, match=r"mine\.toml"):
        load_machine(str(file))


def test_an_unknown_machine_is_refused(cell: Cell) -> None:
    with pytest.raises(SettingsError, match="papr"):
        load_machine("papr")
    assert cell.simulation is not None
    simulation = msgspec.structs.replace(cell.simulation, machine="papr")
    with pytest.raises(SettingsError, match=r"simulation\.machine"):
        PaperCell(msgspec.structs.replace(cell, simulation=simulation), seed=1)


def test_the_page_of_sizes_is_the_types() -> None:
    """Write it again with ``python -m fakes.truth.sizes_page > docs/machine-sizes.md``."""
    assert (ROOT / "docs/machine-sizes.md").read_text("utf-8") == page()


@pytest.mark.parametrize(
    ("key", "nearest"),
    [
        ("rail.backlsh_mm", "backlash_mm"),
        ("tracker.radial", "radial_um"),
        ("mountng.seat", "mount"),
    ],
)
def test_a_mistyped_size_names_the_nearest(key: str, nearest: str) -> None:
    cell = load_cell("paper", {f"simulation.sizes.{key}": "0.05"})
    table = key.partition(".")[0]
    with pytest.raises(SettingsError, match=f'{table}.*did you mean "{nearest}'):
        cell_machine(cell)


def test_single_sizes_of_a_machine_are_replaced() -> None:
    cell = load_cell("paper", {"simulation.sizes.rail.backlash_mm": "0.05"})
    whole = load_machine("paper")
    assert cell_machine(cell).rail == msgspec.structs.replace(whole.rail, backlash_mm=0.05)
    assert cell_machine(cell).transmission == whole.transmission


def test_a_size_that_no_machine_has_is_refused() -> None:
    sizes = {"simulation.sizes.rail.backlas_mm": "0.05", "simulation.sizes.rail.curve_mm": "-1.0"}
    with pytest.raises(SettingsError) as found:
        cell_machine(load_cell("paper", sizes))
    assert found.value.source == "simulation.sizes of paper"
    keys = [problem.split(":")[0] for problem in found.value.problems]
    assert keys == ["rail.backlas_mm", "rail.curve_mm"]


def changed(folder: Path, before: str, after: str) -> str:
    text = (FOLDER / "paper.toml").read_text("utf-8")
    assert before in text
    file = folder / "own.toml"
    file.write_text(text.replace(before, after))
    return str(file)


@pytest.mark.parametrize(
    ("before", "after", "found"),
    [
        ("pins = [30, 51]", "pins = [51, 30]", "transmission.pins"),
        ("ratios = [150, 250]", "ratios = [250, 150]", "transmission.ratios"),
        (
            "[rail]",
            "band = [{ cycles = [32, 4], rms_urad = 45.0 }]\n[rail]",
            "transmission.band[0].cycles",
        ),
        ("backlash_mm = 0.2", "backlash_mm = 100000.0", "rail.backlash_mm"),
        ("largest_mm = 1.9", "largest_mm = 1.2", "errors"),
    ],
)
def test_sizes_that_no_machine_has_are_refused(
    tmp_path: Path, before: str, after: str, found: str
) -> None:
    with pytest.raises(SettingsError) as caught:
        load_machine(changed(tmp_path, before, after))
    (problem,) = caught.value.problems
    assert problem.startswith(f"{found}: ")


@pytest.mark.parametrize(
    ("before", "after", "found"),
    [
        ("largest_mm = 1.9", "largest_mm = 1.21", "errors.largest_mm"),
        ("size_mm = 1.2092", "size_mm = 1e-6", "errors.size_mm"),
    ],
)
def test_a_machine_that_cannot_be_drawn_names_its_file_and_key(
    tmp_path: Path, before: str, after: str, found: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fakes.truth.arm_truth.ArmTruth.DRAWS", 2)
    own = changed(tmp_path, before, after)
    cell = load_cell("paper", {"simulation.machine": own})
    with pytest.raises(SettingsError) as caught:
        simulated_site(cell)
    assert caught.value.source == f"simulation.machine {own!r}"
    assert caught.value.problems[0].startswith(f"{found}: ")


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for read in (load_machine, load_faults, load_cell):
        for path in (str(fifo), "/dev/zero"):
            with pytest.raises(SettingsError):
                read(path)


def test_an_empty_name_of_a_machine_is_refused_with_its_key() -> None:
    with pytest.raises(SettingsError, match=r"simulation\.machine: "):
        load_cell("paper", {"simulation.machine": ""})
