"""Each fault of the rail, as a master sees it on the bus."""

from __future__ import annotations

import pytest

from tests.fakes.rail_bench import BIT_10, BIT_12, BIT_13, Line, on_bus, served, until


@pytest.mark.parametrize("code", [0x7305, 0x8611])
def test_emergency_while_moving(code: int) -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.emcy", code)
        bus.move(100_000)
        assert bus.emergencies() == [code]
        assert bus.read(0x1001, 0, "B") == 1
        bus.control(0x80)
        assert bus.read(0x1001, 0, "B") == 0
        assert bus.emergencies() == [code, 0]


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


@pytest.mark.parametrize(("switch", "inputs"), [(-1, 1), (1, 2)])
def test_limit_switch_on_demand(switch: int, inputs: int) -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.limit_switch", switch)
        bus.start(100_000)
        until(bus.faulty)
        assert bus.read(0x60FD) == inputs
        bus.control(0x00)
        bus.control(0x80)
        assert bus.read(0x60FD) == 0


def test_node_reset_while_moving() -> None:
    with on_bus() as bus:
        bus.home()
        boots = len(bus.heard(0x705))
        bus.faults.set("rail.node_reset", 5)
        bus.start(1_000_000)
        assert bus.status() & 0x6F == 0x40
        assert bus.heard(0x705)[boots:] == [b"\0"]
        until(lambda: bus.rail.poll().moving is False)
        assert bus.position() < 1_000_000


def test_a_node_that_this_bus_lacks_does_not_reboot() -> None:
    """The strip's, where it is on a bus of its own."""
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.node_reset", 7)
        bus.move(100_000)
        assert bus.position() == 100_000
        assert bus.faults.take("rail.node_reset") is None, "it has struck"


def test_set_point_never_acknowledged() -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.no_acknowledge")
        bus.start(100_000)
        assert not bus.status() & BIT_12
        assert bus.position() == 0


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


def test_vanished_gateway_answers_nobody() -> None:
    with served() as bench:
        with Line(bench.server.port) as line:
            for request in (b"2F60600001000000", b"2B40600006000000", b"2B4060000F000000"):
                line.send(b"t6058" + request)
            bench.faults.set("rail.vanish")
            line.send(b"t6058237A6000A0860100")
            line.send(b"t60582B4060001F000000")
            line.send(b"t0800")
            while line.reply():
                pass
        with pytest.raises(ConnectionRefusedError):
            Line(bench.server.port)


def test_counter_that_wrapped_moves_by_its_own_count() -> None:
    with on_bus() as bus:
        bus.home()
        bus.faults.set("rail.reference_lost", 2_147_483.0, count=2)
        until(lambda: bus.rail.poll().encoder_mm > 4_000_000.0)
        before = bus.position()
        bus.move(before + 100_000)
        assert bus.position() == pytest.approx(before + 100_000, abs=50)
