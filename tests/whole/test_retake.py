"""Points are re-measured on a live run and on a finished one; names are chosen."""

from pathlib import Path
from typing import Any

import pytest

from hilcell.cell.file import load_cell
from hilcell.ports import HilcellError
from hilcell.run.control import order
from procedures.repeatability import visits
from tests.whole.bench import SMALL, OwnCell, command, end_of, events, journal, sets
from tests.whole.golden import GoldenRuns
from tests.whole.threaded import Event, ThreadedRun, is_state

KEY = "validate/S300/chosen/001"
CLOSING = [visit.id.key for visit in visits(load_cell("paper", SMALL), "closing")]


def retaken(printed: list[dict[str, Any]]) -> list[str]:
    return [e["key"] for e in printed if e["kind"] == "point" and e.get("retaken")]


@pytest.fixture(scope="module")
def finished(
    tmp_path_factory: pytest.TempPathFactory, golden: GoldenRuns
) -> tuple[Path, dict[str, Any]]:
    runs = tmp_path_factory.mktemp("runs")
    golden["small"].copied_to(runs).rename(runs / "mine")
    return runs, golden["small"].end


def test_a_finished_run_is_reopened_measured_and_judged_again(
    finished: tuple[Path, dict[str, Any]],
) -> None:
    runs, before = finished
    done = command("resume", "mine", "--runs", runs, "--retake", KEY, "--json")
    end = end_of(done)
    assert end["state"] == "finished", done.stderr
    printed = events(done.stdout)
    assert retaken(printed) == [KEY, *CLOSING]
    assert any(e["kind"] == "point" and e["group"] == "control" for e in printed)
    verdicts = [e["key"] for e in printed if e["kind"] == "verdict"]
    assert "validation.S300" in verdicts
    assert verdicts[-2:] == ["revisits.closing", "suspicions"]
    points = [e["key"] for e in printed if e["kind"] == "point" and e["group"] != "control"]
    assert points == [KEY, *CLOSING]
    first = before["result"]["validation"]["S300"]["chosen"]["mean"]
    assert end["result"]["validation"]["S300"]["chosen"]["mean"] >= first  # the larger counts
    assert end["result"]["validation"]["S1100"] == before["result"]["validation"]["S1100"]
    assert journal(runs, "mine")
    assert command("resume", "mine", "--runs", runs).returncode == 2  # it is finished


def test_a_robot_that_changed_before_its_run_is_reopened_is_noticed(
    tmp_path: Path, golden: GoldenRuns, own_cell: OwnCell
) -> None:
    golden["small"].copied_to(tmp_path)
    resume = ("resume", "small", "--runs", tmp_path, "--retake", KEY, "--json")
    own_cell.at_start.append({"name": "robot.mount_slip", "value": 0.2})
    end = end_of(command(*resume))
    assert (end["state"], end["exit"]) == ("finished", 1), end
    (found,) = end["result"]["suspicions"]
    assert found["cause"] == "mount slipped"
    assert found["noticed_by"]
    own_cell.at_start.clear()  # the mount is put back
    end = end_of(command(*resume))
    assert end["exit"] == 1
    assert end["result"]["suspicions"] == [found]


@pytest.mark.parametrize("key", ["grid/0-0-0", "grid/9-9-9"])
def test_a_retake_that_is_not_allowed_is_refused_before_anything_moves(
    finished: tuple[Path, dict[str, Any]], key: str
) -> None:
    """The correction was built with the one, the other is no point."""
    runs, _ = finished
    done = command("resume", "mine", "--runs", runs, "--retake", key, "--retake", KEY)
    assert done.returncode == 2
    assert key in done.stderr
    assert journal(runs, "mine")[-1]["kind"] == "end"


def test_a_live_run_measures_a_vertex_again(tmp_path: Path) -> None:
    def at_vertex(event: Event) -> bool:
        return event["kind"] == "point" and event["key"] in ("grid/0-0-0", "grid/2-0-0")

    with ThreadedRun(tmp_path, "run", "--name", "live", *sets(SMALL), stands=at_vertex) as run:
        run.until(lambda event: event.get("key") == "grid/2-0-0" and at_vertex(event))
        order(run.folder, "pause")
        run.until(lambda event: is_state(event, "paused"))
        order(run.folder, "retake", key="grid/0-0-0")
        with pytest.raises(HilcellError):  # it waits already
            order(run.folder, "retake", key="grid/0-0-0")
        order(run.folder, "proceed")
        run.until(at_vertex)
        order(run.folder, "abort")
        end = run.rest()
    assert (end["exit"], end["state"]) == (4, "aborted")
    assert retaken(run.events) == ["grid/0-0-0"]
    assert not [e for e in run.events if e.get("what") == "safe stop"]


def test_a_name_is_used_once(finished: tuple[Path, dict[str, Any]]) -> None:
    runs, _ = finished
    done = command("run", "--name", "mine", "--runs", runs, "--json")
    assert done.returncode == 2
    assert "mine" in done.stderr


def test_a_folder_without_a_journal_is_taken(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "engine-1.log").write_text("")
    done = command("run", "home", "--name", "mine", "--runs", tmp_path, "--json")
    assert end_of(done)["run"] == "mine"
    assert done.returncode == 0, done.stderr
