"""A driver's options: the table's values are handed on, and stand in the file once."""

import sys
from pathlib import Path
from threading import Event

import msgspec
import pytest

from hilcell.cell.devices import abilities, build_devices, check_options, driver_options, stand_ins
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.clock import WallClock
from tests.hilcell.cell.packages import ENTRIES, WHOLE, install
from tests.whole.bench import command


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
    rail, typo, robot, tracker = caught.value.problems
    assert rail == (
        "rail.options: speed_mm_s: 500.0 here, but rail.speed_mm_s is 250.0; "
        "state it in [rail] only"
    )
    assert typo == 'rail.options: bitrat: unknown key; did you mean "bitrate"?'
    assert "smr_mm: [0.0, 0.0, 0.0] here, but robot.smr_mm is (98.0, 0.0, 127.0)" in robot
    assert "max_std_mm: 0.5 here, but tracker.max_std_mm is 0.05" in tracker


@pytest.mark.parametrize(
    ("broken", "found"),
    [
        (("import msgspec", "import nosuchpackage"), "cannot be loaded: No module named 'nosuch"),
        (("class Robot", "class Robots"), "cannot be loaded: module 'plant_0' has no attribute"),
        (("import msgspec", "import msgspec\nnosuch"), "cannot be loaded: NameError: name 'nosuch"),
        (("def serve(", "def ("), "cannot be loaded: SyntaxError: invalid syntax"),
        (("def stop", "def halt"), "is no driver: it has no stop; see hilcell.ports.Robot"),
        (("class Options", "class Option"), "no driver: it has no Options (a msgspec.Struct); see"),
        (("(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True)", ""), "no Opt"),
        (("lever_mm: float = 1.0", "lever_mm: float"), "robot.options: lever_mm: missing"),
        (("lever_mm: float", 'lever_mm: "Nonsense"'), "that cannot be used: NameError: name 'Nons"),
        ((", speed_percent", ""), "its move_to does not take (joints_rad, speed_percent)"),
        ((", clock", ""), "no driver: its __init__ does not take (options, clock)"),
        (("import msgspec", "raise ValueError('a\\nb')"), "cannot be loaded: ValueError: a b"),
    ],
)
def test_a_driver_that_is_broken_is_refused_with_its_cause(
    broken: tuple[str, str],
    found: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    install(tmp_path, ENTRIES.format("plant_0"), plant_0=WHOLE.replace(*broken))
    monkeypatch.syspath_prepend(tmp_path)
    request.addfinalizer(lambda: sys.modules.pop("plant_0", None))
    cell = load_cell("paper", {"robot.driver": "mine"})
    with pytest.raises(SettingsError) as caught:
        check_options(cell)
    assert found in caught.value.problems[0]


def test_a_driver_that_cannot_be_built_is_refused_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    broken = WHOLE.replace("clock): ...", "clock): raise ValueError('no such thing')")
    install(tmp_path, ENTRIES.format("plant_0"), plant_0=broken)
    monkeypatch.syspath_prepend(tmp_path)
    request.addfinalizer(lambda: sys.modules.pop("plant_0", None))
    cell = load_cell("paper", {"robot.driver": "mine"})
    with pytest.raises(SettingsError) as caught:
        build_devices(cell, stand_ins(cell), WallClock(Event()))
    (problem,) = caught.value.problems
    assert problem == (
        "robot.driver: 'mine' cannot be built: ValueError: no such thing (plant_0.py, line 9)"
    )


def test_a_whole_driver_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    install(tmp_path, ENTRIES.format("plant_0"), plant_0=WHOLE)
    monkeypatch.syspath_prepend(tmp_path)
    request.addfinalizer(lambda: sys.modules.pop("plant_0", None))
    check_options(load_cell("paper", {"robot.driver": "mine"}))


def test_a_simulator_says_where_its_devices_listen() -> None:
    _, options = driver_options(load_cell("paper"), "robot", "robots", {"host": "::1", "port": 5})
    values = msgspec.structs.asdict(options)
    assert (values["host"], values["port"]) == ("::1", 5)


def test_a_simulated_device_of_another_protocol_is_named() -> None:
    with pytest.raises(SettingsError, match="robot listens at channel, unknown to driver"):
        driver_options(load_cell("paper"), "robot", "robots", {"channel": "/dev/pts/1"})


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("simulation.machine", "nosuch", "simulation.machine 'nosuch': no such file"),
        ("simulation.address", "nobody", "simulation.address: HOST:PORT is wanted"),
        ("simulation.simulator", "replay", "simulation.data: missing"),
        ("rail.options.channel", "socket://127.0.0.1:99999", "channel: socket://HOST:PORT"),
        ("rail.options.channel", "socket://", "channel: socket://HOST:PORT is wanted"),
        ("rail.options.channel", "http://x", "channel: socket://HOST:PORT is wanted"),
        ("rail.options.channel", "/dev/ttyUSB0@fast", "PATH[@BAUD] is wanted"),
        ("robot.options.port", "700", "robot and tracker share the address this machine:700"),
        ("robot.options.port", "29536", "rail and robot share the address this machine:29536"),
    ],
)
def test_what_can_never_run_is_refused_before_a_run(key: str, value: str, found: str) -> None:
    with pytest.raises(SettingsError) as caught:
        check_options(load_cell("paper", {key: value}))
    assert len(caught.value.problems) == 1
    assert found in caught.value.problems[0]


def test_a_network_of_can_has_no_syntax_of_a_serial_line() -> None:
    check_options(load_cell("paper", {"rail.options.channel": "/dev/ttyUSB0@115200"}))
    words = {"rail.options.interface": "socketcan", "rail.options.channel": "can0"}
    check_options(load_cell("paper", words))


def test_what_the_drivers_can_is_known_before_anything_is_opened() -> None:
    assert abilities(load_cell("paper")) == {"tracker_streams": True, "robot_sweeps": True}
    assert "this tracker streams: yes, this robot sweeps an axis: yes" in command(
        "check", "paper"
    ).stderr.replace("\n", " ")


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
    with pytest.raises(
        SettingsError, match=r"rail\.driver: 'kuka-e1' is an external axis .* 'ur-rtde' moves none"
    ):
        check_options(load_cell("lab", {"rail.driver": "kuka-e1"}))
