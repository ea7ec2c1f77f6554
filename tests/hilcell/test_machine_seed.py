from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from hilcell.cli import _parser, main
from hilcell.commands import run
from hilcell.ports import DeviceError
from hilcell.runs import read_log


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["run", "--seed", "7"], 7),
        (["run", "--seed", "7", "--machine-seed", "0"], 0),
        (["sim", "--machine-seed", "9"], 9),
    ],
)
def test_the_machine_has_a_seed_of_its_own_or_the_runs(words: list[str], wanted: int) -> None:
    assert run.machine_seed(_parser().parse_args(words)) == wanted


def test_a_resumed_run_has_the_machine_that_it_began_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[int] = []

    def start(*_: object, seed: int, **__: object) -> None:
        started.append(seed)
        raise DeviceError("HC-C18", "Simulated cell", "start", "not here")

    monkeypatch.setattr(run, "start_simulation", start)
    words = ["--machine-seed", "5", "--seed", "2", "--name", "R", "--runs", str(tmp_path)]
    assert main(["run", "home", *words]) == 3
    assert main(["resume", "R", "--runs", str(tmp_path)]) == 3
    assert started == [5, 5]
    inputs = read_log(tmp_path / "R").inputs
    assert (inputs.seed, inputs.machine_seed, inputs.truth_seed) == (2, 5, 5)
    of_old = msgspec.structs.replace(inputs, machine_seed=None)
    assert of_old.truth_seed == 2  # journals of schema 1 had one seed for both


@pytest.mark.parametrize(
    "settings", [["simulation.address=127.0.0.1:9"], ["simulation.simulator=replay"]]
)
def test_a_cell_that_runs_already_takes_no_machine_seed(
    settings: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    sets = [f"--set={each}" for each in settings]
    code = main(["run", "home", "--machine-seed", "3", "--dry-run", *sets])
    refused = "address" in settings[0]
    assert code == (2 if refused else 0)
    assert ("give the seed to its `hilcell sim`" in capsys.readouterr().err) == refused
