"""A certified length shows the tracker's scale, at the uncertainty of certificate and tracker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hilcell.calibration.instrument import known_lengths, scale
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log
from hilcell.model.point import LENGTH, PointId
from hilcell.model.verdicts import LengthsChecked, MeasuredLength
from tests.hilcell.report.journals import Writer, plan_record
from tests.whole.bench import command, end_of, events, sets, simulation
from tests.whole.trace import judge

CELL = load_cell("paper")
(BAR,) = CELL.layout.length


ENDS_MM = [nest.xyz_mm for nest in CELL.layout.bar]
WAY = (ENDS_MM[1] - ENDS_MM[0]) / np.linalg.norm(ENDS_MM[1] - ENDS_MM[0])


def measured(folder: Path, stretched: float, **length: object) -> Log:
    """Return the log of a run whose tracker sees everything larger by a factor."""
    plan = plan_record()
    plan["cell"]["layout"]["length"][0] |= length
    writer = Writer(folder, cell=plan["cell"]).began()
    for name, world_mm in zip(
        BAR.nests, (ENDS_MM[0], ENDS_MM[0] + BAR.length_mm * WAY), strict=True
    ):
        seen_mm = stretched * apply(inverse(CELL.tracker.pose.matrix()), world_mm)
        writer.point(PointId(LENGTH, nest=name), seen_mm)
    return writer.facts().log


@pytest.mark.parametrize(
    ("ppm", "holds"), [(0.0, True), (10.0, True), (-10.0, True), (100.0, False), (-60.0, False)]
)
def test_a_scale_beyond_the_uncertainty_shows_its_size(
    tmp_path: Path, ppm: float, holds: bool
) -> None:
    (found,) = known_lengths(CELL, measured(tmp_path / "run", 1.0 + 1e-6 * ppm))
    assert found.off_ppm == pytest.approx(ppm, abs=1e-3)
    assert found.holds == holds
    assert 0.03 < found.U_mm < 0.07  # noise 0.01 mm of one reading at each end, limits, certificate
    assert not MeasuredLength(("B1", "B2"), 2000.0, float("nan"), 0.04).holds


def test_certificate_and_temperature_count(tmp_path: Path) -> None:
    plain, steel, vague = (
        known_lengths(log.cell, log)[0]
        for log in (
            measured(tmp_path / "plain", 1.0),
            measured(tmp_path / "steel", 1.0, expansion_um_m_k=11.5),
            measured(tmp_path / "vague", 1.0, u_mm=0.2),
        )
    )
    assert steel.wanted_mm - plain.wanted_mm == pytest.approx(2.0 * 2.0 * 11.5e-3, rel=1e-3)
    assert vague.U_mm == pytest.approx(0.4, rel=0.05)


def test_the_suspicion_is_the_verdict_s(tmp_path: Path) -> None:
    log = measured(tmp_path / "run", 1.0001)
    assert scale(log) is None  # not judged yet
    lengths = known_lengths(log.cell, log)
    log.verdicts["known-length"] = LengthsChecked(holds=False, lengths=lengths, wrong=[])
    found = scale(log)
    assert found is not None
    assert (found.cause, found.unit, found.noticed_by) == ("scale", "ppm", "known length B1 to B2")
    assert found.size == pytest.approx(100.0, abs=0.01)


@pytest.mark.parametrize(
    ("value", "named"),
    [
        ('[{nests = ["B1", "F9"], length_mm = 2000.0, u_mm = 0.01}]', "F9"),
        ('[{nests = ["B1", "B2"], length_mm = 1900.0, u_mm = 0.01}]', "2000.000"),
        ('[{nests = ["F1", "F2"], length_mm = 1500.0, u_mm = 0.01}]', "B1, B2"),
    ],
)
def test_lengths_of_other_nests_are_refused(value: str, named: str) -> None:
    with pytest.raises(SettingsError, match=named):
        load_cell("paper", {"layout.length": value})


def test_a_tracker_s_scale_is_judged_when_the_world_is_framed(tmp_path: Path) -> None:
    with simulation() as cell:
        assert cell.ask(do="fault", name="tracker.scale_ppm", value=100.0)["ok"]
        words: list[str | Path] = ["--unattended", "--runs", tmp_path, "--json"]
        done = command("run", "world-frame", *words, *sets({"simulation.address": cell.control}))
    assert done.returncode == 1, done.stderr
    (length,) = end_of(done)["result"]["known_lengths"]
    assert length["off_ppm"] == pytest.approx(100.0, abs=8.0)
    assert not length["holds"]
    assert judge(events(done.stdout)) == []
