"""Keep-out volumes of an unknown hall: by its list, by corners that its person teaches, or none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.commission.record import Commissioned, StepRecord
from hilcell.commission.sequence import NAMES
from hilcell.geometry.frames import apply, inverse
from tests.whole.bench import command, end_of
from tests.whole.halls import Hall, commission, unknown_hall, write_cell

pytestmark = pytest.mark.process
LISTED = ["floor", "rail bed", "plate", "tracker"]
# A post on the plate, in the arm at its safe pose; a fence through the cube of the first station.
POST, FENCE = "post,1,-100,-100,0,400,100,2500", "fence,0,-600,-3000,0,-500,3000,2500"


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sheet")


@pytest.fixture(scope="module")
def hall(sheet: Path) -> Iterator[Hall]:
    with unknown_hall(sheet, 7) as hall:
        yield hall


def file_of(hall: Hall, file: Path, volumes: Mapping[str, Any] | None) -> Path:
    """Write the hall's right cell file, as proved, without volumes but where they come from."""
    tables = hall.right_cell()
    tables |= {"keep_out": None, "volumes": volumes}
    if volumes is None:
        tables["robot"]["envelope"] = None
    tables["simulation"] = {"simulator": "unknown", "address": hall.simulation.control}
    write_cell(tables, file)
    for name in NAMES:
        step = StepRecord(step=name, ended="", operator="", holds=True, checks=[])
        Commissioned.read(file).add(step, file)
    return file


@pytest.mark.parametrize(
    ("more", "differs"),
    [([], []), ([POST], ["volume post"]), ([FENCE, POST], ["volume fence", "volume post"])],
)
def test_a_list_is_proved_volume_by_volume(
    hall: Hall, sheet: Path, tmp_path: Path, more: list[str], differs: list[str]
) -> None:
    volumes = tmp_path / "volumes.csv"
    volumes.write_text("\n".join([(sheet / "volumes.csv").read_text().rstrip(), *more, ""]))
    cell = file_of(hall, tmp_path / "mycell.toml", {"file": str(volumes)})
    proved = proved_by(command("run", "commission-volumes", "--cell", cell, *words(tmp_path)))
    assert [what for what, each in proved.items() if not each["holds"]] == differs
    values = {path for each in proved.values() for path in each.get("values", ())}
    assert len(values) == (0 if differs else len(LISTED))
    assert hall.travel()["slide"]["excursion_mm"] < 0.3


def test_who_has_no_volumes_attests_that(hall: Hall, tmp_path: Path) -> None:
    cell = file_of(hall, tmp_path / "mycell.toml", None)
    done = command(
        "run", "commission-volumes", "--cell", cell, "--operator", "R. Roe", *words(tmp_path)
    )
    (none,) = proved_by(done).values()
    assert none["found"] == "none, attested by R. Roe"
    assert "no axis is swept" in none["expected"]


def test_corners_are_taught_with_a_reflector(hall: Hall, sheet: Path, tmp_path: Path) -> None:
    volumes = {"file": str(sheet / "volumes.csv"), "teach": ["cabinet"]}
    file = file_of(hall, tmp_path / "mycell.toml", volumes)
    done = commission(file, "y\n" * 10, "--only", "volumes")
    assert done.returncode == 0, done.stderr[-3000:]
    assert "corners of cabinet: 4 corners" in done.stderr
    cell, true = load_cell(str(file)), hall.truth()["cell"]["keep_out"][-1]
    assert [each.name for each in cell.keep_out] == [*LISTED, "cabinet"]
    box = cell.keep_out[-1]
    assert np.subtract(sorted(box.size_mm), sorted(true["size_mm"])).tolist() == pytest.approx(
        [60.0] * 3, abs=5.0
    )
    centre_mm = np.array([[true["centre"][f"{axis}_mm"] for axis in "xyz"]])
    assert np.abs(apply(inverse(box.centre.matrix()), centre_mm)).max() < 10.0
    checked = command("show", "last", "--check", "--runs", tmp_path / "runs")
    assert checked.returncode == 0, checked.stdout


def words(folder: Path) -> tuple[str | Path, ...]:
    return "--json", "--runs", folder / "runs"


def proved_by(done: Any) -> dict[str, Any]:
    end = end_of(done)
    assert end["state"] == "finished", done.stderr
    proved: dict[str, Any] = end["result"]["proved"]
    return proved
