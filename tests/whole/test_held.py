"""A slide is confirmed held at the end, also by a drive that has missed the PC's heartbeat."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path

import pytest

from drivers.canopen.cia import NodeState
from drivers.canopen.rail import CanopenRail
from hilcell.run.stopping import close_all
from tests.drivers.peers import soon
from tests.whole.bench import simulation
from tests.whole.sweeper import Engine

pytestmark = pytest.mark.waits


@pytest.mark.parametrize("beats_again", [True, False])
def test_a_drive_that_missed_the_heartbeat_of_a_busy_pc_is_confirmed_held(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, beats_again: bool
) -> None:
    """It brakes and falls to PRE-OPERATIONAL by itself, where it sends no PDO (CiA 301, 1029h)."""
    with simulation() as cell, ExitStack() as stack:
        engine = Engine(cell.control, tmp_path, stack)
        rail = engine.devices.rail
        assert isinstance(rail, CanopenRail)
        rail.home()
        rail.move_to(300.0)
        assert rail.read().powered
        link, (drive, strip) = rail._link, rail._nodes
        assert link is not None
        busy = threading.Event()
        busy.set()
        send = link._send_beat
        monkeypatch.setattr(link, "_send_beat", lambda at: None if busy.is_set() else send(at))
        assert soon(lambda: drive.state == NodeState.PRE_OPERATIONAL)
        assert strip.state == NodeState.OPERATIONAL
        if beats_again:
            busy.clear()
        assert close_all(engine.devices) == {}
        assert rail.statistics().held_by_sdo
