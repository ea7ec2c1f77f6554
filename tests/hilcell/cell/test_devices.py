"""A driver's options: the table's values are handed on, and stand in the file once."""

import sys
from collections.abc import Callable
from pathlib import Path
from threading import Event

import msgspec
import pytest

from hilcell.cell.devices import (
    abilities,
    build_devices,
    check_options,
    driver_options,
    placeholder_addresses,
)
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.clock import WallClock
from tests.hilcell.cell.packages import ENTRIES, WHOLE, install


def test_options_may_not_state_again_what_the_table_states() -> None:
    cell = load_cell(
        "paper",
        {
            "rail.options.speed_mm_s": "500.0",
            "rail.options.bitrat": "500000",
            "tracker.options.max_std_mm": "0.5",
            "robot.options.smr_mm": "[0.0, 0.0, 0.0]",
        },
    )
    with pytest.raises(SettingsError) as caught:
        check_options(cell)
    assert [problem.split(": ")[:2] for problem in caught.value.problems] == [
        ["rail.options", "speed_mm_s"],
        ["rail.options", "bitrat"],
        ["robot.options", "smr_mm"],
        ["tracker.options", "max_std_mm"],
    ]


@pytest.fixture
def plant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Callable[..., Cell]:
    """Return a function that installs a driver, changed in one place, and its cell."""

    def installed(old: str = "", new: str = "") -> Cell:
        install(tmp_path, ENTRIES.format("plant_0"), plant_0=WHOLE.replace(old, new))
        monkeypatch.syspath_prepend(tmp_path)
        request.addfinalizer(lambda: sys.modules.pop("plant_0", None))
        return load_cell("paper", {"robot.driver": "mine"})

    return installed


@pytest.mark.parametrize(
    ("broken", "named"),
    [
        (("import msgspec", "import nosuchpackage"), "nosuchpackage"),
        (("class Robot", "class Robots"), "plant_0"),
        (("import msgspec", "import msgspec\nnosuch"), "NameError"),
        (("def serve(", "def ("), "SyntaxError"),
        (("def stop", "def halt"), "stop"),
        (("class Options", "class Option"), "Options"),
        (("lever_mm: float = 1.0", "lever_mm: float"), "lever_mm"),
        (("lever_mm: float", 'lever_mm: "Nonsense"'), "Nonsense"),
        ((", speed_percent", ""), "move_to"),
        ((", clock", ""), "__init__"),
    ],
)
def test_a_driver_that_is_broken_is_refused_with_its_cause(
    broken: tuple[str, str], named: str, plant: Callable[..., Cell]
) -> None:
    cell = plant(*broken)
    with pytest.raises(SettingsError) as caught:
        check_options(cell)
    assert named in caught.value.problems[0]


def test_a_driver_that_cannot_be_built_is_refused_with_its_line(
    plant: Callable[..., Cell],
) -> None:
    cell = plant("clock): ...", "clock): raise ValueError('no such thing')")
    with pytest.raises(SettingsError) as caught:
        build_devices(cell, placeholder_addresses(cell), WallClock(Event()))
    (problem,) = caught.value.problems
    assert problem.startswith("robot.driver: ")
    assert "plant_0.py, line 9" in problem


def test_a_whole_driver_is_taken(plant: Callable[..., Cell]) -> None:
    check_options(plant())


def test_a_simulator_says_where_its_devices_listen() -> None:
    _, options = driver_options(load_cell("paper"), "robot", {"host": "::1", "port": 5})
    values = msgspec.structs.asdict(options)
    assert (values["host"], values["port"]) == ("::1", 5)


def test_a_simulated_device_of_another_protocol_is_named() -> None:
    with pytest.raises(SettingsError, match="channel"):
        driver_options(load_cell("paper"), "robot", {"channel": "/dev/pts/1"})


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("simulation.machine", "nosuch", ("machine",)),
        ("simulation.address", "nobody", ("address",)),
        ("rail.options.channel", "socket://127.0.0.1:99999", ("channel",)),
        ("rail.options.channel", "http://x", ("channel",)),
        ("rail.options.channel", "/dev/ttyUSB0@fast", ("channel",)),
        ("robot.options.port", "700", ("robot", "tracker", "700")),  # two devices at one address
        ("robot.options.port", "29536", ("robot", "rail", "29536")),
    ],
)
def test_what_can_never_run_is_refused_before_a_run(
    key: str, value: str, named: tuple[str, ...]
) -> None:
    with pytest.raises(SettingsError) as caught:
        check_options(load_cell("paper", {key: value}))
    (problem,) = caught.value.problems
    assert all(word in problem for word in named)


def test_a_network_of_can_has_no_syntax_of_a_serial_line() -> None:
    check_options(load_cell("paper", {"rail.options.channel": "/dev/ttyUSB0@115200"}))
    words = {"rail.options.interface": "socketcan", "rail.options.channel": "can0"}
    check_options(load_cell("paper", words))


def test_what_the_drivers_can_is_known_before_anything_is_opened() -> None:
    able = dict.fromkeys(
        (
            "tracker_streams",
            "tracker_turns_over",
            "tracker_searches",
            "tracker_aims",
            "robot_sweeps",
        ),
        True,
    )
    assert abilities(load_cell("paper")) == able


def test_a_simulated_cell_need_not_say_where_its_devices_are() -> None:
    drivers = {"rail.driver": '"canopen"', "tracker.driver": "leica-emscon"}
    cell = load_cell("paper", drivers)
    unplaced = msgspec.structs.replace(
        cell, rail=msgspec.structs.replace(cell.rail, options={}),
        tracker=msgspec.structs.replace(cell.tracker, options={"serial": "402871"}),
    )  # fmt: skip
    check_options(unplaced)
    with pytest.raises(SettingsError) as caught:
        check_options(msgspec.structs.replace(unplaced, simulation=None))
    assert ["channel" in caught.value.problems[0], "host" in caught.value.problems[1]] == [True] * 2


def test_a_rail_that_rides_on_a_robot_wants_one_that_moves_a_slide() -> None:
    check_options(load_cell("paper", {"rail.driver": "kuka-e1"}))
    with pytest.raises(SettingsError, match=r"rail\.driver: 'kuka-e1' .*'ur-rtde'"):
        check_options(load_cell("lab", {"rail.driver": "kuka-e1"}))
