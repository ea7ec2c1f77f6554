from __future__ import annotations

import socket
import time

import pytest

from drivers.rail_canopen import CanopenRail
from hilcell.ports import DeviceError
from tests.drivers.peers import Server, wall_clock


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_a_gateway_that_hangs_up_while_connecting_is_told(frames: int) -> None:
    """Wherever in the connecting it happens, reading or writing: a lost link, told within 2 s."""

    def hangs_up(connection: socket.socket) -> None:
        heard = 0
        while heard < frames and (data := connection.recv(100)):
            heard += data.count(b"t")
        connection.shutdown(socket.SHUT_RDWR)

    with Server(hangs_up) as server:
        options = {"channel": f"socket://127.0.0.1:{server.port}", "travel_min_mm": 0.0}
        rail = CanopenRail(
            CanopenRail.Options(
                **options,
                travel_max_mm=1.0,
                speed_mm_s=1.0,
                acceleration_mm_s2=1.0,  # type: ignore[arg-type]
            ),
            wall_clock(),
        )
        started_s = time.monotonic()
        with pytest.raises(
            DeviceError, match=r"Rail: (CAN: link lost:|connect: slcan) .*; check the "
        ):
            rail.connect()
        assert time.monotonic() - started_s < 2.0
