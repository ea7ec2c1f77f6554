"""The wires of a rail as its cell file names them: slcan over TCP, on serial lines, two buses."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.canopen import nodes
from tests.whole.bench import command, ran, sets, shop_cell, simulation

pytestmark = pytest.mark.waits

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
    run = ran(tmp_path, "home", values)
    assert run.end["exit"] == 0, run.done.stderr
    assets = {each.kind: each for each in run.log.assets}
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
        cell.strike("rail.strip_silent", count=0)
        run = ran(tmp_path, "home", values | {"simulation.address": cell.control})
    assert run.end["exit"] == 3
    assert "node 6 (strip)" in run.done.stderr + run.done.stdout


@pytest.mark.wall
@pytest.mark.usefixtures("faster_than_a_drive")
def test_a_real_cell_file_names_serial_lines(tmp_path: Path) -> None:
    cell = shop_cell(tmp_path)
    with simulation(values=ON_LINES) as simulated:
        rail = simulated.addresses["rail"]
        values = simulated.shop | {
            "rail.options.channel": f"{rail['channel']}@115200",
            "rail.options.strip.driver": "canopen",
            "rail.options.strip.channel": f"{rail['strip']['channel']}@115200",
        }
        for name in "ab":  # a line has no connection: the gateway's channel may still be open
            run = ran(tmp_path, "home", values, "--cell", cell, name=name)
            assert run.end["exit"] == 0, run.done.stderr
    assert command("check", cell, *sets(values | {"rail.options.interface": "usb"})).returncode == 2
    socketcan = {"rail.options.interface": "socketcan", "rail.options.channel": "can0"}
    assert command("check", cell, *sets(values | socketcan)).returncode == 0
