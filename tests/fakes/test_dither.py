"""The servo and the strip wander at rest, always; no figure follows from how often one looks."""

from __future__ import annotations

from statistics import median

import pytest

from fakes.truth.dither import STEPS, Dither
from tests.fakes.rail_bench import HUNTING, Master, served


@pytest.mark.parametrize("reach", [1, 2, 5])
def test_the_middle_of_any_five_steps_is_zero(reach: int) -> None:
    dither = Dither(reach, 5)
    counts, changes = [], []
    for _ in range(2 * STEPS):
        dither.step()
        counts.append(dither.counts)
        changes.append(dither.change)
    assert (min(counts), max(counts)) == (-reach, reach)
    assert {median(counts[n : n + 5]) for n in range(len(counts) - 4)} == {0}
    assert 0 not in changes


def looks(master: Master) -> list[tuple[int, int]]:
    """Return position and speed of the drive at 20 SYNCs."""
    seen = []
    for _ in range(20):
        master.network.sync.transmit()
        seen.append((master.read(0x6064, 0, "i"), master.read(0x606C, 0, "i")))
    return seen


def test_a_servo_dithers_while_it_has_power() -> None:
    with served() as bench, Master(bench.server.port) as master:
        assert set(looks(master)) == {(0, 0)}, "the brake holds it"
        master.enable(1)
        positions, speeds = zip(*looks(master), strict=True)
        assert bench.rail.still
        assert 2 <= max(positions) - min(positions) <= 4
        assert all(0 < abs(speed) <= HUNTING for speed in speeds)


def test_the_drive_has_windows_of_position_and_speed() -> None:
    with served() as bench, Master(bench.server.port) as master:
        for index, kind in ((0x6067, "I"), (0x6068, "H"), (0x606F, "H"), (0x6070, "H")):
            master.write(index, 0, 77, kind)
            assert master.read(index, 0, kind) == 77
