"""What no device can have is refused with the cell file, before anything is opened."""

from __future__ import annotations

import pytest

from hilcell.cell.devices import check_options
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError

TABLES = {"ur-rtde": "robot", "kuka-c3": "robot", "kuka-eki": "robot"}
BITRATE = "rail.options.bitrate"
CHANNEL = "rail.options.channel"
STRIP = '{{driver = "{}", channel = "{}", bitrate = {}}}'


def check(changed: dict[str, str], cell: str = "paper") -> None:
    check_options(load_cell(cell, changed))


def refused(changed: dict[str, str], key: str, cell: str = "paper") -> None:
    """See that `check` and `run` refuse settings of a cell, by their key."""
    with pytest.raises(SettingsError) as error:
        check(changed, cell)
    (problem,) = error.value.problems
    assert f"{key}: " in problem


@pytest.mark.parametrize("bitrate", ["12345", "0", "-1"])
def test_a_bit_rate_that_slcan_lacks(bitrate: str) -> None:
    refused({BITRATE: bitrate}, "bitrate")
    refused({"rail.options.strip": STRIP.format("canopen", "socket://h:1", bitrate)}, "bitrate")


@pytest.mark.parametrize("baud", ["0", "4000001"])
def test_a_baud_rate_that_no_line_has(baud: str) -> None:
    channel = f"/dev/ttyS0@{baud}"
    refused({CHANNEL: channel}, "channel")
    refused({"rail.options.strip": STRIP.format("serial", channel, 500_000)}, "channel")
    refused({"tracker.driver": "leica-geocom", "tracker.options.channel": channel}, "channel")


@pytest.mark.parametrize(
    "channel",
    ["socket://h:0", "socket://h:65536", "socket://h:nan", "socket://:1", "socket://a b:1",
     "socket://h:1/x", "socket://me@h:1", "tcp://h:1"],
)  # fmt: skip
def test_a_socket_that_cannot_be(channel: str) -> None:
    refused({CHANNEL: channel}, "channel")


@pytest.mark.parametrize("name", ["", "/dev/ttyS0", "a b", "x" * 16])
def test_a_name_that_no_can_interface_has(name: str) -> None:
    kernels = {"rail.options.interface": "socketcan"}
    refused(kernels | {CHANNEL: name}, "channel")
    check(kernels | {CHANNEL: "can0", BITRATE: "12345"})  # it has a bit rate of its own


@pytest.mark.parametrize(
    ("driver", "key", "value"),
    [
        ("kuka-c3", "host", ""), ("kuka-eki", "host", " "), ("ur-rtde", "host", "/dev/ttyS0"),
        ("leica-emscon", "host", "10.0.0.1:7000"), ("t2sa", "host", "http://h"),
        ("kuka-c3", "port", "0"), ("kuka-eki", "port", "65536"), ("leica-emscon", "port", "nan"),
        ("t2sa", "port", "-1"),
    ],
)  # fmt: skip
def test_a_host_or_a_port_that_cannot_be(driver: str, key: str, value: str) -> None:
    table = TABLES.get(driver, "tracker")
    cell = "lab" if driver == "ur-rtde" else "paper"
    refused({f"{table}.driver": driver, f"{table}.options.{key}": value}, key, cell)


@pytest.mark.parametrize("host", ["::1", "fe80::1%eth0", "10.0.0.1", "tracker-1.plant.example"])
def test_hosts_that_may_be(host: str) -> None:
    check({"tracker.options.host": host, "robot.options.host": host})


def test_the_two_ports_of_a_kuka_controller_differ() -> None:
    refused({"robot.driver": "kuka-eki", "robot.options.port": "54601"}, "stop_port")


def test_a_strip_has_no_more_counts_than_a_nanometre_each() -> None:
    refused({"rail.options.strip_counts_per_mm": "1e300"}, "strip_counts_per_mm")
