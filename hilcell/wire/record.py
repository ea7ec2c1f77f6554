"""``run --record-wire``: each device of a cell is reached through a relay that records its wire."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, cast

import msgspec

from hilcell.cell.devices import TABLES, driver_options
from hilcell.cell.file import Cell
from hilcell.errors import HilcellError
from hilcell.ports import Clock
from hilcell.wire.channel import SerialLine, Socket, parse_channel
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

# A wire has a name within its device: "" for ``channel``, or for ``host`` with ``port``; ``rtde``
# for ``rtde_port``; ``strip`` for that of a part with a table of its own. A recording of a wire
# is named by its device and itself: ``robot.wire.jsonl``, ``robot.rtde.wire.jsonl``.

PORT = "port"


def wires_of(options: Mapping[str, object]) -> dict[str, Socket | SerialLine]:
    """Return where a device's wires lead, by name; a CAN interface of the kernel is left out."""
    found: dict[str, Socket | SerialLine] = {}
    host, channel = options.get("host"), options.get("channel")
    for key, value in options.items():
        if isinstance(value, Mapping):
            found |= {joined(key, name): place for name, place in wires_of(value).items()}
        elif isinstance(host, str) and isinstance(value, int) and _is_port(key):
            found[key.removesuffix(PORT).removesuffix("_")] = Socket(host, value)
    if isinstance(channel, str) and not is_can_interface(options):
        found[""] = parse_channel(channel)
    return found


def addressed(options: Mapping[str, object], channels: Mapping[str, str]) -> dict[str, object]:
    """Return the values of a driver's options with which its wires lead to ``channels``."""
    found: dict[str, object] = {}
    for name, channel in channels.items():
        part, place = options.get(name), parse_channel(channel)
        if isinstance(part, Mapping):
            found[name] = {**part, **addressed(part, {"": channel})}
        elif "host" in options and isinstance(place, Socket):
            found |= {"host": place.host, f"{name}_{PORT}".lstrip("_"): place.port}
        else:
            found["channel"] = channel
    return found


def is_can_interface(options: Mapping[str, object]) -> bool:
    """Whether the channel is an interface of the kernel, which no relay can stand before."""
    return options.get("interface") == "socketcan"


def can_interfaces(options: Mapping[str, object]) -> list[str]:
    """Return the CAN interfaces of the kernel that a device, or a part of it, is reached by."""
    parts = [part for part in options.values() if isinstance(part, Mapping)]
    return [str(part["channel"]) for part in (options, *parts) if is_can_interface(part)]


def joined(*names: str) -> str:
    """Return the name of a wire of a part, or among those of its cell."""
    return ".".join(filter(None, names))


def _is_port(key: str) -> bool:
    return key == PORT or key.endswith(f"_{PORT}")


Addresses = Mapping[str, Mapping[str, object]]


class WireRecording:
    """The relay process of one run; ``addresses`` replace those of the devices.

    ``left_out`` names devices whose wires cannot be recorded here, with the reason.
    """

    def __init__(self, cell: Cell, addresses: Addresses, folder: Path, head: Head) -> None:
        """Start the relay; raises `HilcellError` where it cannot reach a serial line."""
        self.left_out: dict[str, str] = {}
        folder, began_s = _unused(folder), time.monotonic()
        stated: dict[str, dict[str, object]] = {}
        orders: list[WireOrder] = []
        for table, group in TABLES:
            _, options = driver_options(cell, table, group, addresses.get(table, {}))
            stated[table] = msgspec.to_builtins(options)
            for wire, place in wires_of(stated[table]).items():
                name = joined(table, wire)
                file = folder / f"{name}{SUFFIX}"
                orders.append(WireOrder.of(name, file, began_s, place))
            if cans := can_interfaces(stated[table]):
                self.left_out[table] = "; ".join(
                    f"{channel} is a CAN interface: record it with `candump -l {channel}`"
                    for channel in cans
                )
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "hilcell.wire"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        channels: dict[str, dict[str, str]] = {table: {} for table in stated}
        for name, channel in self._channels(orders).items():
            table, _, wire = name.partition(".")
            channels[table][wire] = channel
        self.addresses = {
            table: dict(addresses.get(table, {})) | addressed(stated[table], found)
            for table, found in channels.items()
        }
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


def _unused(folder: Path) -> Path:
    """Return a folder without recordings: a run that is resumed has one of its own."""
    found, number = folder, 1
    while recordings(found):
        number += 1
        found = folder / f"wires-{number}"
    found.mkdir(exist_ok=True)
    return found
