"""A calibration is compared with the one that it would supersede, parameter by parameter."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.changes import changed_since, compared, risen_nest
from hilcell.calibration.diagnosis import suspected_causes
from hilcell.calibration.file import read_calibration, write_calibration
from hilcell.calibration.frames import world_motion
from hilcell.geometry.frames import from_rotvec
from hilcell.journal.journal import read_journal
from hilcell.journal.log import Log
from hilcell.journal.previous_reference import floor_before
from hilcell.journal.runs import CALIBRATION, JOURNAL
from hilcell.model.calibration import Update
from hilcell.model.frame import Frame
from hilcell.model.plan import PreviousReference
from hilcell.model.verdicts import Parameter
from hilcell.ports import Array
from tests.hilcell.report.journals import Writer
from tests.hilcell.verdicts import UPDATED
from tests.whole.golden import GoldenRuns


@pytest.fixture
def before(golden: GoldenRuns, log: Log) -> PreviousReference:
    found = floor_before(golden["small"].runs, log.cell, 1)
    assert found is not None
    return found


def then(log: Log, before: PreviousReference) -> Log:
    log.plan = msgspec.structs.replace(log.inputs, floor_before=before)
    return log


def moved(frame: Frame, shift_mm: tuple[float, ...], turn_deg: tuple[float, ...]) -> Frame:
    T = np.array(frame.matrix)
    T[:3, 3] -= shift_mm
    T[:3, :3] = from_rotvec(-np.radians(turn_deg)) @ T[:3, :3]
    return Frame(matrix=T.tolist(), covariance=frame.covariance)


def test_the_same_base_and_stations_hold(log: Log, before: PreviousReference) -> None:
    found = compared(then(log, before))
    assert all(each.holds for each in found)
    places = 1 + len(log.cell.station)
    assert len(found) == 1 + 6 * places
    assert all(each.now - each.then == pytest.approx(0.0, abs=1e-9) for each in found)
    assert suspected_causes(log) == []


def test_without_a_rail_the_base_alone_is_compared(golden: GoldenRuns) -> None:
    log = Log(read_journal(golden["seats"].folder / JOURNAL))
    before = floor_before(golden["seats"].runs, log.cell, 1)
    assert before is not None
    found = compared(then(log, before))
    assert {each.name.split()[0] for each in found} == {"base", "repeatability"}
    assert len(found) == 7
    assert all(each.holds and each.limit > 0.0 for each in found)


@pytest.mark.parametrize(
    ("shift_mm", "turn_deg", "name", "by"),
    [
        ((0.0, 0.0, 12.7), (0.0, 0.0, 0.0), "base z", 12.7),
        ((0.0, -0.63, 0.0), (0.0, 0.0, 0.0), "base y", -0.63),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), "base turned about z", 0.1),
    ],
)
def test_a_base_that_lies_elsewhere_is_a_suspicion(
    log: Log,
    before: PreviousReference,
    shift_mm: tuple[float, ...],
    turn_deg: tuple[float, ...],
    name: str,
    by: float,
) -> None:
    assert before.base is not None
    base = moved(before.base, shift_mm, turn_deg)
    (found,) = suspected_causes(then(log, msgspec.structs.replace(before, base=base)))
    assert (found.cause, found.unit.partition(" of ")[2]) == ("changed since", name)
    assert found.size == pytest.approx(by, rel=1e-3)
    assert before.run in found.noticed_by


def test_a_station_that_lies_elsewhere_is_a_suspicion(log: Log, before: PreviousReference) -> None:
    station = log.cell.station[-1].name
    frames = before.stations | {station: moved(before.stations[station], (0, 3.0, 0), (0, 0, 0))}
    (found,) = suspected_causes(then(log, msgspec.structs.replace(before, stations=frames)))
    assert found.unit == f"mm of {station} y"


def scatter(log: Log, before: PreviousReference, share: float) -> Parameter:
    """Return the repeatability beside one of then that was a share of it."""
    clouds = [np.array(cloud) for cloud in before.visits_mm]
    visits = [cloud.mean(axis=0) + share * (cloud - cloud.mean(axis=0)) for cloud in clouds]
    less = msgspec.structs.replace(before, visits_mm=[each.tolist() for each in visits])
    (found,) = [each for each in compared(then(log, less)) if each.name == "repeatability"]
    assert found.then == pytest.approx(share * found.now)
    return found


def test_a_robot_that_scatters_more_than_then_is_a_suspicion(
    log: Log, before: PreviousReference
) -> None:
    """A brake that slips from the first point on is in the scatter of all its visits alike."""
    assert scatter(log, before, 0.7).holds
    found = changed_since([scatter(log, before, 0.1)], before.run)
    assert found is not None
    assert found.unit == "mm of repeatability"


def test_no_scatter_is_compared_on_another_grid(golden: GoldenRuns, log: Log) -> None:
    grid = msgspec.structs.replace(log.cell.grid, pitch_mm=log.cell.grid.pitch_mm / 2.0)
    other = floor_before(golden["small"].runs, msgspec.structs.replace(log.cell, grid=grid), 1)
    assert other is not None
    assert other.visits_mm == []
    assert "repeatability" not in {each.name for each in compared(then(log, other))}


def test_the_noise_of_readings_makes_no_robot_worse(log: Log, before: PreviousReference) -> None:
    """As of a tracker that stands farther away than it did then."""
    noisy = [
        msgspec.structs.replace(point, std_mm=(0.2, 0.2, 0.2))
        for point in log.select("repeatability")
    ]
    for point in noisy:
        log.points[point.key] = point
    assert scatter(log, before, 0.1).holds


def test_another_station_of_the_grid_is_not_compared(golden: GoldenRuns, log: Log) -> None:
    cell, runs = log.cell, golden["small"].runs
    at = cell.reference
    others = [
        each if each != at else msgspec.structs.replace(each, strip_mm=each.strip_mm + 1.0)
        for each in cell.station
    ]
    found = floor_before(runs, msgspec.structs.replace(cell, station=others), 1)
    assert found is not None
    assert found.base is None
    assert at.name not in found.stations


def test_a_room_that_is_warmer_explains_more(log: Log, before: PreviousReference) -> None:
    assert before.temperature_c is not None
    cold = msgspec.structs.replace(before, temperature_c=before.temperature_c - 10.0)
    usual = {each.name: each.limit for each in compared(then(log, before))}
    wider = {each.name: each.limit for each in compared(then(log, cold))}
    assert wider["base z"] > usual["base z"] + 0.1
    assert wider["base turned about z"] == usual["base turned about z"]


def test_a_calibration_that_a_re_check_has_changed_has_the_frames_of_its_first_run(
    golden: GoldenRuns, log: Log, tmp_path: Path
) -> None:
    """The base is where the re-check has found it, and by as much less certain."""
    first = golden["small"].copied_to(tmp_path)
    writer = Writer(tmp_path / "recheck", cell=log.inputs.cell, digest=log.inputs.digest,
                    machine_seed=1).began()  # fmt: skip
    writer.journal.append("event", "", {"what": "calibration used", "run": first.name})
    for point in log.select("world"):
        if point.id.number is None:
            writer.point(point.id, point.xyz_mm)
    writer.journal.append("verdict", "recheck", UPDATED)
    folder = writer.ended()
    made = read_calibration(first / CALIBRATION)
    at, (x, y, z) = log.cell.grid.station, (2.0, 0.0, 0.0)
    T = np.array(made.stations[at].T_W_B)
    T[:3, 3] += (x, y, z)
    update = Update("recheck", "base", made.provenance.written, 7, [x, y, z, 0.0, 0.0, 0.0],
                    np.diag([0.01] * 3 + [1e-8] * 3).tolist())  # fmt: skip
    entry = msgspec.structs.replace(made.stations[at], T_W_B=T.tolist())
    provenance = msgspec.structs.replace(made.provenance, updates=[update])
    after = msgspec.structs.replace(
        made, stations=made.stations | {at: entry}, provenance=provenance
    )
    write_calibration(after, folder / CALIBRATION)
    found = floor_before(tmp_path, log.cell, 1)
    assert found is not None
    assert found.base is not None
    assert found.run == "recheck"
    assert found.base.matrix == T.tolist()
    wider = np.diag(np.array(found.base.covariance) - np.array(log.frames["base"].covariance))
    np.testing.assert_allclose(wider[:3], 0.01)
    assert len(found.stations) == len(log.cell.station)
    assert found.frames_c is not None


# -- a nest that rose out of the plane of three, known by the base


def since(log: Log, moved: Array) -> Log:
    """Let the base have moved by (6,) since the run before."""
    frame, then = log.frames["base"], log.matrix("base")
    then[:3, 3] -= moved[:3]
    then[:3, :3] = from_rotvec(-moved[3:]) @ then[:3, :3]
    base = Frame(matrix=then.tolist(), covariance=frame.covariance)
    log.plan = msgspec.structs.replace(
        log.inputs, floor_before=PreviousReference("c1", {}, None, base, alike=True)
    )
    return log


def risen(log: Log, nest: int, by_mm: float) -> Array:
    up = log.matrix("world")[:3, :3].T[:, 2]
    return world_motion(log, log.matrix("base")[:3, 3], nest, by_mm * up)


@pytest.mark.parametrize(("nest", "by_mm"), [(0, -1.0), (1, 4.0), (2, -1.0)])
def test_the_nest_that_rose_is_named(log: Log, nest: int, by_mm: float) -> None:
    (found,) = suspected_causes(since(log, risen(log, nest, by_mm)))
    name = log.cell.layout.floor[nest].name
    assert (found.cause, found.unit) == ("nest moved", f"mm of {name}")
    assert found.size == pytest.approx(by_mm, abs=0.01)
    assert found.noticed_by == "base frame of run c1"


@pytest.mark.parametrize("by_mm", [0.0, 0.05])
def test_noise_is_no_risen_nest(log: Log, by_mm: float) -> None:
    assert risen_nest(since(log, risen(log, 2, by_mm))) is None


def test_a_base_that_was_moved_is_no_risen_nest(log: Log) -> None:
    for shift in (np.array([4.0, -3.0, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0, 2e-3])):
        assert risen_nest(since(log, shift)) is None


def test_without_a_base_measured_before_nothing_can_tell(log: Log) -> None:
    assert log.inputs.floor_before is None
    assert risen_nest(log) is None


def test_the_base_before_is_that_of_the_current_calibration(golden: GoldenRuns, log: Log) -> None:
    found = floor_before(golden["small"].runs, log.cell, 1)
    assert found is not None
    base = log.frames["base"]
    assert found.base == Frame(matrix=base.matrix, covariance=base.covariance)
    joints = msgspec.structs.replace(log.cell.base_frame, axis_1_sweep_deg=(-40.0, 40.0))
    swept = msgspec.structs.replace(log.cell, base_frame=joints)
    other = floor_before(golden["small"].runs, swept, 1)
    assert other is not None
    assert found.alike
    assert not other.alike
