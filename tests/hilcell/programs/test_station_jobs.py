"""Jobs are refused or corrected before anything is written, and written whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hilcell.atomic_files import NotWritten
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import CorrectedBefore
from hilcell.programs.station_jobs import SHEET, SUMMARY, StationJobs
from hilcell.run.order import Release
from tests.hilcell.commands.test_prepare import INSIDE, holes, made

CELL = load_cell("paper")


def planned(folder: Path, path: Path, runs: Path, **more: Any) -> StationJobs:
    usual: dict[str, Any] = {"tool": "", "standoff_mm": None, "say": print}
    release = Release(runs=runs, max_age=36_500.0)
    return StationJobs.plan(CELL, str(folder / "calibration.json"), path, release, **(usual | more))


def test_jobs_are_written_whole_and_known_again(tmp_path: Path) -> None:
    made(tmp_path)
    runs, path = tmp_path / "runs", holes(tmp_path, *INSIDE, lean=0.02)
    runs.mkdir()
    jobs = planned(tmp_path, path, runs)
    assert [job.plan.station.name for job in jobs.stations] == ["S1100"]
    assert sorted(jobs.stations[0].plan.holes) == ["H1", "H2", "H3"]
    assert not (tmp_path / "out").exists()
    said = jobs.write(tmp_path / "out", [])
    names = {SUMMARY, SHEET, *jobs.stations[0].files}
    assert {each.name for each in (tmp_path / "out").iterdir()} == names
    assert not [each for each in said if "stamp alone" in each]
    with pytest.raises(NotWritten, match="not empty"):
        jobs.write(tmp_path / "out", [])
    x, y, z = jobs.stations[0].targets.command[0, :3].tolist()
    with pytest.raises(CorrectedBefore):
        planned(tmp_path, holes(tmp_path, (x, y, z), lean=0.02), runs)


def test_points_that_cannot_be_kept_are_said_once(tmp_path: Path) -> None:
    made(tmp_path)
    jobs = planned(tmp_path, holes(tmp_path, *INSIDE, lean=0.02), tmp_path / "none")
    said = jobs.write(tmp_path / "out", [])
    assert [each for each in said if "stamp alone" in each] == said[:1]


def test_a_short_stand_off_is_refused_before_the_holes_are_read(tmp_path: Path) -> None:
    made(tmp_path)
    with pytest.raises(SettingsError, match="--standoff"):
        planned(tmp_path, tmp_path / "no.csv", tmp_path, standoff_mm=1.0)
