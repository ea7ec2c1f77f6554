"""Commissioning of places: the tracker by the floor nests, rail and base by the flange, the slide.

A person puts the beam on each nest, in any order: the nests are recognised by their distances. All
else follows by small motions, each predicted from those before it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import count, zip_longest

import msgspec
import numpy as np

from hilcell.cell.devices import jogging_rail
from hilcell.cell.file import Cell, Pose
from hilcell.decoding import Json
from hilcell.geometry.frames import apply, inverse, matrix, unit
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import rounded
from hilcell.identification.axis_directions import check_axes
from hilcell.identification.mounted_reflector import BaseFit, NominalBase, fit_base, nominal_base
from hilcell.identification.places import RailLine, Recognition, may_be_nests, rail_line, recognised
from hilcell.identification.reflector_radius import reflectors_of
from hilcell.journal.log import Log
from hilcell.model.events import PlaceSeen
from hilcell.model.plan import PlannedStep, Span
from hilcell.ports import Array, HilcellError, NoReading
from hilcell.run.cell_session import CellSession
from hilcell.run.mover import StraightApproach
from hilcell.run.procedure import Procedure, Result, Step
from hilcell.run.prompts import WIDER_MM
from procedures.plan import measure_s, rail_move_s, robot_moves_s
from procedures.proved import prove, proved_result, proved_table

NEST_TRIES = 40  # looks at reflectors that are none of those asked for
SAME_MM = 20.0  # two readings nearer than this are of one nest
NEAR_MM = 20.0  # around a place that is predicted
ROLES = (" (the origin of {W})", " (on the x axis of {W})", " (in its xy plane)")
LEAST_SIDE_MM = 300.0  # of the triangle that defines {W}
STEEPEST_DEG = 80.0  # of its plane: the upper side of a steeper one is not certain
AIM_S = 20.0  # that a person takes for a nest
WIGGLE_DEG, WIGGLE_PERCENT = 1.0, 1.0
SEARCH_MM = 100.0  # around a reflector that moved by a degree of an axis
SAMPLES = 5


class _Proving(Step):
    def result(self, log: Log) -> Result:
        return proved_result(log)


# -- the tracker -----------------------------------------------------------------------------------


class FindTracker(_Proving):
    """The beam on each floor nest, in any order."""

    name = "find-tracker"
    needs = "reflectors in the floor nests, a person who puts the beam on them"
    moves = "nothing"
    measures = "every floor nest"
    yields = "the tracker's pose in {W}; the nests' places where no drawing has them"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        nests = len(cell.layout.fixed_nests)
        seconds = nests * (AIM_S + measure_s(cell, SAMPLES))
        return PlannedStep.of_spans(self.name, 0, [Span("nests", nests, seconds)])

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        if session.cell.layout.is_unplaced:
            self._place(session)
            return
        nests, limit_mm = session.cell.layout.fixed_nests, session.cell.layout.nest_tolerance_mm
        nominal_mm = np.array([nest.xyz_mm for nest in nests])
        seen: list[PlaceSeen] = []
        for number in range(1, len(nests) + 1):
            place = session.aimed_place(
                f"floor nest {number}",
                f"a floor nest ({number} of {len(nests)}), in any order",
                not_a_nest(nominal_mm, places_mm(seen), limit_mm),
                SAMPLES,
                tries=NEST_TRIES,
            )
            if place is None:
                break
            seen.append(place)
        known = recognised(nominal_mm, places_mm(seen), limit_mm) if len(seen) > 2 else []
        upright = [each for each in known if each.upright]
        self._judge(session, [nest.name for nest in nests], (upright or known)[:1], known)

    @staticmethod
    def _place(session: CellSession) -> None:
        """Take the nests where they stand: the first three become the frame {W}, z upward."""
        names = [nest.name for nest in session.cell.layout.floor]
        seen: list[PlaceSeen] = []
        for name, role in zip_longest(names, ROLES, fillvalue=""):
            place = session.aimed_place(
                f"floor nest {name}",
                f"floor nest {name}{role}",
                not_near(places_mm(seen)),
                SAMPLES,
                tries=NEST_TRIES,
            )
            if place is None:
                break
            seen.append(place)
        floor_mm = places_mm(seen)
        T_W_L = world_of(floor_mm) if len(seen) == len(names) else None
        values: Json = {}
        if T_W_L is not None:
            rows = zip(names, apply(T_W_L, floor_mm).round(3).tolist(), strict=True)
            values = {
                "layout.floor": [
                    {"name": name, "x_mm": x, "y_mm": y, "z_mm": z} for name, (x, y, z) in rows
                ],
                "tracker.pose": msgspec.to_builtins(Pose.of(T_W_L)),
            }
        prove(
            session,
            "floor nests",
            holds=bool(values),
            found=f"{len(seen)} nests" + ("" if values else ", of which no frame follows"),
            expected=f"{', '.join(names)}; each of the first three >= {LEAST_SIDE_MM:g} mm from "
            f"the line through the other two, their plane not steeper than {STEEPEST_DEG:g} deg",
            values=values,
        )

    @staticmethod
    def _judge(
        session: CellSession,
        names: list[str],
        chosen: list[Recognition],
        known: list[Recognition],
    ) -> None:
        if not chosen:
            prove(
                session,
                "floor nests",
                holds=False,
                found="fewer than three nests at the distances of the drawing",
                expected=f"{', '.join(names)}, within {session.cell.layout.nest_tolerance_mm:g} mm",
            )
            return
        best = chosen[0]
        taken = [names[nest] if nest >= 0 else "none" for nest in best.nests]
        missing = [name for name in names if name not in taken]
        doubt = "" if len(known) < 2 else "; their distances alone allow exchanged nests, too"
        prove(
            session,
            "floor nests",
            holds=not missing,
            found=f"{', '.join(taken)}, in the order of the beam, off at most {best.worst_mm:.2f} "
            f"mm{doubt}" + (f"; not found: {', '.join(missing)}" if missing else ""),
            expected=f"all nests, within {session.cell.layout.nest_tolerance_mm:g} mm",
        )
        if best.shift_mm:
            prove(
                session,
                "reflector",
                holds=False,
                found=f"the nests' distances need {best.shift_mm:+.2f} mm in every reading along "
                f"its beam: reflectors of {reflectors_of(best.shift_mm)}",
                expected=f"{session.cell.tracker.reflector}; seat these, or correct "
                "tracker.reflector, and repeat the step",
            )
            return
        U_deg = float(np.degrees(best.U_rad))
        pose = pose_values(best.T_W_L, best.U_mm, U_deg)
        stands = "upright" if best.upright else "upside down"
        prove(
            session,
            "tracker",
            holds=True,
            found=f"x {pose['x_mm']:.0f}, y {pose['y_mm']:.0f}, z {pose['z_mm']:.0f} mm in {{W}}, "
            f"{stands}; U {best.U_mm:.2g} mm, {U_deg:.2g} deg (k = 2)",
            expected="a pose by three nests or more",
            values={"tracker.pose": pose},
        )


def world_of(floor_mm: Array) -> Array | None:
    """Return {W}, (4, 4) from the tracker's frame, of floor nests (N, 3) in that frame: the origin
    in the first, x to the second, the third in the xy plane, z upward as the tracker stands.

    None where the first three are too close together, to a line, or to an upright plane, to
    define a frame.
    """
    corners_mm = floor_mm[:3]
    sides_mm = np.linalg.norm(corners_mm - np.roll(corners_mm, 1, axis=0), axis=1)
    normal_mm2 = np.cross(corners_mm[1] - corners_mm[0], corners_mm[2] - corners_mm[0])
    least_mm2 = LEAST_SIDE_MM * sides_mm.max()  # its least height is on its longest side
    if not np.linalg.norm(normal_mm2) >= least_mm2 > 0.0:
        return None
    if not abs(unit(normal_mm2)[2]) >= np.cos(np.radians(STEEPEST_DEG)):
        return None
    x = unit(corners_mm[1] - corners_mm[0])
    z = unit(normal_mm2) * (1.0 if normal_mm2[2] > 0.0 else -1.0)
    return inverse(matrix(np.column_stack([x, np.cross(z, x), z]), corners_mm[0]))


def not_a_nest(nominal_mm: Array, taken_mm: Array, limit_mm: float) -> Callable[[Array], str]:
    """Return why a position (3,), tracker's frame, is no further nest; "" if it is."""

    def refusal(at_mm: Array) -> str:
        if bool(np.any(np.linalg.norm(taken_mm - at_mm, axis=1) < SAME_MM)):
            return "this nest is taken already"
        seen_mm = np.vstack([taken_mm, at_mm])
        if len(seen_mm) < 2 or may_be_nests(nominal_mm, seen_mm, limit_mm):
            return ""
        return "its distances are those of no nest of the drawing"

    return refusal


def places_mm(seen: Sequence[PlaceSeen]) -> Array:
    return np.array([each.xyz_mm for each in seen]).reshape(-1, 3)


def poses_of(seen: Sequence[PlaceSeen]) -> tuple[Array, Array]:
    """Return joints (N, 6) in rad and places (N, 3) in the tracker's frame."""
    return np.radians([each.joints_deg for each in seen]), places_mm(seen)


def pose_values(T: Array, U_mm: float, U_deg: float) -> Json:
    """Return a pose (4, 4) as the cell file has it, with the digits that its U supports."""
    values: dict[str, float] = msgspec.to_builtins(Pose.of(T))
    return {
        key: rounded(value, U_mm if key.endswith("_mm") else U_deg) for key, value in values.items()
    }


# -- rail and base, by the reflector on the flange -------------------------------------------------

RAIL_MM = (20.0, 100.0, 300.0)  # motions of the slide with the parked robot, each from the start
RIDE_SHARE = 5e-3  # of the distance, by which tracker and strip may differ
AXIS_DEG = (1.0, 8.0)
MORE_POSES, MORE_DEG = 10, 15.0
BASE_PERCENT = 5.0
NOISE_MM = 0.05  # of a place seen
# Of the reflector about the controller's tool: where its sense counts, its place, or nothing.
U_TOOL_MM, U_NEAR_MM, U_ANY_MM = 50.0, 20.0, 1e3
FIT_MM = 3.0  # of a robot with nominal kinematics, rms
TOOL_MM = 3.0  # by which a tool that was taught may miss the reflector's centre
TILT_RAD = 1e-4  # 1 sigma by which a slide tilts over the rail


class FindBase(_Proving):
    """The reflector on the flange while the slide moves, then while the robot does."""

    name = "find-base"
    needs = "the tracker's pose, a reflector on the flange, the robot at its safe pose"
    moves = (
        f"axis 1 by {WIGGLE_DEG:g} deg and back at {WIGGLE_PERCENT:g} %; each axis by 1 and 8 deg "
        f"at {BASE_PERCENT:g} %, then all axes by at most {MORE_DEG:g} deg around the safe pose, "
        f"and back to it, at {BASE_PERCENT:g} %"
    )
    measures = "the reflector on the flange after each motion"
    yields = "the rail's direction, the base in {W}, the reflector on the flange"

    def announced(self, cell: Cell) -> str:
        distances = ", ".join(f"{each:g}" for each in RAIL_MM)
        slide = f"the slide by {distances} mm, each from where it stands, and back; "
        return slide + self.moves if cell.has_rail else self.moves

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        joints_rad = self._poses(cell, seed)
        percent = np.full(len(joints_rad) - 1, BASE_PERCENT)
        robot_s = float(np.sum(robot_moves_s(cell, joints_rad[:-1], joints_rad[1:], percent)))
        each_s = cell.settle.robot_s + measure_s(cell, SAMPLES)
        rail_s = sum(2.0 * rail_move_s(cell, distance_mm) for distance_mm in RAIL_MM)
        spans = [
            Span("slide", len(RAIL_MM), rail_s if cell.has_rail else 0.0),
            Span("poses", len(joints_rad), AIM_S + robot_s + len(joints_rad) * each_s),
        ]
        return PlannedStep.of_spans(self.name, 0, spans)

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        cell = session.cell
        session.parked()
        at_start = self._flange(session)
        line = self._ride(session, at_start) if cell.has_rail else None
        if cell.has_rail and line is None:
            return
        fit = self._fit(session, at_start)
        if fit is None:
            return
        self._judge_base(session, fit, line, at_start.strip_mm)

    def _flange(self, session: CellSession) -> PlaceSeen:
        """Return the reflector that moves with axis 1, at the safe pose."""
        cell, T_W_L = session.cell, session.cell.tracker.pose.matrix()
        safe_rad = np.radians(cell.robot.safe_deg)
        fixed_mm = apply(inverse(T_W_L), [nest.xyz_mm for nest in cell.layout.fixed_nests])
        others: list[PlaceSeen] = []
        for number in count(1):
            place = session.aimed_place(
                f"flange {number}",
                "the reflector on the robot's flange",
                not_near(np.vstack([fixed_mm, places_mm(others)])),
                SAMPLES,
                tries=NEST_TRIES,
            )
            if place is None:
                raise HilcellError(
                    "the beam was put on no reflector that moves with axis 1; put it on the one on "
                    "the flange, then repeat the step",
                    code="HC-T64",
                )
            moved_rad = safe_rad.copy()
            moved_rad[0] += np.radians(WIGGLE_DEG)
            jogged(session, moved_rad, safe_rad, f"flange {number} turned")
            stayed = self._is_at(session, f"flange {number} stayed", np.array(place.xyz_mm))
            session.parked(WIGGLE_PERCENT)
            if not stayed:
                return place
            others.append(place)
        raise AssertionError

    @staticmethod
    def _is_at(session: CellSession, key: str, at_mm: Array) -> bool:
        try:
            seen = session.found_place(key, at_mm, 1, radius_mm=10.0)
        except NoReading:
            return False
        return float(np.linalg.norm(np.array(seen.xyz_mm) - at_mm)) < 1.0

    @staticmethod
    def _ride(session: CellSession, at_start: PlaceSeen) -> RailLine | None:
        """Move the slide with the robot parked; return the rail's line in {W}, None for a strip of
        another scale.
        """
        cell, rail = session.cell, session.devices.rail.read()
        middle_mm = (cell.rail.travel_min_mm + cell.rail.travel_max_mm) / 2.0
        way = 1.0 if rail.strip_mm < middle_mm else -1.0
        seen = [at_start]
        near_mm, radius_mm = np.array(at_start.xyz_mm), 1.5 * RAIL_MM[0]
        for distance_mm in RAIL_MM:
            session.rail_to(rail.position_mm + way * distance_mm)
            found = session.found_place(
                f"slide {distance_mm:g} mm", near_mm, SAMPLES, radius_mm=radius_mm
            )
            seen.append(found)
            step = next((each for each in RAIL_MM if each > distance_mm), 0.0)
            moved_mm = np.array(found.xyz_mm) - np.array(at_start.xyz_mm)
            near_mm = np.array(at_start.xyz_mm) + moved_mm * step / distance_mm
            radius_mm = NEAR_MM
        session.rail_to(rail.position_mm)
        T_W_L = cell.tracker.pose.matrix()
        at_mm = apply(T_W_L, places_mm(seen))
        swing_mm = TILT_RAD * abs(float(at_mm[0, 2]))  # the reflector's height above the rail
        line = rail_line([each.strip_mm for each in seen], at_mm, swing_mm)
        holds = abs(line.scale - 1.0) <= RIDE_SHARE
        values: dict[str, object] = {}
        if not holds:
            options = jogging_rail(session.devices.rail).rescaled(line.scale, line.scale, 1.0)
            values = {f"rail.options.{key}": value for key, value in options.items()}
        prove(
            session,
            "scale by the tracker",
            holds=holds,
            found=f"{line.scale:.5f} mm by the tracker a mm of the strip, over {RAIL_MM[-1]:g} mm, "
            f"U {line.U_scale:.1g} (k = 2)",
            expected=f"1 within {RIDE_SHARE:g}",
            values=values,
        )
        return line if holds else None

    def _fit(self, session: CellSession, at_start: PlaceSeen) -> BaseFit | None:
        """Move the robot more and more, each motion predicted by those before it."""
        cell, poses_rad = session.cell, self._poses(session.cell, session.seed)
        arm, smr_mm = cell.robot.arm(), np.array(cell.robot.smr_mm)
        # The slide came back through its backlash.
        again = session.found_place("pose 0", np.array(at_start.xyz_mm), SAMPLES, radius_mm=NEAR_MM)
        seen = [again]
        fit: NominalBase | None = None
        for number, pose_rad in enumerate(poses_rad[1:], start=1):
            jogged(session, pose_rad, poses_rad[number - 1], f"pose {number}", BASE_PERCENT)
            near_mm, radius_mm = np.array(again.xyz_mm), SEARCH_MM
            if fit is not None:
                near_mm, radius_mm = fit.predict_mm(pose_rad), SEARCH_MM / 2
            seen.append(
                session.found_place(f"pose {number}", near_mm, SAMPLES, radius_mm=radius_mm)
            )
            if number == len(cell.robot.joint) and not self._judge_senses(session, *poses_of(seen)):
                return None
            if number >= len(cell.robot.joint):
                fit = nominal_base(arm, *poses_of(seen), NOISE_MM, smr_mm, U_NEAR_MM)
                if not fit.rms_mm <= FIT_MM and not self._judge_axes(session, fit):
                    return None
        session.parked(BASE_PERCENT)
        if not self._judge_axes(
            session, nominal_base(arm, *poses_of(seen), NOISE_MM, smr_mm, U_ANY_MM)
        ):
            return None
        return fit_base(arm, *poses_of(seen), NOISE_MM, smr_mm, U_ANY_MM)

    @staticmethod
    def _judge_senses(session: CellSession, joints_rad: Array, seen_mm: Array) -> bool:
        """Judge the sense of each axis by a motion of 1 deg, before any larger one."""
        robot = session.cell.robot
        checked = check_axes(robot.arm(), joints_rad, seen_mm, NOISE_MM, robot.smr_mm, U_TOOL_MM)
        wrong = [each.words for each in checked.verdicts if each.holds is False]
        open_words = [each.words for each in checked.verdicts if each.holds is None]
        return prove(
            session,
            "senses of the axes",
            holds=checked.explained and not wrong,
            found="; ".join(wrong or open_words or ["each axis turns as the model says"]),
            expected="axes that turn as the cell file says",
        )

    @staticmethod
    def _judge_axes(session: CellSession, fit: NominalBase) -> bool:
        return prove(
            session,
            "axes",
            holds=fit.rms_mm <= FIT_MM,
            found=f"the reflector is {fit.rms_mm:.2f} mm rms from where nominal kinematics turn it",
            expected=f"<= {FIT_MM:g} mm: senses and couplings of all axes as in the cell file",
        )

    @staticmethod
    def _judge_base(
        session: CellSession, fit: BaseFit, line: RailLine | None, strip_mm: float
    ) -> None:
        cell = session.cell
        off_mm = float(np.linalg.norm(fit.smr_mm - cell.robot.smr_mm))
        smr = ", ".join(f"{rounded(value, fit.smr_U_mm):g}" for value in fit.smr_mm.tolist())
        limit_mm = TOOL_MM + fit.smr_U_mm
        if not prove(
            session,
            "reflector on the flange",
            holds=off_mm <= limit_mm,
            found=f"at {smr} mm in the flange by the tracker, U {fit.smr_U_mm:.2g} mm (k = 2); "
            f"{off_mm:.2f} mm from the controller's tool",
            expected=f"<= {limit_mm:.1f} mm; otherwise enter the measured place as the tool on the "
            "controller, and repeat from step controller",
        ):
            return
        along, at = np.array(cell.layout.rail_direction), ""
        direction: dict[str, object] = {}
        if line is not None:
            along = line.direction
            turned = f"whose direction has U {1e3 * line.U_rad:.2g} mrad (k = 2)"
            at = f" at 0 mm of the rail, {turned}"
            direction = {"layout.rail_direction": [round(float(each), 7) for each in along]}
        T_W_B = cell.tracker.pose.matrix() @ fit.T_L_B
        T_W_B[:3, 3] -= strip_mm * along
        pose = pose_values(T_W_B, fit.base_U_mm, fit.base_U_deg)
        prove(
            session,
            "base",
            holds=fit.base_U_mm <= cell.layout.base_tolerance_mm,
            found=f"x {pose['x_mm']:.1f}, y {pose['y_mm']:.1f}, z {pose['z_mm']:.1f} mm in {{W}}"
            f"{at}; from the tracker U {fit.base_U_mm:.2g} mm, "
            f"{fit.base_U_deg:.2g} deg (k = 2)",
            expected=f"U <= {cell.layout.base_tolerance_mm:g} mm",
            values={"layout.base": pose} | direction,
        )

    @staticmethod
    def _poses(cell: Cell, seed: int) -> Array:
        """Return joints (N, 6): the safe pose, each axis by 1 and 8 deg, then random ones."""
        safe_deg = np.array(cell.robot.safe_deg)
        low, high = np.degrees(cell.robot.margin_limits_rad)
        way = np.where(safe_deg < (low + high) / 2.0, 1.0, -1.0)
        rows = [safe_deg]
        for size_deg in AXIS_DEG:
            for axis in range(6):
                row = safe_deg.copy()
                row[axis] += size_deg * way[axis]
                rows.append(row)
        rng = np.random.default_rng([seed, 35])
        rows += list(safe_deg + rng.uniform(-MORE_DEG, MORE_DEG, (MORE_POSES, 6)))
        joints_rad: Array = np.radians(np.clip(np.array(rows), low, high))
        return joints_rad


def not_near(others_mm: Array) -> Callable[[Array], str]:
    """Return why a position (3,) is none of the reflectors looked for: it is one of (N, 3)."""

    def refusal(at_mm: Array) -> str:
        near = bool(np.any(np.linalg.norm(others_mm - at_mm, axis=1) < SAME_MM))
        return "this reflector is another one, known already" if near else ""

    return refusal


def jogged(
    session: CellSession,
    joints_rad: Array,
    from_rad: Array,
    what: str,
    percent: float = WIGGLE_PERCENT,
) -> None:
    session.robot_to(joints_rad, what, straight=StraightApproach(from_rad, percent))


# -- the slide -------------------------------------------------------------------------------------


class FindSlide(_Proving):
    """The beam on each nest of the slide, in any order; they ride with the slide."""

    name = "find-slide"
    needs = "the base, reflectors in the slide's nests, a person who puts the beam on them"
    moves = "the slide by 100 mm and back"
    measures = "every nest of the slide, and the first one again after the motion"
    yields = "the nests of the slide in nominal {B}"

    RIDE_MM = 100.0

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        nests = len(cell.layout.slide)
        seconds = nests * (AIM_S + measure_s(cell, SAMPLES)) + 2.0 * rail_move_s(cell, self.RIDE_MM)
        return PlannedStep.of_spans(self.name, 0, [Span("nests", nests, seconds)])

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        cell, T_L_W = session.cell, inverse(session.cell.tracker.pose.matrix())
        session.parked()
        rail = session.devices.rail.read()
        T_L_B = T_L_W @ cell.layout.nominal_base(rail.strip_mm)
        fixed_mm = apply(T_L_W, [nest.xyz_mm for nest in cell.layout.fixed_nests])
        safe = forward(cell.robot.arm(), np.radians(cell.robot.safe_deg))
        flange_mm = apply(T_L_B, safe[None, :3, 3])
        seen: list[PlaceSeen] = []
        names = [nest.name for nest in cell.layout.slide]
        for number, name in enumerate(names, start=1):
            place = session.aimed_place(
                f"slide nest {number}",
                f"a nest on the slide ({number} of {len(names)}), in any order; it becomes {name}",
                not_near(np.vstack([fixed_mm, flange_mm, places_mm(seen)])),
                SAMPLES,
                tries=NEST_TRIES,
            )
            if place is None:
                break
            seen.append(place)
        in_base_mm = apply(inverse(T_L_B), places_mm(seen))
        nests = [
            {"name": name, "x_mm": round(x, 3), "y_mm": round(y, 3), "z_mm": round(z, 3)}
            for name, (x, y, z) in zip(names, in_base_mm.tolist(), strict=False)
        ]
        if prove(
            session,
            "slide nests",
            holds=len(seen) == len(names),
            found=f"{len(seen)} nests on the slide",
            expected=f"{len(names)}: {', '.join(names)}",
            values={"layout.slide": nests} if len(seen) == len(names) else {},
        ):
            self._ride(session, seen[0], rail.position_mm)

    def _ride(self, session: CellSession, first: PlaceSeen, from_mm: float) -> None:
        """Verify that a nest rides as the base and the rail's direction predict."""
        cell = session.cell
        middle_mm = (cell.rail.travel_min_mm + cell.rail.travel_max_mm) / 2.0
        way = 1.0 if first.strip_mm < middle_mm else -1.0
        session.rail_to(from_mm + way * self.RIDE_MM)
        moved_mm = session.devices.rail.read().strip_mm - first.strip_mm
        R_L_W = cell.tracker.pose.matrix()[:3, :3].T
        along = R_L_W @ np.array(cell.layout.rail_direction)
        near_mm = np.array(first.xyz_mm) + moved_mm * along
        found = self._found(session, near_mm)
        session.rail_to(from_mm)
        off_mm = float("nan") if found is None else float(np.linalg.norm(found.xyz_mm - near_mm))
        limit_mm = cell.layout.nest_tolerance_mm
        prove(
            session,
            "slide nest rides",
            holds=off_mm <= limit_mm,
            found=f"{off_mm:.3f} mm from its predicted place after {moved_mm:.1f} mm",
            expected=f"<= {limit_mm:g} mm",
        )

    @staticmethod
    def _found(session: CellSession, near_mm: Array) -> PlaceSeen | None:
        """Return the nest near (3,), else by a wider search, else where a person shows it."""
        key = "slide nest rides"
        for radius_mm in (NEAR_MM, WIDER_MM):
            with suppress(NoReading):
                around = f"{key}, {radius_mm:g} mm around"
                return session.found_place(around, near_mm, SAMPLES, radius_mm=radius_mm)
        place = "the first nest on the slide, wherever it is now"
        return session.aimed_place(
            f"{key}, by hand", place, lambda _: "", SAMPLES, tries=NEST_TRIES
        )


COMMISSION_TRACKER = Procedure(
    "commission-tracker",
    "commissioning: the tracker's pose, by the floor nests in any order; attended",
    (FindTracker(),),
    proved_table,
    by_hand="put the tracker's beam on the floor nests",
)
COMMISSION_BASE = Procedure(
    "commission-base",
    "commissioning: the rail's direction, the base, the reflector on the flange; attended",
    (FindBase(),),
    proved_table,
    by_hand="put the tracker's beam on the flange's reflector",
)
COMMISSION_SLIDE = Procedure(
    "commission-slide",
    "commissioning: the nests on the slide; attended",
    (FindSlide(),),
    proved_table,
    of_rail=True,
    by_hand="put the tracker's beam on the slide's nests",
)
