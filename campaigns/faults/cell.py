"""A simulated cell in this process: quick to start, its devices behind proxies where wanted."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any, Self

import msgspec

from fakes.host import Host, Order
from hilcell.cell.file import load_cell
from hilcell.wire.channel import Socket
from hilcell.wire.relay import SocketRelay
from tests.whole.bench import Simulation

DEVICES = ("rail", "robot", "tracker")


class _Proxied(Host):
    """A cell whose devices are reached through proxies."""

    def __init__(self, order: Order) -> None:
        super().__init__(order)
        ports = super().addresses()
        rail = int(ports["rail"]["channel"].rpartition(":")[2])
        self.proxies = {"rail": SocketRelay(Socket("127.0.0.1", rail))}
        for name in ("robot", "tracker"):
            self.proxies[name] = SocketRelay(Socket("127.0.0.1", ports[name]["port"]))

    def addresses(self) -> dict[str, Any]:
        found = super().addresses()
        found["rail"]["channel"] = f"socket://127.0.0.1:{self.proxies['rail'].port}"
        for name in ("robot", "tracker"):
            found[name]["port"] = self.proxies[name].port
        return found


class ThreadedCell:
    """A built-in cell on fakes that serve from threads of this process."""

    def __init__(self, name: str = "paper", *, proxied: bool = False, seed: int = 1) -> None:
        cell = msgspec.to_builtins(load_cell(name))
        order = Order(cell={k: v for k, v in cell.items() if v is not None}, seed=seed, truth=True)
        self._host = _Proxied(order) if proxied else Host(order)
        self._thread = threading.Thread(target=self._host.run)
        addresses = self._host.addresses()
        self.address: str = addresses["control"]
        self.simulation = Simulation(addresses, self.address)

    @property
    def proxies(self) -> dict[str, SocketRelay]:
        """Return the proxies by device, none where it has none."""
        return self._host.proxies if isinstance(self._host, _Proxied) else {}

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        for proxy in self.proxies.values():
            proxy.close()
        self._host.end()
        self._thread.join()
