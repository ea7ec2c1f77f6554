"""``run --record-wire``: each device of a cell is reached through a relay that records its wire."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import IO, cast

import msgspec

from hilcell.cell.devices import TABLES, driver_options
from hilcell.cell.file import Cell
from hilcell.errors import HilcellError
from hilcell.wire.channel import SerialLine, Socket, parse_channel
from hilcell.wire.recording import SUFFIX
from hilcell.wire.relay import WireOrder

Addresses = Mapping[str, Mapping[str, object]]
END_S = 5.0


class WireRecording:
    """The relay process of one run; ``addresses`` replace those of the devices.

    ``left_out`` names devices whose wires cannot be recorded here, with the reason.
    """

    def __init__(self, cell: Cell, addresses: Addresses, folder: Path) -> None:
        """Start the relay; raises `HilcellError` where it cannot reach a serial line."""
        self.left_out: dict[str, str] = {}
        orders: dict[str, WireOrder] = {}
        stated: dict[str, dict[str, object]] = {}
        for table, group in TABLES:
            _, options = driver_options(cell, table, group, addresses.get(table, {}))
            stated[table] = msgspec.to_builtins(options)
            try:
                place = _place(stated[table])
            except ValueError as error:
                self.left_out[table] = str(error)
                continue
            if place is not None:
                orders[table] = _order(table, place, folder)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "hilcell.wire"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        channels = self._channels(list(orders.values()))
        self.addresses = {table: dict(each) for table, each in addresses.items()}
        for table, channel in channels.items():
            self.addresses.setdefault(table, {}).update(_address(stated[table], channel))

    def close(self) -> None:
        """End the relay."""
        try:
            self._process.communicate(timeout=END_S)
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


def _place(options: Mapping[str, object]) -> Socket | SerialLine | None:
    """Return where a driver's options lead, None for no wire at all.

    Raises `ValueError` for a wire of another kind.
    """
    host, port, channel = (options.get(key) for key in ("host", "port", "channel"))
    if isinstance(host, str) and isinstance(port, int):
        return Socket(host, port)
    if options.get("interface") == "socketcan":
        raise ValueError(f"{channel} is a CAN interface: record it with `candump -l {channel}`")
    return parse_channel(channel) if isinstance(channel, str) else None


def _order(table: str, place: Socket | SerialLine, folder: Path) -> WireOrder:
    file = str(folder / f"{table}{SUFFIX}")
    if isinstance(place, Socket):
        return WireOrder(table, file, host=place.host, port=place.port)
    return WireOrder(table, file, path=place.path, baud=place.baud)


def _address(options: Mapping[str, object], channel: str) -> dict[str, object]:
    """Return a channel in the words of a driver's options."""
    place = parse_channel(channel)
    if "host" in options and isinstance(place, Socket):
        return {"host": place.host, "port": place.port}
    return {"channel": channel}
