from __future__ import annotations

import socket
import time

import pytest

from drivers.canopen.rail import CanopenRail
from hilcell.ports import DeviceError
from tests.drivers.can_peer import CanPeer
from tests.drivers.peers import Server, wall_clock


def rail_at(channel: str) -> CanopenRail:
    options = CanopenRail.Options(
        channel=channel,
        travel_min_mm=0.0,
        travel_max_mm=1.0,
        speed_mm_s=1.0,
        acceleration_mm_s2=1.0,
    )
    return CanopenRail(options, wall_clock())


def test_nobody_listening_is_named() -> None:
    with CanPeer() as peer:
        channel = peer.channel
    with pytest.raises(DeviceError, match="Rail: connect: slcan socket://"):
        rail_at(channel).connect()


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_a_gateway_that_hangs_up_while_connecting_is_reported(frames: int) -> None:
    """Anywhere in the connecting, reading or writing: a lost link, reported within 2 s."""

    def hangs_up(connection: socket.socket) -> None:
        heard = 0
        while heard < frames and (data := connection.recv(100)):
            heard += data.count(b"t")
        connection.shutdown(socket.SHUT_RDWR)

    with Server(hangs_up) as server:
        rail = rail_at(f"socket://127.0.0.1:{server.port}")
        started_s = time.monotonic()
        with pytest.raises(
            DeviceError, match=r"Rail: (CAN: link lost:|connect: slcan) .*; check the "
        ):
            rail.connect()
        assert time.monotonic() - started_s < 2.0
