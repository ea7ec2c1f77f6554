"""A point's identity gives its key and its group."""

from __future__ import annotations

import msgspec
import pytest

from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.point import PointId

# Key and group of one point of every kind.
KEYS = [
    ("world/F1", "world", PointId("world", nest="F1")),
    ("control/1-13/F3", "control", PointId("control", session=1, pass_number=13, nest="F3")),
    ("base/axis6/023", "base", PointId("base", axis=6, number=23)),
    ("grid/0-3-2", "grid", PointId("grid", vertex=(0, 3, 2))),
    ("repeatability/2/009", "repeatability_2", PointId("repeatability", place=2, number=9)),
    ("slide/S1100/P1", "frames", PointId("slide", station="S1100", nest="P1")),
    ("three/S1900/P3", "three_points", PointId("three", station="S1900", nest="P3")),
    ("six/S300/P8", "six", PointId("six", station="S300", nest="P8")),
    ("frames/S300/axis1/000", "frames_axis1", PointId("frames", "S300", axis=1, number=0)),
    ("sign/before", "sign_before", PointId("sign", how="before")),
    ("validate/S1900/idw/074", "validate_idw", PointId("validate", "S1900", how="idw", number=74)),
    ("survey/back/020/flange", "survey_back",
     PointId("survey", direction="back", number=20, nest="flange")),
    ("repeat/strip/one_side/014-", "repeat_strip_one_side",
     PointId("repeat", how="strip", direction="one_side", number=14, side=-1)),
    ("repeat/plain/random/000+", "repeat_plain_random",
     PointId("repeat", how="plain", direction="random", number=0, side=1)),
    ("campaign/17/SMR2", "campaign", PointId("campaign", pose="17", target="SMR2")),
]  # fmt: skip
BODY = {
    "group": "control", "station": "", "frame": "tracker", "reflector": "SMR 1.5in",
    "xyz_mm": [4394.250549462381, 245.22254947698647, -1507.8305077985306],
    "std_mm": [0.0065458541443585904, 0.008963935717166678, 0.011161274845507118], "samples": 10,
    "temperature_c": 22.432180366276558, "pressure_mbar": 1007.0664730713155,
    "humidity_percent": 42.5377110609435, "session": 1, "rail_mm": 1099.96, "strip_mm": 1100.0,
}  # fmt: skip


@pytest.mark.parametrize(("key", "group", "id"), KEYS)
def test_keys_and_groups_are_what_they_were(key: str, group: str, id: PointId) -> None:
    assert (id.key, id.group) == (key, group)


def test_a_pose_s_other_reflectors_are_points_of_their_own() -> None:
    pose = PointId("validate", station="S300", how="chosen", number=7)
    assert pose.at_seat(1) == pose
    third = pose.at_seat(3)
    assert (third.key, third.group) == ("validate/S300/chosen/007/seat3", "validate_chosen_seats")
    log = Log()
    for number, id in enumerate((pose, third), start=1):
        body = BODY | {"group": id.group, "station": "S300", "id": msgspec.to_builtins(id)}
        log.take(Record(number, "", "point", id.key, body))
    assert [point.id for point in log.select("validate")] == [pose]
    assert [point.id for point in log.measured("validate")] == [pose]
    assert [point.id for point in log.select("validate", seat=3)] == [third]


@pytest.mark.parametrize(("key", "group", "id"), KEYS)
def test_identities_survive_a_journal(key: str, group: str, id: PointId) -> None:
    assert msgspec.json.decode(msgspec.json.encode(id), type=PointId) == id


def test_points_are_selected_by_fields() -> None:
    log = Log(
        Record(
            seq, "", "point", id.key,
            BODY | {"group": group, "station": id.station, "id": msgspec.to_builtins(id)},
        )
        for seq, (_, group, id) in enumerate(KEYS, start=1)
    )  # fmt: skip
    for found, wanted in (
        (log.select("frames", "S300", axis=1), ["frames/S300/axis1/000"]),
        (log.select("frames", axis=6), []),
        (log.select("repeatability", place=2), ["repeatability/2/009"]),
        (log.select("repeatability", place=1), []),
        (log.select("repeat"), ["repeat/plain/random/000+", "repeat/strip/one_side/014-"]),
        (log.select("repeat", direction="random"), ["repeat/plain/random/000+"]),
        (log.select("repeat", how="strip"), ["repeat/strip/one_side/014-"]),
        (log.select("validate", "S300", how="idw"), []),
    ):
        assert [point.key for point in found] == wanted


def test_a_point_of_one_visit_says_so_in_its_key_and_not_in_its_group() -> None:
    id = PointId("touch", station="S300", visit=7, number=3)
    assert (id.key, id.group) == ("touch/S300/v7/003", "touch")
    assert msgspec.json.decode(msgspec.json.encode(id), type=PointId) == id


def test_a_visit_lasts_until_the_slide_is_sent_anywhere() -> None:
    def intent(seq: int, action: str) -> Record:
        return Record(seq, "", "intent", "", {"action": action})

    log = Log([intent(1, "rail.home"), intent(2, "rail.approach"), intent(3, "robot.move")])
    assert log.visit == 2
    log.take(intent(4, "rail.move"))
    assert log.visit == 3
