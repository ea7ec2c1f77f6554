"""A stop may come from any thread, also while the thread that uses the device closes its wire."""

from unittest.mock import Mock

import pytest

from drivers.canopen.rail import CanopenRail
from drivers.kuka.robot import KukaRobot
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from drivers.leica.tracker_geocom import LeicaGeocomTracker
from drivers.spatialanalyzer.tracker_t2sa import T2saTracker

Device = CanopenRail | KukaRobot | LeicaEmsconTracker | LeicaGeocomTracker | T2saTracker


@pytest.mark.parametrize(
    ("kind", "wire", "sends"),
    [
        (CanopenRail, "_image", "quick_stop"),
        (KukaRobot, "_controller", "stop"),
        (LeicaEmsconTracker, "_link", "send"),
        (LeicaGeocomTracker, "_lines", "send"),
        (T2saTracker, "_lines", "send"),
    ],
)
def test_the_stop_goes_to_the_wire_that_was_open_when_it_came(
    kind: type[Device], wire: str, sends: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Mock()
    seen = [opened]  # closed by the second look
    monkeypatch.setattr(kind, wire, property(lambda _: seen.pop() if seen else None), raising=False)
    device: Device = object.__new__(kind)
    device.stop()
    getattr(opened, sends).assert_called_once()
