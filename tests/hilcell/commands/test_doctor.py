"""`doctor`: each check can fail, names what it found and says what to do."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import socket
import sys
import time
from importlib import resources
from pathlib import Path
from types import SimpleNamespace

import pytest

from hilcell.alarms.catalogue import catalogue
from hilcell.cell.addresses import THIS_MACHINE, places
from hilcell.commands import doctor, this_pc
from hilcell.commands.cli import main
from hilcell.run.cell_lock import lock_of_device, locked
from tests.hilcell.cell.packages import install


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(this_pc, "WAKES", 2)


def test_a_sound_pc_is_found_sound(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code = main(["doctor", "--json", "--runs", str(tmp_path), "--cell", "paper"])
    found = json.loads(capsys.readouterr().out)
    states = {each["check"]: each["state"] for each in found["checks"]}
    assert found["ok"] is (code == 0) is ("wrong" not in states.values())
    assert states["python"] == states["ports"] == states["disk"] == states["cell"] == "ok"
    assert states["drivers"] == "ok"
    assert len(states) == 13


def test_every_act_is_shown(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=20_000_000))
    assert main(["doctor", "--runs", str(tmp_path)]) == 2
    lines = capsys.readouterr().out.splitlines()
    row = next(n for n, line in enumerate(lines) if line.startswith("WRONG  disk"))
    assert lines[row + 1].strip() == "-> make 20 MB of room: a run needs it"


def test_a_missing_package_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(this_pc, "requires", lambda _: ["numpy>=2.0", "nosuchpackage<6,>=5"])
    found = this_pc.python()
    assert (found.state, found.found.rpartition(" ")[2]) == ("wrong", "nosuchpackage")


@pytest.mark.parametrize("group", ["robots", "simulated_rails", "programs", "program_writers"])
def test_a_part_of_a_driver_that_cannot_be_loaded_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, group: str
) -> None:
    install(tmp_path, f"[hilcell.{group}]\nmine = nosuchpackage.robot:Robot\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = {each.check: each for each in doctor._of_this_pc(tmp_path)}["drivers"]
    assert found.state == "warning"
    assert found.found == f"{group}: 'mine' cannot be loaded: No module named 'nosuchpackage'"


def test_alarms_of_a_package_that_cannot_be_read_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    install(tmp_path, "[hilcell.alarms]\nmine = nosuchpackage.alarms\n")
    monkeypatch.syspath_prepend(tmp_path)
    catalogue.cache_clear()
    found = {each.check: each for each in doctor._of_this_pc(tmp_path)}["drivers"]
    catalogue.cache_clear()
    assert found.state == "warning"
    assert found.found.startswith("alarms of nosuchpackage.alarms cannot be read: No module")


def test_an_older_python_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(this_pc, "LEAST_PYTHON", (sys.version_info[0], sys.version_info[1] + 1))
    assert this_pc.python().state == "wrong"


@pytest.mark.parametrize(
    ("environment", "columns", "rows", "state"),
    [
        ({"TERM": "xterm"}, 60, 15, "ok"),
        ({"TERM": "xterm"}, 59, 24, "warning"),
        ({"TERM": "xterm"}, 80, 14, "warning"),
        ({"TERM": "xterm", "LC_ALL": "C"}, 80, 24, "warning"),
        ({}, 80, 24, "warning"),
    ],
)
def test_terminals(environment: dict[str, str], columns: int, rows: int, state: str) -> None:
    assert this_pc.terminal(environment, columns, rows).state == state


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


def test_the_nearest_mount_counts_whatever_its_name(tmp_path: Path) -> None:
    """The kernel writes a space in the name of a mount as \\040 (proc(5))."""
    share, mounts = tmp_path.resolve() / "my runs", tmp_path / "mounts"
    (share / "more").mkdir(parents=True)
    written = str(share).replace(" ", r"\040")
    mounts.write_text(f"/dev/sda / ext4 rw 0 0\nserver:/x {written} cifs rw 0 0\n")
    assert this_pc.disk(share / "more", mounts).state == "wrong"
    mounts.write_text(f"server:/ / nfs rw 0 0\n/dev/sdb {written} ext4 rw 0 0\n")
    assert this_pc.disk(share / "more", mounts).state == "ok"


@pytest.mark.parametrize(
    ("free_bytes", "state"),
    [
        (1_100_000_000, "ok"),
        (900_000_000, "warning"),
        (20_500_000, "warning"),
        (20_000_000, "wrong"),
    ],
)
def test_a_disk_needs_room_for_a_run_and_should_have_a_gigabyte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_bytes: int, state: str
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free_bytes))
    found = this_pc.disk(tmp_path, tmp_path / "no mounts")
    assert (found.state, f"{free_bytes / 1e9:.2f} GB free" in found.found) == (state, True)


def test_a_folder_that_is_none_is_wrong(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    assert this_pc.disk(file / "runs").state == "wrong"


def test_a_clock_behind_the_newest_run_is_wrong(tmp_path: Path) -> None:
    assert this_pc.clock(tmp_path).state != "wrong"
    (tmp_path / "run").mkdir()
    os.utime(tmp_path / "run", (time.time() + 3600.0,) * 2)
    assert this_pc.clock(tmp_path).state == "wrong"


@pytest.mark.parametrize(("answer", "state"), [(0, "ok"), (5, "warning"), (-1, "warning")])
def test_a_clock_that_nothing_sets_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: int, state: str
) -> None:
    kernel = SimpleNamespace(adjtimex=lambda _: answer)
    monkeypatch.setattr(ctypes, "CDLL", lambda _: kernel)
    assert this_pc.clock(tmp_path).state == state


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


def test_a_port_that_may_only_be_read_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ttyUSB0").touch()
    assert doctor._file("rail", tmp_path / "ttyUSB0").state == "ok"
    monkeypatch.setattr(os, "access", lambda _, mode: mode == os.R_OK)
    assert doctor._file("rail", tmp_path / "ttyUSB0").state == "wrong"


def test_a_driver_that_names_no_place_is_not_called_wrong() -> None:
    [place] = places({"usb_serial": "A1"})
    assert doctor._in_use_or("tracker", place).state == "ok"


def test_a_cell_without_a_rail_has_no_place_of_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text((resources.files("hilcell.cells") / "fixed.toml").read_text("utf-8")
                    .partition("[simulation]")[0])  # fmt: skip
    main(["doctor", "--json", "--runs", str(tmp_path), "--cell", str(cell)])
    checks = [each["check"] for each in json.loads(capsys.readouterr().out)["checks"]]
    assert not [check for check in checks if "rail" in check]


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
