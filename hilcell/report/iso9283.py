"""The pose test of ISO 9283 in the standard's terms: first page, tables, figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING

import numpy as np

from hilcell.calibration.iso9283 import (
    ANGLES,
    CORNERS,
    CYCLE,
    PLANE,
    Angles,
    Cube,
    Distance,
    Pose,
    PoseTest,
    Worst,
    attained,
)
from hilcell.geometry.statistics import from_mean_mm
from hilcell.model.outcome import RULE, Outcome
from hilcell.model.verdicts import AP, AP_ANGLES, ISO, RP, RP_ANGLES, Characteristic
from hilcell.present.table import Column, Table
from hilcell.report.drawings.svg import INK, MUTED, axes_sheet
from hilcell.report.facts import Facts
from hilcell.typed import typed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURES = ("pose-test", "attained")  # names of the figures below
BLUE, ORANGE, PLANE_FILL = "#12507b", "#c26a2e", "#d3e0ec"


def tests_poses(facts: Facts) -> bool:
    """Whether the run is a pose test that has come to its end."""
    return ISO in facts.result


@dataclass(frozen=True, eq=False)
class PoseReport:
    """The report of one run's test."""

    facts: Facts

    def tested(self) -> PoseTest:
        """Return the result of a pose test."""
        return typed(self.facts.result[ISO], PoseTest)

    def results_sheet(self) -> Table:
        """Return the worst characteristics of positions, for the first page."""
        rows = [each for each in self.tested().figures() if each.of.unit == "mm"]
        columns = _columns(self.facts, "mm", ".3f", lambda row: f"{row.symbol}, {row.of.title}")
        return Table(columns, rows, "Results, at the worst pose")

    def turn_results(self) -> Table:
        """Return the worst angles beside their limits, for the first page."""
        found = self.tested().figures() if tests_poses(self.facts) else []
        rows = [each for each in found if each.of.unit == "deg"]
        columns = _columns(self.facts, "°", ".4f", attrgetter("symbol"))
        return Table(columns, rows, "Results, angles at the worst pose")

    def sentence(self) -> str:
        """Return what was found, in a sentence."""
        found = self.tested()
        robot = (
            f"The robot with the correction of run {found.corrected_by}"
            if found.corrected_by
            else "The robot as it is, not corrected,"
        )
        end = "" if found.limits else " No limits are stated to judge it by."
        return (
            f"{robot} attains commanded positions to {found.worst.ap_mm:.3f} mm (AP) and returns "
            f"to them to {found.worst.rp_mm:.3f} mm (RP) at the worst pose.{end}"
        )

    def conformity_words(self) -> str:
        """Return the decision rule, where limits are stated."""
        return RULE if self.tested().limits else "no limits are stated (iso9283 in the cell file)"

    def method_words(self) -> str:
        """Return cycle and approach in words."""
        found = self.tested()
        return (
            f"ISO 9283:1998, clauses 7.2 and 7.3, positions of the reflector on the flange: "
            f"{found.cycles} cycles {', '.join(CYCLE)} on the plane {found.cube.plane} of a "
            f"cube of {found.cube.side_mm:g} mm, each pose approached directly from the one "
            "before it, measured at rest by laser tracker."
        )

    def sheets(self) -> list[Table]:
        """Return conditions, poses, angles and distance; none of a run that is no pose test."""
        if not tests_poses(self.facts):
            return []
        found = self.tested()
        turns = found.orientation.items()
        columns: tuple[Column[tuple[str, str]], ...] = (
            Column("condition", itemgetter(0)),
            Column("in this test", itemgetter(1)),
        )
        distance: tuple[Column[Distance], ...] = (
            Column("from", attrgetter("start")),
            Column("to", attrgetter("to")),
            Column("commanded", attrgetter("commanded_mm"), "mm", ".3f"),
            Column("AD", attrgetter("ad_mm"), "mm", "+.4f"),
            *(Column(f"AD_{axis}", attrgetter(f"ad_{axis}_mm"), "mm", "+.4f") for axis in "xyz"),
            Column("U(AD)", attrgetter("ad_u95_mm"), "mm", ".4f"),
            Column("RD ±", attrgetter("rd_mm"), "mm", ".4f"),
            Column("U(RD)", attrgetter("rd_u95_mm"), "mm", ".4f"),
        )
        distance_note = (
            "AD: mean of the measured distances less the commanded one; RD = ±3 S of them."
        )
        return [
            Table(columns, _conditions(found), "Test conditions"),
            Table(POSES, found.poses.items(), "Pose accuracy and repeatability", POSES_NOTE),
            Table(TURNS, turns, "Accuracy and repeatability of angles", TURNS_NOTE),
            Table(distance, [found.distance], "Distance accuracy and repeatability", distance_note),
        ]

    def departures(self) -> list[str]:
        """Return in what a pose test departs from the standard, for the first page."""
        return self.tested().deviations if tests_poses(self.facts) else []

    def stated_conditions(self) -> list[tuple[str, str]]:
        """Return velocity, load and cycles of a pose test, for the first page."""
        if not tests_poses(self.facts):
            return []
        found = self.tested()
        return [
            ("Velocity", _velocity(found)),
            ("Load", _load(found)),
            ("Cycles", str(found.cycles)),
        ]


def _columns(
    facts: Facts, unit: str, form: str, name: Callable[[Worst], str]
) -> tuple[Column[Worst], ...]:
    def verdict(row: Worst) -> str:
        if row.limit is None:
            return "not judged"
        return facts.outcome_words(Outcome.ACCEPTED if row.holds else Outcome.REJECTED)

    return (
        Column("characteristic", name),
        Column("at", attrgetter("where")),
        Column("value", attrgetter("value"), unit, form),
        Column("U", attrgetter("U"), unit, form),
        Column("limit", attrgetter("limit"), unit, form),
        Column("verdict", verdict, form="s"),
    )


def uncertainty_words() -> str:
    """Return the meaning of U."""
    return (
        "U: expanded uncertainty, k = 2 (about 95 %). Of AP it holds scatter, tracker, reflector, "
        "drift, temperature and the frame in which poses are commanded; of AD the tracker at both "
        "ends; of RP and RD the statistics of so many cycles. Tracker noise is in RP and RD."
    )


def _velocity(found: PoseTest) -> str:
    return f"{found.velocity_percent:g} % of the rated velocity"


def _conditions(found: PoseTest) -> Iterator[tuple[str, str]]:
    cube, celsius, missing = found.cube, found.temperature_c, found.not_measured
    x, y, z = cube.centre_mm
    corrected = f"corrected by run {found.corrected_by}" if found.corrected_by else "as it is"
    yield "Robot", corrected
    yield "Test cube", f"side {cube.side_mm:g} mm about x {x:g}, y {y:g}, z {z:g} mm in {{B}}"
    yield "Plane, cycle", f"{cube.plane}; {', '.join(CYCLE)}, {found.cycles} times"
    yield "Approach", "directly from the pose before, as the cycle has it"
    yield "Velocity", _velocity(found)
    yield "Load", _load(found)
    yield "Warm-up", _stated(found.warm_up_min, "min")
    yield "Stabilisation", f"{found.stabilisation_s:g} s from the end of motion to measurement"
    air = f"{celsius[0]:.1f} to {celsius[1]:.1f} °C at the tracker" if celsius else "not measured"
    yield "Temperature", air
    yield "Tracker noise", f"{found.tracker_noise_mm:.4f} mm of one coordinate, 1 σ"
    yield "Orientations", f"not measured: {', '.join(missing)}" if missing else "measured"


def _load(found: PoseTest) -> str:
    load_kg, rated_kg = found.load_kg, found.rated_load_kg
    if load_kg is None or rated_kg is None:
        return _stated(load_kg, "kg")
    share = f", {100 * load_kg / rated_kg:.0f} %" if rated_kg else ""
    return f"{load_kg:g} kg of {rated_kg:g} kg rated{share}"


def _stated(value: float | None, unit: str) -> str:
    return "not stated" if value is None else f"{value:g} {unit}"


POSES: tuple[Column[tuple[str, Pose]], ...] = (
    Column("pose", lambda row: row[0]),
    Column("x", lambda row: row[1].commanded_mm[0], form=".0f"),
    Column("y", lambda row: row[1].commanded_mm[1], form=".0f"),
    Column("z", lambda row: row[1].commanded_mm[2], form=".0f"),
    Column(AP.symbol, lambda row: row[1].ap_mm, form=".3f"),
    Column("AP_x", lambda row: row[1].ap_x_mm, form="+.3f"),
    Column("AP_y", lambda row: row[1].ap_y_mm, form="+.3f"),
    Column("AP_z", lambda row: row[1].ap_z_mm, form="+.3f"),
    Column(f"U({AP.symbol})", lambda row: row[1].ap_u95_mm, form=".3f"),
    Column("l mean", lambda row: row[1].l_mean_mm, form=".4f"),
    Column("S_l", lambda row: row[1].s_l_mm, form=".4f"),
    Column(RP.symbol, lambda row: row[1].rp_mm, form=".3f"),
    Column(f"U({RP.symbol})", lambda row: row[1].rp_u95_mm, form=".3f"),
    Column("RP robot", lambda row: row[1].rp_robot_mm, form=".3f"),
)
POSES_NOTE = (
    "All in mm; commanded positions and AP in {B}. AP: barycentre of the attained positions less "
    "the commanded one. RP_l = mean of l + 3 S_l, l the distance from the barycentre; RP robot: "
    "the tracker's noise taken off."
)


def _angle(
    of: Characteristic, part: int, angle: str
) -> Callable[[tuple[str, Angles]], float | None]:
    return lambda row: row[1].of(of)[part].get(angle)


TURNS: tuple[Column[tuple[str, Angles]], ...] = (
    Column("pose", itemgetter(0)),
    *(
        Column(name.format(angle), _angle(of, part, angle), "°", form)
        for of, part, name, form in (
            (AP_ANGLES, 0, "AP_{}", "+.4f"), (AP_ANGLES, 1, "U(AP_{})", ".4f"),
            (RP_ANGLES, 0, "RP_{} ±", ".4f"), (RP_ANGLES, 1, "U(RP_{})", ".4f"),
        )
        for angle in ANGLES
    ),
)  # fmt: skip
TURNS_NOTE = (
    "a, b, c: rotations about x, y, z of {B} from the commanded orientation. AP: their mean; RP = "
    "±3 S of them. AP is blank where no calibration says where the reflectors are on the flange."
)


# -- figures --------------------------------------------------------------------------------------


def fig_poses(facts: Facts) -> tuple[Figure, str] | None:
    """Draw the test cube with its poses, and AP and RP of each."""
    if not tests_poses(facts):
        return None
    found = PoseReport(facts).tested()
    figure, axes = axes_sheet(2.6, 1, 3)
    _cube(axes[0, 0], found.cube, found.poses)
    for ax, of, colour, bars in zip(
        axes[0, 1:],
        (AP, RP),
        (ORANGE, BLUE),
        (
            [(each.ap_mm, each.ap_u95_mm) for each in found.poses.values()],
            [(each.rp_mm, each.rp_u95_mm) for each in found.poses.values()],
        ),
        strict=True,
    ):
        values, u95_mm = zip(*bars, strict=True)
        ax.bar(list(found.poses), values, width=0.6, color=colour, yerr=u95_mm,
               error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2.5})  # fmt: skip
        ax.set_title(f"{of.symbol}, {of.unit}")
        ax.set_ylim(bottom=0.0)
        ax.grid(visible=False, axis="x")
        if limit_mm := found.limits.get(of.limit):
            ax.axhline(limit_mm, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    return figure, (
        "Left: the test cube in {B} and the cycle on its plane. Bars: U, k = 2. Dashed: the limit, "
        "where one is stated."
    )


def _cube(ax: Axes, cube: Cube, poses: dict[str, Pose]) -> None:
    half_mm, centre = cube.side_mm / 2, np.array(cube.centre_mm)
    axonometric = np.array([[-0.45, 0.9, 0.0], [-0.4, -0.18, 0.9]])  # {B}'s x, y, z on paper
    corners = {name: axonometric @ (np.array(at) * half_mm) for name, at in CORNERS.items()}
    edges = [(n, n % 4 + 1) for n in (1, 2, 3, 4)]  # of the top; others lie below and between
    for one, other in edges:
        for a, b in ((one, other), (one + 4, other + 4), (one, one + 4)):
            ends = np.array([corners[f"C{a}"], corners[f"C{b}"]])
            ax.plot(*ends.T, color=MUTED, linewidth=0.7)
    ax.fill(*np.array([corners[name] for name in PLANE]).T, color=PLANE_FILL, alpha=0.7, zorder=0)
    for name, at in corners.items():
        ax.text(
            at[0] * 1.14, at[1] * 1.14, name, ha="center", va="center", fontsize=6.5, color=MUTED
        )
    places = {
        name: axonometric @ (np.array(each.commanded_mm) - centre) for name, each in poses.items()
    }
    for before, after in zip((CYCLE[-1], *CYCLE), CYCLE, strict=False):
        ax.annotate(
            "", tuple(places[after]), tuple(places[before]),
            arrowprops={"arrowstyle": "->", "color": BLUE, "linewidth": 0.8, "shrinkB": 3.0},
        )  # fmt: skip
    for name, at in places.items():
        ax.plot(*at, "o", color=BLUE, markersize=3.5)
        ax.text(at[0], at[1] + 0.12 * half_mm, name, ha="center", fontsize=7.5, weight="bold")
    ax.set_aspect("equal")
    ax.margins(0.14)
    ax.set_axis_off()
    ax.set_title("Test cube", loc="left")


def fig_attained(facts: Facts) -> tuple[Figure, str] | None:
    """Draw the attained positions of each pose about their barycentre, from two sides."""
    if not tests_poses(facts):
        return None
    poses = PoseReport(facts).tested().poses
    clouds = {name: each.error_mm for name, each in attained(facts.log).items()}
    reach_mm = 1.15 * max(
        *(float(from_mean_mm(cloud).max()) for cloud in clouds.values()),
        *(each.rp_mm for each in poses.values()),
    )
    tick_mm = float(f"{0.6 * reach_mm:.1g}")
    figure, axes = axes_sheet(3.1, 2, len(clouds), sharex=True, sharey=True)
    for column, (name, cloud) in enumerate(clouds.items()):
        off_mm = cloud - cloud.mean(axis=0)
        for ax, (across, up) in zip(axes[:, column], ((0, 1), (0, 2)), strict=True):
            ax.plot(off_mm[:, across], off_mm[:, up], "o", color=BLUE, markersize=2.2, alpha=0.75)
            turn = np.linspace(0.0, 2.0 * np.pi, 73)
            rp_mm = poses[name].rp_mm
            ax.plot(rp_mm * np.cos(turn), rp_mm * np.sin(turn), color=ORANGE, linewidth=0.9)
            ax.set_xticks([-tick_mm, tick_mm])
            ax.set_yticks([-tick_mm, 0.0, tick_mm])
            ax.set_xlim(-reach_mm, reach_mm)
            ax.set_ylim(-reach_mm, reach_mm)
            ax.set_aspect("equal")
        axes[0, column].set_title(name)
        axes[1, column].set_xlabel("x, mm")
    axes[0, 0].set_ylabel("y, mm")
    axes[1, 0].set_ylabel("z, mm")
    return figure, "Attained positions less their barycentre, axes of {B}. Circle: radius RP_l."
