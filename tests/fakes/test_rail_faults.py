"""Each fault of the rail, as a master sees it on the wire."""

from __future__ import annotations

import pytest

from tests.fakes.rail_bench import BIT_10, BIT_12, BIT_13, Line, Master, served, until


@pytest.mark.parametrize("code", [0x7305, 0x8611])
def test_emergency_while_moving(code: int) -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.emcy", code)
        master.move(100_000)
        assert [entry.code for entry in master.drive.emcy.log] == [code]
        assert master.read(0x1001, 0, "B") == 1
        master.control(0x80)
        assert master.read(0x1001, 0, "B") == 0
        assert not master.drive.emcy.active


def test_following_error_is_bit_13() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.fault")
        master.start(100_000)
        until(lambda: master.status() & 0x4F == 0x08, "fault")
        assert master.status() & BIT_13
        master.control(0x00)
        master.control(0x80)
        assert not master.status() & BIT_13


def test_lasting_fault_still_lets_the_slide_stop() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.fault", 0x2310, count=0)
        master.start(1_000_000)
        until(lambda: master.status() & 0x4F == 0x08, "fault")
        assert bench.rail.still
        assert [entry.code for entry in master.drive.emcy.log] == [0x2310]


@pytest.mark.parametrize(("switch", "inputs"), [(-1, 1), (1, 2)])
def test_limit_switch_on_demand(switch: int, inputs: int) -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.limit_switch", switch)
        master.start(100_000)
        until(lambda: master.status() & 0x4F == 0x08, "fault")
        assert master.read(0x60FD) == inputs
        master.control(0x00)
        master.control(0x80)
        assert master.read(0x60FD) == 0


def test_node_reset_while_moving() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        boots: list[int] = []
        master.drive.nmt.add_heartbeat_callback(boots.append)
        bench.faults.set("rail.node_reset", 5)
        master.start(1_000_000)
        assert master.status() & 0x6F == 0x40
        assert boots == [0]
        until(lambda: bench.rail.still, "stands")
        assert master.read(0x6064, 0, "i") < 1_000_000


def test_a_node_that_this_bus_lacks_does_not_reboot() -> None:
    """The strip's, where it is on a bus of its own."""
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.node_reset", 7)
        master.move(100_000)
        assert master.read(0x6064, 0, "i") == 100_000
        assert bench.faults.take("rail.node_reset") is None, "it has struck"


def test_set_point_never_acknowledged() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.no_acknowledge")
        master.start(100_000)
        assert not master.status() & BIT_12
        assert master.read(0x6064, 0, "i") == 0


def test_target_reached_too_early() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.early_target_reached")
        master.start(100_000)
        assert master.status() & BIT_10
        assert not master.slow()
        until(master.arrived, "arrived")


def test_wrong_mode_is_shown() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x6060, 0, 1, "b")
        bench.faults.set("rail.wrong_mode", 3)
        assert master.read(0x6061, 0, "b") == 3
        assert master.read(0x6061, 0, "b") == 1


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
        with pytest.raises(OSError, match="refused"):
            Line(bench.server.port)


def test_counter_that_wrapped_moves_by_its_own_count() -> None:
    with served() as bench, Master(bench.server.port) as master:
        master.home()
        bench.faults.set("rail.reference_lost", 2_147_483.0, count=2)
        until(lambda: bench.rail.poll().encoder_mm > 4_000_000.0, "the count has wrapped")
        before = master.read(0x6064, 0, "i")
        master.move(before + 100_000)
        assert master.read(0x6064, 0, "i") == pytest.approx(before + 100_000, abs=50)
