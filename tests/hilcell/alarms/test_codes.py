"""An error says its alarm by a code: each code has an entry, each entry is raised somewhere."""

from __future__ import annotations

import re
from pathlib import Path

from drivers.canopen import cia
from drivers.leica import emscon
from fakes.exercises import ALARMS, EXERCISES
from hilcell.alarms.catalogue import Entry, catalogue, entries_of, entry_of
from hilcell.model.records import EVENTS
from hilcell.model.verdicts import verdict_type
from tests.hilcell.alarms.rooms import packages_of_hilcell

ROOT = Path(__file__).parents[3]
ROOMS = ("hilcell", "drivers", "procedures", "fakes")
CODE = re.compile(r'"(HC-[A-Z]\d\d)"')
FAMILY = re.compile(r"class (\w+)\((?:DeviceError|DeviceRefused|NoReading)\)")
PRACTISED = {exercise.alarm for exercise in EXERCISES}.union(
    *(each.values() for each in ALARMS.values())
)
OWN_WORDS = {"Aborted", "ConnectFailed", "Unsupported"}  # their own __init__ names the code
EVENT = re.compile(r'"what": "([\w ]+)"|(?:\.event|\._note)\(\s*"([\w ]+)"')


def sources(room: str) -> dict[str, str]:
    """Return the text of each module of a room, by its path."""
    found = sorted((ROOT / room).rglob("*.py"))
    return {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in found}


def entries(room: str) -> list[Entry]:
    return entries_of(f"{room}.alarms")


def named(room: str) -> set[str]:
    """Return the codes that the room's source names."""
    return {code for text in sources(room).values() for code in CODE.findall(text)}


def test_the_rooms_are_all_that_have_entries() -> None:
    assert {f"{room}.alarms" for room in ROOMS} == set(packages_of_hilcell())


def test_every_code_that_is_named_has_an_entry_of_this_room_or_of_the_core() -> None:
    for room in ROOMS:
        known = {entry.code for entry in (*entries(room), *entries("hilcell"))}
        assert named(room) - PRACTISED <= known


def test_every_exercise_names_an_alarm_that_a_driver_or_the_core_raises() -> None:
    """An exercise says which alarm the run will show; it raises none itself."""
    assert PRACTISED
    raised = {entry.code for room in ROOMS if room != "fakes" for entry in entries(room)}
    assert raised >= PRACTISED


def test_every_entry_is_raised_in_its_own_room() -> None:
    for room in ROOMS:
        assert {entry.code for entry in entries(room) if not entry.verdict} <= named(room)


def test_every_verdict_of_an_entry_is_judged_somewhere() -> None:
    texts = "".join([*sources("procedures").values(), *sources("hilcell/calibration").values()])
    verdicts = [entry.verdict for entry in catalogue().values() if entry.verdict]
    assert verdicts
    for verdict in verdicts:
        kind = verdict_type(verdict) or verdict_type(f"{verdict}.")
        assert kind is not None, verdict
        assert re.search(rf"\b{kind.__name__}\(", texts), verdict


def test_every_error_of_a_device_names_its_code_first() -> None:
    modules = {path: text for room in ROOMS for path, text in sources(room).items()}
    family = {name for text in modules.values() for name in FAMILY.findall(text)}
    family |= {"DeviceError"}
    family -= OWN_WORDS
    family |= {r"(?:RAIL|STRIP|ROBOT|TRACKER)\.(?:failed|refused|no_reading)", "state_error"}
    raised = re.compile(rf"(?<!class )(?<!def )\b(?:{'|'.join(family)})\(\s*([^,\s]+)")
    first = [found for text in modules.values() for found in raised.findall(text)]
    assert len(first) > 150
    chosen = re.compile(r'"HC-[A-Z]\d\d"$|[\w.]*(code|alarm|alarms)\b|TOO_OLD')
    assert [each for each in first if not chosen.match(each)] == []


def test_every_error_code_of_a_drive_has_an_alarm() -> None:
    for code in (*cia.ERRORS, *(family << 8 for family in cia.FAMILIES), 0x1234):
        assert entry_of(cia.error_alarm(code)).specific


def test_an_error_code_raises_the_alarm_of_its_family() -> None:
    known = {
        0x5441: "HC-R20", 0x2310: "HC-R21", 0x7121: "HC-R21", 0x3210: "HC-R22",
        0x4310: "HC-R23", 0x7305: "HC-R24", 0x8130: "HC-R25", 0x8210: "HC-R25",
        0x8500: "HC-R26", 0x8611: "HC-R26", 0x8612: "HC-R32", 0x1000: "HC-R27",
        0x7122: "HC-R27", 0x0000: "HC-R27",
    }  # fmt: skip
    assert {code: cia.error_alarm(code) for code in known} == known


def test_every_status_of_the_tracker_has_an_alarm() -> None:
    for status in (*emscon.STATUS.values(), emscon.UNKNOWN):
        assert entry_of(status.alarm).specific
        assert (status.alarm == emscon.UNKNOWN.alarm) == (status is emscon.UNKNOWN)


def test_a_code_that_no_catalogue_has_is_the_device_s_general_alarm() -> None:
    """A second make's driver may be newer than its catalogue."""
    general = {device: entry_of("HC-X01", device).code for device in ("Rail", "Robot", "Horse", "")}
    assert general == {"Rail": "HC-R99", "Robot": "HC-B99", "Horse": "HC-C99", "": "HC-C99"}
    assert not entry_of("HC-X01", "Rail").specific


# Events that are the run's ordinary course; every other one becomes an alarm.
ORDINARY = {
    "first pass",
    "announced",
    "promise",
    "earlier run unreadable",
    "connected",
    "station found held",
    "step",
    "retake asked",
    "visited once more",
    "seated",
    "place taken",
    "slide jogged",
    "place seen",
    "controller read",
    "screen back",
    "acknowledged",
    "device back",
    "stream",
    "no poses chosen",
    "changes accepted",
    "axes not swept",
    "calibration revoked",
    "arm carried",
    "calibration used",
    "factory links",
    "notification failed",
    "order",
    "poses chosen",
    "room back",
    "slide proven",
    "station decided",
    "strip back",
    "targets listed",
    "tracker moved",
    "tracker proven",
    "world frame begun again",
}
ALARMING = {
    "no reading", "safe stop", "closed", "command refused", "screen lost", "answer refused",
    "retake refused", "outlier measured again", "station held", "link",
    "curve", "device lost",
}  # fmt: skip


def test_every_event_is_either_ordinary_or_an_alarm() -> None:
    assert set(EVENTS) == ORDINARY | ALARMING | {"internal error"}  # of which the fault speaks
