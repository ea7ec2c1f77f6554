"""Points are kept packed: equal to what was set, in the order set, and small."""

import tracemalloc

import msgspec
import numpy as np

from hilcell.journal.journal import Record
from hilcell.journal.log import Log, VisitedPoses
from hilcell.model.events import ReadingTime
from hilcell.model.point import Point, PointId, Readings

NOW = ReadingTime(59597.515816423, 0.0012767939988407306, 59597.182127809)
POINT = Point(
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


def log_of(count: int) -> Log:
    ids = [PointId("grid", vertex=(0, 0, n)) for n in reversed(range(count))]
    points = [msgspec.structs.replace(POINT, id=id, key=id.key) for id in ids]
    return Log(record(point, seq) for seq, point in enumerate(points, start=1))


def test_a_point_that_was_packed_is_the_one_that_was_taken() -> None:
    log = Log([record(POINT, 1)])
    found = log.points[POINT.key]
    assert msgspec.structs.astuple(found) == msgspec.structs.astuple(POINT)
    assert found.readings == POINT.readings
    assert found.id == POINT.id
    assert found is not log.points[POINT.key]


def test_points_come_as_they_were_measured_or_by_their_keys() -> None:
    log = log_of(3)
    measured = ["grid/0-0-2", "grid/0-0-1", "grid/0-0-0"]
    assert [point.key for point in log.measured("grid")] == measured
    assert [*log.points] == measured
    assert [point.key for point in log.select("grid")] == measured[::-1]
    assert [*log.measured("validate")] == []


def test_a_point_takes_little_memory() -> None:
    tracemalloc.start()
    try:
        log = log_of(200)
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
