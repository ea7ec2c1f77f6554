"""`doctor`: each check can fail, and says what to do."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import socket
import sys
import time
from contextlib import closing
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fakes.abb.server import AbbServer
from fakes.kuka.c3_server import C3Server
from hilcell.alarms.catalogue import catalogue
from hilcell.cell.devices import THIS_MACHINE
from hilcell.cell.file import load_cell
from hilcell.commands import doctor
from hilcell.run.cell_lock import lock_of_device, locked
from tests.fakes.conftest import served, simulated_site
from tests.fakes.wires import C3Client
from tests.hilcell.cell.packages import install
from tests.whole.bench import command, sim_command
from tests.whole.halls import FREE_PORTS

pytestmark = pytest.mark.waits


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "WAKES", 2)


def checks(folder: Path, *words: str) -> dict[str, dict[str, Any]]:
    """Return each check by its name; exit code and answer agree on whether all is sound."""
    done = command("doctor", "--json", "--runs", folder, *words)
    found = json.loads(done.stdout)
    assert found["ok"] is (done.returncode == 0)
    states = [each["state"] for each in found["checks"]]
    assert found["ok"] is ("wrong" not in states)
    return {each["check"]: each for each in found["checks"]}


def of_cell(folder: Path, *settings: str, name: str = "paper") -> dict[str, dict[str, Any]]:
    """Return the checks of a cell's places, by the place."""
    found = whole_cell(folder, *settings, name=name)
    return {key.partition(" at ")[2]: each for key, each in found.items() if " at " in key}


def whole_cell(folder: Path, *settings: str, name: str = "paper") -> dict[str, dict[str, Any]]:
    cell = folder / "cell.toml"
    text = (resources.files("hilcell.cells") / f"{name}.toml").read_text("utf-8")
    cell.write_text(text.partition("[simulation]")[0])
    given = [word for each in settings for word in ("--set", each)]
    return checks(folder, "--cell", str(cell), *given)


def test_a_sound_pc_is_sound(tmp_path: Path) -> None:
    states = {name: each["state"] for name, each in checks(tmp_path, "--cell", "paper").items()}
    assert len(states) == 13
    for name in ("python", "ports", "disk", "cell", "drivers"):
        assert states[name] == "ok"


def test_every_act_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=20_000_000))
    done = command("doctor", "--runs", tmp_path)
    lines = done.stdout.splitlines()
    row = next(n for n, line in enumerate(lines) if line.startswith("WRONG  disk"))
    assert done.returncode == 2
    assert "20 MB" in lines[row + 1]


def test_python_and_its_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "requires", lambda _: ["numpy>=2.0", "nosuchpackage<6,>=5"])
    found = doctor.python()
    assert (found.state, found.found.rpartition(" ")[2]) == ("wrong", "nosuchpackage")
    monkeypatch.setattr(doctor, "requires", lambda _: [])
    monkeypatch.setattr(doctor, "LEAST_PYTHON", (sys.version_info[0], sys.version_info[1] + 1))
    assert doctor.python().state == "wrong"


@pytest.mark.parametrize("group", ["robots", "simulated_rails", "program_writers", "alarms"])
def test_a_part_of_a_driver_that_cannot_be_loaded_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, group: str
) -> None:
    entry = "nosuchpackage" if group == "alarms" else "nosuchpackage.robot:Robot"
    install(tmp_path, f"[hilcell.{group}]\nmine = {entry}\n")
    monkeypatch.syspath_prepend(tmp_path)
    catalogue.cache_clear()
    found = checks(tmp_path)["drivers"]
    catalogue.cache_clear()
    assert found["state"] == "warning"
    assert found["found"].startswith(group)
    assert "nosuchpackage" in found["found"]


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
    assert doctor.terminal(environment, columns, rows).state == state


@pytest.mark.parametrize(("operstate", "state"), [("up", "ok"), ("down", "warning")])
def test_can_interfaces(tmp_path: Path, operstate: str, state: str) -> None:
    for name, kind in (("can7", "280"), ("eth0", "1")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
        (tmp_path / name / "operstate").write_text(f"{operstate}\n")
    found = doctor.can(tmp_path)
    assert (found.state, found.found) == (state, f"can7 {operstate}")
    assert ("can7" in found.do) is (state == "warning")


def test_a_serial_port_that_may_not_be_opened_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    channel = f'rail.options.channel="{port}"'
    assert doctor.serial_ports(tmp_path).state == "ok"
    assert of_cell(tmp_path, channel)[str(port)]["state"] == "ok"
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != port or mode == os.R_OK)
    assert str(port) in doctor.serial_ports(tmp_path).found
    assert doctor.serial_ports(tmp_path).state == "warning"
    assert of_cell(tmp_path, channel)[str(port)]["state"] == "wrong"


@pytest.mark.parametrize(
    ("mounts", "state"),
    [
        ("/dev/sda / ext4 rw 0 0\nserver:/x {runs} nfs4 rw 0 0\n", "wrong"),
        ("/dev/sda / ext4 rw 0 0\nserver:/x {runs} cifs rw 0 0\n", "wrong"),
        ("/dev/sda / ext4 rw 0 0\n", "ok"),
        ("server:/ / nfs rw 0 0\n/dev/sdb {runs} ext4 rw 0 0\n", "ok"),  # the nearest counts
    ],
)
def test_a_shared_disk_is_wrong_whatever_its_name(tmp_path: Path, mounts: str, state: str) -> None:
    """The kernel writes a space in the name of a mount as \\040 (proc(5))."""
    share, file = tmp_path.resolve() / "my runs", tmp_path / "mounts"
    (share / "more").mkdir(parents=True)
    file.write_text(mounts.format(runs=str(share).replace(" ", r"\040")))
    found = doctor.disk(share / "more", file)
    assert (found.state, "network file system" in found.found) == (state, state == "wrong")


@pytest.mark.parametrize(
    ("free_bytes", "state"),
    [(1_100_000_000, "ok"), (900_000_000, "warning"), (20_500_000, "warning"),
     (20_000_000, "wrong")],
)  # fmt: skip
def test_a_disk_needs_room_for_a_run_and_should_have_a_gigabyte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_bytes: int, state: str
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free_bytes))
    assert doctor.disk(tmp_path, tmp_path / "no mounts").state == state
    file = tmp_path / "file"
    file.touch()
    assert doctor.disk(file / "runs").state == "wrong"


@pytest.mark.parametrize(
    ("answer", "ahead_s", "state"),
    [(0, 0.0, "ok"), (5, 0.0, "warning"), (-1, 0.0, "warning"), (0, 3600.0, "wrong")],
)
def test_a_clock_that_nothing_sets_or_behind_the_newest_run_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: int, ahead_s: float, state: str
) -> None:
    kernel = SimpleNamespace(adjtimex=lambda _: answer)
    monkeypatch.setattr(ctypes, "CDLL", lambda _: kernel)
    (tmp_path / "run").mkdir()
    os.utime(tmp_path / "run", (time.time() + ahead_s,) * 2)
    assert doctor.clock(tmp_path).state == state


def test_a_pc_that_wakes_late_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "LATE_S", 0.0)
    assert doctor.pace().state == "warning"


def test_a_device_that_listens_is_reached_and_one_in_use_is_left_alone(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        port = server.getsockname()[1]
        place, setting = f"{THIS_MACHINE}:{port}", f"robot.options.port={port}"
        with locked(lock_of_device(place), "tracker", "20260101-1"):
            found = of_cell(tmp_path, setting)[place]
        assert (found["state"], "20260101-1" in found["found"]) == ("ok", True)
        with pytest.raises(BlockingIOError):
            server.accept()
        assert of_cell(tmp_path, setting)[place]["state"] == "ok"
    assert of_cell(tmp_path, setting)[place]["state"] == "wrong"


@pytest.mark.parametrize("place", ["can99", "/dev/nosuchport"])
def test_a_place_that_is_not_there_is_wrong(tmp_path: Path, place: str) -> None:
    assert of_cell(tmp_path, f'rail.options.channel="{place}"')[place]["state"] == "wrong"


def test_a_cell_without_a_rail_has_no_place_of_it(tmp_path: Path) -> None:
    found = of_cell(tmp_path, name="fixed")
    assert found
    assert not any("rail" in each["check"] for each in found.values())


NARROW = "[[-185, 185], [-139, -5], [-120, 168], [-350, 350], [-125, 125], [-350, 350]]"


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({}, []),
        ({"tool_off_mm": "[0.0, 0.0, 20.0]"}, ["98.000, Y 0.000, Z 147.000", "20.000 mm apart"]),
        ({"limits_deg": NARROW}, ["A2", "-139.000 to -5.000 deg", "-140 to"]),
        ({"limits_deg": NARROW.replace("-139", "-150")}, []),
    ],
)
def test_tool_and_limits_of_a_controller_are_compared(
    tmp_path: Path, entries: dict[str, str], words: list[str]
) -> None:
    """Narrower limits refuse motions that the plan allows; wider ones hinder nothing."""
    sizes = {f"simulation.sizes.controller.{key}": text for key, text in entries.items()}
    with served(C3Server, C3Client, load_cell("paper", sizes)) as robot:
        given = 'robot.options.host="127.0.0.1"', f"robot.options.port={robot.server.port}"
        found = whole_cell(tmp_path, *given)["robot's settings"]
    assert found["state"] == ("wrong" if words else "ok"), found
    assert all(word in found["found"] for word in words), found


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("", []),
        ('robot.name="IRB 6700-150/3.20"', ["IRB 6700-235/2.65", "IRB 6700-150/3.20"]),
        ('robot.options.model="IRB 6700-150"', ["IRB 6700-235/2.65", "IRB 6700-150"]),
        ('robot.options.egm_device="EgmSensor"', ["UCdevice", "EgmSensor"]),
        ("robot.options.web_services=2", ["web_services = 1"]),
    ],
)
def test_what_the_driver_needs_of_a_controller_is_named(
    tmp_path: Path, entry: str, words: list[str]
) -> None:
    site, _ = simulated_site(load_cell("abb"))
    with closing(AbbServer(site)) as server:
        server.start()
        given = ['robot.options.host="127.0.0.1"', f"robot.options.port={server.address['port']}"]
        checked = whole_cell(tmp_path, *given, *filter(None, [entry]), name="abb")
        found = checked["robot's settings"]
    assert found["state"] == ("wrong" if words else "ok"), found
    assert all(word in found["found"] + found["do"] for word in words), found
    assert not site.truth.robot.moving


@pytest.mark.process
def test_the_devices_of_a_running_simulated_cell_are_looked_at_like_real_ones(
    tmp_path: Path,
) -> None:
    with sim_command("--cell", "abb", "--ports", FREE_PORTS) as hall:
        at = ("--cell", "abb", "--set", f"simulation.address={hall.control}")
        sound = checks(tmp_path, *at)
        other = checks(tmp_path, *at, "--set", "robot.options.model=IRB 4600")
    assert sound["robot's settings"]["state"] == "ok"
    assert other["robot's settings"]["state"] == "wrong"
    assert "IRB 4600" in other["robot's settings"]["found"]
    assert checks(tmp_path, *at)["cell"]["do"] == "start `hilcell sim`"
