"""Simulated devices of broken packages: one line names the device, the error and its place."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest

from fakes.simulator import PaperCell
from hilcell.cell.file import load_cell
from hilcell.ports import HilcellError
from tests.hilcell.cell.packages import ENTRIES, WHOLE, install

SERVE = "def serve(site, port): ..."
FALLS = """
from fakes.wires import Listener

def fall(client):
    client.recv(1)
    return 1 + None

class Server:
    def __init__(self):
        self.listener = Listener("mine", fall)
        self.address = {"host": "127.0.0.1", "port": self.listener.port}
        self.start, self.close, self.restore = self.listener.start, self.listener.close, print

def serve(site, port):
    return Server()
"""


def cell_with(
    serve: str, folder: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> PaperCell:
    """Return a started cell whose robot is a package's, with that function ``serve``."""
    install(folder, ENTRIES.format("truth_0"), truth_0=WHOLE.replace(SERVE, serve))
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    request.addfinalizer(lambda: sys.modules.pop("truth_0", None))
    return PaperCell(load_cell("paper", {"robot.driver": "mine"}), seed=1)


@pytest.mark.parametrize(
    ("serve", "found"),
    [
        (SERVE, "NoneType has no address, start, restore, close"),
        ("def serve(site, port): return 1 / 0", "ZeroDivisionError: division by zero (truth_0.py"),
    ],
)
def test_a_device_that_cannot_be_served_is_named(
    serve: str,
    found: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    with pytest.raises(HilcellError) as caught:
        cell_with(serve, tmp_path, monkeypatch, request)
    assert f"simulated robot: {found}" in str(caught.value)


@pytest.mark.wall
def test_an_error_behind_a_wire_is_shown_when_the_cell_ends(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
    capsys: pytest.CaptureFixture[str],
) -> None:
    simulated = cell_with(FALLS, tmp_path, monkeypatch, request)
    port = simulated.options["robot"]["port"]
    assert isinstance(port, int)
    with socket.create_connection(("127.0.0.1", port)) as link:
        link.sendall(b"x")
        assert link.recv(1) == b""
    simulated.close()
    said = capsys.readouterr().err
    assert said.startswith("simulated cell: mine client: TypeError: ")
    assert said.endswith("(truth_0.py, line 21)\n")
