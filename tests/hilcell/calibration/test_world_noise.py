"""The noise of {W}: by all readings of the run, or by its own of a nest that is restless."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.budget import target_uncertainty
from hilcell.calibration.frames import nest_noise, world_covariance
from hilcell.calibration.measurement_budget import WORLD, measurement_budget
from hilcell.geometry.frames import apply, inverse, three_point_frame
from hilcell.geometry.statistics import coverage_factor
from hilcell.journal.journal import read_journal
from hilcell.journal.log import Log, positions_mm, run_noise
from hilcell.journal.runs import JOURNAL
from hilcell.model.point import Point, PointId
from hilcell.ports import Array
from tests.hilcell.report.journals import Writer
from tests.whole.golden import GoldenRuns

NESTS = ("F1", "F2", "F3")
AT_MM = np.array([-350.0, 0.0, 1000.0])  # of {W}, in the cube


@pytest.fixture
def log(golden: GoldenRuns) -> Log:
    log = Log(read_journal(golden["small"].folder / JOURNAL), packed=False)
    run_noise(log)  # before a nest is changed
    return log


def seated(log: Log, places_mm: Array, readings_mm: Sequence[Array]) -> Array:
    """Replace the readings of the nests; return the error (3,) of a target that they cause."""
    for nest, each_mm in zip(NESTS, readings_mm, strict=True):
        mean_mm, std_mm = each_mm.mean(axis=0), each_mm.std(axis=0, ddof=1)
        point: Point = log.points[f"world/{nest}"]
        log.points[point.key] = replace(
            point, xyz_mm=tuple(mean_mm), std_mm=tuple(std_mm), samples=len(each_mm)
        )
    T = log.matrix("world")
    seen_mm = apply(inverse(T), AT_MM[None])
    measured_mm = np.array([each.mean(axis=0) for each in readings_mm])
    framed = T @ three_point_frame(*places_mm) @ inverse(three_point_frame(*measured_mm))
    return np.asarray(apply(framed, seen_mm)[0] - AT_MM)


def test_u_of_the_world_covers_its_error_though_each_nest_is_read_twice(log: Log) -> None:
    """By the nests' own two readings 0.8 of the errors are within U."""
    noise = run_noise(log)
    places_mm = positions_mm([log.points[f"world/{nest}"] for nest in NESTS])
    factors = np.linalg.cholesky(noise.at(places_mm, np.ones(3)))
    covered = []
    for seed in range(200):
        draws = np.random.default_rng([seed, 36]).standard_normal((3, 2, 3))
        readings_mm = places_mm[:, None] + draws @ np.swapaxes(factors, 1, 2)
        off_mm = seated(log, places_mm, [*readings_mm])
        covered += [np.abs(off_mm) <= 2.0 * np.sqrt(np.diag(world_covariance(log, AT_MM))[:3])]
    assert 0.92 <= np.mean(covered) <= 0.98


@pytest.mark.parametrize(("times", "restless"), [(2.0, ()), (30.0, ("F2",))])
def test_a_nest_that_scatters_beyond_chance_counts_by_its_own_readings_and_is_named(
    log: Log, times: float, restless: tuple[str, ...]
) -> None:
    noise = run_noise(log)
    points = [log.points[f"world/{nest}"] for nest in NESTS]
    for point, factor in zip(points, (0.1, times, 1.0), strict=True):
        single_mm2 = np.diag(noise.at(positions_mm([point]), [1])[0])
        std_mm = tuple((factor * np.sqrt(single_mm2)).tolist())
        log.points[point.key] = replace(point, std_mm=std_mm, samples=2)
    found, budget = nest_noise(log), measurement_budget(log)
    assert found.restless == restless
    own_mm2 = np.square(log.points["world/F2"].std_mm) / 2
    wanted_mm2 = np.diag(own_mm2) if restless else noise.at(positions_mm(points[1:2]), [2])[0]
    np.testing.assert_allclose(found.covariances_mm2[1], wanted_mm2)
    assert (found.freedom < 3.0) == bool(restless)
    assert budget is not None
    line = next(line for line in budget.lines if line.name == WORLD)
    bound = next(line for line in target_uncertainty(log).lines if line.name == "World frame")
    assert ("F2" in line.how) == ("F2" in bound.how) == bool(restless)
    assert bound.freedom is not None
    assert (bound.freedom < 5.0) == bool(restless)


def test_few_readings_widen_the_world_s_u_by_student_s_t(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "few").began()
    for nest, xyz_mm in zip(NESTS, ((1500, 0, 0), (0, 1500, 0), (0, 0, 1500)), strict=True):
        writer.point(PointId("world", nest=nest), xyz_mm, samples=2)
    log = writer.facts().log
    budget = measurement_budget(log)
    assert budget is not None
    assert nest_noise(log).freedom == 3.0  # a reading more than one, of each
    line = next(line for line in budget.lines if line.name == WORLD)
    at_points = [
        np.trace(world_covariance(log, at)[:3, :3]) / 3
        for at in positions_mm([*log.points.values()])
    ]  # {L} and {W} are the same here
    wanted_mm = np.sqrt(np.mean(at_points)) * coverage_factor(2.0, 3.0) / 2.0
    assert line.u_mm == pytest.approx(wanted_mm)


def test_a_tracker_without_noise_has_no_restless_nest(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "none").began()
    for nest, xyz_mm in zip(NESTS, ((1500, 0, 0), (0, 1500, 0), (0, 0, 1500)), strict=True):
        writer.point(PointId("world", nest=nest), xyz_mm, std_mm=(0.0, 0.0, 0.0), samples=2)
    log = writer.facts().log
    assert nest_noise(log).restless == ()
    np.testing.assert_allclose(world_covariance(log, AT_MM), 0.0, atol=1e-20)
