"""A Universal Robot's stop over both wires, and dashboard servers that are too old or absent."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import pytest

from drivers.device_errors import ROBOT
from drivers.universal_robots.robot_rtde import Release, UrRtdeRobot
from hilcell.cell.file import load_cell
from hilcell.clock import WallClock
from hilcell.ports import DeviceError, DeviceRefused
from tests.drivers.peers import Server, kind, refusal

PANEL_GONE = ROBOT.broken("panel", "stop", "the panel has gone")
LINK_GONE = ROBOT.broken("link", "stop", "the link has gone")


@pytest.mark.parametrize(
    ("panel", "link"),
    [(None, None), (PANEL_GONE, None), (None, LINK_GONE), (PANEL_GONE, LINK_GONE)],
)
def test_a_stop_goes_over_both_wires_and_fails_where_neither_takes_it(
    panel: DeviceError | None, link: DeviceError | None
) -> None:
    wires = Mock(), Mock()
    wires[0].end_script.side_effect, wires[1].send.side_effect = link, panel
    stop = Release(*wires, session=7).stop
    if panel and link:
        assert refusal(stop) is panel
    else:
        stop()
    wires[0].end_script.assert_called_once_with(7)
    wires[1].send.assert_called_once_with("stop")


OLD = {
    "PolyscopeVersion": "URSoftware 5.4.2.76197 (Jul 2019)",
    "is in remote control": "true",
}
MODEL, SERIAL = {"get robot model": "UR10"}, {"get serial number": "2019350001"}


@contextlib.contextmanager
def panel(answers: dict[str, str]) -> Iterator[int]:
    """Serve a dashboard that knows only some questions; return its port."""

    def serve(wire: socket.socket) -> None:
        wire.sendall(b"Connected: Universal Robots Dashboard Server\n")
        with wire.makefile("rb") as lines:
            for line in lines:
                asked = line.decode().strip()
                answer = answers.get(asked, f"could not understand: '{asked}'")
                wire.sendall(f"{answer}\n".encode())

    with Server(serve) as server:
        yield server.port


def robot_at(port: int, **options: Any) -> UrRtdeRobot:
    return UrRtdeRobot(
        UrRtdeRobot.Options(
            host="127.0.0.1",
            smr_mm=(0.0, 0.0, 0.0),
            joint=load_cell("lab").robot.joint,
            dashboard_port=port,
            rtde_port=port,
            **options,
        ),
        WallClock(threading.Event()),
    )


@pytest.mark.parametrize(
    ("answers", "untold"),
    [(OLD, "model"), (OLD | SERIAL, "model"), (OLD | MODEL, "serial number"), (SERIAL, "model")],
)
@pytest.mark.parametrize("model", ["UR10", "understand"])
def test_a_polyscope_that_does_not_have_the_questions_is_too_old(
    answers: dict[str, str], untold: str, model: str
) -> None:
    with panel(answers) as port:
        found = refusal(robot_at(port, model=model, serial="2019350001").connect)
    assert kind(found) == (DeviceRefused, "HC-B69")
    assert f"does not tell its {untold}" in found.found
    assert answers.get("PolyscopeVersion", "unknown") in found.found
    assert {"3.12", "5.6"} <= set(found.expected.replace(",", "").split())


def test_a_robot_whose_dashboard_refuses_connections_may_have_polyscope_x() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    found = refusal(robot_at(port).connect)
    assert found.code == "HC-B01"
    assert "PolyScope X, which has no dashboard server" in found.act
