"""Identities of devices, and whether they report that they are simulated."""

import struct
from collections.abc import Iterator
from functools import partial
from typing import cast

import pytest
from canopen.sdo.exceptions import SdoAbortedError

from drivers.canopen.rail_setup import Expected, identify
from drivers.canopen.sdo import Aborted, SdoChannel
from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.ports import Identity, says_simulated
from tests.drivers.emscon_peer import EmsconPeer, failure, reply
from tests.drivers.kuka_peer import KukaPeer
from tests.drivers.peers import wall_clock
from tests.drivers.test_robot_kuka_c3 import robot_for


@pytest.mark.parametrize("name", ["simulated", "SIMULATED KR210", "drive (Simulated)"])
def test_the_word_counts_in_any_case(name: str) -> None:
    assert says_simulated(name)
    assert not says_simulated("KR210")


@pytest.fixture
def tracker() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        yield peer


def tracker_identity(peer: EmsconPeer) -> Identity:
    options = LeicaEmsconTracker.Options(
        host="127.0.0.1",
        port=peer.server.port,
        reflector="SMR 1.5in",
        max_std_mm=0.05,
        find_radius_mm=5.0,
    )
    device = LeicaEmsconTracker(options, wall_clock())
    (identity,) = device.connect()
    device.close()
    return identity


def answer(body: bytes, _request: bytes) -> list[bytes]:
    return [reply(132, body)]


def test_a_tracker_tells_its_name(tracker: EmsconPeer) -> None:
    for name, simulated in (("AT401", False), ("AT401 (simulated)", True)):
        field = name.encode("utf-16-le").ljust(64, b"\0")
        tracker.answers[132] = partial(answer, struct.pack("<I64s", 8, field) + bytes(80))
        identity = tracker_identity(tracker)
        assert identity.model == f"Leica {name}, emScon 3.8.900"
        assert identity.simulated is simulated


def test_a_tracker_need_not_have_a_name(tracker: EmsconPeer) -> None:
    tracker.answers[132] = lambda _: [failure(132, 2)]
    assert tracker_identity(tracker).model == "Leica, emScon 3.8.900"
    assert not tracker_identity(tracker).simulated


@pytest.mark.parametrize(
    ("model", "simulated"),
    [("#KR210R2700_2 C4 FLR", False), ("#KR210R2700_2 C4 FLR SIMULATED", True)],
)
def test_a_robot_tells_by_its_model(model: str, simulated: bool) -> None:
    with KukaPeer(**{"$TRAFONAME[]": f'"{model}"'}) as peer:
        robot = robot_for(peer)
        (identity,) = robot.connect()
        robot.close()
    assert (identity.model, identity.simulated) == (model, simulated)


class Node:
    """A node's objects, as an SDO channel reads them."""

    def __init__(self, name: bytes | None, revision: int | None = None) -> None:
        self.name, self.revision = name, revision

    def read(self, index: int, sub: int) -> int:
        if (index, sub) == (0x1018, 3):
            if self.revision is None:
                raise Aborted("Rail", "read 1018h:03", SdoAbortedError(0x06090011))
            return self.revision
        return {1: 0x484, 2: 0x402, 4: 4711}[sub] if index == 0x1018 else 0

    def read_bytes(self, index: int) -> bytes:
        if index != 0x1008 or self.name is None:
            raise Aborted("Rail", "read 1008h:00", SdoAbortedError(0x06020000))
        return self.name


@pytest.mark.parametrize(
    ("name", "simulated"),
    [(None, False), (b"servo", False), (b"a rail drive (simulated)", True), (b"\xff", False)],
)
def test_a_node_tells_by_its_device_name(name: bytes | None, simulated: bool) -> None:
    """1008h is optional."""
    expected = Expected("drive", 5, 402, 0x484, 0x402, 0)
    identity = identify(cast("SdoChannel", Node(name)), expected, 0x00020192, "can0")
    assert identity.simulated is simulated
    assert identity.serial == "4711"


@pytest.mark.parametrize(("revision", "firmware"), [(None, ""), (0x0003_0012, "revision 3.18")])
def test_a_node_is_an_asset(revision: int | None, firmware: str) -> None:
    """The revision, 1018h:03, is optional."""
    expected = Expected("strip", 6, 406, 0x484, 0x402, 0)
    identity = identify(cast("SdoChannel", Node(None, revision)), expected, 0x196, "can0")
    assert (identity.device, identity.kind, identity.maker) == ("Rail", "strip", "vendor 0x484")
    assert identity.firmware == firmware
