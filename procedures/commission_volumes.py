"""Commissioning of the keep-out volumes: from a list, or by corners that a person teaches.

They are written once the arm is clear of each at all poses of a calibration, and every motion of
one can be planned among them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.calibration.grid import grid_of
from hilcell.cell.file import Cell
from hilcell.cell.surroundings import KeepOut, Surroundings, keep_out_problems, posture
from hilcell.cell.tables import Pose
from hilcell.compensation.volumes import CORNERS, read_volumes, row, taught
from hilcell.errors import HilcellError
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep, Span
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import PLAN_MARGIN_MM
from hilcell.run.procedure import Procedure, Result, Step
from procedures import plan
from procedures.base_frame import sweep
from procedures.calibrate import CALIBRATE
from procedures.commission_places import AIM_S, NEST_TRIES, SAME_MM, SAMPLES, not_near, places_mm
from procedures.proved import prove, proved_result, proved_table

NONE = (
    "no volumes: the arm keeps to the grid's cube and the circles of the base frame, and no axis "
    "is swept"
)


class Volumes(Step):
    """Volumes of the cell file, of its list and of the person, each clear of the arm."""

    name = "volumes"
    needs = "a list of the volumes, or a reflector in a person's hand; base, rail and tracker"
    moves = "nothing"
    measures = "the corners of the volumes that are taught"
    yields = "keep-out volumes of which a calibration is clear"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        listed(cell)
        corners = CORNERS[1] * len(to_teach(cell))
        seconds = corners * (AIM_S + plan.measure_s(cell, SAMPLES))
        return PlannedStep.of_spans(self.name, 0, [Span("corners", corners, seconds)])

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        cell = session.cell
        known = [*cell.keep_out, *listed(cell)]
        for name in to_teach(cell):
            corners_mm = self._corners_mm(session, name)
            if prove(
                session,
                f"corners of {name}",
                holds=len(corners_mm) >= CORNERS[0],
                found=f"{len(corners_mm)} corners",
                expected=f"{CORNERS[0]} to {CORNERS[1]}",
            ):
                known.append(taught(name, corners_mm))
        if not known and cell.volumes is None:
            by = session.log.inputs.operator or "the person at the terminal"
            prove(session, "volumes", holds=True, found=f"none, attested by {by}", expected=NONE)
        elif all(each.holds for each in session.log.verdicts.values()):
            self._judge(session, known)

    @staticmethod
    def _corners_mm(session: CellSession, name: str) -> Array:
        """Return corners (N, 3) in {W}; a reflector that stays where it is ends them."""
        cell, T_W_L = session.cell, session.cell.tracker.pose.matrix()
        here = cell.layout.nominal_base(session.devices.rail.read().strip_mm)
        tool = forward(cell.robot.arm(), session.devices.robot.read().joints_rad)
        on_slide_mm = np.array([tool[:3, 3], *(nest.xyz_mm for nest in cell.layout.slide)])
        fixed_mm = np.array([nest.xyz_mm for nest in cell.layout.fixed_nests])
        known_mm = apply(inverse(T_W_L), np.vstack([fixed_mm, apply(here, on_slide_mm)]))
        corners_mm = np.zeros((0, 3))
        for number in range(1, CORNERS[1] + 1):
            corner = f"corner {number} of {name}"
            seen = session.aimed_place(
                f"{name} corner {number}",
                corner,
                not_near(known_mm),
                SAMPLES,
                tries=NEST_TRIES,
                first=f"rest the reflector at {corner}; use high and low corners; to end, leave it "
                "at a corner that was taken",
            )
            at_mm = np.zeros((0, 3)) if seen is None else apply(T_W_L, places_mm([seen]))
            if not len(at_mm) or bool(np.any(np.linalg.norm(corners_mm - at_mm, axis=1) < SAME_MM)):
                break
            corners_mm = np.vstack([corners_mm, at_mm])
        return corners_mm

    @staticmethod
    def _judge(session: CellSession, known: list[KeepOut]) -> None:
        """Prove each volume by itself, then every motion of a calibration among all."""
        cell, envelope = session.cell, session.cell.robot.envelope
        problems = "; ".join(keep_out_problems(known, envelope))
        if problems or envelope is None:
            prove(session, "volumes", holds=False, found=problems, expected="volumes and a shape")
            return
        wanted_mm = envelope.clearance_mm + PLAN_MARGIN_MM
        for name, least in least_clearances(cell, known).items():
            inside = "the arm is in it" if least.clearance_mm < 0.0 else ""
            prove(
                session,
                f"volume {name}",
                holds=least.clearance_mm >= wanted_mm,
                found=f"{inside or f'{least.clearance_mm:.0f} mm from the arm'} at {least.where}",
                expected=f">= {wanted_mm:g} mm from the safe pose, the cube and the circles",
            )
        if not all(each.holds for each in session.log.verdicts.values()):
            return
        among = msgspec.structs.replace(cell, keep_out=known)
        try:
            CALIBRATE.plan(among, session.seed)
            refusal = ""
        except HilcellError as error:
            refusal = str(error)
        prove(
            session,
            "motions of a calibration",
            holds=not refusal,
            found=refusal or f"clear of {', '.join(each.name for each in known)}",
            expected=f"a plan that is clear by {wanted_mm:g} mm",
            values={} if refusal else {f"keep_out.{n}": row(each) for n, each in enumerate(known)},
        )

    def result(self, log: Log) -> Result:
        return proved_result(log)


def listed(cell: Cell) -> list[KeepOut]:
    """Return the volumes that the cell's [volumes] state and its file does not have; raises
    `SettingsError`.
    """
    if cell.volumes is None:
        return []
    boxes = read_volumes(Path(cell.volumes.file)) if cell.volumes.file else []
    return _new(cell, [*boxes, *(floor_and_tracker(cell) if cell.volumes.floor else ())])


def floor_and_tracker(cell: Cell) -> list[KeepOut]:
    """Return the floor up to the highest floor nest, and the tracker on its stand."""
    top_mm = max(nest.z_mm for nest in cell.layout.floor)
    pose, above_mm, width_mm, hall_mm = cell.tracker.pose, 300.0, 800.0, 20_000.0
    height_mm = max(pose.z_mm + above_mm - top_mm, width_mm)
    floor = Pose(x_mm=0.0, y_mm=0.0, z_mm=top_mm - hall_mm / 2.0)
    stand = Pose(x_mm=pose.x_mm, y_mm=pose.y_mm, z_mm=top_mm + height_mm / 2.0)
    return [
        KeepOut(name="floor", centre=floor, size_mm=(hall_mm, hall_mm, hall_mm)),
        KeepOut(name="tracker", centre=stand, size_mm=(width_mm, width_mm, height_mm)),
    ]


def _new(cell: Cell, volumes: list[KeepOut]) -> list[KeepOut]:
    stated = {each.name for each in cell.keep_out}
    return [each for each in volumes if each.name not in stated]


def to_teach(cell: Cell) -> list[str]:
    """Return the names of volumes to be taught that neither file nor list has."""
    stated = {each.name for each in (*cell.keep_out, *listed(cell))}
    return [name for name in (cell.volumes.teach if cell.volumes else ()) if name not in stated]


class Least(NamedTuple):
    """The least clearance of the arm, and the poses that have it."""

    clearance_mm: float
    where: str


def least_clearances(cell: Cell, volumes: list[KeepOut]) -> dict[str, Least]:
    """Return each volume's least clearance from the arm at the poses of a calibration."""
    assert cell.robot.envelope is not None  # noqa: S101 - the caller has looked
    among = Surroundings(cell.robot.arm(), cell.robot.envelope, cell.layout, volumes)
    found: dict[str, Least] = {}
    for where, postures in calibration_postures(cell):
        for name, clearance_mm in among.least_mm(postures).items():
            before = found.get(name)
            nearer = before is None or clearance_mm < before.clearance_mm
            if nearer or np.isnan(clearance_mm):
                found[name] = Least(clearance_mm, where)
    return found


def calibration_postures(cell: Cell) -> Iterator[tuple[str, Array]]:
    """Yield postures (N, 7) with their words: safe pose, cube and circles."""
    safe_rad, rail, places = np.radians(cell.robot.safe_deg), cell.rail, 100
    along_mm = np.linspace(rail.travel_min_mm, rail.travel_max_mm, places)
    yield "the safe pose", np.vstack([posture(at_mm, safe_rad) for at_mm in along_mm])
    vertices_mm = grid_of(cell).serpentine_mm()
    cube_rad = plan.check_reach(cell, plan.poses_at(cell, vertices_mm), "cube")
    for station in plan.stations_in_order(cell):
        yield f"the grid's cube, {station.name}", posture(station.rail_mm, cube_rad)
    for axis in (1, 6):
        yield f"the circle of axis {axis}", posture(cell.reference.rail_mm, sweep(cell, axis))


COMMISSION_VOLUMES = Procedure(
    "commission-volumes",
    "commissioning: keep-out volumes from a list, or by corners that a person teaches",
    (Volumes(),),
    proved_table,
)
