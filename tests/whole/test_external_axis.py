"""The slide as external axis E1 of the robot: whole runs, and an engine that dies on the way."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.kuka.robot_c3 import C3Connection
from hilcell.journal.index import find_run
from hilcell.journal.runs import read_log
from tests.whole.bench import SMALL, Engine, command, end_of, events, sets, simulation, sweep
from tests.whole.trace import judge

E1 = {"rail.driver": "kuka-e1"}
FEWER = {"grid.size_mm": "[900.0, 450.0, 450.0]", "base_frame.points": "4"}
PACE = 40.0
FAR_MM = 2600.0  # the first motion, the slowest there is: all else is quick in fast paced time
SLOW = E1 | {
    "rail.speed_mm_s": "20.0", "survey.from_mm": f"{FAR_MM}", "survey.to_mm": f"{FAR_MM + 400}"
}  # fmt: skip


@pytest.mark.parametrize(
    ("procedure", "plan"), [("sign-check", SMALL | FEWER), *sweep(("calibrate", SMALL))]
)
@pytest.mark.parametrize(
    ("values", "drive"),
    [(E1, "E1 of "), ({"rail.options.strip.driver": "serial"}, "drive vendor 0x484")],
    ids=["E1", "CANopen and a serial strip"],
)
def test_a_small_calibration_ends_in_tolerance(
    tmp_path: Path, procedure: str, plan: dict[str, str], values: dict[str, str], drive: str
) -> None:
    """By day as far as corrected targets at a station: every act that moves slide or arm."""
    words = ("--json", "--unattended", *sets(plan | values))
    done = command("run", procedure, "--runs", tmp_path, *words)
    assert end_of(done)["exit"] == 0, done.stderr
    assert judge(events(done.stdout)) == []
    kinds = {each.kind: each.model for each in read_log(find_run(tmp_path, "last")).assets}
    assert set(kinds) == {"drive", "strip", "robot", "tracker"}
    assert kinds["drive"].startswith(drive)
    assert kinds["strip"] == "MSAC501 simulated"


@pytest.mark.process
def test_a_killed_engine_leaves_a_slide_that_brakes_by_itself(tmp_path: Path) -> None:
    """It would be on its way for half a minute, however slow the PC that kills the engine."""
    values = SLOW | {"rail.options.full_mm_s": "200.0", "rail.speed_mm_s": "2.0"}
    with simulation(PACE, values=values) as cell:
        words = sets(values | {"simulation.address": cell.control})
        engine = Engine("run", "rail-survey", "--runs", tmp_path, "--unattended", *words)
        engine.until(lambda event: event.get("action") == "rail.move")
        port = int(cell.addresses["robot"]["port"])
        line = C3Connection("127.0.0.1", port, lambda: None)
        before_mm = float(line.read("$AXIS_ACT.E1"))
        while abs(float(line.read("$AXIS_ACT.E1")) - before_mm) < 1.0:
            pass  # the test's time limit bounds the wait
        engine.kill()
        while line.read("HC_ERR") != "8":
            pass
        assert line.read("HC_HELD") == "TRUE"
        places = [float(line.read("$AXIS_ACT.E1")), 0.0]
        while abs(places[-1] - places[-2]) > 0.003:  # it dithers
            places.append(float(line.read("$AXIS_ACT.E1")))
        target_mm = float(line.read("HC_TGT").partition("E1 ")[2].partition(",")[0])
        assert abs(target_mm - places[-1]) > 5.0
        line.close()
        again = Engine("resume", engine.run, "--runs", tmp_path, "--unattended")
        again.until(lambda event: event.get("position_mm") == FAR_MM)
        again.kill()


@pytest.mark.wall
def test_a_slide_that_runs_too_fast_is_stopped(tmp_path: Path) -> None:
    """In paced time: in stepped time a poll lets a third of the motion pass."""
    with simulation(PACE, values=SLOW) as cell:
        cell.ask(do="fault", name="robot.slide_fast", value=8.0, count=0)
        words = sets(SLOW | {"simulation.address": cell.control})
        done = command("run", "rail-survey", "--runs", tmp_path, "--json", "--unattended", *words)
    end = end_of(done)
    assert (end["exit"], end["error"]["code"]) == (3, "HC-R33")


def test_a_robot_that_moves_no_slide_is_refused_before_anything_moves(tmp_path: Path) -> None:
    words = sets({"rail.driver": "kuka-e1", "robot.driver": "x"})
    assert command("run", "--runs", tmp_path, *words).returncode == 2
