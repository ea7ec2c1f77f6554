"""A robot of Universal Robots on its three ports: RTDE, scripts, dashboard."""

from __future__ import annotations

import contextlib
import select
import socket

from fakes.motion_faults import Harms
from fakes.site import Site
from fakes.universal_robots.controller import UrController
from fakes.universal_robots.rtde import UrRtdeServer
from fakes.wires.listener import HOST, Listener


class UrServer:
    """Serves one controller; only the port of RTDE can be chosen."""

    RECEIVE = 4096
    STATE = bytes([0, 0, 0, 5, 16])  # an empty message of robot states

    def __init__(self, controller: UrController, site: Site, port: int) -> None:
        self._controller = controller
        self._rtde = UrRtdeServer(controller, site.faults, site.time, port=port)
        self._scripts = Listener("scripts", self._serve_scripts)
        self._dashboard = Listener("dashboard", self._serve_dashboard)

    @property
    def address(self) -> dict[str, object]:
        """Return where it listens, as options of the driver."""
        return {
            "host": HOST,
            "rtde_port": self._rtde.port,
            "script_port": self._scripts.port,
            "dashboard_port": self._dashboard.port,
        }

    def start(self) -> None:
        """Begin to serve."""
        for each in (self._rtde, self._scripts, self._dashboard):
            each.start()

    def restore(self) -> None:
        """Put the controller right, as an operator does."""
        self._controller.restore()

    def close(self) -> None:
        """Stop serving."""
        for each in (self._rtde, self._scripts, self._dashboard):
            each.close()

    def _serve_scripts(self, client: socket.socket) -> None:
        """Play what a client sends, when its ``def`` has reached its ``end``."""
        text = ""
        state_s = 0.1  # the script port sends a state so often, read or not
        longest = 200_000
        while True:
            ready, _, _ = select.select([client], [], [], state_s)
            if not ready:
                with contextlib.suppress(BlockingIOError):
                    client.send(self.STATE, socket.MSG_DONTWAIT)
                continue
            data = client.recv(self.RECEIVE)
            text += data.decode("ascii", "replace")
            if not data or len(text) > longest:
                return
            if text.endswith("\nend\n"):
                self._controller.play(text)
                text = ""

    def _serve_dashboard(self, client: socket.socket) -> None:
        greeting = b"Connected: Universal Robots Dashboard Server\n"
        client.sendall(greeting)
        with client.makefile("rb") as lines:
            while line := lines.readline(self.RECEIVE):
                command = line.decode("ascii", "replace").strip()
                if command == "quit":
                    client.sendall(b"Disconnected\n")
                    return
                client.sendall(self._controller.ask(command).encode() + b"\n")


def serve(site: Site, port: int) -> UrServer:
    """Return the robot of a simulated cell behind RTDE."""
    plant = site.plant
    harms = Harms(plant.lose_zero, plant.slip_mount, plant.lose_motion, plant.grow, plant.loosen)
    controller = UrController(site.cell, plant.robot, site.faults, site.time, harms)
    return UrServer(controller, site, port)
