"""The examples for contributors work as they are printed."""

import re
import socket
import threading
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.alarms.catalogue import Entry
from hilcell.cell.file import load_cell
from hilcell.clock import WallClock
from hilcell.ports import Air, DeviceError, NoReading, Tracker
from hilcell.present.table import Column
from hilcell.report import tables
from hilcell.report.html import report_html
from tests.hilcell.report.journals import validated_run
from tests.hilcell.report.pages import Page
from tests.hilcell.run.bed import Bed

ROOT = Path(__file__).parents[1]
TEXT = "".join(
    (ROOT / page).read_text("utf-8") for page in ("CONTRIBUTING.md", "docs/first-driver.md")
)
BLOCKS = dict(re.findall(r"```\w+\n# (.+)\n((?s:.*?))```", TEXT))


def module(source: str, file: str) -> Any:
    made = ModuleType("example")
    exec(compile(source, file, "exec"), made.__dict__)
    return made


class Peer:
    """Speaks the example's protocol on loopback; ``answers`` are given one a request."""

    def __init__(self, *answers: str) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.requests: list[str] = []
        self._thread = threading.Thread(target=self._serve, args=(answers,))
        self._thread.start()

    def _serve(self, answers: tuple[str, ...]) -> None:
        with self._server, self._server.accept()[0] as link, link.makefile("rw") as lines:
            for answer in (*answers, ""):
                self.requests.append(lines.readline().strip())
                lines.write(f"{answer}\n")
                lines.flush()

    def end(self) -> list[str]:
        self._thread.join(10.0)
        return self.requests


def test_the_driver_measures_stops_and_refuses_another_reflector() -> None:
    driver = module(BLOCKS["drivers/tracker_lines.py"], "docs/first-driver.md").LineTracker
    peer = Peer(
        "LINES 17", "1 2 3 .01 .01 .02 22 1013 45", "9 2 3 .01 .01 .02 22 1013 45", "1 2 odd"
    )
    options = driver.Options(host="127.0.0.1", port=peer.port, find_radius_mm=5.0)
    tracker: Tracker = driver(options, WallClock(threading.Event()))
    assert tracker.connect()[0].serial == "17"
    reading = tracker.measure(np.array([1.0, 2.0, 3.5]), "SMR", 3)
    assert reading.xyz_mm.tolist() == [1.0, 2.0, 3.0]
    assert (reading.air, reading.samples) == (Air(22.0, 1013.0, 45.0), 3)
    with pytest.raises(NoReading, match=r"reflector is 8\.00 mm from its expected place"):
        tracker.measure(np.array([1.0, 2.0, 3.0]), "SMR", 1)
    with pytest.raises(DeviceError, match="invalid answer") as raised:
        tracker.measure(np.zeros(3), "SMR", 1)
    assert raised.value.code == "HC-T02"
    tracker.stop()
    requests = ["MEASURE 1.0 2.0 3.5 3", "MEASURE 1.0 2.0 3.0 1", "MEASURE 0.0 0.0 0.0 1"]
    assert peer.end() == ["ID", *requests, "STOP"]
    tracker.close()


def test_the_driver_closes_its_wire_when_connect_fails() -> None:
    driver = module(BLOCKS["drivers/tracker_lines.py"], "docs/first-driver.md").LineTracker
    peer = Peer("LINES")
    options = driver.Options(host="127.0.0.1", port=peer.port, find_radius_mm=5.0)
    with pytest.raises(DeviceError, match="invalid answer"):
        driver(options, WallClock(threading.Event())).connect()
    assert peer.end() == ["ID", ""]


def test_the_procedure_plans_measures_and_states_its_result(tmp_path: Path) -> None:
    example = ROOT / "docs/examples/floor_noise.py"
    procedure = module(example.read_text("utf-8"), str(example)).FLOOR_NOISE
    nests = len(load_cell("paper").layout.floor)
    assert procedure.plan(load_cell("paper"), 1).points == 2 * nests
    bed = Bed(tmp_path)
    assert bed.run(procedure) == 0
    result = procedure.result(bed.log())
    assert result["floor_noise"]["largest_mm"] == pytest.approx(0.01)
    table = procedure.table(result)
    assert (table.headers, table.texts()) == (["floor noise mm"], [["0.0100"]])


def test_the_alarm_is_listed_and_raised() -> None:
    rows = tomllib.loads(BLOCKS["drivers/alarms/tracker_lines.toml"])["alarm"]
    (entry,) = (msgspec.convert(row, Entry) for row in rows)
    with pytest.raises(NoReading, match="battery 7 %, expected >= 10 %; connect") as raised:
        exec(
            BLOCKS["drivers/tracker_lines.py, in measure"], {"NoReading": NoReading, "percent": 7.0}
        )
    assert raised.value.code == entry.code


def test_the_report_column_shows_its_header_and_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = eval(BLOCKS["hilcell/report/tables.py, in STATIONS"], {"Column": Column})
    monkeypatch.setattr(tables, "STATIONS", (*tables.STATIONS, *made))
    run = validated_run(tmp_path / "r")
    run.frame("station.S1100", strip_mm=1100.01, rms_mm=0.02, tool_uncertainty_mm=0.03,
              cube_uncertainty_mm=0.04)  # fmt: skip
    (row,) = Page(report_html(run.facts())).table("Stations")
    assert row["strip off mm"] == "+0.010"
