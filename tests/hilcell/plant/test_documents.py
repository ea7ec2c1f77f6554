"""A run's calibration file is shipped with it as it lies there, or named as what it is."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import pytest
from sqlalchemy import select

from hilcell.calibration.file import SEAL
from hilcell.journal.runs import CALIBRATION
from hilcell.plant import shipper
from hilcell.plant.database import SHIPPED, Database
from hilcell.plant.shipper import Shipped, ship
from hilcell.plant.tables import DOCUMENT, RUN
from tests.hilcell.plant.conftest import NOW
from tests.hilcell.plant.year import Model, Run
from tests.whole.golden import GoldenRuns


@pytest.fixture
def runs(golden: GoldenRuns, model: Model, tmp_path: Path) -> Path:
    """Return the folder of a whole calibration, and of a run whose file is not there."""
    golden["small"].copied_to(tmp_path / "runs")
    model.write(tmp_path / "runs", Run("other", "north", "HC-1", NOW))
    return tmp_path / "runs"


def shipped(runs: Path, database: Database) -> tuple[Shipped, list[tuple[str, str, str, str]]]:
    done = ship(runs, database)
    with database.transaction() as connection:
        asked = select(RUN.c.name, DOCUMENT.c.name, DOCUMENT.c.sha256, DOCUMENT.c.text)
        rows = connection.execute(asked.join(DOCUMENT, DOCUMENT.c.digest == RUN.c.digest))
        return done, [(run, name, sha256, text) for run, name, sha256, text in rows]


def test_a_calibration_file_is_kept_to_the_letter(runs: Path, office: Database) -> None:
    done, found = shipped(runs, office)
    assert (done.runs, done.refused) == (2, {})
    content = (runs / "small" / CALIBRATION).read_bytes()
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
    spoil: Callable[[Path], object], runs: Path, office: Database
) -> None:
    spoil(runs / "small" / CALIBRATION)
    done, found = shipped(runs, office)
    assert list(done.refused) == ["small"]
    assert (done.runs, found) == (1, [])


def test_a_file_without_an_end_is_not_read(
    runs: Path, office: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shipper, "MOST_BYTES", 1000)
    done, _ = shipped(runs, office)
    assert "1000" in done.refused["small"]


def test_what_a_run_without_a_calibration_has_lying_there_is_not_shipped(
    runs: Path, model: Model, office: Database
) -> None:
    fault = {"code": "HC-B23", "device": "Robot", "operation": "move", "found": "", "wanted": ""}
    broken = model.write(runs, Run("broken", "north", "HC-1", NOW, fault=fault))
    (runs / "small" / CALIBRATION).rename(broken / CALIBRATION)
    done, found = shipped(runs, office)
    assert (done.runs, done.refused, found) == (3, {}, [])


def test_a_file_that_came_back_is_shipped(runs: Path, office: Database) -> None:
    content = (runs / "small" / CALIBRATION).read_bytes()
    edited(runs / "small" / CALIBRATION)
    assert list(shipped(runs, office)[0].refused) == ["small"]
    (runs / "small" / CALIBRATION).write_bytes(content)
    done, found = shipped(runs, office)
    assert (done.runs, done.before, len(found)) == (1, 1, 1)
    (runs / SHIPPED).unlink()
    assert shipped(runs, office)[0] == Shipped(before=2)
