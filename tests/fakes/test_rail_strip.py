"""The CiA 406 strip sensor: where it sees the slide, and its failures at a SYNC."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median

from tests.fakes.rail_bench import STRIP, Bench, Master, served, until


@contextmanager
def synchronised() -> Iterator[tuple[Bench, Master]]:
    """Serve with 6004 + 6503 in the sensor's first TPDO, on every SYNC."""
    with served() as bench, Master(bench.server.port) as master:
        master.write(0x1800, 1, 0xC0000186, "I", STRIP)
        master.write(0x1800, 2, 1, "B", STRIP)
        master.write(0x1A00, 0, 0, "B", STRIP)
        for sub, entry in enumerate((0x60040020, 0x65030010), start=1):
            master.write(0x1A00, sub, entry, "I", STRIP)
        master.write(0x1A00, 0, 2, "B", STRIP)
        master.write(0x1800, 1, 0x40000186, "I", STRIP)
        master.network.nmt.send_command(1)
        yield bench, master


def sync(master: Master, count: int = 1, node: int = STRIP) -> list[tuple[int, int]]:
    """Return position and alarms of ``count`` SYNCs."""
    seen: list[bytes] = []
    before = 0

    def answered() -> bool:
        return len(seen) > before

    def note(_cob_id: int, data: bytearray, _taken_s: float) -> None:
        seen.append(bytes(data))

    master.network.subscribe(0x180 + node, note)
    for _ in range(count):
        before = len(seen)
        master.network.sync.transmit()
        until(answered, "TPDO")
    master.network.unsubscribe(0x180 + node, note)
    return [struct.unpack("<iH", data) for data in seen]


def test_it_is_absolute_and_follows_the_slide() -> None:
    with synchronised() as (bench, master):
        assert abs(sync(master)[0][0] / 100 - bench.rail.slide_mm()) < 0.02
        master.home()
        master.move(300_000)
        position, alarms = sync(master)[0]
        assert abs(position / 100 - bench.rail.slide_mm()) < 0.02
        assert abs(position - 30_000) < 100
        assert alarms == 0
        seen = [position for position, _ in sync(master, 40)]
        assert max(seen) - min(seen) == 2, "at rest it flickers"
        middles = {median(seen[n : n + 5]) for n in range(36)}
        assert len(middles) == 1, "about one value, wherever one begins"


def test_frozen_strip() -> None:
    with synchronised() as (bench, master):
        master.home()
        before = sync(master)[0][0]
        bench.faults.set("rail.strip_frozen", count=0)
        sync(master)
        master.move(50_000)
        assert sync(master)[0][0] == before
        bench.faults.clear("rail.strip_frozen")
        assert abs(sync(master)[0][0] - before - 5000) < 100


def test_missing_magnet_is_alarm_and_emergency() -> None:
    with synchronised() as (bench, master):
        master.enable(1)
        bench.faults.set("rail.missing_magnet", count=2)
        before = sync(master)[0]
        assert before[1] == 1
        until(lambda: [e.code for e in master.strip.emcy.active] == [0x7305], "EMCY")
        master.move(20_000)
        assert sync(master)[0] == before, "it goes on with the last position"
        assert sync(master)[0][0] - before[0] > 1900
        assert sync(master)[0][1] == 0
        until(lambda: not master.strip.emcy.active, "error reset")


def test_jitter_of_one_count() -> None:
    with synchronised() as (bench, master):
        true = median(position for position, _ in sync(master, 5))
        bench.faults.set("rail.strip_jitter", count=4)
        assert [p - true for p, _ in sync(master, 4)] == [-1, 1, -1, 1]


def test_late_process_data() -> None:
    with synchronised() as (bench, master):
        bench.faults.set("rail.late_tpdo", 0.4)
        start_s = time.monotonic()
        sync(master)
        assert time.monotonic() - start_s >= 0.4
        start_s = time.monotonic()
        sync(master)
        assert time.monotonic() - start_s < 0.4


def test_same_moves_give_the_same_figures_however_often_one_looks() -> None:
    """Stepped time: end of motion, strip and plant time do not depend on polls.

    The strip by its middle of five, wherever in its flicker they begin.
    """
    found = []
    for looks in (0, 7):
        with synchronised() as (bench, master):
            master.home()
            for target in (300_000, 299_000, 300_000):
                master.start(target)
                sync(master, looks)
                until(master.arrived, "arrived")
            strip = median(position for position, _ in sync(master, 5))
            found.append((strip, bench.rail.slide_mm(), bench.time.now_s()))
    assert found[0][0] == found[1][0]
    assert all(math.isclose(a, b, abs_tol=1e-9) for a, b in zip(*found, strict=True))
