"""Runs reach the plant's database at least once and stand there once, whatever happens between."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import socket
import sqlite3
import string
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest
from sqlalchemy import func, select

from hilcell.calibration.file import SEAL
from hilcell.journal.index import NAME as INDEX
from hilcell.journal.journal import Record
from hilcell.journal.runs import CALIBRATION, ENGINE, JOURNAL, EngineFile, read_records
from hilcell.plant import shipper
from hilcell.plant.cells import cells
from hilcell.plant.database import SHIPPED, Database
from hilcell.plant.shipper import Shipped, ship
from hilcell.plant.tables import DOCUMENT, POINT, RUN
from tests.hilcell.plant.conftest import DAY, NOW
from tests.hilcell.plant.year import Model, Run, revoke, write_journal
from tests.whole.bench import command
from tests.whole.golden import GoldenRuns


@pytest.fixture(scope="module")
def three(model: Model, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of three runs of a cell; their names are not in the order of their ends."""
    folder = tmp_path_factory.mktemp("three")
    for name, days in (("b", 3), ("c", 2), ("a", 1)):
        model.write(folder, Run(name, "north", "HC-1", NOW - days * DAY))
    return folder


@pytest.fixture
def runs(three: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(three, tmp_path / "runs"))


def kept(database: Database) -> list[tuple[str, int]]:
    with database.transaction() as connection:
        found = connection.execute(select(RUN.c.name, RUN.c.revision).order_by(RUN.c.ended))
        return [(row.name, row.revision) for row in found]


def points(database: Database) -> int:
    with database.transaction() as connection:
        count: int = connection.execute(select(func.count()).select_from(POINT)).scalar_one()
    return count


@contextmanager
def live(folder: Path) -> Iterator[None]:
    """Let a run look as if an engine were at work on it."""
    with tempfile.TemporaryDirectory() as place, socket.socket(socket.AF_UNIX) as listening:
        listening.bind(f"{place}/engine")
        listening.listen()
        file = msgspec.json.encode(EngineFile(1, f"{place}/engine"))
        (folder / ENGINE).write_bytes(file)
        yield
        (folder / ENGINE).unlink()


def test_a_run_that_has_lost_its_journal_is_named(runs: Path, office: Database) -> None:
    (runs / "lost").mkdir()
    (runs / "lost" / "calibration.json").write_text("{}")
    (runs / "notes").mkdir()
    done = command("plant", "ship", runs, "--to", office.name)
    assert done.returncode == 7
    assert "run lost: " in done.stderr
    assert "notes" not in done.stderr


def test_runs_are_shipped_in_the_order_of_their_ends_and_once(runs: Path, office: Database) -> None:
    before = {file: file.read_bytes() for file in runs.glob(f"*/{JOURNAL}")}
    told: list[str] = []
    done = ship(runs, office, told.append)
    assert told == ["b", "c", "a"]
    assert (done.runs, done.before, done.refused) == (3, 0, {})
    assert done.points == points(office)
    assert ship(runs, office) == Shipped(before=3)
    assert len(kept(office)) == 3
    assert {file: file.read_bytes() for file in runs.glob(f"*/{JOURNAL}")} == before


def test_without_its_own_file_nothing_is_doubled(runs: Path, office: Database) -> None:
    ship(runs, office)
    (runs / SHIPPED).unlink()
    assert ship(runs, office) == Shipped(before=3)
    (runs / SHIPPED).write_bytes(b"no database at all" * 100)
    assert ship(runs, office) == Shipped(before=3)


def test_a_database_that_was_set_back_gets_again_what_it_lost(
    runs: Path, office: Database, tmp_path: Path
) -> None:
    shutil.copy(tmp_path / "plant.db", tmp_path / "backup.db")
    ship(runs, office)
    office.close()
    shutil.copy(tmp_path / "backup.db", tmp_path / "plant.db")
    assert ship(runs, office).runs == 3
    assert len(kept(office)) == 3


def test_a_run_that_was_opened_again_is_a_new_revision(runs: Path, office: Database) -> None:
    ship(runs, office)
    last = len(read_records(runs / "a"))
    revoke(runs / "a", NOW)
    done = ship(runs, office)
    assert (done.runs, done.before) == (1, 2)
    assert kept(office)[-2:] == [("a", last), ("a", last + 1)]
    with office.transaction() as connection:
        (state,) = cells(connection, NOW)
    assert (state.calibration, state.condition) == ("c", "valid")


def test_a_cell_whose_calibrations_are_all_revoked_has_none(runs: Path, office: Database) -> None:
    for name in "abc":
        revoke(runs / name, NOW)
    ship(runs, office)
    with office.transaction() as connection:
        (state,) = cells(connection, NOW)
    assert (state.calibration, state.condition) == ("", "no calibration that holds")
    assert state.last_run == "a"


def test_an_older_revision_that_arrives_later_changes_nothing(
    runs: Path, office: Database, tmp_path: Path
) -> None:
    shutil.copytree(runs, tmp_path / "older")
    revoke(runs / "a", NOW)
    ship(runs, office)
    ship(tmp_path / "older", office)
    with office.transaction() as connection:
        (state,) = cells(connection, NOW)
    assert state.calibration == "c"


def test_a_folder_that_is_behind_the_plant_is_named(
    runs: Path, office: Database, tmp_path: Path
) -> None:
    """One that a backup restored, where a run had not ended or was not revoked yet."""
    older = tmp_path / "older"
    shutil.copytree(runs, older)
    last = len(read_records(runs / "a"))
    records = read_records(runs / "b")[:10]
    shutil.rmtree(older / "b")
    rows = [(datetime.fromisoformat(each.t), each.kind, each.key, each.body) for each in records]
    write_journal(older / "b", rows)
    revoke(runs / "a", NOW)
    assert ship(runs, office).behind == {}
    whole = len(read_records(runs / "b"))
    for before in (2, 2):  # read from the journal, then known by the folder's own file
        done = ship(older, office)
        assert (done.before + done.runs, done.waiting) == (before, ["b"])
        assert done.behind == {"a": (last, last + 1), "b": (10, whole)}
    shown = command("plant", "ship", older, "--to", office.name, "--json")
    assert json.loads(shown.stdout)["behind"]["a"] == {"here": last, "plant": last + 1}
    assert f"{last + 1}" in shown.stderr
    revoke(older / "a", NOW)
    assert ship(older, office).behind == {"b": (10, whole)}


def test_a_live_run_and_one_without_an_end_wait(runs: Path, office: Database) -> None:
    records = read_records(runs / "b")[:10]
    rows = [(NOW - DAY, each.kind, each.key, each.body) for each in records]
    write_journal(runs / "cut", rows)
    with live(runs / "a"):
        done = ship(runs, office)
        assert sorted(done.waiting) == ["a", "cut"]
        assert [name for name, _ in kept(office)] == ["b", "c"]
        again = command("plant", "ship", runs, "--to", office.name)
        assert again.returncode == 0
        assert "cut, a" in again.stderr
    assert ship(runs, office).runs == 1


def test_a_journal_that_was_changed_is_refused_and_stops_no_other(
    model: Model, runs: Path, office: Database
) -> None:
    ship(runs, office)
    records = forged(read_records(runs / "a"))
    shutil.rmtree(runs / "a")
    rows = [(datetime.fromisoformat(each.t), each.kind, each.key, each.body) for each in records]
    write_journal(runs / "a", rows)
    model.write(runs, Run("d", "north", "HC-1", NOW - DAY / 2))
    done = ship(runs, office)
    assert (list(done.refused), done.runs) == (["a"], 1)


def forged(records: list[Record]) -> list[Record]:
    """Return the records with one point a millimetre elsewhere."""
    at = next(n for n, each in enumerate(records) if each.kind == "point")
    body = dict(records[at].body)
    body["xyz_mm"] = [body["xyz_mm"][0] + 1.0, *body["xyz_mm"][1:]]
    return [*records[:at], msgspec.structs.replace(records[at], body=body), *records[at + 1 :]]


def one_digit(file: Path) -> None:
    with closing(sqlite3.connect(file)) as base, base:
        for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'"):
            base.execute(f"DROP TRIGGER {name}")
        base.execute("UPDATE record SET body = replace(body, '1', '2') WHERE seq = 9")


@pytest.mark.parametrize(
    "spoil",
    [
        lambda file: file.write_bytes(b"SQLite format 3\0" + b"\xff" * 5000),
        lambda file: file.write_bytes(file.read_bytes()[:9000]),
        one_digit,
    ],
)
def test_a_broken_journal_is_named_and_stops_no_other(
    runs: Path, office: Database, spoil: Callable[[Path], object]
) -> None:
    spoil(runs / "c" / JOURNAL)
    assert list(ship(runs, office).refused) == ["c"]
    assert [name for name, _ in kept(office)] == ["b", "a"]


def test_a_hostile_folder_is_one_line(runs: Path, office: Database) -> None:
    body = {"procedure": "\x1b[31mred\0", "cell": {"name": "x", "serial": "y", "grid": 3}}
    write_journal(runs / "evil", [(NOW, "plan", "", body), (NOW, "end", "", {"exit": "no"})])
    done = command("plant", "ship", runs, "--to", office.name)
    assert (done.returncode, done.stderr.count("\n")) == (7, 2)
    assert "hilcell: run evil: " in done.stderr
    assert "\x1b" not in done.stderr
    assert len(kept(office)) == 3


def spoilt(model: Model, runs: Path, name: str, *more: tuple[Any, str, dict[str, Any]]) -> None:
    """Write a run that has further records before its end."""
    folder = model.write(runs.parent, Run("as-it-was", "north", "HC-1", NOW))
    rows = [(NOW, each.kind, each.key, each.body) for each in read_records(folder)]
    shutil.rmtree(folder)
    write_journal(runs / name, [*rows[:-2], *((NOW, *each) for each in more), *rows[-2:]])


BIG = {
    "holds": True, "mean_mm": 10**400, "mean_tolerance_mm": 0.1, "max_mm": 0.1,
    "max_tolerance_mm": 0.2, "mean_U_mm": 0.0, "max_U_mm": 0.0, "outcome": "accepted",
    "decision": "",
}  # fmt: skip
STREAM = {
    "what": "stream", "key": "../../x", "file": "../../../etc/passwd", "sha256": "0" * 900,
    "samples": 2**40, "joint_samples": 1, "first_device_s": 0.0, "last_device_s": 1.0,
    "longest_gap_s": 0.0, "form": 1,
}  # fmt: skip


@pytest.mark.process
def test_records_that_no_database_takes_are_named_and_stop_no_other(
    runs: Path, model: Model, plant: Database
) -> None:
    """A server's limits are no server that is away: the next shipment would meet them again."""
    key = "".join(random.Random(1).choices(string.ascii_letters, k=20_000))
    spoilt(model, runs, "number", ("verdict", "targets", BIG))
    spoilt(model, runs, "key", ("verdict", key, {"holds": True}))
    spoilt(model, runs, "stream", ("event", "", STREAM))
    spoilt(model, runs, "line", ("event", "", {"what": "note", "text": "x" * 20_000_000}))
    done = ship(runs, plant)
    assert done.runs == 4
    assert {name: reason.split(": ")[0] for name, reason in done.refused.items()} == {
        name: f"run {name}" for name in ("number", "key", "stream")
    }
    assert all("x" * 100 not in each and len(each) < 500 for each in done.refused.values())


@pytest.mark.parametrize("year", [1, 1979, 2200])
def test_a_clock_that_cannot_be_is_refused(
    year: int, runs: Path, model: Model, office: Database
) -> None:
    model.write(runs, Run("x", "north", "HC-1", datetime(year, 6, 1, tzinfo=UTC)))
    done = ship(runs, office)
    assert (list(done.refused), done.runs) == (["x"], 3)


def test_links_and_what_is_no_journal(runs: Path, office: Database, tmp_path: Path) -> None:
    """A run's folder may be a link, as to another disk; it is read, and nothing else is."""
    (runs / "b").rename(tmp_path / "elsewhere")
    (runs / "b").symlink_to(tmp_path / "elsewhere")
    (runs / "loop").symlink_to(runs / "loop")
    for name, target in (("text", "/etc/passwd"), ("endless", "/dev/zero")):
        (runs / name).mkdir()
        (runs / name / JOURNAL).symlink_to(target)
    (runs / "pipe").mkdir()
    os.mkfifo(runs / "pipe" / JOURNAL)
    done = ship(runs, office)
    assert (done.runs, list(done.refused)) == (3, ["text"])
    assert "root:" not in done.refused["text"]


@pytest.mark.parametrize("place", ["same", "elsewhere"])
def test_a_copy_under_another_name_is_refused_and_stops_no_other(
    place: str, runs: Path, office: Database, tmp_path: Path
) -> None:
    """Else it would count twice, and stay valid where the run was revoked."""
    copies = runs if place == "same" else tmp_path / "copies"
    shutil.copytree(runs / "a", copies / "z backup")
    first = ship(runs, office)
    assert len(kept(office)) == 3
    revoke(runs / "a", NOW)
    shutil.copytree(runs / "a", copies / "revoked")
    done = ship(copies, office)
    assert first.refused.keys() | done.refused.keys() == {"z backup", "revoked"}
    ship(runs, office)
    with office.transaction() as connection:
        (state,) = cells(connection, NOW)
    assert (state.calibration, len(kept(office))) == ("c", 4)


@pytest.mark.parametrize("link", [Path.symlink_to, Path.hardlink_to])
def test_what_the_folder_s_own_databases_link_to_is_left_alone(
    link: Callable[[Path, Path], None], runs: Path, office: Database, tmp_path: Path
) -> None:
    other = tmp_path / "other.db"
    shutil.copy(runs / "a" / JOURNAL, other)
    before = other.read_bytes()
    for name in (SHIPPED, INDEX):
        link(runs / name, other)
    assert ship(runs, office).runs == 3
    assert ship(runs, office).before == 3
    assert other.read_bytes() == before


def test_two_shippers_at_once_keep_each_run_once(runs: Path, office: Database) -> None:
    """The second finds each run there although it began before the first had shipped any."""
    second: list[Shipped] = []

    def told(name: str) -> None:
        if name == "b":
            (runs / SHIPPED).unlink()
            second.append(ship(runs, office))

    first = ship(runs, office, told)
    assert second == [Shipped(runs=2, points=second[0].points, before=1)]
    assert (first.runs, first.before) == (1, 2)
    assert len(kept(office)) == 3


# -- the calibration file of a run is shipped as it lies there, or named as what it is ------------


@pytest.fixture
def measured(golden: GoldenRuns, model: Model, tmp_path: Path) -> Path:
    """Return the folder of a whole calibration, and of a run whose file is not there."""
    golden["small"].copied_to(tmp_path / "runs")
    model.write(tmp_path / "runs", Run("other", "north", "HC-1", NOW))
    return tmp_path / "runs"


def shipped(measured: Path, database: Database) -> tuple[Shipped, list[tuple[str, str, str, str]]]:
    done = ship(measured, database)
    with database.transaction() as connection:
        asked = select(RUN.c.name, DOCUMENT.c.name, DOCUMENT.c.sha256, DOCUMENT.c.text)
        rows = connection.execute(asked.join(DOCUMENT, DOCUMENT.c.digest == RUN.c.digest))
        return done, [(run, name, sha256, text) for run, name, sha256, text in rows]


def test_a_calibration_file_is_kept_to_the_letter(measured: Path, office: Database) -> None:
    done, found = shipped(measured, office)
    assert (done.runs, done.refused) == (2, {})
    content = (measured / "small" / CALIBRATION).read_bytes()
    (kept,) = found
    assert kept == ("small", CALIBRATION, hashlib.sha256(content).hexdigest(), content.decode())


def edited(file: Path) -> None:
    content = json.loads(file.read_text())
    content["pitch_mm"] += 1.0
    file.write_text(json.dumps(content))


def linked(file: Path) -> None:
    elsewhere = file.rename(file.with_name("elsewhere"))
    file.symlink_to(elsewhere)


def dangling(file: Path) -> None:
    file.unlink()
    file.symlink_to("/nowhere")


def folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


@pytest.mark.parametrize(
    "spoil",
    [
        edited,
        linked,
        dangling,
        folder,
        lambda file: file.write_bytes(b"\xff\xfe"),
        lambda file: file.write_text("[]"),
        lambda file: file.write_text("[" * 100_000),
        lambda file: file.write_text(json.dumps({"schema": 3, SEAL: 3})),
    ],
)
def test_a_file_that_the_run_did_not_write_is_refused_and_stops_no_other(
    spoil: Callable[[Path], object], measured: Path, office: Database
) -> None:
    spoil(measured / "small" / CALIBRATION)
    done, found = shipped(measured, office)
    assert list(done.refused) == ["small"]
    assert (done.runs, found) == (1, [])


def test_a_file_without_an_end_is_not_read(
    measured: Path, office: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shipper, "MOST_BYTES", 1000)
    done, _ = shipped(measured, office)
    assert "1000" in done.refused["small"]


def test_what_a_run_without_a_calibration_has_lying_there_is_not_shipped(
    measured: Path, model: Model, office: Database
) -> None:
    fault = {"code": "HC-B23", "device": "Robot", "operation": "move", "found": "", "wanted": ""}
    broken = model.write(measured, Run("broken", "north", "HC-1", NOW, fault=fault))
    (measured / "small" / CALIBRATION).rename(broken / CALIBRATION)
    done, found = shipped(measured, office)
    assert (done.runs, done.refused, found) == (3, {}, [])


def test_a_file_that_came_back_is_shipped(measured: Path, office: Database) -> None:
    content = (measured / "small" / CALIBRATION).read_bytes()
    edited(measured / "small" / CALIBRATION)
    assert list(shipped(measured, office)[0].refused) == ["small"]
    (measured / "small" / CALIBRATION).write_bytes(content)
    done, found = shipped(measured, office)
    assert (done.runs, done.before, len(found)) == (1, 1, 1)
    (measured / SHIPPED).unlink()
    assert shipped(measured, office)[0] == Shipped(before=2)
