"""A slow sweep of one axis with the tracker streaming: guarded, recorded, once in a run's life.

Tracker and robot have no clock in common. So samples keep the tracker's own time and the window of
the cell's clock in which they arrived, joints the cell's clock before and after they were asked
for; the reader of the stream pairs them.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from hilcell.cell.devices import streams_of, sweeps_of
from hilcell.journal.stream_file import StreamFile
from hilcell.model.events import StreamRecorded
from hilcell.ports import Array
from hilcell.run.collision import check_stated
from hilcell.run.interlocks import check_joint_limits
from hilcell.run.mover import Mover
from hilcell.run.readings import seen
from hilcell.run.run_context import RunContext

PACE_S = 0.25  # between two questions for the joints: hundreds of them make one line


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


def record_sweep(run: RunContext, mover: Mover, order: SweepOrder) -> StreamRecorded:
    """Go to the start, sweep where the slide stands, and return what the journal keeps of it."""
    tracker, robot = streams_of(run.devices.tracker), sweeps_of(run.devices.robot)
    check_joint_limits(run.cell, order.target_rad, order.key)
    check_stated(run.cell, order.key)
    mover.robot_to(order.start_rad, order.key)
    reflector = run.cell.tracker.reflector
    joints_deg = np.degrees(order.target_rad)
    with mover.admitted() as motion:
        motion.check_way(order.target_rad, order.key)
    with mover.admitted() as motion:
        target = {"axis": order.axis + 1, "joints_deg": joints_deg}
        run.intend(order.key, "robot.sweep", **target, seen=seen(*motion.slide()))
        with (
            StreamFile(run.folder, order.key) as file,
            tracker.stream(order.near_mm, reflector, order.rate_hz) as stream,
            robot.sweep(order.axis, order.end_rad, order.speed_rad_s) as sweep,
        ):
            stream.kickoff()
            motion.begin(order.target_rad, order.key)
            sweep.kickoff()
            while not sweep.ended:
                run.clock.wait(PACE_S)
                file.take((), [sweep.collect()])
                file.take(stream.collect())
            sweep.complete()
            file.take(stream.complete())
            measured = msgspec.structs.replace(
                file.finish(),
                set_up=run.log.set_ups.number,
                axis=order.axis + 1,
                speed_deg_s=float(np.degrees(sweep.speed_rad_s)),
                rate_hz=stream.rate_hz,
                start_deg=np.degrees(order.start_rad).tolist(),
                end_deg=joints_deg.tolist(),
                reflector=reflector,
                session=run.log.session,
            )
    run.add(measured)
    return measured
