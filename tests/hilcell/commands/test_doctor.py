"""`doctor`: each check can fail, names what it found and says what to do."""

from __future__ import annotations

import json
import os
import socket
import time
from importlib import resources
from pathlib import Path

import pytest

from hilcell.cell.addresses import THIS_MACHINE
from hilcell.commands import doctor, this_pc
from hilcell.commands.cli import main
from hilcell.run.cell_lock import lock_of_device, locked


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(this_pc, "WAKES", 2)


def test_a_sound_pc_is_found_sound(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code = main(["doctor", "--json", "--runs", str(tmp_path), "--cell", "paper"])
    found = json.loads(capsys.readouterr().out)
    states = {each["check"]: each["state"] for each in found["checks"]}
    assert found["ok"] is (code == 0) is ("wrong" not in states.values())
    assert states["python"] == states["ports"] == states["disk"] == states["cell"] == "ok"
    assert len(states) == 12


def test_every_act_is_shown(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(this_pc, "LEAST_FREE_GB", 1e9)
    assert main(["doctor", "--runs", str(tmp_path)]) == 2
    lines = capsys.readouterr().out.splitlines()
    row = next(n for n, line in enumerate(lines) if line.startswith("WRONG  disk"))
    assert lines[row + 1].split() == ["->", "make", "1e+09", "GB", "of", "room"]


def test_a_missing_package_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(this_pc, "requires", lambda _: ["numpy>=2.0", "nosuchpackage<6,>=5"])
    found = this_pc.python()
    assert (found.state, found.found.rpartition(" ")[2]) == ("wrong", "nosuchpackage")


@pytest.mark.parametrize(
    ("environment", "columns", "state"),
    [
        ({"TERM": "xterm"}, 80, "ok"),
        ({"TERM": "xterm"}, 59, "warning"),
        ({"TERM": "xterm", "LC_ALL": "C"}, 80, "warning"),
        ({}, 80, "warning"),
    ],
)
def test_terminals(environment: dict[str, str], columns: int, state: str) -> None:
    assert this_pc.terminal(environment, columns, 24).state == state


@pytest.mark.parametrize(("operstate", "state"), [("up", "ok"), ("down", "warning")])
def test_can_interfaces(tmp_path: Path, operstate: str, state: str) -> None:
    for name, kind in (("can7", "280"), ("eth0", "1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
        (tmp_path / name / "operstate").write_text(f"{operstate}\n")
    found = this_pc.can(tmp_path)
    assert (found.state, found.found) == (state, f"can7 {operstate}")
    assert ("sudo ip link set can7 up" in found.do) is (state == "warning")


def test_a_serial_port_that_may_not_be_opened_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ttyUSB0").touch()
    assert this_pc.serial_ports(tmp_path).state == "ok"
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert str(tmp_path / "ttyUSB0") in this_pc.serial_ports(tmp_path).found
    assert this_pc.serial_ports(tmp_path).state == "warning"


def test_a_shared_disk_is_wrong(tmp_path: Path) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/sda / ext4 rw 0 0\nserver:/x {tmp_path.resolve()} nfs4 rw 0 0\n")
    assert "shared over a network (nfs4)" in this_pc.disk(tmp_path, mounts).found
    mounts.write_text("/dev/sda / ext4 rw 0 0\n")
    assert this_pc.disk(tmp_path, mounts).state == "ok"


def test_a_folder_that_is_none_is_wrong(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    assert this_pc.disk(file / "runs").state == "wrong"


def test_a_clock_behind_the_newest_run_is_wrong(tmp_path: Path) -> None:
    assert this_pc.clock(tmp_path).state != "wrong"
    (tmp_path / "run").mkdir()
    os.utime(tmp_path / "run", (time.time() + 3600.0,) * 2)
    assert this_pc.clock(tmp_path).state == "wrong"


def test_a_pc_that_wakes_late_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert this_pc.pace().check == "pace"
    monkeypatch.setattr(this_pc, "LATE_S", 0.0)
    assert this_pc.pace().state == "warning"


def test_a_device_that_listens_is_reached_and_one_that_does_not_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = f"{THIS_MACHINE}:{server.getsockname()[1]}"
        assert doctor._in_use_or("tracker", place).state == "ok"
    found = doctor._in_use_or("tracker", place)
    assert (found.state, found.found) == ("wrong", "no connection: Connection refused")


def test_a_device_that_a_run_uses_is_left_alone() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        place = f"{THIS_MACHINE}:{server.getsockname()[1]}"
        with locked(lock_of_device(place), "tracker", "20260101-1"):
            found = doctor._in_use_or("tracker", place)
        assert found.state == "ok"
        assert "20260101-1" in found.found
        with pytest.raises(BlockingIOError):
            server.accept()


@pytest.mark.parametrize("place", ["can99", "/dev/nosuchport"])
def test_a_place_that_is_not_there_is_wrong(place: str) -> None:
    assert doctor._in_use_or("rail", place).state == "wrong"


def test_places_of_a_real_cell_are_checked(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(
        resources.files("hilcell.cells")
        .joinpath("paper.toml")
        .read_text("utf-8")
        .partition("[simulation]")[0]
    )
    code = main(["doctor", "--json", "--runs", str(tmp_path), "--cell", str(cell),
                 "--set", "robot.options.port=9"])  # fmt: skip
    checks = [each["check"] for each in json.loads(capsys.readouterr().out)["checks"]]
    assert code == 2
    assert checks[-3].startswith("rail at ")
    assert checks[-2] == f"robot at {THIS_MACHINE}:9"
