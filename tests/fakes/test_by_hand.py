"""A cell with one reflector: it is seen where it was put, and nowhere else."""

from __future__ import annotations

import math
import struct
from contextlib import closing

import numpy as np
import pytest

from drivers.leica.emscon import Command, Layout, Setting, Value, encode
from fakes.faults import Faults
from fakes.host import truth_answer
from fakes.leica.emscon_server import EmsconDevice
from fakes.simulator import Control, PaperCell
from fakes.site import Site
from fakes.truth.cell_truth import FLANGE, CellTruth
from hilcell.cell.file import Cell, load_cell
from hilcell.ports import DeviceError
from tests.fakes.conftest import simulated_site

BY_HAND = {"layout.reflectors": "by_hand"}


@pytest.fixture
def truth() -> CellTruth:
    return simulated_site(load_cell("paper", BY_HAND))[1]


def test_it_lies_nowhere_until_it_is_put_somewhere(truth: CellTruth) -> None:
    places = truth.places_in_world()
    assert truth.reflectors_in_world() == {}
    assert truth.tracker.find(np.zeros(3), 1e9) is None
    for place in ("F2", "P8", FLANGE):
        truth.place_reflector(place)
        (found,) = truth.reflectors_in_world().items()
        assert found[0] == place
        assert np.array_equal(found[1], places[place])
    truth.place_reflector("")
    assert truth.reflectors_in_world() == {}
    assert truth.tracker.measure(FLANGE) is None


def test_it_is_seen_where_mounted_ones_are(truth: CellTruth, cell: Cell) -> None:
    mounted = simulated_site(cell)[1].reflectors_in_world()
    places = truth.places_in_world()
    assert places.keys() == mounted.keys()
    assert all(np.array_equal(places[name], mounted[name]) for name in mounted)


def test_the_truth_tells_of_one_reflector_and_of_the_flange(truth: CellTruth) -> None:
    truth.place_reflector("P1")
    answer = truth_answer(truth, {})
    assert list(answer["reflectors_mm"]) == ["P1"]
    assert answer["flange_mm"] == truth.places_in_world()[FLANGE].tolist()


def test_places_that_are_none_are_refused(truth: CellTruth, cell: Cell) -> None:
    with pytest.raises(ValueError, match="P9"):
        truth.place_reflector("P9")
    with pytest.raises(ValueError, match="mounted"):
        simulated_site(cell)[1].place_reflector("P1")


@pytest.mark.parametrize("when", ["before the start", "while measuring"])
def test_carried_away_the_beam_breaks(truth: CellTruth, when: str) -> None:
    device = EmsconDevice(Site(truth.cell, truth, Faults(), truth.time))
    truth.place_reflector("F1")
    at = truth.tracker.reflectors()["F1"]
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
        truth.place_reflector("F2")
        (answer,) = device.handle(encode(Command.START_MEASUREMENT))
    else:
        steps = device.handle(encode(Command.START_MEASUREMENT))
        assert [type(next(steps)), type(next(steps))] == [bytes, float]
        truth.place_reflector("F2")
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
