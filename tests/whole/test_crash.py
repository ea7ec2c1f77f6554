"""kill -9 at any moment, then resume: nothing acknowledged is lost or measured twice."""

import random
import subprocess
from pathlib import Path
from typing import Any

import pytest

from campaigns.kills import figures, killed, problems
from hilcell.commands.cli import main
from hilcell.run.exits import EXIT_STORAGE
from tests.fakes.rail_bench import Line
from tests.whole.bench import (
    SMALL,
    Engine,
    Simulation,
    children,
    command,
    cut,
    end_of,
    events,
    sets,
    simulation,
    sweep,
    wait_gone,
)
from tests.whole.golden import GoldenRuns
from tests.whole.trace import judge


@pytest.mark.timeout(1200)
@pytest.mark.long
def test_kills_change_nothing(tmp_path: Path, golden: GoldenRuns) -> None:
    whole = golden["small"].events
    # Where to die: after so many records, spread over the whole run but not by a pattern.
    moments = sorted(random.Random(2014).sample(range(5, len(whole) - 5), 3))
    with simulation() as cell:
        words = ("calibrate", *sets(SMALL | {"simulation.address": cell.control}))
        found = killed(tmp_path, words, moments, later_s=iter([0.0] * 3))
    assert problems(found, whole) == []


LAST_ERROR = b"t60584003100100000000", b"t58584303100130810000"  # 1003h:01 of the drive: 8130h


def test_a_drive_that_has_latched_the_lost_heartbeat_starts_again(tmp_path: Path) -> None:
    """It takes START only after the first new heartbeat of the engine that resumes."""
    with simulation(20.0) as cell:
        words = sets({"simulation.address": cell.control})
        engine = Engine("run", "home", "--runs", tmp_path, *words)
        engine.until(lambda event: event.get("what") == "connected")
        engine.kill()
        with Line(int(cell.addresses["rail"]["channel"].rsplit(":", 1)[1])) as line:
            answer = b""
            while answer != LAST_ERROR[1]:  # the test's time limit bounds the wait
                line.send(LAST_ERROR[0])
                while not (answer := line.frame()).startswith(b"t585"):
                    pass
        last = command("resume", engine.run, "--runs", tmp_path, "--json")
    assert end_of(last)["state"] == "finished", last.stderr


def after_every_kind(printed: list[dict[str, Any]]) -> list[int]:
    """Return the records after which a death is the most awkward: frames and states."""
    frames = ("world", "base", "station.S1100", "station.S1900")
    return [e["seq"] for e in printed if e["kind"] == "state" or e.get("key") in (*frames, "fit")]


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("cuts", [slice(9, None, 8), *sweep(slice(None))], ids=["some", "all"])
@pytest.mark.long
def test_a_run_resumes_from_between_any_two_records(
    tmp_path: Path,
    golden: GoldenRuns,
    capsys: pytest.CaptureFixture[str],
    cuts: slice,
) -> None:
    whole = golden["small"]
    wanted = figures(whole.result)
    for seq in after_every_kind(whole.events)[cuts]:
        folder = tmp_path / f"cut-{seq}"
        cut(whole.folder, folder, seq)
        main(["resume", folder.name, "--runs", str(tmp_path), "--json"])
        out, err = capsys.readouterr()
        end = events(out)[-1]
        assert end["state"] == "finished", (seq, err)
        assert (folder / "calibration.json").is_file(), seq
        for key, value in figures(end["result"]).items():
            limit_mm = 0.06 if key.endswith(".idw") else 0.03
            assert value == pytest.approx(wanted[key], abs=limit_mm), (seq, key)


def test_a_lost_calibration_file_is_written_again(tmp_path: Path, golden: GoldenRuns) -> None:
    whole = golden["small"]
    cut(whole.folder, tmp_path / "copy", whole.end["seq"])
    done = command("resume", "copy", "--runs", tmp_path, "--json")
    assert done.returncode == whole.done.returncode, done.stderr
    assert (tmp_path / "copy" / "calibration.json").is_file()
    again = command("resume", "copy", "--runs", tmp_path)
    assert again.returncode == 2
    assert "is finished" in again.stderr


def test_a_killed_run_takes_its_simulation_along(tmp_path: Path) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "20", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "intent")
    simulated = children(engine.process.pid)
    assert simulated
    engine.kill()
    for pid in simulated:
        wait_gone(pid)
    (run,) = events(command("runs", "--json", "--runs", tmp_path).stdout)[0]["runs"]
    assert "engine gone" in run["state"]
    shown = command("show", engine.run, "--runs", tmp_path)
    assert "engine gone" in shown.stdout
    resumed = command("resume", engine.run, "--runs", tmp_path, "--json", "--speed", "1")
    assert resumed.returncode == 2  # the speed of a run is frozen in its journal


def struck(
    cell: Simulation, runs: Path, procedure: str, moment: str, fault: str
) -> subprocess.CompletedProcess[str]:
    """Run a procedure which a fault strikes once a point is measured."""

    def hear(event: dict[str, Any]) -> None:
        if event["kind"] == "point" and event["key"] == moment:
            assert cell.ask(do="fault", name=fault)["ok"]

    words = sets(SMALL | {"simulation.address": cell.control})
    return command("run", procedure, "--name", "x", "--json", "--runs", runs, *words, hear=hear)


def faulted(done: subprocess.CompletedProcess[str], device: str) -> None:
    """The run ends safely with exit 3; its journal is whole and names the device."""
    printed = events(done.stdout)
    assert printed[-1]["exit"] == 3, printed[-1]
    assert printed[-1]["state"] == "faulted"
    assert device.capitalize() in printed[-1]["reason"]
    assert any(e["kind"] == "event" and e["what"] == "safe stop" for e in printed)
    assert "hilcell resume" in done.stderr
    assert judge(printed) == []


# Of a calibration in the grid, and of a shorter run once {W} is framed: all devices work then.
MOMENTS = [("base-frame", "world/F3"), *sweep(("calibrate", "grid/0-0-0"))]


@pytest.mark.parametrize(("procedure", "moment"), MOMENTS)
@pytest.mark.parametrize("device", ["rail", "robot", "tracker"])
def test_a_device_that_vanishes_in_mid_motion(
    tmp_path: Path, device: str, procedure: str, moment: str
) -> None:
    """Safe stop, journal intact, exit 3; without the device a resume says so."""
    with simulation() as cell:
        faulted(struck(cell, tmp_path, procedure, moment, f"{device}.vanish"), device)
        again = command("resume", "x", "--runs", tmp_path, "--json")
    end = end_of(again)
    assert end["exit"] == 3
    assert device.capitalize() in end["reason"]


@pytest.mark.parametrize(("procedure", "moment"), MOMENTS)
@pytest.mark.parametrize("fault", ["rail.eof", "robot.idle_close", "tracker.eof"])
def test_a_connection_that_breaks_is_resumed(
    tmp_path: Path, fault: str, procedure: str, moment: str
) -> None:
    with simulation() as cell:
        faulted(struck(cell, tmp_path, procedure, moment, fault), fault.split(".", maxsplit=1)[0])
        done = command("resume", "x", "--runs", tmp_path, "--json")
    assert end_of(done)["state"] == "finished", done.stderr
    journal = events(command("watch", "x", "--runs", tmp_path, "--json").stdout)
    assert judge(journal) == []


def test_a_calibration_file_that_cannot_be_written_is_owed(tmp_path: Path) -> None:
    file = tmp_path / "owing" / "calibration.json"
    file.mkdir(parents=True)  # in the file's way
    done = command(
        "run", "sign-check", "--name", "owing", "--json", "--runs", tmp_path, *sets(SMALL)
    )
    assert done.returncode == EXIT_STORAGE
    assert str(file) in done.stderr
    file.rmdir()
    resumed = command("resume", "owing", "--runs", tmp_path, "--json")
    assert resumed.returncode == 0, resumed.stderr
    assert events(resumed.stdout) == []  # nothing is measured, nothing moves
    assert file.is_file()
