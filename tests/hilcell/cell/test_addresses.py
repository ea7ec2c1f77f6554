"""Two spellings of one place are one place."""

import socket
import threading
from pathlib import Path

import pytest

import hilcell.cell.devices as places_module
from hilcell.cell.devices import device_addresses, places
from hilcell.cell.file import load_cell

LINE = {"driver": "serial", "channel": "socket://10.0.0.1:4001"}
BUS = "socket://10.0.0.1:3000"
NAMED = {"host": "10.0.0.3", "rtde_port": 30004, "script_port": 30002, "rate_hz": 125.0}
HERE = ("localhost", "LOCALHOST.", "127.0.0.1", "::1", "::ffff:127.0.0.1")


@pytest.mark.parametrize(
    ("options", "found"),
    [
        *(({"host": host, "port": 7000}, ["this machine:7000"]) for host in HERE),
        ({"channel": BUS}, ["10.0.0.1:3000"]),  # a URL is a host with a port
        ({"host": "10.0.0.1", "port": 3000}, ["10.0.0.1:3000"]),
        ({"channel": "socket://[::1]:3000"}, ["this machine:3000"]),
        (NAMED, ["10.0.0.3:30004", "10.0.0.3:30002"]),
        (NAMED | {"port": 7}, ["10.0.0.3:7"]),
        ({"channel": "com3@115200"}, ["COM3"]),
        ({"channel": "COM3"}, ["COM3"]),
        ({"channel": "can0", "bitrate": 1}, ["can0"]),
        ({"channel": BUS, "strip": LINE}, ["10.0.0.1:3000", "10.0.0.1:4001"]),
        ({"full_mm_s": 1890.0, "strip": LINE}, ["10.0.0.1:4001"]),
        ({"channel": BUS, "strip": None}, ["10.0.0.1:3000"]),
    ],
)
def test_options_of_a_driver_state_these_places(
    options: dict[str, object], found: list[str]
) -> None:
    assert places(options) == found


def test_a_link_to_a_serial_port_is_that_port(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to("ttyUSB0")
    plain = places({"channel": f"{tmp_path}/ttyUSB0"})
    assert plain == [f"{tmp_path.resolve()}/ttyUSB0"]
    assert places({"channel": f"{tmp_path}/by-id@115200"}) == plain
    assert places({"channel": f"{tmp_path}/../{tmp_path.name}/ttyUSB0"}) == plain


def test_a_host_with_several_addresses_is_at_each(monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(host: str, *_: object, **__: object) -> list[tuple[object, ...]]:
        return [(0, 0, 0, "", (address, 0)) for address in ("192.0.2.1", "192.0.2.2")]

    monkeypatch.setattr(socket, "getaddrinfo", answer)
    both = places({"host": "tracker", "port": 700})
    assert set(places({"host": "192.0.2.2", "port": 700})) < set(both)


@pytest.mark.parametrize("url", ["socket://x:99999", "socket://[x", "socket://"])
def test_a_url_that_is_none_is_left_to_the_driver(url: str) -> None:
    assert len(places({"channel": url})) == 1


def test_a_name_server_that_hangs_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    answered = threading.Event()

    def hang(*_: object, **__: object) -> list[object]:
        answered.wait()
        return []

    monkeypatch.setattr(socket, "getaddrinfo", hang)
    monkeypatch.setattr(places_module, "RESOLVE_S", 0.01)
    try:
        assert places({"host": "Tracker", "port": 700}) == ["tracker:700"]
    finally:
        answered.set()


def test_defaults_of_the_driver_are_part_of_the_place() -> None:
    """paper states no port for robot and tracker: the drivers know them."""
    stated = load_cell("paper", {"robot.options.port": "7000", "robot.options.host": "localhost"})
    assert device_addresses(load_cell("paper"), {}) == device_addresses(stated, {})
    assert device_addresses(stated, {})["this machine:7000"] == ["robot"]
    one = load_cell("paper", {"robot.options.port": "700"})
    assert device_addresses(one, {})["this machine:700"] == ["robot", "tracker"]
