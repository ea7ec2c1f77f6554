"""Corrected targets are known by their points where a spreadsheet has dropped their stamp."""

from pathlib import Path

import numpy as np
import pytest

from hilcell.compensation.targets import CorrectedBefore
from hilcell.journal.runs import CALIBRATION
from hilcell.ports import Array
from hilcell.programs.corrected import CorrectedPoints
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.commands.workplace import read_corrected
from tests.hilcell.lists import write_targets
from tests.whole.bench import command

NOMINAL = np.array([[0.0, 0.0, 1200.0], [0.0, 50.0, 1250.0], [10.0, 60.0, 1300.0]])
COMMAND = NOMINAL + [0.4, -0.3, 0.2]


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    finished(tmp_path / "runs", "1-made", MADE)
    return tmp_path / "runs"


def refuse(runs: Path, targets: Array) -> None:
    names = [f"H{n}" for n in range(len(targets))]
    for folder in (runs, runs / "1-made"):
        CorrectedPoints(folder).refuse("again.csv", names, targets)


def test_corrected_points_are_known_again(runs: Path) -> None:
    CorrectedPoints(runs / "1-made").note("the stamp", NOMINAL, COMMAND)
    refuse(runs, NOMINAL)
    more = NOMINAL + [0.0, 500.0, 0.0]
    lists = (
        COMMAND, np.round(COMMAND[::-1], 3), np.vstack([COMMAND, NOMINAL]),
        np.vstack([COMMAND[:2], NOMINAL, more]),
        COMMAND + [0.005, -0.005, 0.005],  # two decimals
        COMMAND + [0.05, -0.05, 0.05],  # one
        np.vstack([COMMAND[:2] + 0.04, NOMINAL[:2]]),
    )  # fmt: skip
    for again in lists:
        with pytest.raises(CorrectedBefore, match="the stamp"):
            refuse(runs, again)
    with pytest.raises(CorrectedBefore, match=r"1 of 4 .*\(H2; the stamp\)"):
        refuse(runs, np.vstack([NOMINAL[:2], COMMAND[:1], NOMINAL[2:]]))
    with pytest.raises(CorrectedBefore, match=r"12 of 12 .*H9, and 2 more; the stamp"):
        refuse(runs, np.vstack([COMMAND] * 4))
    refuse(runs, np.vstack([COMMAND[:1] + 0.05, NOMINAL]))


def test_targets_are_known_in_every_frame_that_they_were_corrected_in(runs: Path) -> None:
    CorrectedPoints(runs).note("the stamp", NOMINAL, COMMAND)
    with pytest.raises(CorrectedBefore):
        CorrectedPoints(runs).refuse("again.src", ["H1", "H2", "H3"], COMMAND + 900.0, COMMAND)


def test_a_point_that_hardly_moved_is_still_its_nominal_target(runs: Path) -> None:
    for step_mm in (0.005, 0.05):
        CorrectedPoints(runs / "1-made").note("the stamp", NOMINAL, NOMINAL + step_mm)
    refuse(runs, NOMINAL + 0.005)
    refuse(runs, NOMINAL)


def test_a_file_that_was_cut_or_spoilt_is_read_as_far_as_it_goes(runs: Path) -> None:
    CorrectedPoints(runs / "1-made").note("the stamp", NOMINAL, COMMAND)
    with CorrectedPoints(runs / "1-made").file.open("ab") as file:
        file.write(b"s,1.0,nan,2.0,1.0\ns,1.0,x,2.0,1.0\n\xff\xfe,1\ns,1.")
    with pytest.raises(CorrectedBefore):
        refuse(runs, COMMAND)


def test_a_list_whose_column_was_dropped_is_not_corrected_again(runs: Path) -> None:
    """As a spreadsheet saves it: other line ends, three decimals, no column of ours."""
    source, out, again = (runs.parent / f"{name}.csv" for name in ("targets", "out", "again"))
    write_targets(source, ["H1", "H2"], np.array([[0, 0, 1200, 0, 75, 0], [0, 50, 1250, 0, 75, 0]]))
    words = ("--station", "S1100", "--runs", runs)
    assert command("compensate", "1-made", source, "-o", out, *words).returncode == 0
    names, values, (stamp,) = read_corrected(out)
    write_targets(source, names, np.round(values, 3))
    refused = command("compensate", "1-made", source, "-o", again, *words)
    assert (refused.returncode, again.exists()) == (2, False)
    assert stamp.partition(";")[0] in refused.stderr


@pytest.mark.parametrize("how", ["named by its path", "alone", "alone, without runs"])
def test_a_correction_is_known_wherever_its_calibration_lies(runs: Path, how: str) -> None:
    """The points were kept beside the calibration, and looked for in --runs."""
    source, out, again = (runs.parent / f"{name}.csv" for name in ("targets", "out", "again"))
    write_targets(source, ["H1", "H2"], np.array([[0, 0, 1200, 0, 75, 0], [0, 50, 1250, 0, 75, 0]]))
    elsewhere, path = runs.parent / "elsewhere", runs / "1-made" / CALIBRATION
    if how != "alone, without runs":
        elsewhere.mkdir()
    if how != "named by its path":
        path = path.rename(runs.parent / "lone.json")
    words = ("--station", "S1100", "--runs", elsewhere)
    done = command("compensate", path, source, "-o", out, *words)
    assert ("known as corrected by their stamp alone" in done.stderr) == (
        how == "alone, without runs"
    )
    names, values, _ = read_corrected(out)
    write_targets(source, names, np.round(values, 3))
    assert command("compensate", path, source, "-o", again, *words).returncode == (
        0 if how == "alone, without runs" else 2
    )
