"""Each fault of the rail, as a master sees it on the bus."""

from __future__ import annotations

import pytest

from tests.fakes.rail_bench import BIT_10, BIT_13, on_bus, until


def test_following_error_is_bit_13() -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.fault")
        bus.start(100_000)
        until(bus.faulty)
        assert bus.status() & BIT_13
        bus.control(0x00)
        bus.control(0x80)
        assert not bus.status() & BIT_13


def test_lasting_fault_still_lets_the_slide_stop() -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.fault", 0x2310, count=0)
        bus.start(1_000_000)
        until(bus.faulty)
        assert bus.rail.still
        assert bus.emergencies() == [0x2310]


def test_a_node_that_this_bus_lacks_does_not_reboot() -> None:
    """The strip's, where it is on a bus of its own."""
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.node_reset", 7)
        bus.move(100_000)
        assert bus.position() == 100_000
        assert bus.faults.take("rail.node_reset") is None, "it has struck"


def test_target_reached_too_early() -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.early_target_reached")
        bus.start(100_000)
        assert bus.status() & BIT_10
        assert not bus.slow()
        until(bus.arrived)


def test_wrong_mode_is_shown() -> None:
    with on_bus() as bus:
        bus.write(0x6060, 0, 1, "b")
        bus.faults.set("rail.wrong_mode", 3)
        assert [bus.read(0x6061, 0, "b") for _ in range(2)] == [3, 1]


def test_counter_that_wrapped_moves_by_its_own_count() -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.reference_lost", 2_147_483.0, count=2)
        until(lambda: bus.rail.poll().encoder_mm > 4_000_000.0)
        before = bus.position()
        bus.move(before + 100_000)
        assert bus.position() == pytest.approx(before + 100_000, abs=50)
