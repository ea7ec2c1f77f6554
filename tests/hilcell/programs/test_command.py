"""``hilcell plan``: table, JSON, CSV and refusals, as the user sees them."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from hilcell.commands.cli import main
from hilcell.programs.holes import NORMALS


def holes_file(folder: Path, *, half_width_mm: float = 2400.0, x_mm: float = 0.0) -> Path:
    rng = np.random.default_rng(3)
    path = folder / "holes.csv"
    with path.open("w", encoding="utf-8") as file:
        print(",".join(NORMALS), file=file)
        for n in range(40):
            y, z = rng.uniform(-half_width_mm, half_width_mm), rng.uniform(700, 1500)
            print(f"H{n + 1},{x_mm},{y:.3f},{z:.3f},-1,0,0", file=file)
    return path


def test_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "--cell", "paper", str(holes_file(tmp_path)), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"stations", "travel_mm", "bound_mm", "ratio", "unreached"}
    assert found["unreached"] == []
    assert len(found["stations"]) >= 2
    for station in found["stations"]:
        assert {"name", "rail_mm", "holes", "travel_mm"} <= set(station)
        assert len(station["targets"]) == len(station["holes"])
    visited = [name for station in found["stations"] for name in station["holes"]]
    assert sorted(visited) == sorted(f"H{n + 1}" for n in range(40))
    assert 1.0 <= found["ratio"] <= 1.05
    assert found["ratio"] == pytest.approx(found["travel_mm"] / found["bound_mm"])


def test_table_and_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.csv"
    assert main(["plan", str(holes_file(tmp_path)), "-o", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "S300" in shown
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["station", "order", "name"]
    assert {row["name"] for row in rows} == {f"H{n + 1}" for n in range(40)}
    for station in {row["station"] for row in rows}:
        orders = [int(row["order"]) for row in rows if row["station"] == station]
        assert orders == list(range(1, len(orders) + 1))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["holes.csv", "plan.csv"]


def test_unreachable_holes_exit_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.csv"
    words = ["plan", str(holes_file(tmp_path, x_mm=4000.0)), "--json", "-o", str(out)]
    assert main(words) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "40 of 40" in shown.err
    assert "posture (robot.status = 6)" in shown.err
    assert shown.err.count("\n  H") == 10
    assert "metres" not in shown.err
    assert not out.exists()


def test_a_list_in_metres_is_asked_for_its_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "holes.csv"
    rows = [f"H{n},-0.1,{n / 1000},1.1,0,0,-1" for n in range(200)]
    file.write_text("\n".join([",".join(NORMALS), *rows]), "utf-8")
    assert main(["plan", str(file)]) == 2
    shown = capsys.readouterr().err
    assert "metres" in shown
    assert len(shown.splitlines()) < 30


def test_bad_files_exit_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text(",".join(NORMALS) + "\nH1,1,2,3,0,0,0\n", "utf-8")
    for words, named in (
        (["plan", str(bad)], "line 2"),
        (["plan", str(tmp_path / "none.csv")], "none.csv"),
        (["plan", str(bad), "--cell", "papper"], "papper"),
    ):
        assert main(words) == 2
        assert named in capsys.readouterr().err


def test_a_place_that_cannot_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["plan", str(holes_file(tmp_path)), "-o", str(tmp_path / "no" / "plan.csv")]
    assert main(words) == 2
    assert str(tmp_path / "no") in capsys.readouterr().err


def test_the_holes_are_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = holes_file(tmp_path)
    before = file.read_bytes()
    (tmp_path / "link.csv").symlink_to(file)
    for out in (file, tmp_path / "link.csv"):
        assert main(["plan", str(file), "-o", str(out)]) == 2
        assert str(out) in capsys.readouterr().err
    assert file.read_bytes() == before
