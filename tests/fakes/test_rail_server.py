"""The served rail as a whole: clients that come or are killed, nonsense, each of its faults."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fakes.rail_bench import BIT_10, BIT_13, Bus, Line, Master, on_bus, served, until

CLIENT = """
import sys
from tests.fakes.rail_bench import MASTER, Master

master = Master(int(sys.argv[1]))
master.home()
master.write(0x6007, 0, 3, "h")
master.write(0x6081, 0, 5_000, "I")
master.write(0x1016, 1, MASTER << 16 | 500, "I")
master.network.send_periodic(0x700 + MASTER, b"\\x05", 0.02)
master.start(2_900_000)
while master.position() < 1000:
    pass
print("moving", flush=True)
sys.stdin.read()
"""


@pytest.mark.wall
def test_killed_master_leaves_the_slide_standing_and_the_bus_free() -> None:
    with served(20.0) as bench:
        root = Path(__file__).parents[2]
        command = [sys.executable, "-c", CLIENT, str(bench.server.port)]
        with subprocess.Popen(
            command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as client:
            assert client.stdout is not None
            assert client.stdout.readline() == b"moving\n"
            assert not bench.rail.at_rest
            client.kill()
        until(lambda: bench.rail.at_rest)
        with Master(bench.server.port) as master:
            assert master.status() & 0x6F == 0x40
            position = master.position()
            assert 1000 < position < 2_900_000
            assert master.read(0x1003, 1) == 0x8130
            master.enable(1)
            master.move(position + 1000)


def test_one_client_at_a_time() -> None:
    with (
        served() as bench,
        Line(bench.server.port) as first,
        Line(bench.server.port, opened=False) as second,
    ):
        second.send(b"O")
        first.send(b"t60684000100000000000")
        until(lambda: first.frame().startswith(b"t586"))
        assert second.quiet()
        first.__exit__()
        second.send(b"t60584000100000000000")
        assert second.frame() == b"t58584300100092010200", "served once the other has left"


def test_closing_ends_the_connection_and_the_thread() -> None:
    with served() as bench:
        line = Line(bench.server.port)
        bench.server.close()
        with line:
            while line.reply():
                pass
        with pytest.raises(ConnectionRefusedError):
            Line(bench.server.port)


FRAMES = st.tuples(
    st.sampled_from([0x000, 0x080, 0x205, 0x305, 0x405, 0x605, 0x606, 0x77F])
    | st.integers(0, 0x7FF),
    st.binary(max_size=8)
    | st.builds(
        lambda command, index, sub, value: (
            bytes([command]) + index.to_bytes(2, "little") + bytes([sub]) + value
        ),
        st.sampled_from([0x40, 0x2F, 0x2B, 0x23, 0x22, 0x21, 0x00, 0x60, 0x70, 0x80]),
        st.sampled_from(
            [0x1016, 0x1017, 0x1800, 0x1A00, 0x1400, 0x1600, 0x6040, 0x6060, 0x607A, 0x6081, 0x6098]
        ),
        st.integers(0, 9),
        st.binary(min_size=4, max_size=4),
    ),
)


@settings(max_examples=40)
@given(st.lists(FRAMES, max_size=60))
def test_no_frame_upsets_the_nodes(frames: list[tuple[int, bytes]]) -> None:
    with on_bus() as bus:
        for frame in frames:
            bus.send(*frame)
        bus.send(0x000, b"\x81\x00")
        bus.sync()
        assert bus.read(0x1000) == 0x00020192
        assert all(len(data) <= 8 for _, data in bus.frames)


def test_following_error_is_bit_13(bus: Bus) -> None:
    bus.home()
    bus.faults.set("rail.fault")
    bus.start(100_000)
    until(bus.faulty)
    assert bus.status() & BIT_13
    bus.control(0x00)
    bus.control(0x80)
    assert not bus.status() & BIT_13


def test_lasting_fault_still_lets_the_slide_stop(bus: Bus) -> None:
    bus.home()
    bus.faults.set("rail.fault", 0x2310, count=0)
    bus.start(1_000_000)
    until(bus.faulty)
    assert bus.rail.at_rest
    assert bus.emergencies() == [0x2310]


def test_a_node_that_this_bus_lacks_does_not_reboot(bus: Bus) -> None:
    """The strip's, where it is on a bus of its own."""
    bus.home()
    bus.faults.set("rail.node_reset", 7)
    bus.move(100_000)
    assert bus.position() == 100_000
    assert bus.faults.take("rail.node_reset") is None, "it has struck"


def test_target_reached_too_early(bus: Bus) -> None:
    bus.home()
    bus.faults.set("rail.early_target_reached")
    bus.start(100_000)
    assert bus.status() & BIT_10
    assert not bus.slow()
    until(bus.arrived)


def test_wrong_mode_is_shown(bus: Bus) -> None:
    bus.write(0x6060, 0, 1, "b")
    bus.faults.set("rail.wrong_mode", 3)
    assert [bus.read(0x6061, 0, "b") for _ in range(2)] == [3, 1]


def test_counter_that_wrapped_moves_by_its_own_count(bus: Bus) -> None:
    bus.home()
    bus.faults.set("rail.reference_lost", 2_147_483.0, count=2)
    until(lambda: bus.rail.poll().encoder_mm > 4_000_000.0)
    before = bus.position()
    bus.move(before + 100_000)
    assert bus.position() == pytest.approx(before + 100_000, abs=50)
