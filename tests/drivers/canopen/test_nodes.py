"""Nodes: who they are, and when they count as started."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from canopen.sdo.exceptions import SdoAbortedError

from drivers.canopen.cia import NodeCommand, NodeState
from drivers.canopen.nodes import Expected, identify, start_nodes
from drivers.canopen.sdo import Aborted, SdoChannel
from hilcell.ports import is_simulated_name


@pytest.mark.parametrize("name", ["simulated", "SIMULATED KR210", "drive (Simulated)"])
def test_the_word_counts_in_any_case(name: str) -> None:
    assert is_simulated_name(name)
    assert not is_simulated_name("KR210")


class Node:
    """A node's objects, as an SDO channel reads them."""

    def __init__(self, name: bytes | None, revision: int | None = None) -> None:
        self.name, self.revision = name, revision

    def read(self, index: int, sub: int) -> int:
        if (index, sub) == (0x1018, 3):
            if self.revision is None:
                raise Aborted("read 1018h:03", SdoAbortedError(0x06090011))
            return self.revision
        return {1: 0x484, 2: 0x402, 4: 4711}[sub] if index == 0x1018 else 0

    def read_if_present(self, index: int, sub: int) -> int | None:
        try:
            return self.read(index, sub)
        except Aborted:
            return None

    def read_bytes(self, index: int) -> bytes:
        if index != 0x1008 or self.name is None:
            raise Aborted("read 1008h:00", SdoAbortedError(0x06020000))
        return self.name


@pytest.mark.parametrize(
    ("name", "simulated"),
    [(None, False), (b"servo", False), (b"a rail drive (simulated)", True), (b"\xff", False)],
)
def test_a_node_is_simulated_by_its_device_name(name: bytes | None, simulated: bool) -> None:
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


def test_a_state_of_before_is_no_answer_to_a_start() -> None:
    sent = list[NodeCommand]()
    node: Any = SimpleNamespace(number=5, state=NodeState.OPERATIONAL)

    def command(order: NodeCommand) -> None:
        sent.append(order)
        node.state = NodeState.OPERATIONAL

    node.command = command
    link: Any = SimpleNamespace(time=SimpleNamespace(listened_s=0.0), check=lambda: None)
    start_nodes(link, [node], lambda: None)
    assert sent == [NodeCommand.START]
