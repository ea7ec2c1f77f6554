"""I18: what answers after a resume is what answered before, or somebody has agreed."""

import shutil
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from hilcell import __version__
from hilcell.cell.file import load_cell
from hilcell.journal.log import Log
from hilcell.journal.runs import read_log
from hilcell.ports import DeviceError, Identity
from hilcell.run.cell_session import CellSession
from hilcell.run.run_plan import Changes, cell_file, changed_assets, changed_inputs
from tests.hilcell.report.journals import Writer
from tests.hilcell.run.bed import Bed, Live
from tests.hilcell.run.rig import Points, procedure

pytestmark = pytest.mark.waits
STRIP = Identity("Rail", "MSA111C", "4711", "can0 node 2", kind="strip", firmware="1.2")
DRIVE = Identity("Rail", "MD36", "815", "can0 node 1", kind="drive")


def journal(folder: Path, **plan: Any) -> Log:
    return read_log(Writer(folder, **plan).began().left())


def test_another_version_of_hilcell_is_noticed(tmp_path: Path) -> None:
    assert changed_inputs(journal(tmp_path / "a", versions={"hilcell": __version__}), "") == []
    assert changed_inputs(journal(tmp_path / "b", versions={}), "") == []
    old = journal(tmp_path / "c", versions={"hilcell": "0.0.1"})
    (change,) = changed_inputs(old, "")
    assert "0.0.1" in change


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "cell.toml"
    shutil.copy(str(resources.files("hilcell.cells") / "paper.toml"), path)
    return path


def began_with(file: Path, settings: dict[str, str]) -> Log:
    cell = msgspec.to_builtins(load_cell(str(file), settings))
    versions = {"hilcell": __version__}
    plan = {"versions": versions, "cell": cell, "cell_file": str(file), "settings": settings}
    return journal(file.parent / "run", **plan)


def test_an_edited_cell_file_is_noticed(file: Path) -> None:
    log = began_with(file, {"settle.robot_s": "0.25"})
    assert changed_inputs(log, "") == []
    file.write_text(file.read_text().replace("max_tolerance_mm = 0.3", "max_tolerance_mm = 3.0"))
    (change,) = changed_inputs(log, "")
    assert "validation.max_tolerance_mm 0.3 -> 3.0" in change
    assert changed_inputs(log, "validation") == []  # a table that the run itself has filled in
    file.write_text("name = 7")
    (change,) = changed_inputs(log, "")
    assert str(file) in change
    file.unlink()
    assert len(changed_inputs(log, "")) == 1


def test_a_cell_is_found_again_from_any_folder(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(file.parent)
    assert cell_file("cell.toml") == str(file)
    assert cell_file("paper") == "paper"


@pytest.mark.parametrize(
    ("now", "differs"),
    [
        ([STRIP, replace(DRIVE, address="can1 node 1")], ""),
        ([replace(STRIP, serial="9"), DRIVE], "serial 9"),
        ([replace(STRIP, firmware="1.3"), DRIVE], "firmware 1.3"),
        ([replace(STRIP, firmware=""), replace(DRIVE, firmware="2.0")], ""),  # not known once
        ([STRIP], "drive"),
    ],
)
def test_another_asset_is_noticed(now: list[Identity], differs: str) -> None:
    before = (DRIVE, STRIP)
    found = changed_assets(before, now)
    assert len(found) == bool(differs)
    assert all(differs in change for change in found)
    assert changed_assets([], now) == []


def other_rail(bed: Bed) -> str:
    """End a run by a fault, exchange the rail, and return what a resume has to say of it."""

    def fail(session: CellSession, number: int) -> None:
        if number == 1:
            raise DeviceError("HC-T02", "Tracker", "measure", "gone")

    assert bed.run(procedure(Points(2, fail))) == 3
    bed.rail.identity = replace(bed.rail.identity, serial="77")
    return "serial 77"


def test_nobody_there_another_rail_is_refused_again_and_again(bed: Bed) -> None:
    change = other_rail(bed)
    measured = bed.tracker.measured
    for _ in range(2):  # a refused one is not what the next resume is compared with
        assert bed.run(procedure(Points(2))) == 2
        assert change in bed.log().fault
    assert bed.tracker.measured == measured
    assert bed.events("changes accepted") == []


def test_a_script_that_resumes_an_attended_run_does_not_wait(bed: Bed) -> None:
    bed.unattended = False
    change = other_rail(bed)
    assert bed.run(procedure(Points(2)), Changes(can_ask=False)) == 2
    assert change in bed.log().fault


def test_an_option_accepts_another_rail_and_the_journal_says_so(bed: Bed) -> None:
    change = other_rail(bed)
    assert bed.run(procedure(Points(2)), Changes(["the cell file"], accepted=True)) == 0
    (accepted,) = bed.events("changes accepted")
    assert accepted["changes"][0] == "the cell file"
    assert change in accepted["changes"][1]
    assert accepted["by"] == "--accept-changes"
    assert bed.run(procedure(Points(3))) == 0  # from now on it is the one that was before


def test_an_attended_run_waits_until_the_operator_agrees(bed: Bed) -> None:
    bed.unattended = False
    change = other_rail(bed)
    measured = bed.tracker.measured
    with Live(bed, procedure(Points(2))) as live:
        live.until("state", "paused")
        assert change in live.runner.log.life[-1].change.reason
        assert (bed.tracker.measured, bed.robot.moves) == (measured, 0)
        live.runner.post("proceed")
    assert live.code == 0
    assert bed.events("changes accepted")[0]["by"] == "the operator"


def test_an_operator_who_stops_has_not_agreed(bed: Bed) -> None:
    bed.unattended = False
    change = other_rail(bed)
    for _ in range(2):
        with Live(bed, procedure(Points(2))) as live:
            live.until("state", "paused")
            assert change in live.runner.log.life[-1].change.reason
            live.runner.stop()
        assert live.code == 4
    assert bed.events("changes accepted") == []
