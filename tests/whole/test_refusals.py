"""Wrong input, addresses and ports are refused with one clear message and its exit code."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from shlex import quote, split

import pytest

from tests.whole.bench import (
    PAPER,
    command,
    end_of,
    events,
    ran,
    shop_cell,
    shop_values,
    sim_command,
    simulation,
)
from tests.whole.threaded import ThreadedRun


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--cell", "papper"], "papper"),
        (["--cell", "unknown"], "hilcell sim --cell unknown"),
        (["--set", "rail.sped_mm_s=3.0"], "speed_mm_s"),
        (["--set", "rail.speed_mm_s=nan"], "rail.speed_mm_s"),
        (["--set", "rail.options.chanel=x"], "channel"),
        (["--set", "grid.centre.x_mm=2600.0"], "8 of 27"),
        (["--set", "tracker.max_range_mm=4000.0"], "range"),
        (["--set", "rail.driver=canopeen"], "canopen"),
        (["calibrat"], "calibrate"),
        (["--set", "layout.slide=" + "[" + ", ".join(
            f'{{name="P{n}", x_mm={n + 1}00.0, y_mm=0.0, z_mm=0.0}}' for n in range(3)
        ) + "]"], "layout"),
    ],
)  # fmt: skip
def test_refused_before_anything_starts(tmp_path: Path, words: list[str], part: str) -> None:
    done = command("run", "--json", "--runs", tmp_path / "runs", *words)
    assert (done.returncode, end_of(done)["state"]) == (2, "idle")
    assert part in done.stderr
    assert not (tmp_path / "runs").exists()
    if "calibrat" not in words:
        assert command("check", *[w for w in words if w != "--cell"] or ["x"]).returncode == 2


@pytest.mark.parametrize(
    "words",
    [
        "run recheck",
        "plan holes.csv",
        "prepare holes.csv --calibration last -o monday",
        "compensate last holes.csv --station S1 -o out.csv",
        "doctor",
    ],
)
def test_a_hall_that_nobody_has_measured_is_commissioned_first(words: str) -> None:
    done = command(*words.split(), "--cell", "unknown")
    assert (done.returncode, "hilcell commission mycell.toml" in done.stderr) == (2, True)


@pytest.mark.process
@pytest.mark.parametrize("cell", ["paper", "unknown"])
def test_a_sheet_is_refused_before_a_hall_starts(cell: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = command("sim", "--cell", cell, "--sheet", tmp_path / "file/hall", "--ports", "control=0")
    assert (done.returncode, done.stdout) == (2, "")


RECORDED = "--set simulation.simulator=recorded --set simulation.data="
CAN = "--set rail.options.interface=socketcan --set rail.options.channel=can0"
WRONG = "--set simulation.simulator=papper --set tracker.driver=leika"
WRONG += " --set rail.options.bitrate=5 --set robot.options.prot=1"
KEPT = "tests/wires/kuka-c3,leica-emscon,canopen"
BIGGEST_SEED, FASTEST = "9223372036854775807", "1e+06"
# Orders that make no sense, and parts of what is said of them.
SENSELESS = [
    ("", []),
    ("dance", []),
    ("run --set x", []),
    ("run --set \"rail.speed_mm_s=1.0\nname='x'\"", ["KEY=VALUE"]),
    ("run --seed -1", [BIGGEST_SEED]),
    ("run --seed 9223372036854775808", [BIGGEST_SEED]),
    ("run --speed banana", [FASTEST]),
    ("run --speed nan", [FASTEST]),
    ("run --speed 1e7", [FASTEST]),
    ("run --speed 0", []),
    *(
        (f"run --name {quote(name)}", ["--name"])
        for name in ("", "../x", ".hidden", "last", "x" * 101, "a\nb", "ä/")
    ),
    ("run --set simulation.address=:::", [":::"]),
    ("run --set simulation.address=x", ["x"]),
    ("run touch --cell fixed", ["touch refused before anything moves: cell fixed has no rail"]),
    ("run iso9283 --cell fixed --set iso9283.calibration=nothing", ["nothing"]),
    ("run campaign --dry-run --set layout.reflectors=by_hand", ["by_hand"]),
    ("run --unattended --set rail.driver=kuka-e1 --set robot.driver=x", []),
    ("run targets", ["--set targets.file=FILE"]),
    ("run recheck --unattended", []),
    (f"run home {RECORDED}/nowhere", ["make one with `run --record-wire`"]),
    (f"run home {CAN} {RECORDED}{KEPT}", ["rail: can0 is a CAN interface, of which no recording"]),
    (f"check paper {WRONG}", ["'papper'", "bitrate", "prot", "'leika'"]),
    ("sim --set simulation.address=127.0.0.1:1 --ports rail=7", ["simulation.address"]),
    *(
        (f"sim --ports={ports}", ["--ports"])
        for ports in ("rail", "rial=1", "rail=-1", "rail=65536", "rail=1,rail=2", "")
    ),
    ("study report", ["folder"]),
    ("study report r", ["folder"]),
    ("study a.toml b", ["'b'"]),
    ("study report r --workers 2", ["--workers"]),
    ("study report r --dry-run", ["--dry-run"]),
    ("study a.toml --workers 0", ["--workers"]),
    ("study a.toml --scheduler host", ["--scheduler"]),
    ("study a.toml --workers 2 --scheduler tcp://h:1", ["--scheduler"]),
]


@pytest.mark.parametrize(("order", "parts"), SENSELESS)
def test_an_order_that_makes_no_sense(tmp_path: Path, order: str, parts: list[str]) -> None:
    words = split(order)
    done = command(*words, *(("--runs", tmp_path / "runs") if words[:1] == ["run"] else ()))
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert [part for part in parts if part not in done.stderr] == []
    assert list(tmp_path.iterdir()) == []


def test_a_simulated_cell_that_is_not_there(tmp_path: Path) -> None:
    address = "127.0.0.1:1"
    done = command("run", "--runs", tmp_path, "--set", f"simulation.address={address}")
    assert done.returncode == 3, done.stderr
    assert address in done.stderr


def test_dry_run_opens_nothing_and_prints_the_plan(tmp_path: Path) -> None:
    done = command("run", "--full", "--dry-run", "--json", "--runs", tmp_path / "runs")
    assert done.returncode == 0
    plan, end = events(done.stdout)
    assert plan["kind"] == "plan"
    assert plan["points"] > 700
    assert plan["duration_s"] > 1000
    assert end["kind"] == "end"
    assert not (tmp_path / "runs").exists()


def test_a_port_on_which_no_device_listens(tmp_path: Path) -> None:
    """All three devices are tried and all failures reported, before anything moves."""
    values = shop_values(f"socket://127.0.0.1:{free_port()}", free_port(), free_port())
    run = ran(tmp_path, "calibrate", values, "--cell", shop_cell(tmp_path))
    assert (run.end["exit"], run.end["state"]) == (3, "faulted")
    for name in ("Rail", "Robot", "Tracker"):
        assert name in run.end["reason"]
    assert not [event for event in run.events if event["kind"] == "intent"]


def test_a_device_of_the_wrong_identity(tmp_path: Path) -> None:
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nname = "robot.wrong_identity"\ncount = 1000\n')
    with simulation(faults=str(faults)) as cell:
        run = ran(tmp_path, "calibrate", {"simulation.address": cell.control})
    assert run.end["exit"] == 2, run.done.stderr
    assert "Robot" in run.end["reason"]
    assert not [event for event in run.events if event["kind"] == "intent"]


def test_a_second_run_on_the_same_cell(tmp_path: Path) -> None:
    with ThreadedRun(tmp_path, "run", "home") as run:
        run.until(lambda event: event["kind"] == "intent")
        done = command("run", "home", "--json", "--runs", tmp_path)
        assert (done.returncode, end_of(done)["exit"]) == (6, 6)
        assert run.folder.name in done.stderr
        assert run.rest()["exit"] == 0


def test_a_real_cell_copied_from_paper_needs_a_name_and_a_serial_of_its_own(
    tmp_path: Path,
) -> None:
    cell = shop_cell(tmp_path)
    refused: list[list[str | Path]] = [["run", "--runs", tmp_path, "--cell", cell], ["check", cell]]
    for words in refused:
        done = command(*words)
        assert done.returncode == 2
        assert "name: 'paper'" in done.stderr
    cell.write_text(PAPER.read_text("utf-8").replace("speed_mm_s = 250.0", "speed_mm_s = 200.0"))
    done = command("check", cell)
    assert done.returncode == 0
    assert "serial: 'HC-2014'" in done.stderr


def test_speed_is_for_simulated_cells(tmp_path: Path) -> None:
    words = ("--cell", shop_cell(tmp_path), "--speed", "2", "--runs", tmp_path)
    assert command("run", *words).returncode == 2


@pytest.mark.parametrize("folder", ["/etc/passwd", "/proc/x", "x" * 300])
def test_a_runs_folder_that_cannot_be_used(folder: str) -> None:
    done = command("run", "--runs", folder)
    assert done.returncode == (2 if folder == "/etc/passwd" else 7)
    assert folder in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_an_engine_that_cannot_write_its_file_says_so_and_can_be_resumed(
    tmp_path: Path, temporary: Path
) -> None:
    runs = tmp_path / "runs"
    (runs / "d" / "engine.json").mkdir(parents=True)  # as little to be written as on a full disk
    for words in (("run", "home", "--name", "d"), ("resume", "d")):
        done = command(*words, "--runs", runs)
        assert done.returncode == 7, done.stderr
        assert "engine.json" in done.stderr
        assert f"hilcell resume d --runs {runs}" in done.stderr
    (runs / "d" / "engine.json").rmdir()
    assert command("resume", "d", "--runs", runs).returncode == 0
    assert [path.name for path in temporary.iterdir() if "locks" not in path.name] == []


def test_a_folder_of_runs_that_takes_no_run(tmp_path: Path) -> None:
    (tmp_path / "d").write_text("in the way")
    done = command("run", "home", "--name", "d", "--runs", tmp_path)
    assert done.returncode == 7
    assert f"{tmp_path}/d" in done.stderr


@pytest.mark.wall
@pytest.mark.usefixtures("faster_than_a_drive")
def test_a_plain_cell_file_on_simulated_devices_is_a_simulated_run(tmp_path: Path) -> None:
    ports = {name: free_port() for name in ("rail", "robot", "tracker")}
    values = shop_values(f"socket://localhost:{ports['rail']}", ports["robot"], ports["tracker"])
    asked = ",".join(f"{name}={port}" for name, port in ports.items())
    with sim_command("--speed", "max", "--ports", asked) as simulated:
        assert simulated.addresses["rail"] == {"channel": f"socket://127.0.0.1:{ports['rail']}"}
        assert simulated.addresses["robot"]["port"] == ports["robot"]
        run = ran(tmp_path, "home", values, "--cell", shop_cell(tmp_path), name="r")
    assert run.end["exit"] == 0, run.done.stderr
    assert run.result["simulated"] is True
    first, *rest = run.events
    assert first["simulated"] is False  # the plan states what is known before anything is opened
    (connected,) = [e for e in rest if e["kind"] == "event" and e["what"] == "connected"]
    assert [each["simulated"] for each in connected["devices"]] == [True] * 4
    kinds = [each["kind"] for each in connected["devices"]]
    assert kinds == ["drive", "strip", "robot", "tracker"]
    (row,) = json.loads(command("runs", "--json", "--runs", tmp_path).stdout)["runs"]
    assert row["simulated"] is True
    command("report", "r", "--runs", tmp_path, "-o", tmp_path / "r.html")
    assert "SIMULATION." in (tmp_path / "r.html").read_text("utf-8")


def test_a_taken_port_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = int(taken.getsockname()[1])
        done = command("sim", "--ports", f"tracker={port}")
    assert (done.returncode, done.stdout) == (2, "")
    assert f"port {port} " in done.stderr
