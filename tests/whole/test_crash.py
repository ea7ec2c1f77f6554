"""kill -9 at any moment, then resume: nothing acknowledged is lost or measured twice."""

import math
import random
from itertools import combinations, starmap
from pathlib import Path
from typing import Any

import pytest

from campaigns.kills import figures, killed, problems
from hilcell.commands.cli import main
from hilcell.errors import EXIT_STORAGE
from hilcell.journal.runs import read_log
from tests.fakes.rail_bench import Line
from tests.whole.bench import (
    SMALL,
    Engine,
    children,
    command,
    cut,
    end_of,
    events,
    journal,
    ran,
    sets,
    simulation,
    sweep,
    wait_gone,
)
from tests.whole.golden import GoldenRuns


@pytest.mark.process
def test_kills_change_nothing(tmp_path: Path) -> None:
    """Of a short run: `make torture` kills whole calibrations."""
    words = ("base-frame", *sets(SMALL | {"base_frame.points": "4"}))
    whole = events(command("run", *words, "--json", "--runs", tmp_path / "whole").stdout)
    # Where to die: after so many records, spread over the whole run but not by a pattern.
    moments = sorted(random.Random(2014).sample(range(5, len(whole) - 5), 2))
    with simulation() as cell:
        words = (*words, *sets({"simulation.address": cell.control}))
        found = killed(tmp_path / "killed", words, moments, later_s=iter([0.0] * 2))
    assert problems(found, whole) == []


LAST_ERROR = b"t60584003100100000000", b"t58584303100130810000"  # 1003h:01 of the drive: 8130h


@pytest.mark.process
def test_a_drive_that_has_latched_the_lost_heartbeat_starts_again(tmp_path: Path) -> None:
    """It takes START only after the first new heartbeat of the engine that resumes."""
    with simulation() as cell:
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
@pytest.mark.parametrize("cuts", [slice(10, None, 16), *sweep(slice(None))], ids=["some", "all"])
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
            # New noise: 3 sigma of two means over 4 targets at other stations, as in the campaign.
            limit_mm = 0.02 if key == "S1100.chosen" else 0.06
            assert value == pytest.approx(wanted[key], abs=limit_mm), (seq, key)


def test_a_resumed_simulation_has_noise_of_its_own(tmp_path: Path, golden: GoldenRuns) -> None:
    """Else a visit after a death repeats the first one, and repeatability is half as large."""
    whole, place = golden["small"], "repeatability/{}/{:03}"
    *_, half = (e["seq"] for e in whole.events if e.get("key") == place.format(0, 4))
    folder = tmp_path / "half"
    cut(whole.folder, folder, half)
    assert command("resume", "half", "--runs", tmp_path).returncode == 0
    points = read_log(folder).points
    for n in range(3):
        visits = [points[place.format(n, m)].xyz_mm for m in range(10)]
        assert min(starmap(math.dist, combinations(visits, 2))) > 1e-3


@pytest.mark.process
def test_a_killed_run_takes_its_simulation_along(tmp_path: Path) -> None:
    engine = Engine("run", "--runs", tmp_path, "--speed", "100", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "intent")
    simulated = children(engine.process.pid)
    assert simulated
    engine.kill()
    for pid in simulated:
        wait_gone(pid)
    (run,) = events(command("runs", "--json", "--runs", tmp_path).stdout)[0]["runs"]
    assert "engine gone" in run["state"]
    resumed = command("resume", engine.run, "--runs", tmp_path, "--json", "--speed", "1")
    assert resumed.returncode == 2  # the speed of a run is frozen in its journal


# Of a calibration in the grid, and of a shorter run once {W} is framed: all devices work then.
MOMENTS = [("base-frame", "world/F3"), *sweep(("calibrate", "grid/0-0-0"))]


@pytest.mark.parametrize(("procedure", "moment"), MOMENTS)
@pytest.mark.parametrize(
    ("fault", "back"),
    [("rail.vanish", False), ("rail.eof", True), ("robot.idle_close", True), ("tracker.eof", True)],
)
def test_a_device_that_is_lost_in_mid_run(
    tmp_path: Path, fault: str, back: bool, procedure: str, moment: str
) -> None:
    """Safe stop, journal intact, exit 3; a resume goes on, or says that the device is not there."""

    def hear(event: dict[str, Any]) -> None:
        if event["kind"] == "point" and event["key"] == moment:
            cell.strike(fault)

    with simulation() as cell:
        values = SMALL | {"simulation.address": cell.control}
        printed = ran(tmp_path, procedure, values, hear=hear).events
        again = command("resume", "x", "--runs", tmp_path, "--json")
    end, device = printed[-1], fault.partition(".")[0].capitalize()
    assert (end["exit"], end["state"]) == (3, "faulted"), end
    assert device in end["reason"]
    assert any(e["kind"] == "event" and e["what"] == "safe stop" for e in printed)
    if back:
        assert end_of(again)["state"] == "finished", again.stderr
    else:
        assert end_of(again)["exit"] == 3
        assert device in end_of(again)["reason"]
    assert journal(tmp_path, "x")


def test_a_calibration_file_that_cannot_be_written_is_owed(
    tmp_path: Path, golden: GoldenRuns
) -> None:
    whole = golden["sign-check"]
    last = next(e["seq"] for e in whole.events if e.get("key") == "sign/corrected")
    cut(whole.folder, tmp_path / "owing", last)
    file = tmp_path / "owing" / "calibration.json"
    file.mkdir()  # in the file's way
    words = ("resume", "owing", "--json", "--runs", tmp_path)
    done = command(*words, "--unattended")
    assert done.returncode == EXIT_STORAGE
    assert str(file) in done.stderr
    file.rmdir()
    resumed = command(*words)
    assert resumed.returncode == 0, resumed.stderr
    assert events(resumed.stdout) == []  # nothing is measured, nothing moves
    assert file.is_file()
    assert command(*words).returncode == 2  # it is finished
    file.unlink()
    assert command(*words).returncode == 0  # a lost file is written again
    assert file.is_file()
