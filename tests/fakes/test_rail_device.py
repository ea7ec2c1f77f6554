"""Drive and strip of another scale, sign, unit, number or homing than the cell file states."""

from __future__ import annotations

import pytest

from fakes.canopen.rail_device import RailDevice
from tests.fakes.rail_bench import BIT_10, DRIVE, STRIP, Bus, on_bus, until

RAMP, SPEED = 0x6083, 0x6081


def strip_counts(bus: Bus, node: int = STRIP) -> int:
    bus.sync()
    return bus.read(0x6004, 0, "i", node)


@pytest.mark.parametrize("counts_per_mm", [1000.0, -1000.0, 900.0, 10_000.0])
def test_the_drive_counts_by_its_own_scale_and_sign(counts_per_mm: float) -> None:
    with on_bus(RailDevice(counts_per_mm=counts_per_mm)) as bus:
        began_mm, counts = bus.rail.slide_mm(), bus.position()
        bus.enable(1)
        bus.move(counts + 20_000)
        gone_mm = bus.rail.slide_mm() - began_mm
        assert gone_mm == pytest.approx(20_000 / counts_per_mm, abs=0.3)


@pytest.mark.parametrize("strip_counts_per_mm", [100.0, -100.0, 1000.0])
def test_the_strip_counts_by_its_own_scale_sign_and_zero(strip_counts_per_mm: float) -> None:
    device = RailDevice(strip_counts_per_mm=strip_counts_per_mm, strip_zero_mm=1500.0)
    with on_bus(device) as bus:
        slide_mm = strip_counts(bus) / strip_counts_per_mm - 1500.0
        assert slide_mm == pytest.approx(bus.rail.slide_mm(), abs=0.05)
        assert bus.read(0x6501, 0, "H", STRIP) == 1e6 / abs(strip_counts_per_mm)


@pytest.mark.parametrize(
    ("device", "counts_s"),
    [
        (RailDevice(), 1.0),
        (RailDevice(speed_unit="0.1 counts/s"), 0.1),
        (RailDevice(speed_unit="rpm", counts_per_turn=6000), 100.0),
    ],
)
def test_speeds_are_in_the_drives_unit(device: RailDevice, counts_s: float) -> None:
    with on_bus(device) as bus:
        bus.write(SPEED, 0, round(50_000 / counts_s), "I")
        bus.write(RAMP, 0, round(1_000_000 / counts_s), "I")
        bus.write(RAMP + 1, 0, round(1_000_000 / counts_s), "I")
        bus.enable(1)
        bus.start(bus.position() + 500_000)
        fastest_mm_s = fastest = 0.0
        while not bus.status() & BIT_10:
            fastest = max(fastest, bus.read(0x606C, 0, "i") * counts_s)
            fastest_mm_s = max(fastest_mm_s, bus.server._drive._slide.velocity_mm_s)
        assert fastest_mm_s == pytest.approx(50.0)
        assert fastest == pytest.approx(50_000, abs=300)


def test_the_motor_has_limits_of_its_own() -> None:
    with on_bus(RailDevice(motor_mm_s=30.0, motor_mm_s2=100.0)) as bus:
        bus.enable(1)
        bus.start(bus.position() + 500_000)
        fastest_mm_s = 0.0
        while not bus.status() & BIT_10:
            fastest_mm_s = max(fastest_mm_s, bus.rail.poll().velocity_mm_s)
        assert fastest_mm_s == pytest.approx(30.0)


def test_exchanged_node_numbers_answer_by_the_other_profile() -> None:
    with on_bus(RailDevice(drive_node=STRIP, strip_node=DRIVE)) as bus:
        assert bus.read(0x1000, node=DRIVE) & 0xFFFF == 406
        assert bus.read(0x1000, node=STRIP) & 0xFFFF == 402


@pytest.mark.parametrize(
    ("method", "counts_per_mm", "ends_mm"),
    [
        (17, 1000.0, 0.0),
        (17, -1000.0, 3000.0),
        (18, 1000.0, 3000.0),
        (18, -1000.0, 0.0),
        (33, 1000.0, 630.0),
        (34, 1000.0, 650.0),
        (35, 1000.0, 640.0),
        (37, -1000.0, 640.0),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_homing_ends_where_its_method_says_with_the_offset_as_position(
    method: int, counts_per_mm: float, ends_mm: float, sign: int
) -> None:
    device = RailDevice(
        counts_per_mm=counts_per_mm,
        homing_methods=(method,),
        home_offset_sign=1 if sign > 0 else -1,
    )
    with on_bus(device) as bus:
        bus.write(0x607C, 0, 123_000, "i")
        bus.enable(6)
        bus.write(0x6098, 0, method, "b")
        bus.control(0x1F)
        until(lambda: bus.status() & 0x1400 == 0x1400)
        assert bus.position() == pytest.approx(sign * 123_000, abs=3)
        assert bus.rail.poll().strip_mm == pytest.approx(ends_mm, abs=0.8)


def test_an_absolute_drive_reads_its_place_from_power_on() -> None:
    with on_bus(RailDevice(absolute=True, counts_per_mm=-1000.0)) as bus:
        assert bus.position() == pytest.approx(-640_000, abs=3)


@pytest.mark.parametrize(
    ("unit", "code"), [("counts/s", 0x00B50300), ("0.1 counts/s", 0xFFB50300), ("rpm", 0x00B44700)]
)
def test_a_drive_may_state_its_units(unit: str, code: int) -> None:
    with on_bus(RailDevice(speed_unit=unit, states_units=True)) as bus:  # type: ignore[arg-type]
        assert bus.read(0x60A9) == code
        assert bus.read(0x6090, 1) / bus.read(0x6090, 2) == 10_000
