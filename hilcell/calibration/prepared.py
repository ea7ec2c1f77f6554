"""From corrected targets to the program of their station: base, tool, stand-off and ways."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product, zip_longest

import numpy as np

from hilcell.calibration.part import Clearance, Part
from hilcell.calibration.tip import Tip
from hilcell.cell.file import Cell
from hilcell.compensation.station_program import Places, StationProgram
from hilcell.compensation.targets import as_listed
from hilcell.errors import bounded
from hilcell.geometry.closed_form import status_of
from hilcell.geometry.frames import inverse, poses_from_zyx, zyx_from_pose
from hilcell.geometry.inverse import posture, reachable
from hilcell.geometry.kinematics import Arm, Bools, forward
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import Array, HilcellError

NEAR_SHARE = 0.5  # of the stand-off, that ways between holes keep at least


class WayError(HilcellError):
    """A way of a program that comes too near to the part, or to what stands in the cell."""

    code = "HC-C10"


@dataclass(frozen=True, eq=False)
class Drilling:
    """A robot at a station, with a tool whose tip keeps ``standoff_mm`` from the part."""

    cell: Cell
    T_W_B: Array
    tip: Tip
    standoff_mm: float

    STEP_MM = 5.0  # between places of a straight way at which joints are computed

    DRAWN_BACK_MM = (100.0, 200.0, 300.0, 450.0, 600.0)  # behind the stand-off, where ways need it

    @property
    def arm(self) -> Arm:
        """Return the arm with the tip as its tool point."""
        return self.tip.arm(self.cell.robot.arm())

    def straight_rad(self, names: Sequence[str], command: Array) -> Array:
        """Return the joints (N, K, 6) from the stand-off straight to commands (N, 6) in {W}.

        Raises `WayError` naming the holes on whose ways the arm leaves its limits.
        """
        count = 1 + int(np.ceil(self.standoff_mm / self.STEP_MM))
        back_mm = np.linspace(self.standoff_mm, 0.0, count)
        poses = self._drawn_back(command, back_mm)
        robot = self.cell.robot
        known = (robot.status, robot.margin_limits_rad, np.radians(robot.home_deg))
        self._refuse_unreached(names, back_mm, reachable(self.arm, poses, *known))
        return posture(self.arm, poses, *known)

    def _refuse_unreached(self, names: Sequence[str], back_mm: Array, reached: Bools) -> None:
        """Raise `WayError` naming the holes whose ways (N, K) are not all within reach."""
        bad = np.flatnonzero(~reached.all(axis=1)).tolist()
        if not bad:
            return
        first = [back_mm[~reached[n]].min() for n in bad]
        lines = (
            f"{names[n]}: beyond the arm's reach or a joint limit from {off_mm:.0f} mm in front "
            "of the hole"
            for n, off_mm in zip(bad, first, strict=True)
        )
        raise WayError(
            f"the arm does not reach the stand-off of {self.standoff_mm:g} mm at {len(bad)} of "
            f"{len(names)} holes:\n{_listed(lines)}\n"
            "shorten it (--standoff, or standoff_mm of the tool), or move the part"
        )

    def drawn_back_rad(self, command: Array) -> Iterator[Array]:
        """Yield the joints (6,) behind the stand-off of a command (6,), nearest first, as far as
        the arm reaches.
        """
        robot, back_mm = self.cell.robot, self.standoff_mm + np.array(self.DRAWN_BACK_MM)
        known = (robot.status, robot.margin_limits_rad, np.radians(robot.home_deg))
        (poses,) = self._drawn_back(command[None], back_mm)
        yield from posture(self.arm, poses[reachable(self.arm, poses, *known)], *known)

    def _drawn_back(self, command: Array, back_mm: Array) -> Array:
        """Return poses (N, K, 4, 4) in {B}, drawn back (K,) along z from commands (N, 6) in {W}."""
        moved = np.repeat(poses_from_zyx(command)[:, None], len(back_mm), axis=1)
        moved[..., :3, 3] -= back_mm[:, None] * moved[..., :3, 2]
        return inverse(self.T_W_B) @ moved

    def places(self, joints_rad: Array) -> Places:
        """Return the tip at joints (N, 6)."""
        values = as_listed(zyx_from_pose(self.T_W_B @ forward(self.arm, joints_rad)))
        return Places(values, joints_rad, status_of(self.arm, joints_rad))


def station_program(
    drilling: Drilling,
    station: str,
    names: Sequence[str],
    command: Array,
    part: Part,
    remarks: Sequence[str],
) -> StationProgram:
    """Return the program for commands (N, 6) of the tip in {W}, as a list states them.

    Between holes the tip keeps half of the stand-off at least. Where the direct way is not clear,
    it is drawn back farther first, at the hole before, at the next one, or at both. At each
    stand-off it comes from below on every axis, by ``robot.approach_deg``, as every pose of the
    calibration did. Raises `WayError` where the arm leaves its limits, or no such way is clear.
    """
    robot = drilling.cell.robot
    straight_rad = drilling.straight_rad(names, command)
    off_rad, at_rad = straight_rad[:, 0], straight_rad[:, -1]
    below_rad = off_rad - np.radians(robot.approach_deg)
    clearance = Clearance(
        drilling.cell, drilling.cell.station_named(station), drilling.arm, drilling.T_W_B, part,
        NEAR_SHARE * drilling.standoff_mm,
    )  # fmt: skip
    problems = [
        f"{name}: {why}"
        for name, below, off, way in zip(names, below_rad, off_rad, straight_rad, strict=True)
        if (why := clearance.refusal(below, off) or clearance.straight_refusal(way))
    ]
    safe_rad = np.radians(robot.safe_deg)
    from_safe_mm = lengths_mm(command[:, :3] - drilling.places(safe_rad[None]).values[:, :3])
    gate = command[int(from_safe_mm.argmin())]  # the hole that the tip comes to first
    holes = [gate, *command, gate]
    via = list[Places]()
    for n, (start, end) in enumerate(
        zip([safe_rad, *off_rad], [*below_rad, safe_rad], strict=True)
    ):
        stops, why = _way(clearance, start, end, *map(drilling.drawn_back_rad, holes[n : n + 2]))
        via.append(drilling.places(np.array(stops).reshape(-1, 6)))
        if why:
            to = f"the way to {names[n]}" if n < len(names) else "the way back to the safe pose"
            problems.append(f"{to}: {why}")
    if problems:
        raise WayError(
            f"{station}: ways of its program are not clear:\n{_listed(problems)}\n"
            "change --standoff, robot.safe_deg, the holes or keep_out of the cell file"
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
        speed_percent=robot.speed_percent,
        options=robot.options,
        remarks=remarks,
    )


def _listed(lines: Iterable[str]) -> str:
    return "\n".join(f"  {each}" for each in bounded(list(lines)))


def _way(
    clearance: Clearance,
    start: Array,
    end: Array,
    before: Iterable[Array],
    after: Iterable[Array],
) -> tuple[list[Array], str]:
    """Return the stops (M, 6) of a clear way between joints (6,), and why there is none, or "".

    ``before`` and ``after`` are joints (6,) at which the tip is drawn back from the holes at the
    way's start and end, nearest first; they are asked for only where the direct way is not clear.
    """

    def refusal(stops: Sequence[Array]) -> str:
        ways = pairwise([start, *stops, end])
        return next(filter(None, (clearance.refusal(*each) for each in ways)), "")

    if not (direct := refusal([])):
        return [], ""
    behind, ahead = list(before), list(after)
    single = [[one] for both in zip_longest(behind, ahead) for one in both if one is not None]
    pairs = sorted(product(range(len(behind)), range(len(ahead))), key=sum)
    for stops in [*single, *([behind[one], ahead[other]] for one, other in pairs)]:
        if not refusal(stops):
            return stops, ""
    return [], direct
