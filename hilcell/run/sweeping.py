"""A slow sweep of one axis with the tracker streaming: guarded, recorded, once in a run's life.

The trap: tracker and robot have no clock in common. So samples keep the tracker's own time and the
window of the cell's clock in which they arrived, joints the cell's clock before and after they
were asked for; the reader of the stream pairs them.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import msgspec
import numpy as np

from hilcell.devices import streams_of, sweeps_of
from hilcell.ports import Array
from hilcell.run.bench import Bench
from hilcell.run.fresh import fresh
from hilcell.run.interlocks import check_joint_limits, robot_may_move
from hilcell.run.stream_file import StreamFile, StreamRecord

PACE_S = 0.05  # between two questions for the joints: a controller bears 20 a second


@dataclass(frozen=True)
class SweepOrder:
    """From joints (6,) one axis (0 to 5) to its end; the reflector begins at (3,) mm."""

    key: str
    start_rad: Array
    axis: int
    end_rad: float
    speed_rad_s: float
    near_mm: Array  # the tracker's frame
    rate_hz: float

    @property
    def target_rad(self) -> Array:
        """Return the joints (6,) at the end."""
        joints_rad = self.start_rad.copy()
        joints_rad[self.axis] = self.end_rad
        return joints_rad


def record_sweep(bench: Bench, order: SweepOrder) -> StreamRecord:
    """Go to the start, sweep where the slide stands, and return what the journal keeps of it."""
    if order.key in bench.log.streams:
        return bench.log.streams[order.key]
    tracker, robot = streams_of(bench.devices.tracker), sweeps_of(bench.devices.robot)
    bench.checkpoint()
    check_joint_limits(bench.cell, order.target_rad, order.key)
    bench.robot_to(order.start_rad, order.key)
    rail = fresh(bench.devices.rail.read, bench.cell.settle.reading_age_s)
    robot_may_move(bench.cell, rail, bench.held, time.monotonic())
    reflector = bench.cell.tracker.reflector
    joints_deg = np.degrees(order.target_rad)
    bench.intend(order.key, "robot.sweep", axis=order.axis + 1, joints_deg=joints_deg)
    with (
        StreamFile(bench.folder, order.key) as file,
        tracker.stream(order.near_mm, reflector, order.rate_hz) as stream,
        robot.sweep(order.axis, order.end_rad, order.speed_rad_s) as sweep,
    ):
        stream.kickoff()
        sweep.kickoff()
        while not sweep.ended:
            bench.clock.wait(PACE_S)
            file.take((), [sweep.collect()])
            file.take(stream.collect())
        sweep.complete()
        file.take(stream.complete())
        record = file.finish()
        speed_deg_s, rate_hz = float(np.degrees(sweep.speed_rad_s)), stream.rate_hz
    bench.event(
        "stream",
        **msgspec.structs.asdict(record),
        axis=order.axis + 1,
        speed_deg_s=speed_deg_s,
        rate_hz=rate_hz,
        start_deg=np.degrees(order.start_rad),
        end_deg=joints_deg,
        reflector=reflector,
        session=bench.log.session,
    )
    return record
