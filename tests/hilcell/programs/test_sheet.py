"""The drilling sheet: what it says of holes, stations and conditions."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.calibration.influence import NoBound
from hilcell.cell.file import load_cell
from hilcell.programs.station_jobs import StationJobs
from tests.hilcell.commands.test_prepare import INSIDE, holes, made
from tests.hilcell.programs.test_station_jobs import planned


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
