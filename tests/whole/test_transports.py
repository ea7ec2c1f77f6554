"""The wires of a rail as its cell file names them: slcan over TCP, on serial lines, two buses."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.canopen import nodes
from hilcell.journal.index import find_run
from hilcell.journal.runs import read_log
from tests.whole.bench import command, end_of, sets, simulation

pytestmark = pytest.mark.waits

PAPER = Path(__file__).parents[2] / "hilcell/cells/paper.toml"
OWN_BUS = {"rail.options.strip.driver": "canopen"}
# A cell file that names a serial line has its simulated gateway at the end of a pseudo terminal.
ON_LINES = {
    "rail.options.channel": "/dev/serial/by-id/usb-gateway",
    "rail.options.strip.driver": "canopen",
    "rail.options.strip.channel": "/dev/serial/by-id/usb-other",
}
OF_THE_KERNEL = OWN_BUS | {
    "rail.options.interface": "socketcan",
    "rail.options.channel": "can0",
    "rail.options.strip.interface": "socketcan",
    "rail.options.strip.channel": "can1",
}
E1 = {"rail.driver": "kuka-e1"} | OWN_BUS
HOME = ("run", "home", "--json", "--unattended")


@pytest.mark.parametrize(
    ("values", "drive_at", "strip_at"),
    [
        ({}, "socket://", "socket://"),
        (OWN_BUS, "socket://", "socket://"),
        (ON_LINES, "/dev/pts/", "/dev/pts/"),
        (OF_THE_KERNEL, "socket://", "socket://"),
        (E1, "127.0.0.1", "socket://"),
    ],
    ids=["one bus", "two buses", "two serial lines", "rehearsed without CAN", "E1 and a bus"],
)
def test_a_run_reaches_drive_and_strip(
    tmp_path: Path, values: dict[str, str], drive_at: str, strip_at: str
) -> None:
    done = command(*HOME, "--runs", tmp_path, *sets(values))
    assert end_of(done)["exit"] == 0, done.stderr
    assets = {each.kind: each for each in read_log(find_run(tmp_path, "last")).assets}
    assert assets["drive"].address.startswith(drive_at)
    assert assets["strip"].address.startswith(strip_at)
    buses = {assets[kind].address.split()[0] for kind in ("drive", "strip")}
    assert len(buses) == (2 if values else 1)
    assert assets["strip"].serial == "2014002"


@pytest.mark.parametrize("drive", [{}, {"rail.driver": "kuka-e1"}], ids=["canopen", "kuka-e1"])
def test_a_strip_whose_bus_falls_silent_is_named(
    tmp_path: Path, drive: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(nodes, "FIND_S", 1.0)  # it is never heard
    values = drive | OWN_BUS
    with simulation(values=values) as cell:
        cell.ask(do="fault", name="rail.strip_silent", value=True, count=0)
        words = sets(values | {"simulation.address": cell.control})
        done = command(*HOME, "--runs", tmp_path, *words)
    assert end_of(done)["exit"] == 3
    assert "node 6 (strip)" in done.stderr + done.stdout


@pytest.mark.wall
@pytest.mark.usefixtures("faster_than_a_drive")
def test_a_plant_s_cell_file_names_serial_lines(tmp_path: Path) -> None:
    cell = tmp_path / "shop.toml"
    cell.write_text(PAPER.read_text("utf-8").split("[simulation]")[0])
    with simulation(values=ON_LINES) as simulated:
        where = simulated.addresses
        values = {
            "name": "shop",
            "serial": "HC-7",
            "rail.options.channel": f"{where['rail']['channel']}@115200",
            "rail.options.strip.driver": "canopen",
            "rail.options.strip.channel": f"{where['rail']['strip']['channel']}@115200",
            "robot.options.port": str(where["robot"]["port"]),
            "tracker.options.port": str(where["tracker"]["port"]),
            "settle.rail_s": "0.0",
            "rail.standstill_dwell_s": "0.05",
        }
        words = ["--cell", str(cell), "--runs", str(tmp_path), *sets(values)]
        for _ in range(2):  # a line has no connection: the gateway's channel may still be open
            done = command(*HOME, *words)
            assert end_of(done)["exit"] == 0, done.stderr
    assert command("check", cell, *sets(values | {"rail.options.interface": "usb"})).returncode == 2
    socketcan = {"rail.options.interface": "socketcan", "rail.options.channel": "can0"}
    assert command("check", cell, *sets(values | socketcan)).returncode == 0
