"""Simulated devices on ports of one's choice, reached by a cell file that names no simulator."""

import json
import socket
from pathlib import Path

import pytest

from tests.whole.bench import command, ran, shop_cell, shop_values, sim_command
from tests.whole.test_refusals import free_port


@pytest.mark.wall
@pytest.mark.usefixtures("faster_than_a_drive")
def test_a_plain_cell_file_on_simulated_devices_is_a_simulated_run(tmp_path: Path) -> None:
    ports = {name: free_port() for name in ("rail", "robot", "tracker")}
    values = shop_values(f"socket://localhost:{ports['rail']}", ports["robot"], ports["tracker"])
    asked = ",".join(f"{name}={port}" for name, port in ports.items())
    with sim_command("--speed", "max", "--ports", asked) as simulated:
        assert simulated.addresses["rail"] == {"channel": f"socket://127.0.0.1:{ports['rail']}"}
        assert simulated.addresses["robot"]["port"] == ports["robot"]
        run = ran(tmp_path, "home", values, "--cell", shop_cell(tmp_path), name="r")
    assert run.end["exit"] == 0, run.done.stderr
    assert run.result["simulated"] is True
    first, *rest = run.events
    assert first["simulated"] is False  # the plan states what is known before anything is opened
    (connected,) = [e for e in rest if e["kind"] == "event" and e["what"] == "connected"]
    assert [each["simulated"] for each in connected["devices"]] == [True] * 4
    kinds = [each["kind"] for each in connected["devices"]]
    assert kinds == ["drive", "strip", "robot", "tracker"]
    (row,) = json.loads(command("runs", "--json", "--runs", tmp_path).stdout)["runs"]
    assert row["simulated"] is True
    command("report", "r", "--runs", tmp_path, "-o", tmp_path / "r.html")
    assert "SIMULATION." in (tmp_path / "r.html").read_text("utf-8")


def test_a_taken_port_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = int(taken.getsockname()[1])
        done = command("sim", "--ports", f"tracker={port}")
    assert (done.returncode, done.stdout) == (2, "")
    assert f"port {port} " in done.stderr


@pytest.mark.parametrize("text", ["rail", "rial=1", "rail=0", "rail=65536", "rail=1,rail=2", ""])
def test_ports_that_are_none(text: str) -> None:
    done = command("sim", "--ports", text)
    assert done.returncode == 2
    assert "--ports" in done.stderr


def test_a_simulated_cell_that_runs_keeps_its_ports() -> None:
    done = command("sim", "--set", "simulation.address=127.0.0.1:1", "--ports", "rail=7")
    assert done.returncode == 2
    assert "simulation.address" in done.stderr
