"""CESAPI's own tracker simulator as an independent far side.

It answers every command by its own layouts and fills in made-up values; the settings that were
written are put back, so that connecting succeeds. It never sends a measurement's result.
"""

from __future__ import annotations

import logging
import socket
from typing import Any

from tests.drivers.peers import Server
from tests.fakes.wires import exactly

READS = {6: 5, 25: 24, 27: 26, 29: 28, 41: 40, 44: 43}


class CesapiServer(Server):
    """Serves LTSimulator's packets from a loop that does not poll."""

    def __init__(self) -> None:
        level = logging.getLogger().level
        from CESAPI.test import LTSimulator, logger  # configures the root logger when imported

        logging.getLogger().setLevel(level)
        logger.setLevel(logging.WARNING)
        logging.getLogger("CESAPI.connection").setLevel(logging.WARNING)
        self._simulator = LTSimulator()
        self._simulator.initialized = True
        self._written: dict[int, Any] = {}
        super().__init__(self._answer)

    def _answer(self, connection: socket.socket) -> None:
        while True:
            head = exactly(connection, 4)
            data = head + exactly(connection, int.from_bytes(head, "little") - 4)
            command, answer = self._simulator.packets(data)
            self._simulator.populateReturnPacket(answer)
            number = command.packetInfo.command
            self._written[number] = command
            self._complete(number, answer)
            connection.sendall(answer.pack())

    def _complete(self, number: int, answer: Any) -> None:
        written: Any = self._written.get(READS.get(number, -1))
        for name in (
            "unitsSettings",
            "measMode",
            "coordSysType",
            "stationaryModeData",
            "searchParams",
        ):
            if hasattr(written, name):
                setattr(answer, name, getattr(written, name))
        if hasattr(written, "iInternalReflectorId"):
            answer.iInternalReflectorId = written.iInternalReflectorId
        if number == 42:
            answer.iTotalReflectors = 1
            answer.cReflectorName = "SMR 1.5in".encode("utf-16-le")
