"""What `prepare` writes for one station agrees: list, bounds, program, sheet, `compensate`."""

import csv
import json
import math
import re
from datetime import UTC, datetime, timedelta
from importlib import resources
from pathlib import Path

import msgspec
import numpy as np
import pytest

from drivers.kuka.program_krl.files import read_program
from hilcell.calibration.budget import DRILL
from hilcell.calibration.influence import ASSUMED, Influence, motion
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import inverse, pose_from_zyx, poses_from_zyx
from hilcell.geometry.inverse import inverse_kinematics
from tests.hilcell.calibration.calibrations import STAMP, T_W_B, calibration
from tests.hilcell.commands.test_prepare import (
    FILES,
    INSIDE,
    holes,
    made,
    planned,
    prepare,
    refused,
)
from tests.hilcell.lists import write_targets
from tests.whole.bench import command

CELL = load_cell("paper")
TILT = np.radians(75.0)  # of the calibrated tool


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Return the folder that three holes were prepared into."""
    made(tmp_path)
    assert prepare(tmp_path, holes(tmp_path, *INSIDE, lean=0.02)).returncode == 0
    return tmp_path / "out"


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_plan_and_compensate_agree_with_prepare_digit_for_digit(out: Path, tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    (station,) = planned(tmp_path / "holes.csv", "--calibration", file)
    nominal, again, bounds = (tmp_path / name for name in ("n.csv", "again.csv", "bounds.csv"))
    write_targets(nominal, station["holes"], np.array(station["targets"]))
    words = ("--station", "S1100", "-o", again, "--bounds", bounds, "--cell", "paper")
    assert command("compensate", file, nominal, *words).returncode == 0
    listed = rows(out / "S1100.csv")
    common = [name for name in listed[0] if name not in ("bound95_mm", "corrected_by")]
    assert [[row[name] for name in common] for row in listed] == [
        [row[name] for name in common] for row in rows(again)
    ]
    assert [row["bound95_mm"] for row in listed] == [row["bound95_mm"] for row in rows(bounds)]
    facts = json.loads((out / "summary.json").read_text())["stations"][0]
    assert [f"{each:.4f}" for each in facts["bound95_mm"]] == [row["bound95_mm"] for row in listed]


def test_the_program_has_the_points_of_the_list_in_the_order_of_visit(out: Path) -> None:
    src, dat = ((out / name).read_text("latin-1") for name in ("S1100.src", "S1100.dat"))
    read = read_program("S1100.src", src, ("S1100.dat", dat))
    names = [target.name for target in read.targets if not target.name.startswith("XV")]
    assert names == [f"X{letter}{n}" for n in (1, 2, 3) for letter in "ASP"]
    listed = rows(out / "S1100.csv")
    holes = [target for target in read.targets if target.name.startswith("XP")]
    for target, row in zip(holes, listed, strict=True):
        numbers = [number.text for number in target.numbers.values()]
        assert numbers == list(row.values())[1:7]
    order = ("PTP XHOME", "HALT", "PTP XA1", "PTP XS1", "LIN XP1", "LIN XS1", "PTP XA2")
    places = [src.index(each) for each in order]
    assert places == sorted(places)
    assert "1100.00 mm" in src


def test_every_axis_rises_to_its_stand_off_as_in_the_calibration(out: Path) -> None:
    dat = (out / "S1100.dat").read_text("latin-1")
    src = (out / "S1100.src").read_text("latin-1")
    read = read_program("S1100.src", src, ("S1100.dat", dat))
    assert read.base is not None
    T_B_W = pose_from_zyx(*read.base.values)
    np.testing.assert_allclose(T_B_W, inverse(T_W_B), atol=1e-4)
    poses = T_B_W @ poses_from_zyx(read.values())
    joints_deg = np.degrees(inverse_kinematics(CELL.robot.arm(), poses, CELL.robot.status))
    below, off = (
        [n for n, target in enumerate(read.targets) if target.name.startswith(name)]
        for name in ("XA", "XS")
    )
    rise_deg = (joints_deg[off] - joints_deg[below] + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(rise_deg, CELL.robot.approach_deg, atol=2e-4)
    by_joints = [target for target in read.targets if not target.name.startswith("XP")]
    assert all(target.posture == CELL.robot.status for target in by_joints)


@pytest.mark.parametrize("name", ["S1100.src", "S1100.csv"])
def test_nothing_of_it_is_corrected_again(out: Path, tmp_path: Path, name: str) -> None:
    words = ("--station", "S1100", "-o", tmp_path / "again")
    done = command("compensate", tmp_path / "calibration.json", out / name, *words)
    assert done.returncode == 2


def test_the_program_says_what_a_stroke_would_add(out: Path) -> None:
    """The errors change by (0, 0.1, -0.2) of 1.2 mm over 450 mm in z, z and x of the base."""
    source = (out / "S1100.src").read_text("latin-1")
    change_mm = 1.2 / 450.0 * 20.0 * np.array([0.0, 0.1 * np.cos(TILT), -0.2 * np.sin(TILT)])
    along_mm = change_mm @ [np.sin(TILT), 0.0, np.cos(TILT)]
    across_mm = np.sqrt(change_mm @ change_mm - along_mm**2)
    (said,) = [line for line in source.splitlines() if "stroke of 20 mm" in line]
    found = [float(each) for each in re.findall(r"([\d.]+) mm (?:across|along) \(", said)]
    assert found == pytest.approx([across_mm, abs(along_mm)], abs=6e-4)


@pytest.mark.parametrize(
    ("words", "settings", "smaller"),
    [
        (["--temperature", "22.5"], {}, True),
        ([], {"uncertainty.drill_offset_mm": "[0.0, 0.0, 250.0]"}, False),
    ],
)
def test_bounds_are_those_of_the_stated_air_and_drill(
    out: Path, tmp_path: Path, words: list[str], settings: dict[str, str], smaller: bool
) -> None:
    known = calibration(digest=load_cell("paper", settings).digest)
    assert known.uncertainty is not None
    turned = Influence(DRILL, ASSUMED, "", "", "tool", motion(0.0, 1e-4**2))
    lines = [*known.uncertainty.lines, turned]
    file = made(
        tmp_path,
        provenance=known.provenance,
        uncertainty=msgspec.structs.replace(known.uncertainty, lines=lines),
    )
    source = tmp_path / "holes.csv"
    words += [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    other = tmp_path / "other"
    done = command("prepare", source, "--calibration", file, "-o", other, *words)
    assert done.returncode == 0
    for one, stated in zip(rows(out / "S1100.csv"), rows(other / "S1100.csv"), strict=True):
        lower, higher = (stated, one) if smaller else (one, stated)
        assert float(lower["bound95_mm"]) < float(higher["bound95_mm"])


def test_the_sheet_has_stations_holes_bounds_and_conditions(out: Path) -> None:
    page = (out / "sheet.html").read_text("utf-8")
    listed = rows(out / "S1100.csv")
    places = [page.index(f'<td class="words">{row["name"]}</td>') for row in listed]
    assert places == sorted(places)
    nominal_mm = {f"H{n}": each for n, each in enumerate(INSIDE, start=1)}
    for row in listed:
        assert f"<td>{float(row['bound95_mm']):.3f}</td>" in page
        command_mm = [float(row[f"{axis}_mm"]) for axis in "xyz"]
        assert f"<td>{math.dist(command_mm, nominal_mm[row['name']]):.3f}</td>" in page
    for figures in ("1100.00 ± 0.01", "20.0 to 25.0 °C", "180 days", "S1100.src, S1100.dat"):
        assert figures in page
    assert "SIMULATED" not in page
    assert "<script" not in page
    assert "http" not in page.replace("http-equiv", "")


def test_the_sheet_says_until_when_it_holds(tmp_path: Path) -> None:
    written = datetime.now(UTC) - timedelta(days=10.0)
    made(
        tmp_path,
        provenance=calibration(digest=CELL.digest, written=f"{written:{STAMP}}").provenance,
    )
    assert prepare(tmp_path, holes(tmp_path, *INSIDE), "--max-age", "30").returncode == 0
    page = (tmp_path / "out" / "sheet.html").read_text("utf-8")
    until = (written + timedelta(days=30.0)).astimezone()
    assert f"{until:%Y-%m-%d}, 30 days" in page
    assert "OUT OF TOLERANCE" not in page


def cell_with(folder: Path, old: str, new: str) -> tuple[Path, str]:
    """Write the paper's cell with other words; return its file and digest."""
    cell, text = folder / "cell.toml", resources.files("hilcell.cells") / "paper.toml"
    cell.write_text(text.read_text("utf-8").replace(old, new))
    return cell, load_cell(str(cell)).digest


def test_programs_and_sheet_say_what_the_strip_must_read(tmp_path: Path) -> None:
    """The strip's zero is not the rail's."""
    cell, digest = cell_with(tmp_path, "strip_mm = 1100.0", "strip_mm = 1100.37")
    made(tmp_path, provenance=calibration(digest=digest).provenance)
    assert prepare(tmp_path, holes(tmp_path, *INSIDE), "--cell", cell).returncode == 0
    assert "1100.37 mm" in (tmp_path / "out" / "S1100.src").read_text()
    assert "1100.37 ± 0.01 mm" in (tmp_path / "out" / "sheet.html").read_text("utf-8")
    (facts,) = json.loads((tmp_path / "out" / "summary.json").read_text())["stations"]
    assert (facts["rail_mm"], facts["strip_mm"]) == (1100.0, 1100.37)


def test_a_simulated_calibration_marks_sheet_and_programs(tmp_path: Path) -> None:
    made(tmp_path, provenance=calibration(digest=CELL.digest, simulated=True).provenance)
    assert prepare(tmp_path, holes(tmp_path, *INSIDE)).returncode == 0
    for name, mark in (("sheet.html", "SIMULATED"), ("S1100.src", "SIMULATED"),
                       ("S1100.dat", "SIMULATION")):  # fmt: skip
        assert mark in (tmp_path / "out" / name).read_text("utf-8")


def made_for_two(folder: Path, other: str, digest: str) -> Path:
    """Write a calibration of S1100 and one more station beside it; return holes for both."""
    one = calibration(digest=digest)
    beside = pose_from_zyx(0.0, 800.0, 0.0, 0.0, 0.0, 0.0)
    at_other = msgspec.structs.replace(
        one.stations["S1100"], T_W_B=(beside @ T_W_B).tolist(), strip_mm=1900.0
    )
    stated = one.uncertainty
    assert stated is not None
    made(
        folder,
        provenance=one.provenance,
        stations={"S1100": one.stations["S1100"], other: at_other},
        uncertainty=msgspec.structs.replace(stated, stations={"S1100": [], other: []}),
    )
    far = [(x, y + 1100.0, z) for x, y, z in INSIDE]
    return holes(folder, *far, *INSIDE)


def test_stations_whose_names_differ_by_case_alone_are_refused(tmp_path: Path) -> None:
    """Their files would replace one another on the controller, and on many a PC."""
    cell, digest = cell_with(tmp_path, '"S1900"', '"s1100"')
    assert "s1100.csv" in refused(tmp_path, made_for_two(tmp_path, "s1100", digest), "--cell", cell)


def test_each_station_has_a_program_of_its_own(tmp_path: Path) -> None:
    source = made_for_two(tmp_path, "S1900", CELL.digest)
    assert prepare(tmp_path, source).returncode == 0
    assert "1900.00 mm" in (tmp_path / "out" / "S1900.src").read_text()
    page = (tmp_path / "out" / "sheet.html").read_text("utf-8")
    assert page.index("1. Station S1100") < page.index("2. Station S1900")
    assert {row["name"] for row in rows(tmp_path / "out" / "S1900.csv")} == {"H1", "H2", "H3"}


def test_a_robot_without_a_writer_gets_lists_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made(tmp_path)
    monkeypatch.setattr("hilcell.programs.station_jobs.program_writer", lambda driver, form: None)
    done = prepare(tmp_path, holes(tmp_path, *INSIDE))
    assert "kuka-c3" in done.stderr
    written = sorted(each.name for each in (tmp_path / "out").iterdir())
    assert written == [name for name in FILES if not name.endswith((".src", ".dat"))]
