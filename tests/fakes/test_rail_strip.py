"""The CiA 406 strip sensor: where it sees the slide, and its failures at a SYNC."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from statistics import median

import pytest

from fakes.strip import StripLine
from hilcell.cell.file import Cell
from tests.fakes.conftest import simulated_site
from tests.fakes.rail_bench import STRIP, Bus, on_bus, until


@contextmanager
def synchronised() -> Iterator[Bus]:
    """Have 6004 + 6503 in the sensor's first TPDO, on every SYNC."""
    with on_bus() as bus:
        bus.map_pdo(0, (0x60040020, 0x65030010), STRIP)
        bus.start_nodes()
        yield bus


@pytest.fixture
def bus() -> Iterator[Bus]:
    with synchronised() as bus:
        yield bus


def sync(bus: Bus, count: int = 1) -> list[tuple[int, int]]:
    """Return position and alarms of ``count`` SYNCs."""
    before = len(bus.heard(0x186))
    bus.sync(count)
    return [struct.unpack("<iH", data) for data in bus.heard(0x186)[before:]]


def test_it_is_absolute_and_follows_the_slide(bus: Bus) -> None:
    assert abs(sync(bus)[0][0] / 100 - bus.rail.slide_mm()) < 0.02
    bus.home()
    bus.move(300_000)
    position, alarms = sync(bus)[0]
    assert abs(position / 100 - bus.rail.slide_mm()) < 0.02
    assert abs(position - 30_000) < 100
    assert alarms == 0
    seen = [position for position, _ in sync(bus, 40)]
    assert max(seen) - min(seen) == 2, "at rest it flickers"
    middles = {median(seen[n : n + 5]) for n in range(36)}
    assert len(middles) == 1, "about one value, wherever one begins"


def test_jitter_of_one_count(bus: Bus) -> None:
    true = median(position for position, _ in sync(bus, 5))
    bus.faults.set("rail.strip_jitter", count=4)
    assert [p - true for p, _ in sync(bus, 4)] == [-1, 1, -1, 1]


def test_same_moves_give_the_same_figures_however_often_one_looks() -> None:
    """Stepped time: end of motion, strip and cell time do not depend on polls.

    The strip by its middle of five, wherever in its jitter they begin.
    """
    found = []
    for looks in (0, 7):
        with synchronised() as bus:
            bus.home()
            for target in (300_000, 299_000, 300_000):
                bus.start(target)
                sync(bus, looks)
                until(bus.arrived)
            strip = median(position for position, _ in sync(bus, 5))
            found.append((strip, bus.rail.slide_mm(), bus.time.now_s()))
    assert found[0][0] == found[1][0]
    assert all(math.isclose(a, b, abs_tol=1e-9) for a, b in zip(*found, strict=True))


def test_a_head_that_misses_its_strip_says_so_in_its_register(cell: Cell) -> None:
    """The strip on a serial line of its own."""
    site, _ = simulated_site(cell)
    with closing(StripLine(site, {})) as line:
        line.answers(b"Z")
        assert line.answers(b"X") == ([b"0x00>\r"], b"")
        site.faults.set("rail.missing_magnet")
        line.answers(b"Z")
        assert line.answers(b"X") == ([b"0x01>\r"], b"")
        line.answers(b"Z")
        assert line.answers(b"XA") == ([b"0x00>\r"], b"A")
