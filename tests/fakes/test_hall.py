"""Drawn halls: sound truths, a sheet that says nothing of them; traps."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from fakes.faults import Faults
from fakes.hall import Sheet, draw_cell, sheet_of
from fakes.time import CellTime
from fakes.traps import TRAPS, rail_device, with_trap
from fakes.truth.cell_truth import FLANGE, CellTruth
from fakes.truth.machine import controller_arm
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError, convert

UNKNOWN = load_cell("unknown")
ADDRESSES: dict[str, dict[str, object]] = {"rail": {"channel": "socket://127.0.0.1:1"}}


def truth_of(cell: Cell, seed: int = 1) -> CellTruth:
    return CellTruth(cell, seed, CellTime(), Faults())


def sheet(seed: int) -> Sheet:
    return sheet_of(draw_cell(UNKNOWN, seed), seed, ADDRESSES, "127.0.0.1:2")


@pytest.mark.parametrize("seed", range(1, 21))
def test_a_drawn_hall_can_be_measured(seed: int) -> None:
    drawn = draw_cell(UNKNOWN, seed)
    assert convert(msgspec.to_builtins(drawn, str_keys=True), Cell, "drawn").name == "unknown"
    truth, device = truth_of(drawn, seed), rail_device(drawn)
    assert {device.drive_node, device.strip_node, 127}.__len__() == 3
    assert isinstance(truth.rail, RailTruth)
    truth.rail.brake(closed=False)
    low, high = controller_arm(drawn).limits_deg.T
    assert np.all((low < drawn.robot.home_deg) & (drawn.robot.home_deg < high))
    least_mm, most_mm = drawn.tracker.min_range_mm, drawn.tracker.max_range_mm
    base_mm = truth.base_in_world()[:3, 3]
    of_tracker_mm = truth.tracker.pose_in_world[:3, 3]
    assert np.linalg.norm((base_mm - of_tracker_mm)[:2]) > 4000.0  # out of the arm's reach
    for end_mm in (-3000.0, 6000.0):  # as far as it goes
        truth.rail.move(end_mm, 500.0, 500.0)
        truth.time.advance(60.0)
        truth.rail.poll()
        for name, at_mm in truth.tracker.reflectors().items():
            assert least_mm < np.linalg.norm(at_mm) < most_mm, name


def test_the_sheet_knows_the_drawing_and_the_tape(tmp_path: Path) -> None:
    for seed in range(1, 9):
        drawn, known = draw_cell(UNKNOWN, seed), sheet(seed)
        places = truth_of(drawn, seed).places_in_world()
        for name, file in known.files().items():
            (tmp_path / name).write_text(file)
        with (tmp_path / "nests.csv").open() as rows:
            drawing = {
                row["name"]: [float(row[f"{axis}_mm"]) for axis in "xyz"]
                for row in csv.DictReader(rows)
            }
        assert list(drawing) == ["F1", "F2", "F3", "F4", "B1", "B2"]
        for name, drawn_mm in drawing.items():
            assert math.dist(drawn_mm, places[name]) < 0.2
        assert abs(known.travel_mm - drawn.rail.travel_max_mm) <= 5.5
        again = msgspec.json.decode((tmp_path / "hall.json").read_bytes(), type=Sheet)
        assert again.files() == known.files()


def test_halls_differ_in_all_that_a_person_does_not_know() -> None:
    looks: dict[str, Callable[[Cell], object]] = {
        "tracker": lambda cell: cell.tracker.pose,
        "base": lambda cell: cell.layout.base,
        "slide": lambda cell: cell.layout.slide[0].xyz_mm.tolist(),
        "reflector": lambda cell: cell.robot.smr_mm,
        "direction": lambda cell: cell.layout.rail_direction,
        "nodes": lambda cell: (rail_device(cell).drive_node, rail_device(cell).strip_node),
        "strip": lambda cell: rail_device(cell).strip_zero_mm,
        "limits": lambda cell: controller_arm(cell).limits_deg.tolist(),
    }
    halls = [draw_cell(UNKNOWN, seed) for seed in range(1, 21)]
    for name, look in looks.items():
        assert len({str(look(hall)) for hall in halls}) >= 19, name
    for choice, many in (
        (lambda device: device.speed_unit, 3),
        (lambda device: device.counts_per_mm > 0, 2),
        (lambda device: device.strip_counts_per_mm > 0, 2),
        (lambda device: device.absolute, 2),
    ):
        assert len({choice(rail_device(hall)) for hall in halls}) == many
    couplings = [truth_of(hall).arm.design.coupling for hall in halls]
    assert 2 <= couplings.count(-1.0) <= 10
    assert draw_cell(UNKNOWN, 3) == draw_cell(UNKNOWN, 3)


def test_an_arm_with_a_coupled_axis_stands_as_the_other() -> None:
    paper = load_cell("paper")
    places = [
        truth_of(cell).places_in_world() for cell in (paper, with_trap(paper, "coupled-axis-3"))
    ]
    assert math.dist(places[0][FLANGE], places[1][FLANGE]) < 1e-6  # errors are of the axes


@pytest.mark.parametrize("name", TRAPS)
@pytest.mark.parametrize("where", ["paper", "unknown"])
def test_a_trap_is_another_sound_truth(where: str, name: str) -> None:
    cell = load_cell(where) if where == "paper" else draw_cell(UNKNOWN, 7)
    trapped = with_trap(cell, name)
    assert convert(msgspec.to_builtins(trapped, str_keys=True), Cell, name) is not None
    truth_of(trapped)
    before, after = rail_device(cell), rail_device(trapped)
    expected: dict[str, object] = {
        "drive-sign": after.counts_per_mm == -before.counts_per_mm,
        "strip-sign": after.strip_counts_per_mm == -before.strip_counts_per_mm,
        "scale-0.9": after.counts_per_mm == 0.9 * before.counts_per_mm,
        "scale-10": after.counts_per_mm == 10.0 * before.counts_per_mm,
        "speed-rpm": after.speed_unit == "rpm",
        "speed-0.1": after.speed_unit == "0.1 counts/s",
        "no-self-stop": not after.watchful,
        "nodes-exchanged": (after.drive_node, after.strip_node)
        == (before.strip_node, before.drive_node),
        "wrong-tool": controller_arm(trapped).tool_mm != controller_arm(cell).tool_mm,
        "coupled-axis-3": controller_arm(trapped).chain.coupling == -1.0,
        "other-smr": trapped.tracker.reflector == "SMR 0.5in",
        "tracker-upside-down": truth_of(trapped).tracker.pose_in_world[2, 2] < -0.99,
        "nests-exchanged": math.dist(
            truth_of(trapped).places_in_world()["F2"], truth_of(cell).places_in_world()["F3"]
        )
        < 4.0,
    }
    assert expected[name]


def test_an_unknown_trap_or_setting_names_the_nearest() -> None:
    with pytest.raises(SettingsError, match="drive-sign"):
        with_trap(UNKNOWN, "drive-sing")
    wrong = load_cell("paper", {"simulation.sizes.rail_device.drive_nod": "7"})
    with pytest.raises(SettingsError, match="drive_node"):
        rail_device(wrong)
