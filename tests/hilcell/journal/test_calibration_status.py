"""Which calibration of a cell is current, from the runs of a folder."""

from typing import Any

import msgspec
import pytest

from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.calibration_status import (
    CalibrationStatus,
    current_of,
    descended_from,
    statuses,
)
from hilcell.journal.index import RunRow

REVOKED = CalibrationFacts(kind="base", used="01", doubt="a slip", revoked="it had slipped")


def row(name: str, *, code: int = 0, state: str = "finished", **facts: Any) -> RunRow:
    """Return a run whose name is the second at which it began and ended."""
    t = f"2026-11-22T10:00:{name[:2]}Z"
    return RunRow(
        name=name, begun=t, ended=t, state=state, exit=code, cell="paper", serial="P-1",
        moved=True, facts=CalibrationFacts(**facts),
    )  # fmt: skip


def made(name: str, **more: Any) -> RunRow:
    facts: dict[str, Any] = {"kind": "made", "validated": True}
    return row(name, **(facts | more))


def states(*rows: RunRow) -> dict[str, str]:
    return {name: each.text for name, each in sorted(statuses(rows).items())}


def test_a_later_one_supersedes() -> None:
    assert states(made("02"), made("01")) == {"01": "superseded by 02", "02": "current"}
    assert statuses([made("01"), made("02")])["01"].current == "02"


@pytest.mark.parametrize(
    "bad",
    [
        made("02", validated=False),
        made("02", code=1),
        made("02", state="aborted", code=4),
        row("02"),
        row("02", kind="touch", used="01"),
    ],
)
def test_what_was_not_validated_supersedes_nothing(bad: RunRow) -> None:
    assert states(made("01"), bad)["01"] == "current"


def test_a_doubt_goes_on_to_what_is_made_of_it() -> None:
    doubted = row("02", kind="base", used="01", doubt="a slip explains it as well")
    runs = [made("01"), doubted, row("03", kind="targets", used="02")]
    in_doubt = "in doubt: a slip explains it as well"
    assert states(*runs[:2]) == {"01": "superseded by 02", "02": in_doubt}
    assert not any(each.usable or each.current for each in statuses(runs[:2]).values())
    assert states(*runs)["03"] == in_doubt
    assert states(*runs, made("04"))["04"] == "current"
    assert states(made("01"), msgspec.structs.replace(doubted, facts=REVOKED))["01"] == "current"


@pytest.mark.parametrize("kind", ["base", "targets"])
def test_an_update_of_the_current_one_supersedes_it(kind: str) -> None:
    update = row("02", kind=kind, used="01", code=1)
    assert states(made("01"), update) == {"01": "superseded by 02", "02": "current"}
    stale = row("03", kind=kind, used="01", code=1)
    assert states(made("01"), made("02"), stale)["03"] == "superseded by 02"
    assert states(made("01"), made("02"), stale)["02"] == "current"


def test_a_re_check_with_redo_revokes_what_it_judged() -> None:
    found = statuses([made("01"), made("02"), row("03", recheck="redo", used="02", code=1)])
    assert found["02"] == CalibrationStatus("revoked", "03", "its re-check says redo")
    assert found["01"] == CalibrationStatus("superseded", "02")  # the robot has changed since
    assert (
        states(row("02", state="aborted", recheck="redo", used="01"), made("01"))["01"] == "current"
    )


def test_what_is_based_on_a_revoked_one_is_revoked() -> None:
    update = row("02", kind="base", used="01", code=1)
    found = statuses([made("01", revoked="wrong reflector"), update])
    assert found["01"].text == "revoked: wrong reflector"
    assert found["02"].state == "revoked"
    assert "it is based on one revoked: wrong reflector" in found["02"].text


def test_a_redo_of_an_older_one_leaves_its_update() -> None:
    update = row("02", kind="base", used="01", code=1)
    redo = row("03", recheck="redo", used="01", code=1)
    late = row("04", kind="targets", used="01", code=1)
    found = states(made("01"), update, redo, late)
    assert found["01"].startswith("revoked by 03")
    assert found["02"] == "current"
    assert found["04"].startswith("revoked by 01: it is based on one revoked by 03")


def test_one_that_was_revoked_supersedes_nothing() -> None:
    found = statuses([made("01"), made("02", revoked="nest was loose")])
    assert found["01"] == CalibrationStatus("current", current="01")
    assert found["02"] == CalibrationStatus("revoked", "", "nest was loose", "01")


def test_a_revoked_re_check_revokes_nothing() -> None:
    redo = row("02", recheck="redo", used="01", code=1, revoked="the tracker was cold")
    assert states(made("01"), redo) == {"01": "current"}


def test_a_touched_base_holds_until_the_cell_moves() -> None:
    touch = row("02", kind="touch", used="01")
    assert states(made("01"), touch) == {"01": "current", "02": "current"}
    assert states(made("01"), touch, row("03"))["02"] == "out of date by 03"
    assert states(made("01"), touch, made("03"))["02"] == "superseded by 03"
    of_touch = row("03", kind="targets", used="02", code=1)
    assert states(made("01"), touch, of_touch)["03"] == "current"


def test_cells_and_machines_are_apart() -> None:
    other = [
        msgspec.structs.replace(made("02"), **change)
        for change in ({"cell": "hard"}, {"serial": "P-2"}, {"simulated": True, "machine_seed": 3})
    ]
    for each in other:
        assert states(made("01"), each) == {"01": "current", "02": "current"}


@pytest.mark.parametrize(
    "replay",
    [
        made("02"),
        row("02", kind="base", used="01", code=1),
        row("02", recheck="redo", used="01", code=1),
        row("02", kind="touch", used="01"),
    ],
)
def test_a_replay_changes_nothing(replay: RunRow) -> None:
    replay = msgspec.structs.replace(replay, replayed=True)
    found = statuses([made("01"), replay])
    assert found["01"] == CalibrationStatus("current", current="01")
    assert current_of([made("01"), replay], "paper", "P-1", False, None) == "01"
    assert not replay.calibrates
    if replay.facts.kind:
        assert found["02"].text == "replayed: a replay measures nothing"
        assert not found["02"].usable
    touched = row("02", kind="touch", used="01")
    moved = msgspec.structs.replace(row("03"), replayed=True)
    assert states(made("01"), touched, moved)["02"] == "current"


@pytest.mark.parametrize("real_first", [True, False])
def test_a_simulated_run_never_supersedes_a_real_one(real_first: bool) -> None:
    first, second = ("01", "02") if real_first else ("02", "01")
    rows = [made(first), simulated(made(second), 1), simulated(row("03", recheck="redo"), None)]
    found = statuses(rows)
    assert (found[first].state, found[first].current) == ("current", first)
    assert current_of(rows, "paper", "P-1", False, None) == first


def simulated(row: RunRow, seed: int | None) -> RunRow:
    return msgspec.structs.replace(row, simulated=True, machine_seed=seed)


def test_a_run_is_of_the_machine_whose_calibration_it_uses() -> None:
    """A re-check of a cell that is simulated elsewhere does not know the machine's seed."""
    update = simulated(row("02", kind="base", used="01", code=1), None)
    assert states(simulated(made("01"), 1), update) == {"01": "superseded by 02", "02": "current"}


def test_the_run_whose_calibration_is_current() -> None:
    rows = [made("01"), made("02"), made("03", code=1)]
    assert current_of(rows, "paper", "P-1", False, None) == "02"
    assert current_of(rows, "paper", "P-2", False, None) == ""
    revoked = [made("01"), made("02", revoked="a nest was moved")]
    assert current_of(revoked, "paper", "P-1", False, None) == statuses(revoked)["01"].current
    machines = [simulated(made(f"0{seed}"), seed) for seed in (1, 2)]
    assert current_of(machines, "paper", "P-1", True, 1) == "01"
    assert current_of(machines, "paper", "P-1", True, 3) == ""


DIFFERS = {"validated": True, "suspected": True, "changed_since": "01"}


def test_one_that_differs_from_the_current_one_supersedes_it_only_when_that_is_revoked() -> None:
    second = made("02", code=1, **DIFFERS)
    found = statuses([made("01"), second])
    assert (found["01"].state, found["02"].state, found["02"].current) == (
        "current", "suspected", "01",
    )  # fmt: skip
    assert "01" in found["02"].reason
    first = made("01", revoked="half-inch balls")
    assert states(first, second) == {"01": "revoked: half-inch balls", "02": "current"}
    assert states(made("01"), made("02", code=1, **DIFFERS, revoked="wrong"))["01"] == "current"


def test_a_redo_decides_as_a_person_does() -> None:
    redo = row("03", recheck="redo", used="01", code=1)
    assert states(made("01"), made("02", code=1, **DIFFERS), redo)["02"] == "current"


def test_one_that_differs_and_is_suspected_of_more_stays_so() -> None:
    first = made("01", revoked="half-inch balls")
    assert states(first, made("02", code=1, suspected=True))["02"] == "suspected"
    assert (
        states(first, made("02", code=1, validated=False, changed_since="01"))["02"]
        == "not validated"
    )


def test_a_copy_of_a_folder_supersedes_nothing_and_hides_no_revocation() -> None:
    """A backup beside the run was current after the run was revoked."""
    run, backup = (msgspec.structs.replace(made(name), origin="a") for name in ("01", "01-old"))
    copied = "copy: the run is 01"
    assert states(backup, run) == {"01": "current", "01-old": copied}
    assert statuses([backup, run])["01-old"].current == "01"
    revoked = msgspec.structs.replace(backup, facts=made("01", revoked="a wrong ball").facts)
    assert states(revoked, run) == {"01": "revoked: a wrong ball", "01-old": copied}
    assert not any(each.usable for each in statuses([revoked, run]).values())
    late = row("02", kind="base", used="01-old", code=1)
    assert states(late, run, backup) == {
        "01": "copy: the run is 01-old",
        "01-old": "superseded by 02",
        "02": "current",
    }


def test_what_descends_from_one_is_what_rests_on_it() -> None:
    again = made("03", carried="02")
    rows = [made("04"), again, row("05", kind="base", used="03"), made("01"), made("02")]
    assert [each.name for each in descended_from(rows, "02")] == ["03", "05"]
    assert descended_from(rows, "05") == descended_from(rows, "04") == []
    assert states(made("02", revoked="a bump"), again)["03"] == "current"  # its targets were sent
