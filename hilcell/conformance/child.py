"""A program that begins to move a device, to be killed: ``python -m hilcell.conformance.child``."""

from __future__ import annotations

import importlib
import select
import subprocess
import sys
import threading
from typing import IO, Any, Self, cast

import msgspec

from hilcell.cell.file import Cell
from hilcell.cell.settings import convert
from hilcell.clock import WallClock
from hilcell.conformance.acts import ACTS, Driver
from hilcell.conformance.bench import LOOK_S, Bench, Riding, Settings
from hilcell.conformance.verdicts import Broken, Port
from hilcell.typed import Json, decoded


class Made(msgspec.Struct, frozen=True):
    """A driver's class and its options."""

    module: str
    name: str
    options: Json

    @classmethod
    def of(cls, settings: Settings, **changed: object) -> Self:
        """Return the order for one, with ``changed`` options."""
        kind, options = settings
        stated = msgspec.to_builtins(msgspec.structs.replace(options, **changed))
        return cls(kind.__module__, kind.__qualname__, stated)

    def built(self, table: str) -> Driver:
        """Return it, not connected."""
        kind: Any = importlib.import_module(self.module)
        for name in self.name.split("."):
            kind = getattr(kind, name)
        options = convert(self.options, kind.Options, table)
        return kind(options, WallClock(threading.Event()))


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """Which driver moves which device, and the robot on which it rides."""

    cell: Json
    port: Port
    driver: Made
    carrier: Made | None
    path: list[str]


class Child:
    """The program, from its start to its kill."""

    def __init__(self, bench: Bench) -> None:
        self._check = bench.check_outer
        carrier = bench.carrier()
        order = Order(
            cell={k: v for k, v in msgspec.to_builtins(bench.cell).items() if v is not None},
            port=bench.port,
            driver=Made.of(bench.settings(), **bench.acts.slowly()),
            carrier=None if carrier is None else Made.of(carrier),
            path=sys.path,
        )
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "hilcell.conformance.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        stdin = cast("IO[bytes]", self._process.stdin)
        stdin.write(msgspec.json.encode(order) + b"\n")
        stdin.flush()

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *exception: object) -> None:
        self.kill()

    def wait_for(self, word: str) -> None:
        """Wait until it says a word; raises `Broken` where it ends before."""
        said_so = cast("IO[bytes]", self._process.stdout)
        while not select.select([said_so], [], [], LOOK_S)[0]:
            self._check()
        line = said_so.readline().decode().strip()
        if line != word:
            self._process.kill()
            said = self._process.communicate()[1].decode(errors="replace").strip()
            raise Broken(f"a program of its own could not use the device: {line} {said[-500:]}")

    def kill(self) -> None:
        """Kill it, as by ``kill -9``."""
        self._process.kill()
        self._process.communicate()


def main() -> None:
    """Connect, say so, and begin what takes seconds."""
    order = decoded(sys.stdin.buffer.readline(), Order)
    sys.path[:] = order.path
    device = order.driver.built(order.port)
    if order.carrier is not None:
        device = Riding(device, order.carrier.built("robot"))
    device.connect()
    print("connected", flush=True)
    ACTS[order.port](convert(order.cell, Cell, "cell")).travel(device)
    end_s = 30.0
    threading.Event().wait(end_s)


if __name__ == "__main__":
    main()
