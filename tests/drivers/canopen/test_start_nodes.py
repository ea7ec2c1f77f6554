"""Nodes are started by NMT and by what they say afterwards, never by what they said before."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from drivers.canopen.cia import NodeCommand, NodeState
from drivers.canopen.nodes import start_nodes


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
