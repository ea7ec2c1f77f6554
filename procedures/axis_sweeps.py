"""Errors of single joints, from slow sweeps of single axes with the tracker streaming."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import NamedTuple, Self

import numpy as np

from hilcell.calibration.grid import grid_of
from hilcell.cell.devices import Rests, abilities
from hilcell.cell.file import Cell
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import forward
from hilcell.identification.axis_motion import SweepStream
from hilcell.identification.sweeps import swept_axis
from hilcell.journal.log import Log
from hilcell.journal.stream_file import read_stream
from hilcell.model.events import AxesNotSwept, CurveMeasured, NoReadingOf, Pair
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.results import StepResult
from hilcell.ports import Array, NoReading
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import below, check_sweep
from hilcell.run.mover import SweepCommand
from hilcell.run.procedure import Result
from procedures import plan

DIRECTIONS = ("up", "down")
# A quick plan sweeps so much faster than the cell file says, with as many samples a degree, but no
# sweep shorter than the joints' readings need.
FASTER, LEAST_S = 3.0, 5.0
FASTEST_HZ = 1000.0


class Swept(StepResult, frozen=True, kw_only=True):
    """An axis's transmission curve: lines in cycles per revolution, amplitudes, rms of the smooth
    error, residual, and difference of both sweeps.
    """

    axis: int
    used: bool
    reason: str
    range_deg: Pair
    cycles: list[float]
    amplitude_urad: list[float]
    lag_ms: float
    lag_u_ms: float
    noise_urad: float
    signal_urad: float
    smooth_urad: float
    share: float
    differ_urad: float
    lost: int

    @property
    def lines(self) -> str:
        pairs = zip(self.cycles, self.amplitude_urad, strict=True)
        return ", ".join(f"{cycles:.1f}: {size:.1f}" for cycles, size in pairs) or "none"


class Sweeps(StepResult, frozen=True, kw_only=True):
    """The swept axes, or why there are none."""

    left_out: str
    axes: list[Swept]


class AxisSweeps:
    """Each axis moves alone, up and down, the others as at the cube's middle.

    A joint's lag behind the tracker has opposite signs upwards and downwards, so it is identified.
    """

    TRIES, ATTEMPTS = 3, 2  # of one sweep after a broken beam, of both sweeps of an axis
    STREAM_S = 1.5  # begin and end of a stream

    name = "axis-sweeps"
    needs = "the base frame, the grid's station held; a tracker that streams, a robot that sweeps"
    moves = "single axes slowly, through the cube's middle"
    measures = "the flange reflector, streaming"
    yields = "the transmission curve of each axis"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse sweeps out of limits or out of the tracker's range; skip a cell that cannot."""
        if reason := left_out(cell):
            return PlannedStep(self.name, 0, 0.0, note=reason)
        station, positions = cell.reference, 20  # that must be in the tracker's range
        seconds, here_rad = 0.0, np.radians(cell.robot.safe_deg)
        cube = CubeJoints.of(cell)
        for axis in self.axes(cell):
            for direction in DIRECTIONS:
                start_rad, end_rad = cube.ends_rad(cell, axis, direction)
                check_sweep(cell, station, start_rad, end_rad, f"A{axis} swept {direction}")
                path_rad = np.linspace(start_rad, end_rad, positions)
                at_mm = forward(cell.robot.arm(), path_rad)[:, :3, 3]
                world_mm = apply(cell.layout.nominal_base(station.rail_mm), at_mm)
                plan.check_range(cell, world_mm, f"A{axis} swept {direction}")
                turn_deg = float(np.degrees(np.abs(end_rad - start_rad).max()))
                percent = plan.first_pass_percent(cell, start_rad[None])[0]
                below_rad = below(cell, start_rad)
                seconds += float(plan.robot_moves_s(cell, here_rad, below_rad, percent))
                seconds += float(plan.robot_moves_s(cell, below_rad, start_rad, percent))
                sweep_s = turn_deg / (haste(cell, turn_deg) * cell.sweeps.speed_deg_s)
                seconds += Rests.of(cell).robot_s + self.STREAM_S + sweep_s
                here_rad = end_rad
        count = len(DIRECTIONS) * len(self.axes(cell))
        return PlannedStep.of_spans(
            self.name, 0, [Span("sweep", count, seconds), *plan.closing(cell)]
        )

    def perform(self, session: CellSession) -> None:
        cell = session.cell
        if reason := left_out(cell):
            session.add(AxesNotSwept(reason=reason))
            return
        left = [axis for axis in self.axes(cell) if axis not in session.log.curves]
        cube = CubeJoints.of(cell)
        swept = [self._swept(session, cube, axis) for axis in left]
        session.close_step()
        for curve in swept:
            session.add(curve)

    def _swept(self, session: CellSession, cube: CubeJoints, axis: int) -> CurveMeasured:
        """Return an axis's curve; sweep again where the first sweeps cannot be used."""
        for attempt in range(1, self.ATTEMPTS + 1):
            up, down = (
                self._sweep(session, cube, axis, direction, attempt) for direction in DIRECTIONS
            )
            curve = swept_axis(up, down, session.cell.robot.arm(), axis - 1)
            if not curve.reason:
                break
        return curve

    def _sweep(
        self, session: CellSession, cube: CubeJoints, axis: int, direction: str, attempt: int = 1
    ) -> SweepStream:
        """Return the stream of one sweep, in {B}."""
        again = "" if attempt == 1 else f"/{attempt}"
        cell, key = session.cell, f"sweep/A{axis}/{direction}{again}"
        station = cell.reference
        T_W_B = session.frames.base_in_world(station)
        if key not in session.log.streams:
            session.flange_at(station)
            start_rad, end_rad = cube.ends_rad(cell, axis, direction)
            start_mm = (T_W_B @ forward(cell.robot.arm(), start_rad))[:3, 3]
            at_mm = session.frames.tracker_from_world(start_mm)[0]
            end = float(end_rad[axis - 1])
            faster = haste(cell, float(np.degrees(abs(end - start_rad[axis - 1]))))
            speed_rad_s = faster * float(np.radians(cell.sweeps.speed_deg_s))
            rate_hz = min(faster * cell.sweeps.rate_hz, FASTEST_HZ)
            self._record(session, SweepCommand(
                key, start_rad, axis - 1, end, speed_rad_s, at_mm, rate_hz,
            ))  # fmt: skip
        record = session.log.streams[key]
        data = read_stream(session.folder, record)
        T_B_L = inverse(T_W_B) @ session.frames.tracker_in_world(record.set_up)
        return replace(data, xyz_mm=apply(T_B_L, data.xyz_mm))

    def _record(self, session: CellSession, order: SweepCommand) -> None:
        """Sweep, up to `TRIES` times after a broken beam; raises `NoReading`."""
        for tries in range(1, self.TRIES + 1):
            try:
                session.sweep(order)
            except NoReading as error:
                key, said, facts = order.key, str(error), error.of_point(order.key).facts()
                session.add(NoReadingOf(key=key, tries=tries, reason=said, error=facts))
                if tries == self.TRIES:
                    raise
            else:
                return

    def result(self, log: Log) -> Result:
        reasons = ["", *(each.reason for each in log.happened(AxesNotSwept))]
        axes = [self._reported(record) for record in log.curves.values()]
        return {"sweeps": Sweeps(left_out=reasons[-1], axes=axes)}

    @staticmethod
    def _reported(record: CurveMeasured) -> Swept:
        return Swept(
            axis=record.axis,
            used=record.holds,
            reason=record.reason,
            range_deg=np.degrees([record.low_rad, record.high_rad]).tolist(),
            cycles=record.cycles,
            amplitude_urad=record.amplitudes_urad,
            lag_ms=record.lag_s * 1e3,
            lag_u_ms=record.lag_sigma_s * 1e3,
            noise_urad=record.noise_rad * 1e6,
            signal_urad=record.signal_rad * 1e6,
            smooth_urad=record.smooth_rad * 1e6,
            share=record.share,
            differ_urad=record.differ_rad * 1e6,
            lost=record.lost,
        )

    @staticmethod
    def table(result: Result) -> Table:
        return Table(
            [
                Column("axis", lambda row: f"A{row.axis}"),
                Column("used", lambda row: "yes" if row.used else row.reason),
                Column("cycles: amplitude", attrgetter("lines"), "µrad"),
                Column("smooth", attrgetter("smooth_urad"), "µrad", ".1f"),
                Column("lag", attrgetter("lag_ms"), "ms", ".2f"),
                Column("noise", attrgetter("noise_urad"), "µrad", ".1f"),
                Column("signal", lambda row: 100 * row.share, "%", ".0f"),
            ],
            typed(result["sweeps"], Sweeps).axes,
        )

    @staticmethod
    def words(result: Result) -> str:
        """Return why no axis was swept; "" where some were."""
        reason = typed(result["sweeps"], Sweeps).left_out
        return f"Axes not swept: {reason}." if reason else ""

    @staticmethod
    def axes(cell: Cell) -> list[int]:
        """Return the axes to sweep, 1 to 6.

        Not axis 2 where its joint turns axis 3, too: a sweep moves one joint.
        """
        return [axis for axis in cell.sweeps.axes if axis != 2 or not cell.robot.arm().coupling]


def left_out(cell: Cell) -> str:
    """Return why no axis of the cell is swept and the consequence; "" where some are."""
    able = abilities(cell)
    obstacles = {
        "sweeps.enabled is false in the cell file": not cell.sweeps.enabled,
        "sweeps.axes names none of the axes": not AxisSweeps.axes(cell),
        "they leave the grid's cube, and the cell file states no robot.envelope": (
            cell.surroundings is None
        ),
        f"tracker driver {cell.tracker.driver!r} does not stream": not able["tracker_streams"],
        f"robot driver {cell.robot.driver!r} does not sweep an axis": not able["robot_sweeps"],
    }
    reason = next((text for text, applies in obstacles.items() if applies), "")
    return (
        f"{reason}; the ripple of the gears stays in the error after correction" if reason else ""
    )


def haste(cell: Cell, turn_deg: float) -> float:
    """Return speed and samples of a sweep over those of the cell file."""
    usual_s = turn_deg / cell.sweeps.speed_deg_s
    return max(1.0, min(FASTER, usual_s / LEAST_S)) if cell.plan.quick else 1.0


class CubeJoints(NamedTuple):
    """The lowest and highest joints (6,) of the grid's cube, and those at its middle."""

    low_rad: Array
    high_rad: Array
    middle_rad: Array

    @classmethod
    def of(cls, cell: Cell) -> Self:
        grid, along_edge = grid_of(cell), 7  # places
        edges = np.linspace(grid.origin_mm, grid.far_mm, along_edge).T
        places_mm = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1).reshape(-1, 3)
        joints_rad = plan.check_reach(cell, plan.poses_at(cell, places_mm), "cube")
        middle_rad = joints_rad[len(joints_rad) // 2]
        return cls(joints_rad.min(axis=0), joints_rad.max(axis=0), middle_rad)

    def ends_rad(self, cell: Cell, axis: int, direction: str) -> tuple[Array, Array]:
        """Return the joints (6,) at the begin and at the end of a sweep."""
        low_rad, high_rad = self.low_rad[axis - 1], self.high_rad[axis - 1]
        centre_rad = (low_rad + high_rad) / 2
        half_rad = (high_rad - low_rad) / 2 + np.radians(cell.sweeps.margin_deg)
        start_rad, end_rad = self.middle_rad.copy(), self.middle_rad.copy()
        start_rad[axis - 1], end_rad[axis - 1] = centre_rad - half_rad, centre_rad + half_rad
        return (start_rad, end_rad) if direction == "up" else (end_rad, start_rad)
