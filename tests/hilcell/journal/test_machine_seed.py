from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.commands.cli import main, whole_parser
from hilcell.journal.runs import read_log
from hilcell.ports import DeviceError
from hilcell.run import run_plan


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["run", "--seed", "7"], 7),
        (["run", "--seed", "7", "--machine-seed", "0"], 0),
        (["sim", "--machine-seed", "9"], 9),
    ],
)
def test_the_machine_has_a_seed_of_its_own_or_the_runs(words: list[str], wanted: int) -> None:
    found = whole_parser().parse_args(words)
    assert run_plan.machine_seed(load_cell("paper"), found.seed, found.machine_seed) == wanted


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the seeds of the machines that were to be started; none is."""
    seeds: list[int] = []

    def start(*_: object, seed: int, **__: object) -> None:
        seeds.append(seed)
        raise DeviceError("HC-C18", "Simulated cell", "start", "not here")

    monkeypatch.setattr("hilcell.run.engine.start_simulation", start)
    return seeds


def test_a_resumed_run_has_the_machine_that_it_began_with(
    tmp_path: Path, started: list[int]
) -> None:
    words = ["--machine-seed", "5", "--seed", "2", "--name", "R", "--runs", str(tmp_path)]
    assert main(["run", "home", *words]) == 3
    assert main(["resume", "R", "--runs", str(tmp_path)]) == 3
    assert started == [5, 5]
    inputs = read_log(tmp_path / "R").inputs
    assert (inputs.seed, inputs.machine_seed) == (2, 5)


@pytest.mark.usefixtures("started")
@pytest.mark.parametrize("address", ["", "127.0.0.1:9"])
def test_a_machine_that_this_run_did_not_start_has_no_seed_in_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    def real(*_: object) -> Cell:
        return msgspec.structs.replace(load_cell("paper"), simulation=None, name="n", serial="s")

    if not address:
        monkeypatch.setattr("hilcell.cell.devices.load_cell", real)
    words = ["--name", "R", "--runs", str(tmp_path), f"--set=simulation.address={address}"]
    assert main(["run", "home", *words]) == 3
    inputs = read_log(tmp_path / "R").inputs
    assert (inputs.seed, inputs.machine_seed) == (1, None)


@pytest.mark.parametrize("command", ["run", "sim"])
def test_a_cell_slower_than_real_time_is_refused(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main([command, "--speed", "0.5"])
    assert "1 .. 1e+06" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("asked", "calibrated", "found"), [(None, None, None), (None, 2, 2), (1, None, 1), (2, 2, 2)]
)
def test_a_run_is_of_the_calibrated_machine(
    asked: int | None, calibrated: int | None, found: int | None
) -> None:
    assert run_plan.checked_machine_seed(asked, calibrated) == found
    with pytest.raises(SettingsError, match="simulated machine 8"):
        run_plan.checked_machine_seed(7, 8)
