"""Two spellings of one place are one place."""

import socket
import threading
from pathlib import Path

import pytest

import hilcell.cell.addresses as places_module
from hilcell.cell.addresses import places
from hilcell.cell.devices import device_addresses
from hilcell.cell.file import load_cell


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST.", "127.0.0.1", "::1", "::ffff:127.0.0.1"]
)
def test_all_names_of_this_machine_are_one_place(host: str) -> None:
    assert places({"host": host, "port": 7000}) == ["this machine:7000"]


def test_a_url_and_host_with_port_are_one_place() -> None:
    assert places({"channel": "socket://10.0.0.1:3000"}) == places(
        {"host": "10.0.0.1", "port": 3000}
    )
    assert places({"channel": "socket://[::1]:3000"}) == ["this machine:3000"]


def test_ports_with_names_of_their_own_are_places_each() -> None:
    named = {"host": "10.0.0.3", "rtde_port": 30004, "script_port": 30002, "rate_hz": 125.0}
    assert places(named) == ["10.0.0.3:30004", "10.0.0.3:30002"]
    assert places(named | {"port": 7}) == ["10.0.0.3:7"]


def test_a_link_to_a_serial_port_is_that_port(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to("ttyUSB0")
    plain = places({"channel": f"{tmp_path}/ttyUSB0"})
    assert plain == [f"{tmp_path.resolve()}/ttyUSB0"]
    assert places({"channel": f"{tmp_path}/by-id@115200"}) == plain
    assert places({"channel": f"{tmp_path}/../{tmp_path.name}/ttyUSB0"}) == plain


def test_com_ports_and_can_interfaces() -> None:
    assert places({"channel": "com3@115200"}) == places({"channel": "COM3"}) == ["COM3"]
    assert places({"channel": "can0", "bitrate": 1}) == ["can0"]


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


def test_devices_at_one_place_are_named_together() -> None:
    one = load_cell("paper", {"robot.options.port": "700"})
    assert device_addresses(one, {})["this machine:700"] == ["robot", "tracker"]


def test_the_line_of_a_strip_is_a_place_beside_the_bus() -> None:
    line = {"driver": "serial", "channel": "socket://10.0.0.1:4001"}
    bus = "socket://10.0.0.1:3000"
    assert places({"channel": bus, "strip": line}) == ["10.0.0.1:3000", "10.0.0.1:4001"]
    assert places({"full_mm_s": 1890.0, "strip": line}) == ["10.0.0.1:4001"]
    assert places({"channel": bus, "strip": None}) == ["10.0.0.1:3000"]
