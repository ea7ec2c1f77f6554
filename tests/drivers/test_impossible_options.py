"""What no device can have is refused with the cell file, before anything is opened."""

from __future__ import annotations

import pytest

from drivers.canopen.slcan_bus import BIT_RATES
from hilcell.cell.devices import check_options
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError

OTHER = {"kuka-c3": "robot", "kuka-eki": "robot", "leica-emscon": "tracker", "t2sa": "tracker"}
RATES = f"found {{}}; allowed: {', '.join(map(str, BIT_RATES))}"
BAUD = "a baud rate is wanted behind @, found '/dev/ttyS0@{}'; allowed: 50 to 4000000"
HOST = "host: letters of a host name or of an IP address, no port, are wanted, found {!r}"
SOCKET = "channel: socket://HOST:PORT is wanted, found {!r}; allowed ports: 1 to 65535"
KERNEL = "the kernel's name of a CAN interface is wanted, found {!r}"
STRIP = '{{driver = "{}", channel = "{}", bitrate = {}}}'


def problems(cell: str, changed: dict[str, str]) -> str:
    """Return what `check` and `run` say of a cell with these settings."""
    with pytest.raises(SettingsError) as refused:
        check_options(load_cell(cell, changed))
    return "\n".join(refused.value.problems)


@pytest.mark.parametrize("bitrate", ["12345", "0", "-1", "999999"])
def test_a_bit_rate_that_slcan_lacks(bitrate: str) -> None:
    found = problems("paper", {"rail.options.bitrate": bitrate})
    assert f"bitrate: a bit rate of slcan is wanted, {RATES.format(bitrate)}" in found
    strip = STRIP.format("canopen", "socket://h:1", bitrate)
    assert RATES.format(bitrate) in problems("paper", {"rail.options.strip": strip})


@pytest.mark.parametrize("baud", ["0", "4000001"])
@pytest.mark.parametrize("driver", ["canopen", "strip", "leica-geocom"])
def test_a_baud_rate_that_no_line_has(baud: str, driver: str) -> None:
    channel = f"/dev/ttyS0@{baud}"
    changed = {
        "canopen": {"rail.options.channel": channel},
        "strip": {"rail.options.strip": STRIP.format("serial", channel, 500_000)},
        "leica-geocom": {"tracker.driver": driver, "tracker.options.channel": channel},
    }[driver]
    assert BAUD.format(baud) in problems("paper", changed)


@pytest.mark.parametrize(
    "channel",
    ["socket://h:0", "socket://h:65536", "socket://h:nan", "socket://h:-1", "socket://:1",
     "socket://a b:1", "socket://h:1/x", "socket://me@h:1", "tcp://h:1"],
)  # fmt: skip
def test_a_socket_that_cannot_be(channel: str) -> None:
    assert SOCKET.format(channel) in problems("paper", {"rail.options.channel": channel})


@pytest.mark.parametrize("name", ["", "/dev/ttyS0", "a b", "x" * 16])
def test_a_name_that_no_can_interface_has(name: str) -> None:
    can = {"rail.options.interface": "socketcan", "rail.options.channel": name}
    assert KERNEL.format(name) in problems("paper", can)
    kernels = {"rail.options.channel": "can0", "rail.options.bitrate": "12345"}
    check_options(load_cell("paper", can | kernels))  # which has a bit rate of its own


@pytest.mark.parametrize(
    ("driver", "host"),
    [("kuka-c3", ""), ("kuka-eki", " "), ("leica-emscon", "10.0.0.1:7000"), ("t2sa", "http://h"),
     ("ur-rtde", "/dev/ttyS0"), ("ur-rtde", "a b")],
)  # fmt: skip
def test_a_host_that_cannot_be(driver: str, host: str) -> None:
    table = OTHER.get(driver, "robot")
    cell = "lab" if driver == "ur-rtde" else "paper"
    changed = {f"{table}.driver": driver, f"{table}.options.host": host}
    assert HOST.format(host) in problems(cell, changed)


@pytest.mark.parametrize("host", ["::1", "fe80::1%eth0", "10.0.0.1", "tracker-1.plant.example"])
def test_hosts_that_may_be(host: str) -> None:
    check_options(load_cell("paper", {"tracker.options.host": host}))
    check_options(load_cell("paper", {"robot.options.host": host}))


@pytest.mark.parametrize(
    ("driver", "port"),
    [("kuka-c3", "0"), ("kuka-eki", "65536"), ("leica-emscon", "nan"), ("t2sa", "-1")],
)
def test_a_port_that_cannot_be(driver: str, port: str) -> None:
    changed = {f"{OTHER[driver]}.driver": driver, f"{OTHER[driver]}.options.port": port}
    assert "allowed: >= 1, <= 65535" in (found := problems("paper", changed)) or "finite" in found


def test_the_two_ports_of_a_kuka_controller_differ() -> None:
    eki = {"robot.driver": "kuka-eki", "robot.options.port": "54601"}
    assert "stop_port: 54601 is that of port, too" in problems("paper", eki)


def test_a_strip_has_no_more_counts_than_a_nanometre_each() -> None:
    found = problems("paper", {"rail.options.strip_counts_per_mm": "1e300"})
    assert "strip_counts_per_mm: a number is wanted, found 1e+300; allowed: > 0, <= 1e+06" in found
