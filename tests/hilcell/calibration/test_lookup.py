"""Which calibration a procedure starts from, and which it refuses before anything moves."""

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from hilcell.calibration import lookup
from hilcell.calibration.file import Calibration, write_calibration
from hilcell.calibration.lookup import (
    CalibrationFile,
    NoCalibration,
    calibrated_machine,
    calibration_named,
    calibration_status,
    calibration_statuses,
    record_of,
    with_calibration,
)
from hilcell.calibration.validity import CalibrationRefused
from hilcell.cell.file import Cell, RecheckTable, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.journal.index import read_index
from hilcell.journal.journal import Journal, Record
from hilcell.journal.log import Log
from hilcell.journal.runs import CALIBRATION, JOURNAL, read_log
from hilcell.model.events import CalibrationUsed
from hilcell.model.verdicts import Rechecked
from hilcell.ports import HilcellError
from hilcell.report.facts import read_facts
from tests.hilcell.calibration.calibrations import calibration
from tests.hilcell.commands.finished_runs import FIT, MADE, finished, text_of
from tests.hilcell.report.journals import Writer
from tests.hilcell.verdicts import RECHECKED, REDO

CELL = load_cell("paper")


def made(runs: Path, name: str, **provenance: Any) -> Calibration:
    """Write a run with a calibration of the cell, simulated as it is, that was not validated."""
    folder = runs / name
    finished(runs, name, FIT)
    here: dict[str, Any] = {"cell": CELL.name, "digest": CELL.digest, "simulated": True}
    found = calibration(**(here | {"run": name} | provenance))
    write_calibration(found, folder / CALIBRATION)
    return found


def using(named: str = "") -> Cell:
    return msgspec.structs.replace(CELL, recheck=RecheckTable(calibration=named))


def test_the_newest_calibration_of_this_cell_is_taken(tmp_path: Path) -> None:
    made(tmp_path, "1-old")
    made(tmp_path, "2-new")
    made(tmp_path, "3-other-cell", cell="another")
    finished(tmp_path, "4-no-calibration", {})
    (tmp_path / "4-no-calibration" / CALIBRATION).unlink()
    cell = with_calibration(using(), "recheck", tmp_path).cell
    assert Path(cell.recheck.calibration) == tmp_path / "2-new" / CALIBRATION
    assert calibration_named(cell, "recheck").provenance.run == "2-new"
    assert cell.digest == CELL.digest


def test_a_real_cell_never_takes_that_of_a_simulated_one(tmp_path: Path) -> None:
    made(tmp_path, "1-real", simulated=False)
    made(tmp_path, "2-simulated")
    real = msgspec.structs.replace(using(), simulation=None)
    for cell, wanted in ((real, "1-real"), (using(), "2-simulated")):
        found = with_calibration(cell, "recheck", tmp_path).cell
        assert calibration_named(found, "recheck").provenance.run == wanted


@pytest.mark.parametrize("how", ["1-old", "1-", "file"])
def test_a_run_or_its_file_may_be_named(tmp_path: Path, how: str) -> None:
    made(tmp_path, "1-old")
    made(tmp_path, "2-new")
    named = str(tmp_path / "1-old" / CALIBRATION) if how == "file" else how
    cell = with_calibration(using(named), "recheck", tmp_path).cell
    assert calibration_named(cell, "recheck").provenance.run == "1-old"


@pytest.mark.parametrize("how", ["", "1-made", "file"])
def test_one_whose_run_has_not_ended_with_it_is_in_doubt(tmp_path: Path, how: str) -> None:
    """A run that was opened again, or a journal that says nothing of a calibration."""
    made(tmp_path, "1-made")
    journal = Journal(tmp_path / "1-made" / JOURNAL, "1-made", create=False)
    journal.append("state", "", {"machine": "run", "to": "checking"})
    journal.close()
    named = str(tmp_path / "1-made" / CALIBRATION) if how == "file" else how
    with pytest.raises(HilcellError, match="checking"):
        with_calibration(using(named), "recheck", tmp_path)
    (tmp_path / "1-made" / JOURNAL).unlink()
    finished(tmp_path, "1-made", {})
    with pytest.raises(HilcellError, match="no calibration by its journal"):
        with_calibration(using(named), "recheck", tmp_path)


def test_no_calibration_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(NoCalibration, match="calibrate"):
        with_calibration(using(), "recheck", tmp_path)
    with pytest.raises(HilcellError, match="nothing"):
        with_calibration(using("nothing"), "recheck", tmp_path)
    made(tmp_path, "1-old")
    (tmp_path / "1-old" / CALIBRATION).unlink()
    with pytest.raises(NoCalibration, match="1-old"):
        with_calibration(using("1-old"), "recheck", tmp_path)
    with pytest.raises(NoCalibration, match=r"recheck\.calibration"):
        calibration_named(using(), "recheck")


def test_a_machine_takes_its_own_calibration(tmp_path: Path) -> None:
    """Another machine's newer one was taken, found to hold no more, and revoked."""
    here: dict[str, Any] = {"cell": CELL.name, "digest": CELL.digest, "simulated": True}
    for name, seed in (("1-of-1", 1), ("2-of-2", 2)):
        known = calibration(run=name, **here)
        finished(tmp_path, name, MADE, plan={"machine_seed": seed}, provenance=known.provenance)
    for asked, name in ((1, "1-of-1"), (2, "2-of-2"), (None, "2-of-2")):
        cell = with_calibration(using(), "recheck", tmp_path, machine=asked).cell
        assert Path(cell.recheck.calibration).parent.name == name
        assert calibrated_machine(cell, "recheck") == int(name[-1])
    with pytest.raises(NoCalibration, match="2-of-2 is of simulated machine 2"):
        with_calibration(using(), "recheck", tmp_path, machine=3)


@pytest.mark.parametrize("provenance", [{"sign_checked": False}, {"simulated": False}])
def test_an_unfit_one_is_refused(tmp_path: Path, provenance: dict[str, Any]) -> None:
    made(tmp_path, "1-old", **provenance)
    with pytest.raises(CalibrationRefused):
        with_calibration(using(), "recheck", tmp_path)


def test_the_current_one_is_not_known_where_a_later_journal_cannot_be_read(tmp_path: Path) -> None:
    made(tmp_path, "1-old")
    made(tmp_path, "2-new")
    (tmp_path / "2-new" / JOURNAL).write_bytes(b"no database" * 1000)
    with pytest.raises(CalibrationRefused, match=r"2-new(.|\n)*in doubt.*2-new"):
        with_calibration(using(), "recheck", tmp_path)
    cell = with_calibration(using("1-old"), "recheck", tmp_path).cell
    assert calibration_named(cell, "recheck").provenance.run == "1-old"


FIXED = (
    "name", "serial", "robot.joint", "robot.smr_mm", "robot.more_smr_mm", "robot.status",
    "layout.base", "layout.floor", "station", "grid.station",
)  # fmt: skip


@pytest.mark.parametrize("key", ["", *FIXED])
def test_a_cell_that_was_changed_keeps_its_calibration_but_for_what_that_rests_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    table, _, field = key.rpartition(".")
    then: dict[str, Any] = {name: getattr(CELL, name) for name in ("name", "serial", "station")}
    for name in ("robot", "layout", "grid"):
        of = getattr(CELL, name)
        then[name] = SimpleNamespace(**{each: getattr(of, each) for each in of.__struct_fields__})
    if key:
        (vars(then[table]) if table else then)[field] = "other"
    made(tmp_path, "1-old", digest="d" * 64)
    own = read_log(tmp_path / "1-old")
    log = SimpleNamespace(cell=SimpleNamespace(**then), verdict=own.verdict, events=own.events)
    monkeypatch.setattr(lookup, "read_log", lambda folder: log)
    if not key:
        assert with_calibration(using("1-old"), "recheck", tmp_path).accepted == []
        return
    with pytest.raises(
        CalibrationRefused, match=f"{key} differs from the cell that was calibrated"
    ):
        with_calibration(using("1-old"), "recheck", tmp_path)


def test_a_file_alone_must_be_of_the_same_cell_file(tmp_path: Path) -> None:
    made(tmp_path, "1-old", digest="d" * 64)
    alone = tmp_path / "alone.json"
    (tmp_path / "1-old" / CALIBRATION).rename(alone)
    with pytest.raises(CalibrationRefused, match="dddddddddddd"):
        with_calibration(using(str(alone)), "recheck", tmp_path)


@pytest.mark.parametrize("verdict", [RECHECKED, REDO, None])
def test_a_run_that_wrote_none_says_what_to_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verdict: Rechecked | None
) -> None:
    used = CalibrationUsed(**record_of(made(tmp_path, "1-old"), ""))
    records = [Record(1, "2026-01-01T00:00:00.000Z", "event", "", msgspec.to_builtins(used))]
    log = Log(records)
    if verdict is not None:
        log.verdicts["recheck"] = verdict
    monkeypatch.setattr(lookup, "read_log", lambda folder: log)
    monkeypatch.setattr(lookup, "find_run", lambda runs, name: runs / name)
    with pytest.raises(NoCalibration, match=r"r1 .*1-old"):
        CalibrationFile.named("r1", tmp_path)


def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    made(tmp_path, "1-old")
    path = tmp_path / "1-old" / CALIBRATION
    path.write_text(path.read_text().replace('"pitch_mm": 450', '"pitch_mm": 451'))
    with pytest.raises(SettingsError, match="seal"):
        with_calibration(using(), "recheck", tmp_path)


@pytest.mark.parametrize("content", [b"{", b"\xff", b'{"schema": 1}'])
def test_a_damaged_calibration_of_another_cell_ends_no_run(tmp_path: Path, content: bytes) -> None:
    made(tmp_path, "1-old")
    of_other = msgspec.structs.replace(CELL, name="another")
    Writer(tmp_path / "2-other", cell=msgspec.to_builtins(of_other)).began().journal.close()
    (tmp_path / "2-other" / CALIBRATION).write_bytes(content)
    cell = with_calibration(using(), "recheck", tmp_path).cell
    assert calibration_named(cell, "recheck").provenance.run == "1-old"


def test_a_damaged_calibration_that_was_revoked_ends_no_run(tmp_path: Path) -> None:
    made(tmp_path, "1-old")
    made(tmp_path, "2-revoked")
    journal = Journal(tmp_path / "2-revoked" / JOURNAL, "2-revoked", create=False)
    journal.append("event", "", {"what": "calibration revoked", "reason": "bumped tracker"})
    journal.close()
    (tmp_path / "2-revoked" / CALIBRATION).write_bytes(b"{")
    cell = with_calibration(using(), "recheck", tmp_path).cell
    assert calibration_named(cell, "recheck").provenance.run == "1-old"


@pytest.mark.parametrize("journal", ["whole", "damaged"])
def test_a_damaged_calibration_that_may_be_current_is_refused(tmp_path: Path, journal: str) -> None:
    made(tmp_path, "1-old")
    made(tmp_path, "2-new")
    (tmp_path / "2-new" / CALIBRATION).write_bytes(b"{")
    if journal == "damaged":
        (tmp_path / "2-new" / JOURNAL).write_bytes(b"no database" * 1000)
    with pytest.raises(SettingsError, match=r"2-new(.|\n)*move it out of .*recheck\.calibration"):
        with_calibration(using(), "recheck", tmp_path)


def test_one_of_a_cell_that_cannot_be_read_is_named_with_the_way_out(tmp_path: Path) -> None:
    """It has the name of this cell: another of the name, or this one with another file."""
    made(tmp_path, "1-old")
    made(tmp_path, "2-new", digest="d" * 64)
    (tmp_path / "2-new" / JOURNAL).write_bytes(b"no database" * 1000)
    way_out = r"2-new/journal\.sqlite cannot be read; .*move it out of .*recheck\.calibration"
    with pytest.raises(CalibrationRefused, match=way_out):
        with_calibration(using(), "recheck", tmp_path)
    (tmp_path / "2-new").rename(tmp_path.parent / f"{tmp_path.name}-2-new")
    found = with_calibration(using(), "recheck", tmp_path).cell
    assert calibration_named(found, "recheck").provenance.run == "1-old"


@pytest.mark.parametrize("cut", [None, 0, 5000])
def test_a_later_calibration_whose_journal_is_lost_leaves_the_one_before_in_doubt(
    tmp_path: Path, cut: int | None
) -> None:
    """It may have superseded it: nobody corrects by the old one without a word."""
    for name, day in (("1-old", "01"), ("2-new", "02")):
        known = calibration(run=name, simulated=True, written=f"2026-01-{day}T00:00:00+00:00")
        finished(tmp_path, name, MADE, provenance=known.provenance)
    assert text_of(tmp_path / "1-old") == "superseded by 2-new"
    journal = tmp_path / "2-new" / JOURNAL
    content = journal.read_bytes()
    journal.unlink()
    if cut is not None:
        journal.write_bytes(content[:cut])
    found = calibration_status(tmp_path / "1-old")
    assert found is not None
    assert (found.state, found.usable) == ("in doubt", False)
    assert "run 2-new wrote a later calibration" in found.reason
    assert calibration_statuses(tmp_path, read_index(tmp_path))["1-old"] == found  # as listed
    (tmp_path / "2-new" / CALIBRATION).unlink()
    assert text_of(tmp_path / "1-old") == "current"


def test_a_calibration_with_which_its_run_did_not_end_is_in_doubt_wherever_it_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lists, one run's page, its report and what uses it say the same; without a file, nothing."""
    folder = tmp_path / "1-none"
    finished(tmp_path, "1-none", {})
    text = "in doubt: its run made no calibration by its journal"
    used = CalibrationFile.named(str(folder / CALIBRATION), tmp_path).status
    assert used is not None
    assert used.text == text_of(folder) == text
    assert calibration_statuses(tmp_path, read_index(tmp_path)) == {"1-none": used}
    assert read_facts(folder).status == used
    monkeypatch.chdir(folder)
    assert text_of(Path()) == text
    (folder / CALIBRATION).unlink()
    assert calibration_status(folder) is read_facts(folder).status is None


def test_a_run_that_was_revoked_stays_so_in_a_copy_of_its_runs(tmp_path: Path) -> None:
    runs, copy = tmp_path / "runs", tmp_path / "copy"
    finished(runs, "1-made", MADE)
    shutil.copytree(runs, copy)
    path = str(copy / "1-made" / CALIBRATION)
    journal = Journal(runs / "1-made" / JOURNAL, "1-made", create=False)
    journal.append("event", "", {"what": "calibration revoked", "reason": "a nest"})
    journal.close()
    for named in (runs, copy):
        found = CalibrationFile.named(path, named).status
        assert found is not None
        assert found.text == ("revoked: a nest" if named == runs else "current")
    shutil.rmtree(runs)
    finished(runs, "1-made", MADE)  # another run of the same name
    assert CalibrationFile.named(path, runs).status == calibration_status(copy / "1-made")


def test_a_copied_folder_is_the_run_that_it_was_copied_from(tmp_path: Path) -> None:
    finished(tmp_path, "1-made", MADE)
    shutil.copytree(tmp_path / "1-made", tmp_path / "1-made-backup")
    assert text_of(tmp_path / "1-made") == "current"
    assert text_of(tmp_path / "1-made-backup") == "copy: the run is 1-made"
    finished(tmp_path, "2-made", MADE)
    assert text_of(tmp_path / "1-made") == "superseded by 2-made"


@pytest.mark.parametrize(
    ("name", "written"), [("2-older", "2026-01-01"), ("3-copy-of-another", "2026-01-03")]
)
def test_a_folder_without_a_journal_that_is_older_or_a_copy_leaves_no_doubt(
    tmp_path: Path, name: str, written: str
) -> None:
    known = calibration(run="1-made", simulated=True, written="2026-01-02T00:00:00+00:00")
    finished(tmp_path, "1-made", MADE, provenance=known.provenance)
    run = "2-older" if name == "2-older" else "of-elsewhere"
    other = calibration(run=run, simulated=True, written=f"{written}T00:00:00+00:00")
    (tmp_path / name).mkdir()
    write_calibration(other, tmp_path / name / CALIBRATION)
    assert text_of(tmp_path / "1-made") == "current"
