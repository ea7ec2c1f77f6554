"""The log: cached results, assets, outcomes, packed points, set-ups."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.decoding import Json
from hilcell.identity import Identity, different_assets
from hilcell.journal.calibration_facts import facts_of
from hilcell.journal.index import row_of
from hilcell.journal.journal import Record
from hilcell.journal.log import Log, VisitedPoses
from hilcell.journal.runs import read_log
from hilcell.model.events import ReadingTime
from hilcell.model.point import Point, PointId, Readings
from hilcell.model.records import Kind
from tests.hilcell.alarms.journals import event, log_of, point
from tests.hilcell.report.journals import Writer
from tests.hilcell.verdicts import FITTED, JUDGED, POSE_TESTED


def test_a_result_is_computed_again_after_the_next_record() -> None:
    log, asked = Log(), list[str]()

    def events(log: Log, name: str) -> int:
        asked.append(name)
        return len(log.events)

    for seq in (1, 2):
        log.take(Record(seq, "2026-01-01T00:00:00.000Z", "event", "", {"what": "said"}))
        assert [log.once(events, ""), log.once(events, "")] == [seq, seq]
        assert log.once(events, "other") == seq
    assert asked == ["", "other"] * 2


POINT = {
    "id": {"kind": "noise"}, "group": "noise", "station": "", "reflector": "", "samples": 1,
    "xyz_mm": [1.0, 2.0, 3.0], "std_mm": [0.0, 0.0, 0.0], "session": 1, "frame": "tracker",
}  # fmt: skip


def test_a_record_that_is_not_read_leaves_a_result_as_it_is() -> None:
    log, asked = Log(), list[int]()

    def frames(log: Log) -> int:
        asked.append(len(log.frames))
        return len(log.frames)

    verdict, frame, state = (
        {"holds": True},
        {"matrix": [[1.0]]},
        {"machine": "run", "to": "running"},
    )
    rows: tuple[tuple[Kind, Json], ...] = (
        ("frame", frame), ("verdict", verdict), ("intent", {}), ("state", state), ("frame", frame),
        ("point", POINT), ("event", {"what": "said"}),
    )  # fmt: skip
    for seq, (kind, body) in enumerate(rows, start=1):
        log.take(Record(seq, "2026-01-01T00:00:00.000Z", kind, "own", body))
        assert log.once_measured(frames) == 1
    assert asked == [1] * 4  # once for each frame, for the point and for the event


# -- Assets are known by kind and serial number ----------------------------------------------------


ASSETS = [
    Identity(device="Rail", model="drive", serial="2014001", kind="drive"),
    Identity(device="Rail", model="strip", serial="2014002", kind="strip"),
    Identity(device="Robot", model="#KR210R2700_2 C4 FLR SIMULATED", serial="860112"),
]


def test_a_device_without_a_kind_is_of_its_name() -> None:
    assert [asset.kind for asset in ASSETS] == ["drive", "strip", "robot"]


def test_assets_differ_by_serial_number() -> None:
    first = ASSETS
    other = [replace(asset, address="elsewhere") for asset in ASSETS]
    assert different_assets(first, other) == []
    other[1] = replace(ASSETS[1], serial="7")
    assert different_assets(first, other) == [(first[1], other[1])]
    assert different_assets(first[:1], other[2:]) == []


# -- The word for a run, from its log: the same that the list of runs has from its index -----------


@pytest.mark.parametrize(
    ("points", "end", "said"),
    [(1, 0, "measured"), (0, 0, "done"), (1, 1, "out of tolerance"), (1, None, "")],
)
def test_a_run_that_judged_nothing(tmp_path: Path, points: int, end: int | None, said: str) -> None:
    writer = Writer(tmp_path / "r").began()
    for number in range(points):
        writer.point(PointId("noise", number=number), (1.0, 2.0, 3.0))
    if end is not None:
        writer.state("run", "finished")
        writer.journal.append("end", "", {"state": "finished", "exit": end, "result": {}})
    writer.journal.close()
    assert read_log(tmp_path / "r").outcome_text == row_of(tmp_path / "r").verdict == said


def test_a_model_whose_places_were_not_validated_is_in_no_tolerance() -> None:
    """Another test that holds says nothing of it."""
    tested = facts_of({"fit": FITTED, "iso9283": POSE_TESTED})
    assert (tested.outcome, tested.verdict) == (None, "not validated")
    assert facts_of({"fit": FITTED, "validation.S1": JUDGED}).verdict == "in tolerance"
    assert facts_of({"iso9283": POSE_TESTED}).verdict == "in tolerance"


# -- Points are kept packed: equal to what was set, in the order set, and small --------------------


NOW = ReadingTime(59597.515816423, 0.0012767939988407306, 59597.182127809)
POINT_PACKED = Point(
    id=PointId("grid", vertex=(2, 1, 0)),
    key="grid/2-1-0",
    group="grid",
    station="S1100",
    reflector="SMR 1.5in",
    xyz_mm=(3939.152366094726, 241.08606863272894, -695.7501741469947),
    std_mm=(0.00715751479691877, 0.010576348416853797, 0.010563227800907377),
    samples=1,
    session=1,
    frame="tracker",
    temperature_c=23.489092340259308,
    nominal_mm=(450.8127694425416, -4.066265246568767, 799.8599201755027),
    commanded_deg=(0.0, -44.05862142001652, 99.43200711425763, 0.0, -70.37338569424112, 0.0),
    joints_deg=(-8e-05, -44.05864, 99.432, -4e-05, -70.3734, 0.0),
    strip_mm=1100.0,
    readings=Readings(NOW, NOW, NOW, NOW),
)


def record(point: Point, seq: int) -> Record:
    body = msgspec.json.decode(msgspec.json.encode(point))  # with numbers of its own
    return Record(seq, "", "point", point.key, body)


def grid_log(count: int) -> Log:
    ids = [PointId("grid", vertex=(0, 0, n)) for n in reversed(range(count))]
    points = [msgspec.structs.replace(POINT_PACKED, id=id, key=id.key) for id in ids]
    return Log(record(point, seq) for seq, point in enumerate(points, start=1))


def test_a_point_that_was_packed_is_the_one_that_was_taken() -> None:
    log = Log([record(POINT_PACKED, 1)])
    found = log.points[POINT_PACKED.key]
    assert msgspec.structs.astuple(found) == msgspec.structs.astuple(POINT_PACKED)
    assert found.readings == POINT_PACKED.readings
    assert found.id == POINT_PACKED.id
    assert found is not log.points[POINT_PACKED.key]


def test_points_come_as_they_were_measured_or_by_their_keys() -> None:
    log = grid_log(3)
    measured = ["grid/0-0-2", "grid/0-0-1", "grid/0-0-0"]
    assert [point.key for point in log.measured("grid")] == measured
    assert [*log.points] == measured
    assert [point.key for point in log.select("grid")] == measured[::-1]
    assert [*log.measured("validate")] == []


def test_a_point_takes_little_memory() -> None:
    tracemalloc.start()
    try:
        log = grid_log(200)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held / len(log.points) < 1500  # unpacked 2500


def test_a_motion_takes_its_numbers_only() -> None:
    driven = VisitedPoses()
    body = {"action": "robot.move", "strip_mm": 1100.0, "joints_deg": [0.0] * 6}
    for seq in range(1, 1002):
        driven.take(Record(seq, "", "intent", "p", body))
    assert len(driven._ends) == 7 * 1000
    assert driven.has(1100.0, np.zeros(6))
    assert not driven.has(1200.0, np.zeros(6))


# -- Points of a tracker that is framed again by another engine count no longer --------------------


def test_nests_of_a_frame_that_was_begun_again_are_no_points_any_more() -> None:
    measured = point("world/F1"), point("grid/1-0-0")
    again = event("world frame begun again", invalid=["world/F1"])
    assert [*log_of(*measured).points] == ["world/F1", "grid/1-0-0"]
    assert [*log_of(*measured, again).points] == ["grid/1-0-0"]
    assert [*log_of(*measured, again, point("world/F1")).points] == ["grid/1-0-0", "world/F1"]
