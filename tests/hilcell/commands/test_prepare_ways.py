"""A program of `prepare`, driven hole by hole beside a part that is a solid of the test's own."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hilcell.calibration.tool_point import tool_tips
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, poses_from_zyx
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.kinematics import Arm, forward
from hilcell.ports import Array
from hilcell.programs.plan import Volume
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.calibration.test_tool_point import DRILL, at_tip_of, cell_with
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.commands.test_prepare import DIGEST, INSIDE, holes, made, prepare, refused
from tests.hilcell.commands.test_prepared_files import made_for_two
from tests.whole.bench import command

CELL = load_cell("paper")
ARM = CELL.robot.arm()
OUTWARD = -Volume(calibration()).orientation("S1100")[:, 2]
ALONG = np.array([0.0, 1.0, 0.0])
ACROSS = np.cross(OUTWARD, ALONG)
CENTRE = apply(T_W_B, np.array([[1850.0, 0.0, 950.0]]))[0]
RADIUS_MM = 20_000.0
ACROSS_MM = 250.0  # of the holes
BESIDE_MM = 300.0  # the skin ends so far from its holes
CORRECTED_MM = 2.0  # commands lie beside the holes by the robot's errors
STANDOFF_MM = 100.0
POINT = re.compile(r"DECL E6POS (X[ASPV][\d_]+)=\{([^}]*)\}")
MOTION = re.compile(r"^(PTP|LIN) (X\w+)", re.MULTILINE)


def height_mm(places_mm: Array) -> Array:
    """Return how far places (K, 3) are above a skin that bulges towards the robot, a cylinder."""
    off = places_mm - CENTRE
    across, along = off @ ACROSS, off @ ALONG
    found: Array = off @ OUTWARD + across**2 / (2 * RADIUS_MM)
    beside = (np.abs(across) > ACROSS_MM + BESIDE_MM / 2) | (np.abs(along - 400.0) > 1000.0)
    return np.where(beside, np.inf, found)


def skin(count_along: int, count_across: int, length_mm: float) -> tuple[Array, Array]:
    """Return holes (N, 3) on the skin, and its outward normals (N, 3) there."""
    along, across = np.meshgrid(
        np.linspace(-400.0, -400.0 + length_mm, count_along),
        np.linspace(-ACROSS_MM, ACROSS_MM, count_across),
    )
    s, t = along.reshape(-1, 1), across.reshape(-1, 1)
    points = CENTRE + s * ALONG + t * ACROSS - t**2 / (2 * RADIUS_MM) * OUTWARD
    normals = OUTWARD + t / RADIUS_MM * ACROSS
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def listed(folder: Path, points: Array, normals: Array) -> Path:
    path = folder / "skin.csv"
    rows = [
        ",".join([f"N{n}", *(f"{each:.6f}" for each in row)])
        for n, row in enumerate(np.column_stack([points, normals]), start=1)
    ]
    path.write_text("\n".join(["name,x_mm,y_mm,z_mm,nx,ny,nz", *rows, ""]))
    return path


def motions(
    folder: Path, station: str, base: Array, arm: Arm = ARM
) -> Iterator[tuple[str, str, Array]]:
    """Yield word, point and places (K, 3) in {W} of the tool point on each motion of a program."""
    robot = CELL.robot
    home_rad = np.radians(robot.home_deg)
    points = {
        name: poses_from_zyx(
            np.array([[float(each.split()[1]) for each in numbers.split(",")[:6]]])
        )[0]
        for name, numbers in POINT.findall((folder / f"{station}.dat").read_text("latin-1"))
    }
    names = list(points)
    limits_rad = robot.margin_limits_rad - np.radians([[1.0], [-1.0]])
    nominal = NominalRobot(arm, robot.status, limits_rad, home_rad)
    joints = nominal.joints_for(inverse(base) @ np.array(list(points.values())))
    joints_rad = dict(zip(names, joints, strict=True)) | {"XHOME": np.radians(robot.safe_deg)}
    here_rad = joints_rad["XHOME"]
    for word, name in MOTION.findall((folder / f"{station}.src").read_text("latin-1")):
        there_rad = joints_rad[name]
        shares = np.linspace(0.0, 1.0, 60)[:, None]
        way = apply(base, forward(arm, here_rad + shares * (there_rad - here_rad))[:, :3, 3])
        if word == "LIN":
            way = way[0] + shares * (way[-1] - way[0])
        yield word, name, way
        here_rad = there_rad


def test_no_way_of_a_program_touches_the_part_but_at_its_holes(tmp_path: Path) -> None:
    """500 holes on two stations: from hole to hole the tool keeps half of the stand-off."""
    points, normals = skin(25, 20, 1600.0)
    path = listed(tmp_path, points, normals)
    made_for_two(tmp_path, "S1900", DIGEST)
    done = prepare(tmp_path, path, "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert [each["standoff_mm"] for each in facts["stations"]] == [STANDOFF_MM] * 2
    other = pose_from_zyx(0.0, 800.0, 0.0, 0.0, 0.0, 0.0) @ T_W_B
    drilled = 0
    for station, base in (("S1100", T_W_B), ("S1900", other)):
        for word, name, way in motions(tmp_path / "out", station, base):
            above_mm = height_mm(way)
            off_mm = np.linalg.norm(points[:, None] - way, axis=-1).min(axis=0)
            at_hole = off_mm <= CORRECTED_MM
            assert (above_mm[~at_hole] > 0.0).all(), (station, name)
            if word == "PTP":
                assert above_mm.min() >= STANDOFF_MM / 2, (station, name)
            elif name.startswith("XP"):
                drilled += 1
                assert at_hole[-1]
                np.testing.assert_allclose(
                    way[0] - way[-1], STANDOFF_MM * normals[0], atol=STANDOFF_MM * 0.06
                )
    assert drilled == len(points)


@pytest.mark.parametrize(("words", "standoff_mm"), [((), 100.0), (("--standoff", "150"), 150.0)])
def test_every_stand_off_lies_on_the_free_side(
    tmp_path: Path, words: tuple[str, ...], standoff_mm: float
) -> None:
    made(tmp_path)
    assert prepare(tmp_path, holes(tmp_path, *INSIDE), *words).returncode == 0
    found = list(motions(tmp_path / "out", "S1100", T_W_B))
    between = [word for word, name, _ in found if name[:2] not in ("XH", "XV")]
    assert between == ["PTP", "PTP", "LIN", "LIN"] * 3
    for word, name, way in found:
        if word == "LIN":
            off = (way[0] - way[-1]) @ OUTWARD
            assert off == pytest.approx(standoff_mm if "P" in name else -standoff_mm, abs=1e-3)
    text = (tmp_path / "out" / "S1100.src").read_text("latin-1")
    page = (tmp_path / "out" / "sheet.html").read_text("utf-8")
    for stated in (f"stand-off {standoff_mm:g} mm", "assumed side", "depth 0", "no [[tool]]"):
        assert stated in text
        assert stated in page


def test_a_stand_off_too_short_or_out_of_reach_is_refused(tmp_path: Path) -> None:
    made(tmp_path)
    path = holes(tmp_path, *INSIDE)
    assert "the part" in refused(tmp_path, path, "--standoff", "21")
    assert "--standoff" in refused(tmp_path, path, "--standoff", "10")
    said = refused(tmp_path, path, "--standoff", "1000")
    for words in ("1000 mm at 3 of 3 holes", "H1: ", "H2: ", "H3: ", "--standoff"):
        assert words in said


def test_normals_that_point_into_the_part_are_named(tmp_path: Path) -> None:
    made(tmp_path)
    points, normals = skin(3, 2, 100.0)
    said = refused(tmp_path, listed(tmp_path, points, -normals))
    assert said.count("points into the part") == len(points)
    assert "larger volume" not in said


def box(name: str, centre_mm: Array, size_mm: tuple[float, ...], b_deg: float = 75.0) -> str:
    """Return the table of a box that the arm keeps out of, turned as the calibrated tool."""
    x, y, z = centre_mm.tolist()
    return (
        f'\n[[keep_out]]\nname = "{name}"\ncentre = {{ x_mm = {x:.3f}, y_mm = {y:.3f}, '
        f"z_mm = {z:.3f}, b_deg = {b_deg} }}\nsize_mm = {list(size_mm)}\n"
    )


def calibrated(folder: Path, *tables: str) -> Path:
    """Write a cell with more tables and a calibration of it; return the cell's file."""
    cell = cell_with(folder, *tables)
    made(folder, provenance=calibration(digest=load_cell(str(cell)).digest).provenance)
    return cell


def test_ways_through_what_stands_in_the_cell_are_refused(tmp_path: Path) -> None:
    """A beam in front of a hole, where the tool stands off."""
    points, normals = skin(2, 2, 800.0)
    beam = box("beam", points[0] + 200.0 * normals[0], (60.0, 60.0, 60.0), 0.0)
    cell = calibrated(tmp_path, beam)
    assert "beam" in refused(tmp_path, listed(tmp_path, points, normals), "--cell", cell)


def test_a_box_that_carries_holes_is_the_part(tmp_path: Path) -> None:
    """Its surface may be touched at the holes, and no way leads through it."""
    cell = calibrated(tmp_path, box("jig", CENTRE - 50.0 * OUTWARD, (600.0, 900.0, 100.0)))
    points, normals = skin(2, 1, 600.0)
    assert prepare(tmp_path, listed(tmp_path, points, normals), "--cell", cell).returncode == 0


def test_a_program_whose_comments_were_stripped_is_known_by_its_points(tmp_path: Path) -> None:
    """A controller drops comments; a second correction would take the error off twice."""
    runs, place = tmp_path / "runs", ("--station", "S1100", "-o", tmp_path / "again.src")
    known = calibration(run="1-made", simulated=True, digest=DIGEST)
    finished(runs, "1-made", MADE, provenance=known.provenance)
    words = ("--runs", runs, "--calibration", "1-made", "-o", tmp_path / "out")
    done = command("prepare", holes(tmp_path, *INSIDE), *words)
    assert done.returncode == 0, done.stderr
    for suffix in (".src", ".dat"):
        text = (tmp_path / "out" / f"S1100{suffix}").read_text("latin-1")
        lines = [line for line in text.splitlines() if not line.startswith(";")]
        (tmp_path / f"S1100{suffix}").write_text("\n".join([*lines, ""]), "latin-1")
    done = command("compensate", "1-made", tmp_path / "S1100.src", *place, "--runs", runs)
    assert done.returncode == 2
    assert "whose stamp was lost" in done.stderr


@pytest.mark.parametrize("aside_mm", [200.0, -200.0])
def test_no_tool_passes_through_a_box_between_its_holes(tmp_path: Path, aside_mm: float) -> None:
    """A long drill keeps the flange far away from a bracket that is higher than the tip goes."""
    tool = DRILL.replace("z_mm = 310.0", "z_mm = 700.0")
    holes_path = at_tip_of(cell_with(tmp_path, tool), tmp_path)
    rows = np.genfromtxt(holes_path, delimiter=",", skip_header=1)[:2, 1:]
    rows[:, :3] = rows[0, :3] + np.outer([0.0, aside_mm], ALONG)
    path = listed(tmp_path, rows[:, :3], rows[:, 3:])
    middle_mm = rows[:, :3].mean(axis=0) + 60.0 * OUTWARD
    cell = calibrated(tmp_path, tool, box("bracket", middle_mm, (400.0, 40.0, 120.0)))
    done = prepare(tmp_path, path, "--cell", cell)
    if done.returncode == 0:  # led round it
        loaded = load_cell(str(cell))
        tip = tool_tips(loaded)[1]
        x, y, z = middle_mm.tolist()
        inner = inverse(pose_from_zyx(x, y, z, 0.0, 75.0, 0.0))
        for _, name, way in motions(tmp_path / "out", "S1100", T_W_B, tip.arm(loaded.robot.arm())):
            inside = (np.abs(apply(inner, way)) < np.array([200.0, 20.0, 60.0])).all(axis=1)
            assert not inside.any(), name
    else:
        assert "bracket" in done.stderr


@pytest.mark.parametrize(("high_mm", "code"), [(60.0, 2), (0.0, 0)])
def test_a_box_beside_a_hole_is_no_part_where_it_sticks_out(
    tmp_path: Path, high_mm: float, code: int
) -> None:
    """The spindle comes down beside it; a box that ends at the hole's plane carries the hole."""
    at_tip = at_tip_of(cell_with(tmp_path, DRILL), tmp_path)
    place = np.genfromtxt(at_tip, delimiter=",", skip_header=1)[:1, 1:]
    beside_mm = place[0, :3] + 33.0 * ALONG + (high_mm / 2 - 50.0) * OUTWARD
    cell = calibrated(tmp_path, DRILL, box("bracket", beside_mm, (200.0, 60.0, high_mm + 100.0)))
    done = prepare(tmp_path, listed(tmp_path, place[:, :3], place[:, 3:]), "--cell", cell)
    assert done.returncode == code, done.stderr
    assert ("bracket" in done.stderr) == (code == 2)
