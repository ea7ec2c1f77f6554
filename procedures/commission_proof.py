"""Commissioning's end: the stations by the strip, a first pass, a correction, and a stop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilcell.calibration.grid import grid_of
from hilcell.cell.devices import sweeping_robot
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import Point, PointId
from hilcell.ports import Array, DeviceError, NoReading
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result, Step
from procedures import plan
from procedures.base_frame import BaseFrame
from procedures.proved import prove, proved_result, proved_table
from procedures.rail import HoldStation
from procedures.world_frame import Home, WorldFrame

SAMPLES = 3
SEARCH_MM = 20.0


class Stations(Step):
    """Holds every station by the strip, and sees the nests on the slide there."""

    name = "stations"
    needs = "the nests on the slide"
    moves = "the slide to every station, the robot parked"
    measures = "the strip, and the nests on the slide"
    yields = "stations that the strip holds and the tracker sees"

    def announced(self, cell: Cell) -> str:
        places = ", ".join(f"{each.name} {each.strip_mm:.0f}" for each in cell.station)
        return f"the slide to every station ({places} mm of the strip), the robot parked"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        each_s = len(cell.layout.slide) * plan.measure_s(cell, SAMPLES)
        seconds = sum(
            plan.approach_s(cell, cell.rail.travel_min_mm, station) + each_s
            for station in cell.station
        )
        return PlannedStep.of_spans(self.name, 0, [Span("stations", len(cell.station), seconds)])

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        for station in session.cell.station:
            if f"commissioning.station {station.name}" not in session.log.verdicts:
                self._visit(session, station)
        held = [name for name in session.log.verdicts if name.startswith("commissioning.station ")]
        prove(
            session,
            "stations",
            holds=len(held) == len(session.cell.station),
            found=f"{len(held)} stations visited",
            expected="every station of the cell file",
            values={"station": session.cell.station},
        )

    def _visit(self, session: CellSession, station: Station) -> None:
        cell = session.cell
        session.hold_station(station)
        strip_mm = session.devices.rail.read().strip_mm
        T_L_B = inverse(cell.tracker.pose.matrix()) @ cell.layout.nominal_base(strip_mm)
        off_mm: list[float] = []
        unseen: list[str] = []  # with the reason
        for nest in cell.layout.slide:
            near_mm = apply(T_L_B, nest.xyz_mm[None])[0]
            key = f"{station.name} {nest.name}"
            try:
                seen = session.found_place(key, near_mm, SAMPLES, radius_mm=SEARCH_MM)
            except NoReading as error:
                unseen.append(f"{nest.name} ({error.summary})")
            else:
                off_mm.append(float(np.linalg.norm(np.array(seen.xyz_mm) - near_mm)))
        limit_mm = 2.0 * cell.layout.nest_tolerance_mm
        worst_mm = max(off_mm, default=float("nan"))
        prove(
            session,
            f"station {station.name}",
            holds=not unseen and worst_mm <= limit_mm,
            found=f"strip {strip_mm:.2f} mm, {len(off_mm)} nests within {worst_mm:.2f} mm"
            + (f", not seen: {', '.join(unseen)}" if unseen else ""),
            expected=f"strip {station.strip_mm:.2f} mm, all nests within {limit_mm:g} mm",
        )

    def result(self, log: Log) -> Result:
        return proved_result(log)


class FirstPass(Step):
    """The corners of the cube, slowly, and one of them corrected by its measured error."""

    name = "first-pass"
    needs = "world and base frame, the grid's station held"
    moves = "the robot to the corners of its cube at the cell file's speed"
    measures = "the reflector on the flange"
    yields = "a robot that reaches its cube, and a correction that goes the right way"

    RIGHT_WAY = 0.5  # largest share of the error that a correction may leave

    def announced(self, cell: Cell) -> str:
        size = " x ".join(f"{each:g}" for each in cell.grid.size_mm)
        return f"the robot to the corners of its cube, {size} mm, at {cell.robot.speed_percent:g} %"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        joints_rad = plan.check_targets(
            cell, cell.reference, plan.poses_at(cell, self._corners_mm(cell)), "corner of the cube"
        )
        points = len(joints_rad) + 1
        spans = [plan.flange_points(cell, joints_rad), *plan.closing(cell)]
        return PlannedStep.of_spans(self.name, points, spans)

    def perform(self, session: CellSession) -> None:
        cell, station = session.cell, session.cell.reference
        corners_mm = self._corners_mm(cell)
        joints_rad = plan.joints_for(cell, corners_mm)
        T_W_B = session.frames.base_in_world(station)
        errors_mm = np.array(
            [
                self._error_mm(
                    session,
                    session.flange_point(
                        PointId("commission", number=number),
                        station,
                        joints,
                        nominal_mm=apply(T_W_B, corner_mm[None])[0],
                    ),
                    corner_mm,
                )
                for number, (joints, corner_mm) in enumerate(
                    zip(joints_rad, corners_mm, strict=True)
                )
            ]
        )
        self._judge(session, corners_mm, errors_mm)
        session.close_step()

    def _judge(self, session: CellSession, corners_mm: Array, errors_mm: Array) -> None:
        cell, station = session.cell, session.cell.reference
        lengths_mm = np.linalg.norm(errors_mm, axis=1)
        worst = int(np.argmax(lengths_mm))
        target_mm = corners_mm[worst]
        joints = plan.joints_for(cell, (target_mm - errors_mm[worst])[None])[0]
        point = session.flange_point(
            PointId("commission", number=len(corners_mm), how="corrected"),
            station,
            joints,
            nominal_mm=apply(session.frames.base_in_world(station), target_mm[None])[0],
        )
        left_mm = float(np.linalg.norm(self._error_mm(session, point, target_mm)))
        limit_mm = cell.layout.base_tolerance_mm
        prove(
            session,
            "first pass",
            holds=bool(lengths_mm.max() <= limit_mm),
            found=f"{len(corners_mm)} corners of the cube reached, off {lengths_mm.mean():.2f} mm "
            f"mean, {lengths_mm.max():.2f} mm at most",
            expected=f"<= {limit_mm:g} mm",
        )
        prove(
            session,
            "correction",
            holds=left_mm <= self.RIGHT_WAY * float(lengths_mm[worst]),
            found=f"{lengths_mm[worst]:.3f} mm before, {left_mm:.3f} mm with command = nominal - e",
            expected=f"<= {100 * self.RIGHT_WAY:g} % of the error before",
        )

    @staticmethod
    def _error_mm(session: CellSession, point: Point, corner_mm: Array) -> Array:
        """Return e (3,) in {B}: actual less nominal."""
        T_W_B = session.frames.base_in_world(session.cell.reference)
        actual_mm = session.frames.world_from_tracker(np.array(point.xyz_mm))
        error_mm: Array = apply(inverse(T_W_B), actual_mm)[0] - corner_mm
        return error_mm

    @staticmethod
    def _corners_mm(cell: Cell) -> Array:
        """Return the corners (8, 3) of the cube in {B}."""
        vertices_mm = grid_of(cell).serpentine_mm()
        low, high = vertices_mm.min(axis=0), vertices_mm.max(axis=0)
        ends: Sequence[Array] = (low, high)
        return np.array(
            [
                [ends[i][0], ends[j][1], ends[(k + j + i) % 2][2]]
                for i in range(2)
                for j in range(2)
                for k in range(2)
            ]
        )

    def result(self, log: Log) -> Result:
        return proved_result(log)


class StopRobot(Step):
    """A stop in a slow motion of axis 1; the run's last motion, for a stop is latched."""

    name = "stop-robot"
    needs = "a robot that can move one axis slowly"
    moves = "axis 1 by at most 5 deg at 1 deg/s"
    measures = "the joints after the stop"
    yields = "a robot that a software stop brakes"

    SWEEP_DEG, SPEED_DEG_S = 5.0, 1.0
    STOPPED_DEG = 0.5  # at most, after the stop
    POLL_S = 0.005

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, 0, self.SWEEP_DEG / self.SPEED_DEG_S)

    def perform(self, session: CellSession) -> None:
        if "commissioning.robot stop" in session.log.verdicts:
            return
        session.parked()
        start_rad = np.radians(session.cell.robot.safe_deg)
        low, high = session.cell.robot.margin_limits_rad[:, 0]
        way = 1.0 if start_rad[0] < (low + high) / 2.0 else -1.0
        end_rad = start_rad.copy()
        end_rad[0] += way * np.radians(self.SWEEP_DEG)
        with session.admitted() as motion:
            motion.check_path(end_rad, "stop")
            motion.begin(end_rad, "stop")
            at_stop_rad, at_rest_rad = self._stopped(session, float(end_rad[0]))
        after_deg = abs(float(np.degrees(at_rest_rad - at_stop_rad)))
        short_deg = abs(float(np.degrees(end_rad[0] - at_rest_rad)))
        holds = after_deg <= self.STOPPED_DEG and short_deg >= self.STOPPED_DEG
        prove(
            session,
            "robot stop",
            holds=holds,
            found=f"at rest {after_deg:.3f} deg after the stop, {short_deg:.2f} deg before the end",
            expected=f"<= {self.STOPPED_DEG:g} deg after the stop",
        )

    def _stopped(self, session: CellSession, end_rad: float) -> tuple[float, float]:
        """Stop a sweep of axis 1 in its middle; return the joint at the stop and at rest, rad."""
        robot = session.devices.robot
        speed_rad_s = np.radians(self.SPEED_DEG_S)
        at_stop_rad = float("nan")
        try:
            with sweeping_robot(robot).sweep(0, end_rad, speed_rad_s) as sweep:
                sweep.kickoff()
                session.clock.wait(self.SWEEP_DEG / self.SPEED_DEG_S / 2.0)
                session.clock.wait(self.POLL_S)
                at_stop_rad = float(sweep.collect().joints_rad[0])
                robot.stop()
                while not sweep.ended:
                    session.clock.wait(self.POLL_S)
                    sweep.collect()  # raises once the controller shows the stop
        except DeviceError:
            if np.isnan(at_stop_rad):
                raise
        session.clock.wait(session.cell.settle.robot_s)
        return at_stop_rad, float(robot.read().joints_rad[0])

    def result(self, log: Log) -> Result:
        return proved_result(log)


COMMISSION_STATIONS = Procedure(
    "commission-stations",
    "commissioning: every station by the strip, its nests by the tracker",
    (Home(), Stations()),
    proved_table,
    of_rail=True,
)
COMMISSION_PROOF = Procedure(
    "commission-proof",
    "commissioning: a first pass of the cube, a correction, a stop",
    (Home(), WorldFrame(), HoldStation(), BaseFrame(), FirstPass(), StopRobot()),
    proved_table,
    by_hand="watch the first motions at the E-stop",
)
