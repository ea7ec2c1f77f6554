"""``run --record-wire``: each device of a cell is reached through a relay that records its wire."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, cast

import msgspec

from hilcell.cell.devices import stated_options
from hilcell.cell.file import Cell
from hilcell.errors import HilcellError
from hilcell.ports import Clock
from hilcell.wire.channel import addressed, can_interfaces, wires_of
from hilcell.wire.recording import (
    CLOCK,
    SUFFIX,
    Head,
    RecordedLooks,
    Recorder,
    TimedStop,
    recordings,
)
from hilcell.wire.relay import WireOrder

Addresses = Mapping[str, Mapping[str, object]]


class WireRecording:
    """The relay process of one run; ``addresses`` replace those of the devices.

    ``left_out`` names devices whose wires cannot be recorded here, with the reason.
    """

    def __init__(self, cell: Cell, addresses: Addresses, folder: Path, head: Head) -> None:
        """Start the relay; raises `HilcellError` where it cannot reach a serial line."""
        self.left_out: dict[str, str] = {}
        folder, began_s = self._unused(folder), time.monotonic()
        stated = stated_options(cell, addresses)
        orders = [
            WireOrder(name, str(folder / f"{name}{SUFFIX}"), began_s, place)
            for name, place in wires_of(stated).items()
        ]
        for table, options in stated.items():
            if cans := can_interfaces(options):
                self.left_out[table] = "; ".join(
                    f"{channel} is a CAN interface: record it with `candump -l {channel}`"
                    for channel in cans
                )
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "hilcell.wire.relay"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        self.addresses: Addresses = addressed(stated, self._channels(orders))
        self._looks = (folder / f"{CLOCK}{SUFFIX}").open("ab")
        self._recorder = Recorder(self._looks, began_s)
        self._recorder.take(0, "run", msgspec.json.encode(head))

    def clock(self, clock: Clock, stop: TimedStop) -> Clock:
        """Return the cell's clock as one whose looks are recorded: wires are paired by them."""
        return RecordedLooks(clock, self._recorder, stop)

    def close(self, exit_code: int | None = None) -> None:
        """End the relay, and state how the run has ended."""
        if exit_code is not None:
            self._recorder.take(0, "over", b"%d" % exit_code)
        self._recorder.close()
        self._looks.close()
        end_s = 5.0
        try:
            self._process.communicate(timeout=end_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()

    def _channels(self, orders: list[WireOrder]) -> dict[str, str]:
        stdin, stdout = cast("IO[bytes]", self._process.stdin), self._process.stdout
        stdin.write(msgspec.json.encode(orders) + b"\n")
        stdin.flush()
        line = cast("IO[bytes]", stdout).readline()
        if not line:
            _, words = self._process.communicate()
            last = words.decode(errors="replace").strip().rpartition("\n")[2]
            raise HilcellError(f"--record-wire: the relay did not start: {last}")
        return msgspec.json.decode(line, type=dict[str, str])

    @staticmethod
    def _unused(folder: Path) -> Path:
        """Return a folder without recordings: a run that is resumed has one of its own."""
        found, number = folder, 1
        while recordings(found):
            number += 1
            found = folder / f"wires-{number}"
        found.mkdir(exist_ok=True)
        return found
