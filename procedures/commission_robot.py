"""Commissioning of the robot: settings of its controller, then each axis by a degree.

The controller's pose at rest, against that of its joints by the cell file, shows coupled axes and a
wrong tool before anything moves.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.controller_pose import Deviation
from hilcell.cell.file import Cell
from hilcell.cell.robot import RobotTable, arm_from_joints
from hilcell.geometry.inverse import status_of
from hilcell.journal.log import Log
from hilcell.model.events import ControllerRead
from hilcell.model.plan import PlannedStep, Span
from hilcell.ports import Array, RobotSettings
from hilcell.run.cell_session import CellSession
from hilcell.run.mover import StraightApproach
from hilcell.run.procedure import Procedure, Result, Step
from procedures.proved import prove, proved_result, proved_table

JOG_DEG = 1.0
JOG_PERCENT = 1.0
READ_BACK_DEG = 0.02
LIMIT_DEG = 0.01  # of joint limits that agree


class ReadController(Step):
    """Reads joints, limits and tool; the present pose becomes the safe pose."""

    name = "read-controller"
    needs = "the robot at a pose clear of the slide's way, from which the tracker sees the flange"
    moves = "nothing"
    measures = "the controller's joints, pose, limits and tool"
    yields = "tool, joint limits and safe pose of the cell file; coupled axes"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, 0, 1.0)

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        cell, robot = session.cell, session.devices.robot.read()
        settings: RobotSettings = session.devices.robot.settings()  # type: ignore[attr-defined]
        joints_deg = np.degrees(robot.joints_rad).tolist()
        if not session.log.happened(ControllerRead):
            session.add(_read(settings, joints_deg))
        self._judge_limits(session, settings)
        self._judge_arm(session, settings, robot.joints_rad, robot.pose)
        rounded_deg = [round(deg, 3) + 0.0 for deg in joints_deg]  # no -0.0
        status = int(status_of(cell.robot.arm(), robot.joints_rad))
        prove(
            session,
            "safe pose",
            holds=robot.still,
            found=", ".join(f"A{n} {deg:.2f}" for n, deg in enumerate(rounded_deg, 1)) + " deg",
            expected="the robot at rest",
            values={
                "robot.safe_deg": rounded_deg,
                "robot.home_deg": rounded_deg,
                "robot.status": status,
            },
        )

    @staticmethod
    def _judge_limits(session: CellSession, settings: RobotSettings) -> None:
        if settings.joint_limits_rad is None:
            return
        stated_deg = np.degrees(settings.joint_limits_rad)
        joints = session.cell.robot.joint
        ours_deg = np.array([[joint.min_deg, joint.max_deg] for joint in joints])
        outside = (ours_deg[:, 0] < stated_deg[:, 0] - LIMIT_DEG) | (
            ours_deg[:, 1] > stated_deg[:, 1] + LIMIT_DEG
        )
        ends = [f"A{n} {low:g} .. {high:g}" for n, (low, high) in enumerate(stated_deg, 1)]
        values: dict[str, object] = {}
        for axis in np.flatnonzero(outside):
            low, high = (round(float(deg), 3) for deg in stated_deg[axis])
            values |= {f"robot.joint.{axis}.min_deg": low, f"robot.joint.{axis}.max_deg": high}
        prove(
            session,
            "joint limits",
            holds=not outside.any(),
            found=f"controller {', '.join(ends)} deg",
            expected="those of the cell file, or wider",
            values=values,
        )

    @staticmethod
    def _judge_arm(
        session: CellSession, settings: RobotSettings, joints_rad: Array, pose: Array
    ) -> None:
        """Judge the controller's pose against the arm with the controller's own tool."""
        robot = session.cell.robot
        tool = settings.tool
        if tool is None:
            tool = robot.arm().tool
        off = Deviation(arm_from_joints(robot.joint, tool), joints_rad, pose)
        smr_mm = [round(float(value), 3) for value in tool[:3, 3]]
        same = bool(np.all(np.abs(np.subtract(smr_mm, robot.smr_mm)) < 0.002))
        coupled = None if off.holds else coupling_of(robot, tool, joints_rad, pose)
        prove(
            session,
            "kinematics",
            holds=off.holds,
            found=f"{off.off_mm:.3f} mm from the pose of the joints by the cell file"
            + ("" if coupled is None else f": axis 3 turns with axis 2 (coupled, {coupled:+d})"),
            expected=f"<= {off.limit_mm:.3f} mm",
            values={} if coupled is None else coupled_values(session.cell, settings, coupled),
        )
        prove(
            session,
            "tool",
            holds=same,
            found=f"x {smr_mm[0]:g}, y {smr_mm[1]:g}, z {smr_mm[2]:g} mm on the controller",
            expected="robot.smr_mm " + ", ".join(f"{value:g}" for value in robot.smr_mm),
            values={"robot.smr_mm": smr_mm},
        )

    def result(self, log: Log) -> Result:
        return proved_result(log)


def coupled_values(cell: Cell, settings: RobotSettings, coupling: int) -> dict[str, object]:
    """Return the values of a cell file whose axis 3 is coupled to axis 2.

    Poses and limits are the controller's: its joint 3 is the chain's angle less ``coupling q2``.
    """
    values: dict[str, object] = {
        "robot.joint.2.coupled_to": 2,
        "robot.joint.2.coupling": coupling,
    }
    for key in ("axis_1_deg", "axis_6_deg"):
        pose = list(getattr(cell.base_frame, key))
        pose[2] -= coupling * pose[1]
        values[f"base_frame.{key}"] = pose
    if settings.joint_limits_rad is not None:
        low, high = np.degrees(settings.joint_limits_rad[2])
        values["robot.joint.2.min_deg"] = round(float(low), 3)
        values["robot.joint.2.max_deg"] = round(float(high), 3)
    return values


def coupling_of(robot: RobotTable, tool: Array, joints_rad: Array, pose: Array) -> int | None:
    """Return how axis 3 turns with axis 2, if that explains the controller's pose; else None."""
    arm = arm_from_joints(robot.joint, tool)
    for coupling in (1, -1):
        turned = joints_rad.copy()
        turned[2] += coupling * joints_rad[1]
        if Deviation(arm, turned, pose).holds:
            return coupling
    return None


def _read(settings: RobotSettings, joints_deg: list[float]) -> ControllerRead:
    limits = () if settings.joint_limits_rad is None else np.degrees(settings.joint_limits_rad)
    tool = settings.tool
    return ControllerRead(
        joints_deg=joints_deg,
        model=settings.model or "",
        serial=settings.serial or "",
        joint_limits_deg=[(float(low), float(high)) for low, high in limits],
        tool_mm=None if tool is None else (float(tool[0, 3]), float(tool[1, 3]), float(tool[2, 3])),
    )


class JogAxes(Step):
    """Each axis by a degree at 1 %, and back: does it read as it was sent?"""

    name = "jog-axes"
    needs = "a robot whose kinematics agree with its controller's"
    moves = f"each axis alone by {JOG_DEG:g} deg at {JOG_PERCENT:g} %, and back"
    measures = "joints and pose by the controller"
    yields = "axes that turn as the cell file says"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        speeds = [joint.speed_deg_s * JOG_PERCENT / 100.0 for joint in cell.robot.joint]
        seconds = sum(2.0 * (JOG_DEG / speed + 1.0 + cell.settle.robot_s) for speed in speeds)
        return PlannedStep.of_spans(self.name, 0, [Span("jogs", 0, seconds)])

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        start_rad = np.radians(session.cell.robot.safe_deg)
        session.parked()
        for axis in range(6):
            what = f"axis {axis + 1}"
            if f"commissioning.{what}" in session.log.verdicts:
                continue
            target_rad = start_rad.copy()
            target_rad[axis] += np.radians(JOG_DEG) * _inwards(session.cell, axis, start_rad)
            moved = jog_to(session, target_rad, start_rad, what)
            back = jog_to(session, start_rad, target_rad, f"{what} back")
            off_deg = np.degrees(np.abs(moved - target_rad))
            still_deg = float(np.degrees(np.abs(back - start_rad)).max())
            turned_deg = float(np.degrees(moved - start_rad)[axis])
            prove(
                session,
                what,
                holds=bool(off_deg.max() <= READ_BACK_DEG and still_deg <= READ_BACK_DEG),
                found=f"turned {turned_deg:+.3f} deg, others at most "
                f"{float(np.delete(off_deg, axis).max()):.3f} deg",
                expected=f"as sent within {READ_BACK_DEG:g} deg",
            )

    def result(self, log: Log) -> Result:
        return proved_result(log)


def jog_to(session: CellSession, joints_rad: Array, from_rad: Array, what: str) -> Array:
    """Move straight from one pose to another at 1 %; return the joints (6,) read at the end."""
    straight = StraightApproach(from_rad, JOG_PERCENT)
    return session.robot_to(joints_rad, what, straight=straight).joints_rad


def _inwards(cell: Cell, axis: int, joints_rad: Array) -> float:
    """Return the direction away from the nearer limit of an axis."""
    low, high = cell.robot.margin_limits_rad[:, axis]
    return 1.0 if joints_rad[axis] < (low + high) / 2.0 else -1.0


COMMISSION_CONTROLLER = Procedure(
    "commission-controller",
    "commissioning: settings of the robot's controller; nothing moves",
    (ReadController(),),
    proved_table,
)
COMMISSION_ROBOT = Procedure(
    "commission-robot",
    "commissioning: each axis of the robot by a degree",
    (JogAxes(),),
    proved_table,
    by_hand="watch the first motions at the E-stop",
)
