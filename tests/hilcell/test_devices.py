"""A driver's options: the table's values are handed on, and stand in the file once."""

import pytest

from hilcell.cell import load_cell
from hilcell.devices import check_options, driver_options
from hilcell.settings import SettingsError


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


def test_a_simulator_says_where_its_devices_listen() -> None:
    _, options = driver_options(load_cell("paper"), "robot", "robots", {"host": "::1", "port": 5})
    assert (getattr(options, "host"), getattr(options, "port")) == ("::1", 5)  # noqa: B009
