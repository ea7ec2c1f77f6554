"""A robot's stop goes over each wire that there is, and fails only where none takes it."""

from unittest.mock import Mock

import pytest

from drivers.device_errors import ROBOT
from drivers.universal_robots.robot_rtde import Release
from hilcell.ports import DeviceError

PANEL_GONE = ROBOT.broken("panel", "stop", "the panel has gone")
LINK_GONE = ROBOT.broken("link", "stop", "the link has gone")


@pytest.mark.parametrize(("panel", "link"), [(None, None), (PANEL_GONE, None), (None, LINK_GONE)])
def test_a_stop_that_one_wire_takes_is_sent(
    panel: DeviceError | None, link: DeviceError | None
) -> None:
    wires = Mock(), Mock()
    wires[0].end_script.side_effect, wires[1].send.side_effect = link, panel
    Release(*wires, session=7).stop()
    wires[0].end_script.assert_called_once_with(7)
    wires[1].send.assert_called_once_with("stop")


def test_a_stop_that_no_wire_takes_is_an_error() -> None:
    wires = Mock(), Mock()
    wires[0].end_script.side_effect, wires[1].send.side_effect = LINK_GONE, PANEL_GONE
    with pytest.raises(DeviceError, match="the panel has gone"):
        Release(*wires, session=7).stop()
    wires[0].end_script.assert_called_once_with(7)
