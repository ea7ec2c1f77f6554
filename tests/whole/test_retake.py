"""Points are re-measured on a live run and on a finished one; names are chosen."""

from pathlib import Path
from typing import Any

import pytest

from fakes.simulator import Control
from hilcell.cell.devices import start_simulation
from hilcell.cell.file import Cell, load_cell
from hilcell.commands import run
from hilcell.ports import HilcellError, SimulatedCell
from hilcell.run.client import order
from procedures.revisits import visits
from tests.whole.bench import SMALL, Engine, command, end_of, events, sets
from tests.whole.golden import GoldenRuns
from tests.whole.trace import judge

KEY = "validate/S300/chosen/001"
CLOSING = [visit.id.key for visit in visits(load_cell("paper", SMALL), "closing")]


def retaken(journal: list[dict[str, Any]]) -> list[str]:
    return [e["key"] for e in journal if e["kind"] == "point" and e.get("retaken")]


@pytest.fixture(scope="module")
def finished(
    tmp_path_factory: pytest.TempPathFactory, golden: GoldenRuns
) -> tuple[Path, dict[str, Any]]:
    runs = tmp_path_factory.mktemp("runs")
    golden["small"].copied_to(runs).rename(runs / "mine")
    return runs, golden["small"].end


def test_a_finished_run_is_reopened_measured_and_judged_anew(
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
    journal = events(command("watch", "mine", "--runs", runs, "--json").stdout)
    assert judge(journal) == []
    again = command("resume", "mine", "--runs", runs)
    assert again.returncode == 2
    assert "is finished" in again.stderr


def test_a_robot_that_changed_before_its_run_is_reopened_is_noticed(
    tmp_path: Path, golden: GoldenRuns, monkeypatch: pytest.MonkeyPatch
) -> None:
    def start(cell: Cell, **words: Any) -> SimulatedCell | None:
        found = start_simulation(cell, **words)
        assert found is not None
        with Control(found.address) as control:
            control.ask("fault", name="robot.mount_slip", value=0.2)
        return found

    monkeypatch.setattr(run, "start_simulation", start)
    golden["small"].copied_to(tmp_path)
    done = command("resume", "small", "--runs", tmp_path, "--retake", KEY, "--json")
    end = end_of(done)
    assert (end["state"], end["exit"]) == ("finished", 1), done.stderr
    (found,) = end["result"]["suspicions"]
    assert found["cause"] == "mount slipped"
    assert found["noticed_by"] == "vertices re-visited at the end"
    monkeypatch.setattr(run, "start_simulation", start_simulation)  # the mount is put back
    done = command("resume", "small", "--runs", tmp_path, "--retake", KEY, "--json")
    assert end_of(done)["exit"] == 1
    assert end_of(done)["result"]["suspicions"] == [found]


@pytest.mark.parametrize(
    ("key", "part"),
    [("grid/0-0-0", "the correction was built with it"), ("grid/9-9-9", "no such point")],
)
def test_what_may_not_be_retaken_is_refused_before_anything_moves(
    finished: tuple[Path, dict[str, Any]], key: str, part: str
) -> None:
    runs, _ = finished
    done = command("resume", "mine", "--runs", runs, "--retake", key, "--retake", KEY)
    assert done.returncode == 2
    assert part in done.stderr
    journal = events(command("watch", "mine", "--runs", runs, "--json").stdout)
    assert journal[-1]["kind"] == "end"


def test_a_live_run_measures_a_vertex_anew(tmp_path: Path) -> None:
    engine = Engine("run", "--name", "live", "--runs", tmp_path, "--speed", "50", *sets(SMALL))
    engine.until(lambda event: event["kind"] == "point" and event["key"] == "grid/2-0-0")
    folder = tmp_path / "live"
    order(folder, "retake", key="grid/0-0-0")
    with pytest.raises(HilcellError, match="waits already"):
        order(folder, "retake", key="grid/0-0-0")
    engine.until(lambda event: event["kind"] == "point" and event["key"] == "grid/0-0-0")
    order(folder, "abort")
    printed = engine.rest()
    assert printed[-1]["exit"] == 4
    assert printed[-1]["state"] == "aborted"
    assert retaken(printed) == ["grid/0-0-0"]
    assert judge(printed) == []
    assert not [e for e in printed if e.get("what") == "safe stop"]


def test_a_name_is_used_once(finished: tuple[Path, dict[str, Any]]) -> None:
    runs, _ = finished
    done = command("run", "--name", "mine", "--runs", runs, "--json")
    assert done.returncode == 2
    assert "run mine exists already" in done.stderr


def test_a_folder_without_a_journal_is_taken(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "engine-1.log").write_text("")
    done = command("run", "home", "--name", "mine", "--runs", tmp_path, "--json")
    assert end_of(done)["run"] == "mine"
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "last", "x" * 101, "a\nb", "ä/"])
def test_a_name_that_is_no_folder_is_refused(tmp_path: Path, name: str) -> None:
    done = command("run", "--name", name, "--runs", tmp_path)
    assert done.returncode == 2
    assert "1 to 100 letters, digits" in done.stderr
    assert not list(tmp_path.iterdir())
