"""From corrected targets to the program of their station: base, tool, stand-off, clear paths.
Lengths mm, angles rad.

Only the holes and the cell's boxes are known of a part. It is assumed behind the plane of each
hole, where that hole is the nearest one and not farther than `REACH_MM`; a box of ``[[keep_out]]``
on which a hole lies is the part, or its jig, unless the box sticks out in front of that hole. The
tip, in front of all else of the tool, is judged against both, and so is the arm as far as its
wrist; the wrist, and the line from flange to tip, against the other boxes, as in a run. On the
straight path close to a hole the tip may be near to such a box, but not in it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product, zip_longest

import numpy as np
from msgspec.structs import replace
from scipy.spatial import cKDTree

from hilcell.calibration.tool_point import Tip
from hilcell.cell.file import Cell, KeepOut, Station
from hilcell.cell.surroundings import LEAST_MM, LINKS, CapsuleTable, Surroundings
from hilcell.cell.surroundings import posture as with_slide
from hilcell.compensation.programs import Places, StationProgram
from hilcell.compensation.targets import as_listed
from hilcell.errors import indented
from hilcell.geometry.frames import apply, inverse, poses_from_zyx, zyx_from_pose
from hilcell.geometry.inverse import NominalRobot, status_of
from hilcell.geometry.kinematics import Arm, forward
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import counted

NEAR_SHARE = 0.5  # of the stand-off, that paths between holes keep at least
REACH_MM = 300.0  # from a hole: farther away nothing is known of the part


@dataclass(frozen=True, eq=False)
class Drilling:
    """A robot at a station, with a tool whose tip keeps ``standoff_mm`` from the part."""

    cell: Cell
    T_W_B: Array
    tip: Tip
    standoff_mm: float

    STEP_MM = 5.0  # between places of a straight path at which joints are computed
    DRAWN_BACK_MM = (100.0, 200.0, 300.0, 450.0, 600.0)  # behind the stand-off, where paths need it

    @property
    def arm(self) -> Arm:
        return self.tip.arm(self.cell.robot.arm())

    def straight_rad(self, names: Sequence[str], command: Array) -> Array:
        """Joints (N, K, 6) from the stand-off to commands (N, 6) in {W}, within limits."""
        count = 1 + int(np.ceil(self.standoff_mm / self.STEP_MM))
        back_mm = np.linspace(self.standoff_mm, 0.0, count)
        poses = self._drawn_back(command, back_mm)
        reached = self._robot.reachable(poses)
        if bad := np.flatnonzero(~reached.all(axis=1)).tolist():
            lines = (
                f"{names[n]}: beyond the arm's reach or a joint limit from "
                f"{back_mm[~reached[n]].min():.0f} mm in front of the hole"
                for n in bad
            )
            raise HilcellError(
                f"the arm does not reach the stand-off of {self.standoff_mm:g} mm at {len(bad)} of "
                f"{counted(len(names), 'hole')}:\n{indented(lines)}\n"
                "shorten it (--standoff, or standoff_mm of the tool), or move the part",
                code="HC-C10",
            )
        return self._robot.joints_for(poses)

    @property
    def _robot(self) -> NominalRobot:
        robot = self.cell.robot
        home_rad = np.radians(robot.home_deg)
        return NominalRobot(self.arm, robot.status, robot.margin_limits_rad, home_rad)

    def drawn_back_rad(self, command: Array) -> Iterator[Array]:
        """Yield the reachable joints (6,) behind a command's stand-off, nearest first."""
        back_mm, robot = self.standoff_mm + np.array(self.DRAWN_BACK_MM), self._robot
        (poses,) = self._drawn_back(command[None], back_mm)
        yield from robot.joints_for(poses[robot.reachable(poses)])

    def _drawn_back(self, command: Array, back_mm: Array) -> Array:
        moved = np.repeat(poses_from_zyx(command)[:, None], len(back_mm), axis=1)
        moved[..., :3, 3] -= back_mm[:, None] * moved[..., :3, 2]
        return inverse(self.T_W_B) @ moved

    def places(self, joints_rad: Array) -> Places:
        values = as_listed(zyx_from_pose(self.T_W_B @ forward(self.arm, joints_rad)))
        return Places(values, joints_rad, status_of(self.arm, joints_rad))


def station_program(
    drilling: Drilling,
    station: str,
    names: Sequence[str],
    command: Array,
    part: WorkPiece,
    remarks: Sequence[str],
) -> StationProgram:
    """Program for commands (N, 6) of the tip in {W}, as listed.

    Between holes the tip keeps at least half of the stand-off. Where the direct path is not clear,
    it is drawn back farther, at the hole before, at the next one, or at both. At each stand-off it
    comes from below on every axis, by ``robot.approach_deg``, as in the calibration. Raises
    `HilcellError` where the arm leaves its limits, or no path is clear.
    """
    robot = drilling.cell.robot
    straight_rad = drilling.straight_rad(names, command)
    off_rad, at_rad = straight_rad[:, 0], straight_rad[:, -1]
    below_rad = off_rad - robot.approach_rad
    clearance = Clearance(
        drilling.cell, drilling.cell.station_named(station), drilling.arm, drilling.T_W_B, part,
        NEAR_SHARE * drilling.standoff_mm,
    )  # fmt: skip
    problems = [
        f"{name}: {why}"
        for name, below, off, path in zip(names, below_rad, off_rad, straight_rad, strict=True)
        if (why := clearance.refusal(below, off) or clearance.straight_refusal(path))
    ]
    safe_rad = np.radians(robot.safe_deg)
    from_safe_mm = lengths_mm(command[:, :3] - drilling.places(safe_rad[None]).values[:, :3])
    gate = command[int(from_safe_mm.argmin())]  # the hole that the tip comes to first
    holes = [gate, *command, gate]
    via = list[Places]()
    for n, (start, end) in enumerate(
        zip([safe_rad, *off_rad], [*below_rad, safe_rad], strict=True)
    ):
        stops, why = _path(clearance, start, end, *map(drilling.drawn_back_rad, holes[n : n + 2]))
        via.append(drilling.places(np.array(stops).reshape(-1, 6)))
        if why:
            to = f"the path to {names[n]}" if n < len(names) else "the path back to the safe pose"
            problems.append(f"{to}: {why}")
    if problems:
        raise HilcellError(
            f"{station}: paths of its program are not clear:\n{indented(problems)}\n"
            "change --standoff, robot.safe_deg, the holes or keep_out of the cell file",
            code="HC-C10",
        )
    return StationProgram(
        station=station,
        names=names,
        command=Places(command, at_rad, status_of(drilling.arm, at_rad)),
        standoff=drilling.places(off_rad),
        approach=drilling.places(below_rad),
        via=via,
        base=zyx_from_pose(inverse(drilling.T_W_B)[None])[0],
        tool=zyx_from_pose(drilling.arm.tool[None])[0],
        tool_name=drilling.tip.name,
        tool_number=drilling.tip.number,
        safe_deg=robot.safe_deg,
        arm=drilling.arm,
        speed_percent=robot.speed_percent,
        options=robot.options,
        remarks=remarks,
    )


def _path(
    clearance: Clearance, start: Array, end: Array, before: Iterable[Array], after: Iterable[Array]
) -> tuple[list[Array], str]:
    """Stops (M, 6) of a clear path between joints (6,), and why there is none, or "".

    ``before`` and ``after``: joints (6,) at which the tip is drawn back from the holes at the
    path's start and end, nearest first; evaluated only where the direct path is not clear.
    """

    def refusal(stops: Sequence[Array]) -> str:
        motions = pairwise([start, *stops, end])
        return next(filter(None, (clearance.refusal(*each) for each in motions)), "")

    if not (direct := refusal([])):
        return [], ""
    behind, ahead = list(before), list(after)
    single = [[one] for both in zip_longest(behind, ahead) for one in both if one is not None]
    pairs = sorted(product(range(len(behind)), range(len(ahead))), key=sum)
    for stops in [*single, *([behind[one], ahead[other]] for one, other in pairs)]:
        if not refusal(stops):
            return stops, ""
    return [], direct


@dataclass(frozen=True, eq=False)
class WorkPiece:
    """The holes ``points_mm`` (N, 3) of a whole part in {W}, and its outward normals (N, 3)."""

    points_mm: Array
    outward: Array

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points_mm)

    def free_mm(self, places_mm: Array) -> Array:
        """Distance of positions (K, 3) in {W} in front of the part; inf beyond `REACH_MM`."""
        off_mm, nearest = self._tree.query(places_mm)
        from_hole = places_mm - self.points_mm[nearest]
        front_mm = np.einsum("ki,ki->k", from_hole, self.outward[nearest])
        return np.where(off_mm <= REACH_MM, front_mm, np.inf)


class Clearance:
    """Clearance of an arm at a station; ``arm`` has the tool's tip as its tool point."""

    TO_WRIST = 4  # links; those after them work close to the part
    AT_HOLE_MM = 1.0  # of a hole: there the tip may touch what it drills
    SAMPLE_MM = 5.0  # between samples along a path
    SAMPLES = 9  # by which a path's length is estimated

    def __init__(
        self, cell: Cell, station: Station, arm: Arm, T_W_B: Array, part: WorkPiece, least_mm: float
    ) -> None:
        """Between holes the tip keeps ``least_mm`` in front of the part."""
        self._arm, self._T_W_B, self._part, self._least_mm = arm, T_W_B, part, least_mm
        self._rail_mm = station.rail_mm
        boxes = [_Box(cell, station, each) for each in cell.keep_out]
        self._carriers = [box for box in boxes if box.carries(part, least_mm)]
        self._others = [box for box in boxes if box not in self._carriers]
        self._around = self._around_tool = self._to_wrist = None
        if (envelope := cell.robot.envelope) is not None:
            shape, layout = cell.robot.arm(), cell.layout
            x_mm, y_mm, z_mm = arm.tool[:3, 3].tolist()  # all that is known of a tool's body
            line = CapsuleTable(
                link=LINKS, from_mm=(0.0, 0.0, 0.0), to_mm=(x_mm, y_mm, z_mm), radius_mm=LEAST_MM
            )
            longer = replace(envelope, capsule=[*envelope.capsule, line])
            if others := [box.table for box in self._others]:
                self._around = Surroundings(shape, envelope, layout, others)
                self._around_tool = Surroundings(shape, longer, layout, others)
            if carriers := [box.table for box in self._carriers]:
                self._to_wrist = Surroundings(shape, envelope, layout, carriers, self.TO_WRIST)

    def refusal(self, start_rad: Array, end_rad: Array) -> str:
        """Why a synchronous joint motion between (6,) and (6,) is not clear, or ""."""
        tip_mm = self._sampled_mm(start_rad, end_rad)
        free_mm = float(self._part.free_mm(tip_mm).min())
        if not free_mm >= self._least_mm:
            where = "inside" if free_mm < 0.0 else "in front of"
            return (
                f"the tip is {abs(free_mm):.1f} mm {where} the part, expected at least "
                f"{self._least_mm:.0f} mm in front of it"
            )
        return self._passes_through(tip_mm) or self._collides(
            self._around_tool, start_rad[None], end_rad[None]
        )

    def straight_refusal(self, joints_rad: Array) -> str:
        """Why a straight path by joints (K, 6) to a hole is not clear, or ""."""
        tip_mm = self._tip_mm(joints_rad)
        before = np.linalg.norm(tip_mm - tip_mm[-1], axis=1) > self.AT_HOLE_MM
        *_, end_mm = free_mm = self._part.free_mm(tip_mm)  # commands lie beside their holes
        deepest_mm = float(free_mm.min())
        if not deepest_mm >= min(float(end_mm), 0.0) - self.AT_HOLE_MM:
            return (
                f"the tip is {-deepest_mm:.1f} mm inside the part on its straight path in: behind "
                "the plane of another hole"
            )
        return (
            self._passes_through(tip_mm[before])
            or self._tool_passes_through(joints_rad)
            or self._collides(self._around, joints_rad[:-1], joints_rad[1:])
        )

    def _tool_passes_through(self, joints_rad: Array) -> str:
        """Box that contains a part of the line from flange to tip, of those without a hole."""
        x_mm = self._arm.tool[:3, 3]
        shares = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(x_mm) / self.SAMPLE_MM))
        flanges = forward(self._arm, joints_rad) @ inverse(self._arm.tool)
        line_mm = np.concatenate([np.outer(shares, x_mm).T, np.ones((1, len(shares)))])
        places_mm = np.swapaxes((flanges @ line_mm)[:, :3], 1, 2).reshape(-1, 3)
        through = (box for box in self._others if box.contains(apply(self._T_W_B, places_mm)))
        return next((f"the tool passes through keep-out {box.table.name}" for box in through), "")

    def _passes_through(self, tip_mm: Array) -> str:
        for boxes, why in ((self._carriers, ", on which holes lie"), (self._others, "")):
            for box in boxes:
                if box.contains(tip_mm):
                    return f"the tip passes through keep-out {box.table.name}{why}"
        return ""

    def _collides(self, around: Surroundings | None, starts_rad: Array, ends_rad: Array) -> str:
        start, end = (with_slide(self._rail_mm, each) for each in (starts_rad, ends_rad))
        for known in (around, self._to_wrist):
            if known is None:
                continue
            proof = known.prove(start, end)
            for n in np.flatnonzero(~proof.clear).tolist():
                nearest = known.nearest(start[n], end[n], float(proof.share[n]))
                return (
                    f"link {nearest.link} comes within {nearest.clearance_mm:.1f} mm of keep-out "
                    f"{nearest.volume}, expected at least {known.wanted_mm:.0f} mm"
                )
        return ""

    def _sampled_mm(self, start_rad: Array, end_rad: Array) -> Array:
        """Positions (K, 3) of the tip in {W} along a motion."""
        path_rad = end_rad - start_rad
        rough_mm = self._tip_mm(start_rad + np.linspace(0.0, 1.0, self.SAMPLES)[:, None] * path_rad)
        length_mm = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(rough_mm))
        shares = np.linspace(0.0, 1.0, 2 + int(np.ceil(length_mm / self.SAMPLE_MM)))
        return self._tip_mm(start_rad + shares[:, None] * path_rad)

    def _tip_mm(self, joints_rad: Array) -> Array:
        return apply(self._T_W_B, forward(self._arm, joints_rad)[:, :3, 3])


@dataclass(frozen=True, eq=False)
class _Box:
    cell: Cell
    station: Station
    table: KeepOut

    ON_BOX_MM = 5.0  # a hole this near to a box lies on it

    def carries(self, part: WorkPiece, front_mm: float) -> bool:
        """Whether holes lie on it, and it does not stick out beside them. ``front_mm`` in front of
        them it is at least half as far away.
        """
        on_it = self._outside_mm(part.points_mm) <= self.ON_BOX_MM
        in_front_mm = part.points_mm[on_it] + front_mm * part.outward[on_it]
        return bool(on_it.any() and (self._outside_mm(in_front_mm) >= front_mm / 2).all())

    def contains(self, places_mm: Array) -> bool:
        """Whether any of positions (K, 3) in {W} is in it, or is NaN."""
        return not bool((self._outside_mm(places_mm) > 0.0).all())

    def _outside_mm(self, places_mm: Array) -> Array:
        frame = self.table.centre.matrix()
        if self.table.frame == "slide":
            frame = self.cell.layout.nominal_base(self.station.rail_mm) @ frame
        beyond_mm = np.abs(apply(inverse(frame), places_mm)) - np.array(self.table.size_mm) / 2
        return np.asarray(np.linalg.norm(np.maximum(beyond_mm, 0.0), axis=-1))
