"""A certified length shows the tracker's scale, at the uncertainty of certificate and tracker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fakes.faults import Faults
from fakes.truth.tracker_truth import TrackerTruth
from hilcell.calibration.instrument import (
    AXES,
    BothFaces,
    compared_positions,
    judged_faces,
    known_lengths,
    scale,
)
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log
from hilcell.model.point import LENGTH, PointId
from hilcell.model.verdicts import LengthsChecked, MeasuredLength
from tests.hilcell.report.journals import Writer, plan_record
from tests.whole.bench import command, end_of, sets, simulation

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


NESTS = {nest.name: nest.xyz_mm for nest in CELL.layout.fixed_nests}
LIMIT_MM = 0.015 + 0.012
FAULTS = ("tracker.collimation", "tracker.transit", "tracker.index")


def found(seed: int, fault: str = "", urad: float = 0.0) -> BothFaces:
    faults = Faults()
    tracker = TrackerTruth(CELL, seed, faults, lambda: NESTS)
    if fault:
        faults.set(fault, urad)
    front, back = (
        np.array(
            [
                tracker.measurements(name, count, back=back).xyz_mm.mean(axis=0)  # type: ignore[union-attr] # they are in range
                for name in NESTS
            ]
        )
        for back, count in ((False, 10), (True, 5))
    )
    return judged_faces(list(NESTS), front, back, np.full(len(NESTS), LIMIT_MM))


@pytest.mark.parametrize(("fault", "unit"), list(zip(FAULTS, AXES, strict=True)))
@pytest.mark.parametrize("urad", [50.0, -100.0])
def test_the_axis_that_is_off_is_named_with_its_size(fault: str, unit: str, urad: float) -> None:
    for seed in range(5):
        seen = found(seed, fault, urad)
        assert seen.suspicion is not None
        assert (seen.suspicion.cause, seen.suspicion.unit) == ("instrument", unit)
        assert seen.suspicion.size == pytest.approx(urad, abs=8.0)


def test_a_tracker_as_it_left_its_last_check_holds() -> None:
    assert all(found(seed).holds for seed in range(50))


def test_a_figure_that_is_none_holds_nothing() -> None:
    front = np.array([[4000.0, 100.0, -1500.0]])
    assert not judged_faces(["F1"], front, front * np.nan, np.array([LIMIT_MM])).holds


NEST_MM = np.array([4400.0, 100.0, -1500.0])
BEAM = NEST_MM / np.linalg.norm(NEST_MM)
NAMES = ["F1", "F2", "F3", "B1", "B2", "flange"]
REFLECTOR_LIMIT_MM = 0.04


def seen(seed: int = 1) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return NEST_MM + 0.005 * np.random.default_rng(seed).standard_normal((len(NAMES), 3))


@pytest.mark.parametrize("prism_mm", [0.15, -0.5])
def test_a_prism_of_another_length_is_named(prism_mm: float) -> None:
    at_mm = seen()
    at_mm[5] += prism_mm * BEAM
    wrong = [
        each
        for each in compared_positions(NAMES, at_mm, np.full(6, REFLECTOR_LIMIT_MM), np.zeros(6))
        if not each.holds
    ]
    assert [each.place for each in wrong] == ["flange"]
    assert wrong[0].along_mm == pytest.approx(prism_mm, abs=0.02)
    assert wrong[0].across_mm < 0.02


def test_reflectors_alike_hold() -> None:
    for seed in range(50):
        found = compared_positions(NAMES, seen(seed), np.full(6, REFLECTOR_LIMIT_MM), np.zeros(6))
        assert all(each.holds for each in found)


def test_a_place_that_is_no_number_holds_nothing() -> None:
    at_mm = seen()
    at_mm[2] = np.nan
    found = compared_positions(NAMES, at_mm, np.full(6, REFLECTOR_LIMIT_MM), np.zeros(6))
    assert not found[2].holds
