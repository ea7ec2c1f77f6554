"""A cell file without a rail: a robot on the floor, at one station."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from threading import Event

import msgspec
import numpy as np
import pytest

from hilcell.cell.devices import build_devices, check_options, start_simulation
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError, convert
from hilcell.clock import WallClock
from hilcell.ports import DeviceError, HilcellError
from hilcell.run.procedure import Procedure
from procedures.calibrate import CALIBRATE, RAIL_SURVEY, STATION_FRAMES, STATION_REPEATABILITY
from procedures.paper import PAPER
from procedures.touch_station import TOUCH

TEXT = (resources.files("hilcell.cells") / "fixed.toml").read_text("utf-8")
FIXED = load_cell("fixed")


def file_problems(tmp_path: Path, text: str) -> str:
    file = tmp_path / "cell.toml"
    file.write_text(text)
    with pytest.raises(SettingsError) as caught:
        load_cell(str(file))
    return "\n".join(caught.value.problems)


def test_one_station_at_0_and_no_nests_on_a_slide() -> None:
    check_options(FIXED)
    assert not FIXED.has_rail
    assert load_cell("paper").has_rail
    assert [(each.name, each.rail_mm) for each in FIXED.station] == [("BASE", 0.0)]
    assert (FIXED.grid.station, FIXED.layout.slide, FIXED.touch.poses) == ("BASE", [], 0)
    assert np.array_equal(FIXED.layout.nominal_base(0.0), FIXED.layout.base.matrix())


def test_a_journal_reads_it_back() -> None:
    frozen = msgspec.json.decode(msgspec.json.encode(FIXED))
    again = convert({key: value for key, value in frozen.items() if value is not None}, Cell, "")
    assert (again, again.digest) == (FIXED, FIXED.digest)


def test_its_station_may_have_a_name(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(TEXT.replace("[grid]\n", '[[station]]\nname = "CELL 4"\n\n[grid]\n'))
    assert load_cell(str(file)).grid.station == "CELL 4"


def test_what_belongs_to_a_rail_is_refused_without_one(tmp_path: Path) -> None:
    rail = "[[station]]\nname = 'S1'\nrail_mm = 300.0\n[[station]]\nname = 'S2'\n[grid]\n"
    nests = "".join(
        f"[[layout.slide]]\nname = 'P{n}'\nx_mm = {x}\ny_mm = {y}\nz_mm = 60.0\n"
        for n, (x, y) in enumerate([(0.0, 0.0), (300.0, 0.0), (0.0, 300.0)])
    )
    text = TEXT.replace("[grid]\n", rail) + nests + "[touch]\nposes = 4\n"
    text = text.replace("[layout]\n", "[layout]\nrail_direction = [0.0, 1.0, 0.0]\n")
    found = file_problems(tmp_path, text)
    for key in ("station: ", "300.0 of S1", "layout.slide: ", "touch.poses: "):
        assert key in found


def test_nonsense_is_refused(tmp_path: Path) -> None:
    for table in ("station = 3", "station = [4]", "grid = 'no'", "layout = []", "touch = 1"):
        assert table.split()[0] in file_problems(tmp_path, f"name = 'x'\nserial = 'y'\n{table}\n")


@pytest.mark.parametrize(
    "procedure", [RAIL_SURVEY, STATION_REPEATABILITY, STATION_FRAMES, TOUCH, PAPER]
)
def test_procedures_of_a_rail_refuse_it(procedure: Procedure) -> None:
    with pytest.raises(HilcellError, match="fixed"):
        procedure.plan(FIXED, 1)


def test_a_calibration_is_planned_without_a_station_frame() -> None:
    steps = {step.name: step for step in CALIBRATE.plan(FIXED, 1).steps}
    assert steps["station-frames"].points == 0
    assert steps["hold-station"].duration_s == 0.0
    assert steps["robot-grid"].points == 64


def test_its_rail_has_no_wire_and_goes_nowhere() -> None:
    options = {"robot": {"host": "127.0.0.1"}, "tracker": {"host": "127.0.0.1"}}
    rail = build_devices(FIXED, options, WallClock(Event())).rail
    rail.home()
    rail.move_to(0.0)
    reading = rail.settle()
    assert rail.connect() == []
    assert (reading.still, reading.powered, reading.strip_mm) == (True, False, 0.0)
    with pytest.raises(DeviceError, match="rail") as caught:
        rail.move_to(100.0)
    assert caught.value.code == "HC-R36"


def test_a_port_for_the_rail_that_it_lacks_is_refused() -> None:
    with pytest.raises(SettingsError, match="rail"):
        start_simulation(FIXED, seed=1, speed=1.0, ports={"rail": 29536})
