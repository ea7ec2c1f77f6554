"""The tracker's field check: on a simulated cell without wires, and its mathematics alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from fakes.in_process import InProcessCell
from hilcell.calibration.instrument import axis_levers, beam_axes, half_differences_mm
from hilcell.calibration.tracker_check import (
    DIRECTIONS,
    decided,
    fitted_axes,
    fitted_trend,
    limit_across_mm,
    seen_direction,
)
from hilcell.cell.file import Cell, load_cell
from hilcell.journal.log import Log
from hilcell.model.outcome import Outcome
from hilcell.model.point import STEADY
from hilcell.model.verdicts import AxesJudged, DriftJudged
from hilcell.ports import Array, HilcellError
from hilcell.run.procedure import Result, run_in_process
from procedures.tracker_check import TRACKER_CHECK, nests_by_range
from tests.hilcell.verdicts import TRACKER_DRIFT

CELL = load_cell("paper")
FACES = "both faces at "


def checked(
    folder: Path, seed: int, cell: Cell = CELL, faults: Mapping[str, float] = {}
) -> tuple[Log, Array]:
    """Return the log of a check of the tracker of a seed, and the true errors (3,) of its axes."""
    simulated = InProcessCell(cell, seed, seed)
    tracker = simulated.tracker._truth.tracker  # type: ignore[attr-defined] # the simulated one
    for name, value in faults.items():
        tracker._faults.set(name, value)
    log = run_in_process(
        cell, TRACKER_CHECK, seed=seed, machine_seed=seed, folder=folder, simulated=simulated
    )
    return log, tracker._axes_rad


def axes_of(log: Log) -> tuple[Array, Array]:
    """Return the errors (3,) of the axes, urad, and their U (3,)."""
    judged = log.verdict(AxesJudged)
    assert judged is not None
    return (
        np.array([each.value for each in judged.axes], dtype=float),
        np.array([each.U for each in judged.axes], dtype=float),
    )


# -- the check -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "axis"), [("tracker.collimation", 0), ("tracker.transit", 1), ("tracker.index", 2)]
)
def test_an_axis_that_is_off_fails_and_its_size_is_within_u(
    tmp_path: Path, fault: str, axis: int
) -> None:
    within = 0
    for seed in range(8):
        log, true_rad = checked(tmp_path, seed, faults={fault: 80.0})
        assert not log.verdicts["tracker-axes"].holds
        urad, U_urad = axes_of(log)
        assert urad[axis] == pytest.approx(80.0, abs=12.0)
        within += int(np.sum(np.abs(urad - 1e6 * true_rad) <= U_urad))
    assert within >= 20  # of 24 intervals of 95 %


def test_sound_trackers_are_not_rejected_and_most_are_accepted(tmp_path: Path) -> None:
    accepted = 0
    for seed in range(20):
        log, _ = checked(tmp_path, seed)
        assert all(each.holds for each in log.verdicts.values())
        figures = log.verdicts["tracker-axes"].figures
        accepted += all(each.outcome is Outcome.ACCEPTED for each in figures)
        assert log.verdicts["tracker-drift"].figures[0].outcome is Outcome.ACCEPTED
    assert accepted >= 14


@pytest.mark.nightly
@pytest.mark.parametrize("cell", ["paper", "six-r"])
def test_intervals_cover_what_was_injected_and_sound_trackers_pass(
    tmp_path: Path, cell: str
) -> None:
    """Of 120 trackers with axes off by up to 60 urad, and of 120 sound ones, each cell."""
    within, failed, count = np.zeros(3), 0, 120
    names = ("tracker.collimation", "tracker.transit", "tracker.index")
    for seed in range(50_000, 50_000 + count):
        drawn = np.random.default_rng(seed).uniform(-60.0, 60.0, 3).tolist()
        log, true_rad = checked(
            tmp_path, seed, load_cell(cell), dict(zip(names, drawn, strict=True))
        )
        urad, U_urad = axes_of(log)
        within += np.abs(urad - 1e6 * true_rad) <= U_urad
        sound, _ = checked(tmp_path, seed, load_cell(cell))
        failed += not all(each.holds for each in sound.verdicts.values())
    assert np.all(within >= 0.9 * count)  # 95 % less 2.5 sigma
    assert failed <= 1


def test_a_tracker_that_warms_up_drifts(tmp_path: Path) -> None:
    log, _ = checked(tmp_path, 3, faults={"tracker.warming": 200.0})
    judged = log.verdict(DriftJudged)
    assert judged is not None
    assert not judged.holds
    along_mm, across_mm, down_mm = judged.trend_mm
    assert across_mm > 0.1 > max(abs(along_mm), abs(down_mm))
    assert judged.range_mm >= across_mm


def test_a_total_station_is_checked_but_for_its_axes(tmp_path: Path) -> None:
    cell = load_cell("lab")
    log, _ = checked(tmp_path, 4, cell)
    assert "tracker-axes" not in log.verdicts
    assert log.verdicts["tracker-drift"].holds
    unchecked = unchecked_of(TRACKER_CHECK.result(log))
    assert "turn it over" in unchecked[0]
    (step,) = [each for each in TRACKER_CHECK.plan(cell, 1).steps if each.name == "axes"]
    assert "does not turn it over" in step.note


def unchecked_of(result: Result) -> list[str]:
    found = result["not_checked"]
    assert isinstance(found, list)
    return found


def test_what_was_not_checked_is_said(tmp_path: Path) -> None:
    log, _ = checked(tmp_path, 1)
    directions, nobody = unchecked_of(TRACKER_CHECK.result(log))
    assert "along the beam, nor across it, upright" in directions
    assert "nobody was there" in nobody
    assert TRACKER_CHECK.words(TRACKER_CHECK.result(log)).count("Not checked") == 2


def test_a_series_lasts_ten_minutes_of_the_cell(tmp_path: Path) -> None:
    log, _ = checked(tmp_path, 1)
    elapsed_s = [point.elapsed_s for point in log.measured(STEADY)]
    assert elapsed_s == pytest.approx([30.0 * n for n in range(21)], abs=1.0)
    duration_s = TRACKER_CHECK.plan(CELL, 1).duration_s
    assert 600.0 < duration_s < 900.0


def test_a_table_has_a_row_for_each_figure(tmp_path: Path) -> None:
    log, _ = checked(tmp_path, 2)
    names = [row[0] for row in TRACKER_CHECK.table(TRACKER_CHECK.result(log)).rows]
    assert names[:3] == [f"{FACES}{seen.nest.name}" for seen in nests_by_range(CELL)]
    assert {"collimation", "transit tilt", "vertical index"} < set(names)
    assert f"length B1 to B2, {DIRECTIONS[1]}" in names


# -- which nests -----------------------------------------------------------------------------------


def test_the_nearest_a_middle_and_the_farthest_nest_are_chosen() -> None:
    near, middle, far = nests_by_range(CELL)
    assert near.nest.name in ("B1", "B2")
    assert (middle.nest.name, far.nest.name) == ("F2", "F3")
    assert near.range_mm < middle.range_mm < far.range_mm


@pytest.mark.parametrize(("most_mm", "names"), [("1000.0", "none"), ("3000.0", "B1, B2|B2, B1")])
def test_too_few_nests_in_range_are_refused(most_mm: str, names: str) -> None:
    cell = load_cell("paper", {"tracker.max_range_mm": most_mm})
    with pytest.raises(HilcellError, match=f"expected 3 nests.*got ({names}); move"):
        nests_by_range(cell)
    with pytest.raises(HilcellError, match="refused before anything moves"):
        TRACKER_CHECK.plan(cell, 1)


def test_nests_at_one_distance_are_warned_of() -> None:
    ring = [
        {"name": f"F{n}", "x_mm": 2000.0 * math.cos(n), "y_mm": 2000.0 * math.sin(n), "z_mm": 0.0}
        for n in range(4)
    ]
    pose = "{ x_mm = 0.0, y_mm = 0.0, z_mm = 1000.0 }"
    floor = ", ".join(
        f'{{ name = "{each["name"]}", x_mm = {each["x_mm"]}, y_mm = {each["y_mm"]}, z_mm = 0.0 }}'
        for each in ring
    )
    values = {"layout.floor": f"[{floor}]", "layout.bar": "[]", "layout.length": "[]"}
    cell = load_cell("paper", values | {"tracker.pose": pose})
    (warning,) = TRACKER_CHECK.plan(cell, 1).warnings
    assert "all nests are 2236 to 2236 mm away" in warning


# -- mathematics -----------------------------------------------------------------------------------

PLACES_MM = np.array([[2000.0, 900.0, -1200.0], [2900.0, 200.0, -1500.0], [800.0, -4500.0, 700.0]])


def circles_read(at_mm: Array, axes_rad: Array, sign: float) -> Array:
    """Return places (N, 3) by the circles' readings with errors of the axes: c / sin z + i cot z
    of the horizontal angle, v of the zenith distance, in the second face the other sign.
    """
    range_mm = np.linalg.norm(at_mm, axis=1)
    zenith, azimuth = np.arccos(at_mm[:, 2] / range_mm), np.arctan2(at_mm[:, 1], at_mm[:, 0])
    c, i, v = sign * axes_rad
    azimuth, zenith = azimuth + c / np.sin(zenith) + i / np.tan(zenith), zenith + v
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1) * np.sin(zenith)[:, None]
    read_mm: Array = range_mm[:, None] * np.column_stack([flat, np.cos(zenith)])
    return read_mm


def test_the_textbook_s_formulas_give_the_axes_back() -> None:
    axes_rad = 1e-6 * np.array([40.0, -70.0, 25.0])
    front_mm, back_mm = (circles_read(PLACES_MM, axes_rad, sign) for sign in (1.0, -1.0))
    off_rad = half_differences_mm(front_mm, back_mm) / np.linalg.norm(front_mm, axis=1)[:, None]
    found = fitted_axes(front_mm, off_rad, np.full(3, 1e-6))
    np.testing.assert_allclose(found.sizes_rad, axes_rad, atol=2e-8)
    assert np.abs(found.left_rad).max() < 2e-8


def test_u_is_the_scatter_of_the_axes() -> None:
    u_rad, rng = 1e-6 * np.array([0.5, 1.0, 2.0]), np.random.default_rng(7)
    levers = axis_levers(PLACES_MM)
    true_rad = 1e-6 * np.array([5.0, -3.0, 8.0])
    draws = rng.standard_normal((2000, 3, 2)) * u_rad[:, None]
    found = [fitted_axes(PLACES_MM, levers @ true_rad + each, u_rad) for each in draws]
    scatter = np.cov(np.array([each.sizes_rad for each in found]).T)
    np.testing.assert_allclose(scatter, found[0].covariance, rtol=0.1, atol=1e-13)


def test_beams_of_one_height_do_not_tell_the_tilt() -> None:
    level_mm = np.array([[2000.0, 0.0, 10.0], [0.0, 3000.0, -10.0], [-4000.0, 5.0, 0.0]])
    off_rad = axis_levers(level_mm) @ np.array([3e-6, 0.0, 4e-6])
    found = fitted_axes(level_mm, off_rad, np.full(3, 1e-6))
    assert np.isnan(found.sizes_rad).tolist() == [False, True, False]
    np.testing.assert_allclose(found.sizes_rad[[0, 2]], [3e-6, 4e-6], atol=1e-12)
    assert np.abs(found.left_rad).max() < 1e-12


def test_a_trend_is_seen_along_across_and_down_with_its_u() -> None:
    place_mm, elapsed_s, rng = PLACES_MM[1], np.arange(0.0, 601.0, 30.0), np.random.default_rng(1)
    change_mm = np.array([0.02, -0.05, 0.01])
    line = elapsed_s[:, None] / 600.0 * (change_mm @ beam_axes(place_mm[None])[0])
    within = 0
    for _ in range(300):
        noise = 0.004 * rng.standard_normal((21, 3))
        trend = fitted_trend(elapsed_s, place_mm + line + noise, 600.0)
        within += int(np.sum(np.abs(trend.change_mm - change_mm) <= 2.14 * trend.u_mm))
    assert within / 900 == pytest.approx(0.9545, abs=0.02)  # 2.14: t of 19 degrees of freedom


@pytest.mark.parametrize(
    ("trend_mm", "outcome"),
    [(0.010, Outcome.ACCEPTED), (0.018, Outcome.UNDECIDED), (0.027, Outcome.REJECTED)],
)
def test_only_a_rejected_figure_fails(trend_mm: float, outcome: Outcome) -> None:
    judged = decided(replace(TRACKER_DRIFT, trend_mm=(0.0, trend_mm, 0.0)))
    assert judged.figures[0].outcome is outcome
    assert judged.holds is (outcome is not Outcome.REJECTED)
    assert "trend of N1 in 10 min" in judged.why


def test_a_figure_that_is_none_fails() -> None:
    assert not decided(replace(TRACKER_DRIFT, trend_mm=(math.nan, 0.0, 0.0))).holds


def test_a_length_is_named_by_how_the_tracker_sees_it() -> None:
    beside_mm = np.array([3000.0, 0.0, 0.0])
    for way, name in zip(np.eye(3), DIRECTIONS, strict=True):
        assert seen_direction(np.array([beside_mm - 400.0 * way, beside_mm + 400.0 * way])) == name


def test_the_limit_is_the_cell_s_or_the_instrument_s_class() -> None:
    stated = {"uncertainty.tracker_limit_mm": "0.015", "uncertainty.tracker_limit_um_m": "6"}
    assert limit_across_mm(load_cell("paper", stated), 5000.0) == pytest.approx(0.045)
    fine = {"uncertainty.tracker_limit_mm": "0.001", "uncertainty.tracker_limit_um_m": "0"}
    arcsec_mm = math.radians(1.0 / 3600.0) * 5000.0
    assert limit_across_mm(load_cell("lab", fine), 5000.0) == pytest.approx(2.0 * arcsec_mm)
