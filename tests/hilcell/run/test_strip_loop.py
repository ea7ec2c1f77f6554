"""The closed loop of section 4.3 against a slide with backlash, friction and a strip."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.file import load_cell
from hilcell.ports import DeviceError, Identity, LinkStatistics, RailReading
from hilcell.run.mover import approach_station

CELL = load_cell("paper")
S1100 = CELL.station_named("S1100")


class Slide:
    """A rail in memory: the strip sees ``gain`` times the command, plus offset and backlash."""

    def __init__(self, offset_mm: float = 0.3, backlash_mm: float = 0.2, gain: float = 1.0) -> None:
        self.offset_mm, self.backlash_mm, self.gain = offset_mm, backlash_mm, gain
        self.command_mm, self.true_mm = 0.0, 0.0
        self.moves: list[float] = []
        self.frozen = False

    def connect(self) -> list[Identity]:
        return []

    def home(self) -> None: ...

    def move_to(self, position_mm: float) -> None:
        upwards = position_mm > self.command_mm
        self.command_mm = position_mm
        self.moves.append(position_mm)
        ideal = S1100.strip_mm + self.gain * (position_mm - S1100.rail_mm) + self.offset_mm
        self.true_mm = ideal + (0.0 if upwards else self.backlash_mm)

    def settle(self) -> RailReading:
        strip_mm = 1098.0 if self.frozen else round(self.true_mm, 2)
        return RailReading(self.command_mm, strip_mm, 0.0, True, True, 0.0)

    def read(self) -> RailReading:
        return self.settle()

    def hold(self) -> None: ...

    def statistics(self) -> LinkStatistics:
        return LinkStatistics()

    def stop(self) -> None: ...

    def close(self) -> None: ...


@given(offset_mm=st.floats(-0.8, 0.8), backlash_mm=st.floats(0.0, 0.5), gain=st.floats(0.8, 1.2))
def test_it_converges_and_always_comes_from_below(
    offset_mm: float, backlash_mm: float, gain: float
) -> None:
    slide = Slide(offset_mm, backlash_mm, gain)
    approach_station(slide, CELL.rail, S1100)
    assert abs(slide.settle().strip_mm - S1100.strip_mm) <= 0.01 + 1e-9
    for low, high in zip(slide.moves[0::2], slide.moves[1::2], strict=True):
        assert math.isclose(high - low, CELL.rail.back_off_mm)


@pytest.mark.parametrize("offset_mm", [0.3, -0.3])
def test_a_slide_that_does_not_follow_is_refused(offset_mm: float) -> None:
    slide = Slide(offset_mm, gain=-1.0)
    with pytest.raises(DeviceError, match="S1100"):
        approach_station(slide, CELL.rail, S1100)


@pytest.mark.parametrize("slip_mm", [2.5, -2.5])
def test_a_slip_to_either_side_is_refused(slip_mm: float) -> None:
    with pytest.raises(DeviceError, match=f"{1100 + slip_mm:.2f} mm"):
        approach_station(Slide(offset_mm=slip_mm), CELL.rail, S1100)


def test_a_frozen_strip_is_refused() -> None:
    slide = Slide()
    slide.frozen = True
    with pytest.raises(DeviceError, match=r"frozen .*1098\.00 mm"):
        approach_station(slide, CELL.rail, S1100)


def test_a_strip_that_says_nothing_is_refused() -> None:
    with pytest.raises(DeviceError):
        approach_station(Slide(offset_mm=float("nan")), CELL.rail, S1100)
