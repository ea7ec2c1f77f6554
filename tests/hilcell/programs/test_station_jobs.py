"""Jobs are refused or corrected before anything is written, and written whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.atomic_files import NotWritten
from hilcell.calibration.influence import NoBound
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


@pytest.fixture
def jobs(tmp_path: Path) -> StationJobs:
    """Return the job of three holes, the first named as no page would have it."""
    made(tmp_path)
    file = holes(tmp_path, *INSIDE, lean=0.02)
    file.write_text(file.read_text().replace("H1", "<i>H1</i>"))
    return planned(tmp_path, file, tmp_path / "runs")


def with_targets(jobs: StationJobs, **changed: Any) -> StationJobs:
    (job,) = jobs.stations
    return replace(jobs, stations=[replace(job, targets=replace(job.targets, **changed))])


def test_names_are_escaped_and_figures_are_rounded(jobs: StationJobs) -> None:
    page = replace(jobs, source=Path('run <b>"x')).sheet()
    assert "<dd>run &lt;b&gt;" in page
    assert "&lt;i&gt;H1&lt;/i&gt;" in page
    (job,) = jobs.stations
    x, y, z = (f"{each:.2f}".replace("-", "\u2212") for each in job.plan.poses[0, :3])
    assert f"<td>{x}</td><td>{y}</td><td>{z}</td>" in page
    assert f"{job.largest_mm:.3f} mm" in page
    assert 'holes\\000020run\\000020\\00003cb\\00003e\\000022x"' in page


def test_columns_are_those_that_have_figures(jobs: StationJobs) -> None:
    """Those of the rail, of the bounds, of the bounds of orientation."""
    page = jobs.sheet()
    assert "strip must read" in page
    assert "95 % bound mm" in page
    assert 'colspan="8"' in page
    page = replace(jobs, cell=load_cell("fixed")).sheet()
    assert "strip must read" not in page
    assert "Rail at" not in page
    page = with_targets(jobs, bounds=NoBound("<none stated>")).sheet()
    assert "&lt;none stated&gt;" in page
    assert "95 % bound mm" not in page
    assert 'colspan="7"' in page
    page = with_targets(jobs, bounds_deg=np.array([0.01234, 0.02, 0.03])).sheet()
    assert "<td>0.0123</td>" in page
    assert 'colspan="9"' in page


def test_bounds_are_on_the_sheet_where_every_station_states_them(jobs: StationJobs) -> None:
    """The note that none are stated would contradict those of another station."""
    (job,) = jobs.stations
    (without,) = with_targets(jobs, bounds=NoBound("none")).stations
    page = replace(jobs, stations=[job, without]).sheet()
    assert "No bounds are stated" in page
    assert "95 % bound mm" not in page
    (turned,) = with_targets(jobs, bounds_deg=np.array([0.01, 0.02, 0.03])).stations
    page = replace(jobs, stations=[job, turned]).sheet()
    assert page.count("95 % bound mm") == 2
    assert "95 % bound °" not in page
