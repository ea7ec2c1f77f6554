"""`compensate` as a command, in this process, on URScript; and the program of a station."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from drivers.universal_robots.program_urscript import load_program, read_program, write_station
from hilcell.calibration.file import write_calibration
from hilcell.calibration.influence import Influence
from hilcell.calibration.tool_point import tool_tips
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import CorrectedBefore, Stamp, refuse_corrected
from hilcell.geometry.frames import apply, poses_from_zyx, zyx_from_pose
from hilcell.geometry.kinematics import forward
from hilcell.programs.drilling import Drilling, WorkPiece, station_program
from tests.drivers.universal_robots.program_urscript.samples import SCRIPT, TURN
from tests.hilcell.calibration.calibrations import T_W_B, calibration
from tests.hilcell.commands import workplace
from tests.hilcell.compensation.models import level
from tests.hilcell.lists import write_targets

CELL = load_cell("paper")
STAMP = Stamp("a-run", "2026-11-22T14:00:00Z", "S1100")


class Workplace(workplace.Workplace):
    """A folder with a calibration and a program, and the command over them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "drill.script", "out.script")
        self.program()

    def program(self, text: str = SCRIPT) -> None:
        self.source.write_text(text, "latin-1")


@pytest.fixture
def desk(tmp_path: Path) -> Workplace:
    return Workplace(tmp_path)


def test_a_corrected_program_arrives_like_a_list_and_is_not_corrected_again(
    desk: Workplace,
) -> None:
    """Poses are in {B}: command + error at the command = target, to a micrometre's rounding."""
    done = desk.run()
    assert (done.returncode, done.stdout) == (0, "")
    assert "{B}" in done.stderr
    assert "set_tcp" in done.stderr, "its numbers were not checked"
    expected, command = load_program(desk.source).values(), load_program(desk.out).values()
    arrived = command[:, :3] + calibration().error_model().predict(level(command[:, :3])).error_mm
    assert np.abs(command[:, :3] - expected[:, :3]).max() > 0.3
    np.testing.assert_allclose(arrived, expected[:, :3], atol=2e-3)
    np.testing.assert_array_equal(command[:, 3:], expected[:, 3:])
    targets, out = desk.folder / "targets.csv", desk.folder / "out.csv"
    write_targets(targets, ["H0", "H1", "H2"], zyx_from_pose(T_W_B @ poses_from_zyx(expected)))
    assert desk.compensate(source=targets, out=out) == 0
    _, listed, _ = workplace.read_corrected(out)
    np.testing.assert_allclose(apply(T_W_B, command[:, :3]), listed[:, :3], atol=1.2e-3)
    said = desk.refused(source=desk.out, out=desk.folder / "again.script")
    assert "20261101-120000-calibrate-abcd" in said
    desk.refused(source=targets, out=desk.out)  # a list is not named like a program


def test_a_program_whose_stamp_was_lost_is_known_at_another_station(desk: Workplace) -> None:
    """Its poses are in {B}, and the slide's place takes them elsewhere in {W}."""
    known = calibration()
    entry = known.stations["S1100"]
    moved = T_W_B.copy()
    moved[0, 3] -= 800.0
    there = msgspec.structs.replace(entry, T_W_B=moved.tolist(), strip_mm=300.0)
    places: dict[str, list[Influence]] = {"S1100": [], "S300": []}
    known = msgspec.structs.replace(
        known,
        stations={"S1100": entry, "S300": there},
        uncertainty=msgspec.structs.replace(known.uncertainty, stations=places),
        verdicts=known.verdicts | {"S300": known.verdicts["S1100"]},
    )
    write_calibration(known, desk.folder / "calibration.json")
    assert desk.run().returncode == 0
    lines = desk.out.read_text("latin-1").splitlines()
    desk.program("\n".join(line for line in lines if "corrected by" not in line))
    said = desk.refused("--station", "S300", out=desk.folder / "again.script")
    assert "targets corrected before" in said


@pytest.mark.parametrize(
    ("tcp", "code"), [("", 0), ("SMR", 0), ("p[0.0, 0.0, 0.3, 0.0, 0.0, 0.0]", 2), ("TURNED", 2)]
)
def test_a_tcp_that_is_not_the_calibrated_one(desk: Workplace, tcp: str, code: int) -> None:
    smr = [each / 1000.0 for each in CELL.robot.smr_mm]
    stated = {"SMR": f"p{[*smr, 0.0, 0.0, 0.0]}", "TURNED": f"p{[*smr, 0.01, 0.0, 0.0]}"}
    line = f"set_tcp({stated.get(tcp, tcp)})" if tcp else ""
    desk.program(SCRIPT.replace("set_tcp(p[0.18, 0.0, 0.21, 0.0, 0.0, 0.0])", line))
    desk.calibrate(digest=CELL.digest)
    done = desk.run("--cell", "paper")
    assert done.returncode == code
    assert ("drill.script line 4: " in done.stderr) == (code == 2)
    assert ("no TCP" in done.stderr) == (not tcp)
    assert desk.out.exists() == (code == 0)


@pytest.mark.parametrize(
    ("old", "new", "token"),
    [
        ("movel(P1)", "movec(P1, P1)", "drill.script line 23"),
        ("P1=p[1.85", "P1=p[9.85", "P1 (drill.script line 6)"),
        ("movel(P1)", "movel(p[1.85, 0, 0.95, 0, 1.5, 0])", "10.94 deg"),
    ],
)
def test_refused_and_nothing_written(desk: Workplace, old: str, new: str, token: str) -> None:
    desk.program(SCRIPT.replace(old, new))
    assert token in desk.refused()


def test_a_program_states_metres_and_is_not_asked_for_its_unit(desk: Workplace) -> None:
    desk.program(SCRIPT.replace("P1=p[1.85, -.05, 0.95", "P1=p[0.1, -.05, 0.1"))
    said = desk.refused()
    assert "drill.script: 1 of 3 targets outside the calibrated volume" in said
    assert "inches" not in said
    desk.program(f"def drill():\n  movel(p[0.1, 0.0, 0.1, {TURN}])\nend\n")
    said = desk.refused()
    assert "1 of 1 target outside the calibrated volume" in said
    assert "inches" not in said


def test_the_program_of_a_station_moves_to_the_joints_of_its_commands() -> None:
    targets = np.array([[0.0, 0.0, 1200.0, 0.0, 75.0, 0.0], [0.0, 50.0, 1250.0, 0.0, 75.0, 0.0]])
    names = ["Träger °1", "H2\n  movej(X)"]
    tip = tool_tips(CELL)[0]
    drilling = Drilling(CELL, T_W_B, tip, 100.0)
    outward = -poses_from_zyx(targets)[:, :3, 2]
    part = WorkPiece(targets[:, :3], outward)
    program = station_program(drilling, "S1100", names, targets, part, ["SIMULATED"])
    ((name, content),) = write_station(program, STAMP).items()
    text = content.decode("ascii")
    assert name == "S1100.script"
    lines = text.splitlines()
    assert lines[:3] == ["def S1100():", f"  # {STAMP.text}", "  # SIMULATED"]
    assert "  # 1 of 2: Trager deg1" in lines
    moves = [line for line in lines if line.startswith("  movej(")]
    joints_rad = np.array([joints_of(line) for line in moves])
    np.testing.assert_allclose(
        np.degrees(joints_rad[[0, -1]]), [CELL.robot.safe_deg] * 2, atol=1e-5
    )
    straight = [joints_of(line) for line in lines if line.startswith("  movel(")]
    places = T_W_B @ forward(CELL.robot.arm(), np.array(straight))
    np.testing.assert_allclose(places[::2], poses_from_zyx(targets), atol=2e-3)
    back_mm = places[1::2, :3, 3] - places[::2, :3, 3]
    np.testing.assert_allclose(back_mm, 100.0 * outward, atol=2e-3)
    at = [lines.index(line) for line in lines if line.startswith("  movel(")][::2]
    below, off = (np.array([joints_of(lines[n - back]) for n in at]) for back in (2, 1))
    np.testing.assert_array_equal(off, straight[1::2])
    np.testing.assert_allclose(np.degrees(off - below), CELL.robot.approach_deg, atol=2e-5)
    assert "  set_tcp(p[0.0980000, 0.0000000, 0.1270000, 0.0000000, 0.0000000, 0.0000000])" in lines
    speed = 1.05 * CELL.robot.speed_percent / 100.0
    assert all(f"v={speed:.4f})" in line for line in moves)
    with pytest.raises(SettingsError, match="joint target"):
        read_program(name, text)
    with pytest.raises(CorrectedBefore):
        refuse_corrected(name, lines)


def joints_of(line: str) -> list[float]:
    return [float(each) for each in line[line.index("[") + 1 : line.index("]")].split(",")]
