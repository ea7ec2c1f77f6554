"""The checker: a journal that is well holds all invariants, each doctored one breaks its own."""

from __future__ import annotations

import math

import pytest

from hilcell.invariants import check_invariants
from hilcell.journal.journal import StorageError
from tests.hilcell.invariants.doctored import (
    DEVICES,
    FRAME,
    Doctored,
    event,
    flange,
    rail,
    robot,
    state,
)

NAN = math.nan
LATE = {"taken_s": 17.0, "age_s": 0.1, "ended_s": 18.0}
OTHER = [{"device": "Robot", "kind": "robot", "model": "KR", "serial": "9"}]


def broken(journal: Doctored) -> dict[str, list[str]]:
    verdicts = check_invariants(journal.records())
    return {name: [b.what for b in each.broken] for name, each in verdicts.items() if each.broken}


def test_a_good_journal_holds_every_invariant_and_judges_each() -> None:
    verdicts = check_invariants(Doctored().records())
    assert list(verdicts) == [f"I{n}" for n in range(1, 19)]
    assert broken(Doctored()) == {}
    assert all(each.checked for each in verdicts.values())


def readings(**facts: object) -> dict[str, object]:
    return {f"readings__{name}": value for name, value in facts.items()}


def slid(by_mm: float) -> Doctored:
    """F2 has moved against the others in the bump, and is where it was ever since."""
    journal = Doctored()
    for name in ("world.1 F2", "control 1 F2", "resumed F2", "control 2 F2"):
        journal.change(name, xyz_mm=[1505.0 + by_mm, 0.0, 0.0])
    return journal


JOGGED = event(
    "jogged", "slide jogged", key="5 mm", distance_mm=5.0, bound_mm=9.0, speed_mm_s=2.0,
    stopped_by="", taken_s=[0.0], drive_mm=[0.0], strip_mm=[0.0], velocity_mm_s=[0.0],
)  # fmt: skip
CASES: list[tuple[str, Doctored]] = [
    ("I1", Doctored().after("point 1", rail("not parked", 1))),
    ("I1", Doctored().after("point 1", JOGGED)),
    ("I1", Doctored().change("approach", seen__still=False)),
    ("I1", Doctored().change("approach", seen__joints_deg=[0.0, -99.8, 110.0, 0.0, -30.0, 0.0])),
    ("I1", Doctored().change("approach", seen__joints_deg=[NAN, -100.0, 110.0, 0.0, -30.0, 0.0])),
    ("I1", Doctored().change("approach", seen__joints_deg=[])),
    ("I1", Doctored().change("approach", seen__ended_s=5.1)),
    ("I2", Doctored().change("move 1", seen__still=False)),
    ("I2", Doctored().change("move 1", seen__powered=True)),
    ("I2", Doctored().change("move 1", seen__powered=None)),
    ("I2", Doctored().change("move 1", seen__strip_mm=10.03)),
    ("I2", Doctored().change("move 1", seen__strip_mm=NAN)),
    ("I2", Doctored().change("move 1", seen__ended_s=9.1)),
    ("I2", Doctored().change("point 1", strip_mm=10.03)),
    ("I2", Doctored().change("point 1", strip_mm=NAN)),
    ("I2", Doctored().without("held")),
    ("I3", Doctored().move("point 3", "finish")),
    ("I3", Doctored().move("point 1", "paused")),
    ("I3", Doctored().change("point 1", readings__rail__ended_s=18.1)),
    ("I3", Doctored().change("point 1", readings__rail__ended_s=None)),
    ("I3", Doctored().change("point 1", readings__robot__ended_s=19.1)),
    ("I4", Doctored().change("point 1", readings__robot__ended_s=20.1)),
    ("I1", Doctored().change("approach", seen=None)),
    ("I2", Doctored().change("move 1", seen=None)),
    ("I14", Doctored().change("move 1", seen=None)),
    ("I14", Doctored().change("approach", seen=None)),
    ("I4", Doctored().without("move 1")),
    ("I4", Doctored().after("point 1", flange("seat of another pose", "grid/7/seat2", 1))),
    ("I4", Doctored().change("point 1", temperature_c=None)),
    ("I4", Doctored().change("point 1", readings=None)),
    ("I4", Doctored().change("point 1", smr_mm=None)),
    ("I5", Doctored().move("park", "fault")),
    ("I5", Doctored().move("park", "paused")),
    ("I5", Doctored().move("move 3", "finish")),
    ("I6", Doctored().change("fault", reason="Robot: link lost")),
    ("I6", Doctored().change("end 1", reason="Robot: link lost")),
    ("I6", Doctored().change("fault", reason="")),
    ("I7", Doctored().without("closed")),
    ("I7", Doctored().after("closed", event("twice", "closed", problems={}, took_s=0.1))),
    ("I7", Doctored().change("closed", took_s=15.1)),
    ("I7", Doctored().change("closed", took_s=NAN)),
    ("I8", Doctored().after("point 1", flange("twice", "grid/1", 1))),
    ("I8", Doctored().change("end 2", result={"points": {"world": 6, "grid": 2, "control": 18}})),
    ("I9", Doctored().after("point 3", robot("again", "grid/1", 2))),
    ("I9", Doctored().without("found")),
    ("I9", Doctored().without("proven again")),
    ("I9", Doctored().without("run")),
    ("I10", Doctored().change("base", points=["grid/7"])),
    ("I10", Doctored().after("moved", ("of it", "frame", "six", FRAME | {"points": ["grid/2"]}))),
    ("I10", Doctored().change("end 2", result={"points": {"world": 6, "grid": 4, "control": 18}})),
    ("I10", Doctored().change("moved", invalid=[])),
    ("I11", Doctored().change("move 3", session=1)),
    ("I11", Doctored().change("point 3", session=1)),
    ("I12", Doctored().without("closed")),
    ("I12", Doctored().change("closed again", problems={"Rail": "no answer within 10 s"})),
    ("I13", Doctored().change("proceed", by="")),
    ("I13", Doctored().change("proceed", by="screen lost")),
    ("I14", Doctored().change("move 1", seen__age_s=0.51)),
    ("I14", Doctored().change("approach", seen__age_s=NAN)),
    ("I14", Doctored().change("point 1", readings__began__age_s=4.0)),
    ("I14", Doctored().change("held", began__age_s=4.0)),
    ("I14", Doctored().change("point 1", readings__rail__taken_s=19.9)),
    ("I14", Doctored().change("point 1", readings__tracker__age_s=-1.0)),
    ("I15", Doctored().change("world.1 F1", set_up=0)),
    ("I15", Doctored().change("world.1 F1", xyz_mm=[5.0, 0.0, 4.0])),
    ("I15", slid(0.2)),
    ("I15", slid(NAN)),
    ("I15", Doctored().change("point 2 again", set_up=0)),
    ("I15", Doctored().change("control F3", xyz_mm=[0.0, 1500.0, 0.2])),
    ("I15", Doctored().change("control F3", xyz_mm=[0.0, 1500.0, NAN])),
    ("I15", Doctored().without("control F3")),
    ("I16", Doctored().without("proven 1")),
    ("I16", Doctored().without("proven 2")),
    ("I16", Doctored().without("proven after pause")),
    ("I16", Doctored().without("proven again")),
    ("I17", Doctored().change("verdict", holds=False)),
    ("I17", Doctored().change("read", until=1000)),
    ("I18", Doctored().change("connected again", devices=OTHER)),
    ("I18", Doctored().change("connected again", hilcell="0.2.0")),
    (
        "I18",  # what was agreed to holds for one connection
        Doctored()
        .after("found", event("agreed", "changes accepted", changes=["x"], by="me"))
        .move("agreed", "resume")
        .after("connected again", event("a third time", "connected", devices=OTHER)),
    ),
]


def test_every_break_is_found() -> None:
    missed = [n for n, (invariant, journal) in enumerate(CASES) if invariant not in broken(journal)]
    assert missed == []
    assert {name for name, _ in CASES} == {f"I{n}" for n in range(1, 19)}


def test_a_gap_is_found() -> None:
    records = Doctored().records()
    del records[9]
    assert check_invariants(records)["I8"].broken


@pytest.mark.parametrize(
    "journal",
    [
        Doctored()
        .after("found", event("agreed", "changes accepted", changes=["x"], by="me"))
        .move("agreed", "resume")
        .change("connected again", devices=OTHER),
        Doctored().change("connected again", devices=[{**each, "firmware": "1.2"}
                                                      for each in DEVICES]),
        Doctored().after("point 3", event("odd", "outlier measured again", key="grid/3"),
                         robot("odd move", "grid/3", 2),
                         flange("odd point", "grid/3", 2, 1)).change("odd point", retaken=True),
        Doctored().after("point 1", flange("another reflector", "grid/1/seat2", 1))
        .change("end 2", result={"points": {"world": 6, "grid": 4, "control": 18}}),
        Doctored().after("end 1", ("refused", "end", "", {"state": "faulted", "exit": 2,
                                                          "reason": "Robot: nobody answers"})),
    ],
    ids=["accepted", "firmware not stated once", "retake", "seat", "refused resume"],
)  # fmt: skip
def test_what_was_agreed_to_breaks_nothing(journal: Doctored) -> None:
    assert broken(journal) == {}


def test_a_device_that_cannot_tell_is_not_proven() -> None:
    journal = Doctored().change("closed", problems={"Rail": "no answer within 10 s"})
    verdict = check_invariants(journal.records())["I12"]
    assert verdict.holds
    assert len(verdict.inconclusive) == 1
    assert verdict.checked == 3  # the robot, and both where the run has finished


def test_a_reflector_that_is_carried_proves_less_often() -> None:
    journal = Doctored().without("proven 1").change("plan", cell__layout__reflectors="by_hand")
    assert check_invariants(journal.records())["I16"].checked == 0
    assert broken(journal) == {}


def test_settling_is_judged_in_the_time_of_the_cell() -> None:
    journal = Doctored().change("point 1", readings__robot__ended_s=19.5)
    assert "I3" in broken(journal)
    fast = journal.change("plan", cell__simulation={}, speed=2.0)
    assert broken(fast) == {}


def test_a_damaged_record_is_named() -> None:
    journal = Doctored().change("held", station=None)
    with pytest.raises(StorageError, match="record 11"):
        check_invariants(journal.records())


def test_a_state_out_of_turn_is_found() -> None:
    assert "I9" in broken(Doctored().after("run", state("twice", "checking", "running")))
