"""A cell with one reflector: it is seen where it was put, and nowhere else."""

from __future__ import annotations

import math
import struct
from contextlib import closing

import numpy as np
import pytest

from drivers.leica.emscon import Command, Layout, Setting, Value, encode
from fakes.faults import Faults
from fakes.host import truth_of
from fakes.leica.emscon_server import EmsconDevice
from fakes.simulator import Control, PaperCell
from fakes.site import Site
from fakes.time import PlantTime
from fakes.truth.cell_truth import FLANGE, Plant
from hilcell.cell.file import Cell, load_cell
from hilcell.ports import DeviceError

BY_HAND = {"layout.reflectors": "by_hand"}


@pytest.fixture
def plant() -> Plant:
    return Plant(load_cell("paper", BY_HAND), 1, PlantTime(), Faults())


def test_it_lies_nowhere_until_it_is_put_somewhere(plant: Plant) -> None:
    places = plant.places_in_world()
    assert plant.reflectors_in_world() == {}
    assert plant.tracker.find(np.zeros(3), 1e9) is None
    for place in ("F2", "P8", FLANGE):
        plant.seat(place)
        (found,) = plant.reflectors_in_world().items()
        assert found[0] == place
        assert np.array_equal(found[1], places[place])
    plant.seat("")
    assert plant.reflectors_in_world() == {}
    assert plant.tracker.measure(FLANGE) is None


def test_it_is_seen_where_mounted_ones_are(plant: Plant, cell: Cell) -> None:
    mounted = Plant(cell, 1, PlantTime(), Faults()).reflectors_in_world()
    places = plant.places_in_world()
    assert places.keys() == mounted.keys()
    assert all(np.array_equal(places[name], mounted[name]) for name in mounted)


def test_the_truth_tells_of_one_reflector_and_of_the_flange(plant: Plant) -> None:
    plant.seat("P1")
    truth = truth_of(plant, {})
    assert list(truth["reflectors_mm"]) == ["P1"]
    assert truth["flange_mm"] == plant.places_in_world()[FLANGE].tolist()


def test_places_that_are_none_are_refused(plant: Plant, cell: Cell) -> None:
    with pytest.raises(ValueError, match="P9"):
        plant.seat("P9")
    with pytest.raises(ValueError, match="mounted"):
        Plant(cell, 1, PlantTime(), Faults()).seat("P1")


@pytest.mark.parametrize("when", ["before the start", "while measuring"])
def test_carried_away_the_beam_breaks(plant: Plant, when: str) -> None:
    device = EmsconDevice(Site(plant.cell, plant, Faults(), plant.time))
    plant.seat("F1")
    at = plant.tracker.reflectors()["F1"]
    for packet in (
        encode(Command.INITIALIZE),
        encode(Setting.UNITS.write, Setting.UNITS.layout.pack(*Value.MILLIMETRES)),
        encode(Command.GO_POSITION, Layout.POSITION.pack(*at, 1)),
    ):
        *_, answer = device.handle(packet)
    assert isinstance(answer, bytes)
    assert len(answer) == 16 + 12  # found: status OK comes first
    assert answer[12:16] == struct.pack("<I", 0)
    if when == "before the start":
        plant.seat("F2")
        (answer,) = device.handle(encode(Command.START_MEASUREMENT))
    else:
        steps = device.handle(encode(Command.START_MEASUREMENT))
        assert [type(next(steps)), type(next(steps))] == [bytes, float]
        plant.seat("F2")
        answer = next(steps)
        assert next(steps, None) is None
    assert isinstance(answer, bytes)
    assert answer[-4:] == struct.pack("<I", 10004)  # not ready


def test_the_control_channel_seats_it() -> None:
    with (
        closing(PaperCell(load_cell("paper", BY_HAND), seed=1, truth=True)) as cell,
        Control(cell.address) as control,
    ):
        assert control.ask("truth")["reflectors_mm"] == {}
        control.ask("seat", place="F2")
        (seen,) = control.ask("truth")["reflectors_mm"].values()
        assert math.dist(seen, (1500.0, 0.0, 0.0)) < 6.0
        for wrong in ({"place": "F9"}, {}):
            with pytest.raises(DeviceError):
                control.ask("seat", **wrong)
