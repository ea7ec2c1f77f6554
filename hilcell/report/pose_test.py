"""The pose test of ISO 9283 in the standard's terms: first page, tables, figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hilcell.calibration.decision import RULE
from hilcell.calibration.pose_test import ANGLES, ISO, LIMITS, TURN_LIMITS, attained, worst_turn
from hilcell.geometry.pose_test import CORNERS, CYCLE, PLANE
from hilcell.geometry.sequential import Outcome
from hilcell.geometry.statistics import from_mean_mm
from hilcell.present.table import Column, Table
from hilcell.report.drawings.svg import INK, MUTED, axes_sheet
from hilcell.report.facts import Facts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Pose = tuple[str, Mapping[str, Any]]  # its name and its results
FIGURES = ("pose-test", "attained")  # names of the figures below
BLUE, ORANGE, PLANE_FILL = "#12507b", "#c26a2e", "#d3e0ec"
AXONOMETRIC = np.array([[-0.45, 0.9, 0.0], [-0.4, -0.18, 0.9]])  # {B}'s x, y, z on paper
EDGES = [(n, n % 4 + 1) for n in (1, 2, 3, 4)]  # of the top; others lie below and between


class Result(NamedTuple):
    """One characteristic at its worst place, for the first page."""

    name: str
    where: str
    value: float
    U: float
    limit: float | None

    @property
    def outcome(self) -> Outcome | None:
        """Return whether the value and its U keep the limit; None where none is stated."""
        if self.limit is None:
            return None
        return "accepted" if self.value + self.U <= self.limit else "rejected"


def _results_in(unit: str, form: str, facts: Facts) -> tuple[Column[Result], ...]:
    return (
        Column("characteristic", lambda row: row.name),
        Column("at", lambda row: row.where),
        Column("value", lambda row: row.value, unit, form),
        Column("U", lambda row: row.U, unit, form),
        Column("limit", lambda row: row.limit, unit, form),
        Column("verdict", lambda row: facts.verdict_words(row.outcome, "not judged"), form="s"),
    )


def tests_poses(facts: Facts) -> bool:
    """Whether the run is a pose test that has come to its end."""
    return ISO in facts.result


def results_sheet(facts: Facts) -> Table:
    """Return the worst characteristics, for the first page."""
    columns = _results_in("mm", ".3f", facts)
    return Table(columns, _results(facts.result[ISO]), "Results, at the worst pose")


def _results(found: Mapping[str, Any]) -> Iterator[Result]:
    worst, way, limits = found["worst"], found["distance"], found["limits"]
    ends = f"{way['from']} to {way['to']}"
    rows = (
        ("AP_p, pose accuracy", worst["ap_pose"], worst["ap_mm"], worst["ap_u95_mm"]),
        ("RP_l, pose repeatability", worst["rp_pose"], worst["rp_mm"], worst["rp_u95_mm"]),
        ("|AD|, distance accuracy", ends, abs(way["ad_mm"]), way["ad_u95_mm"]),
        ("RD, distance repeatability, ±", ends, way["rd_mm"], way["rd_u95_mm"]),
    )
    for key, (name, where, value_mm, u95_mm) in zip(LIMITS, rows, strict=True):
        yield Result(name, where, value_mm, u95_mm, limits.get(f"{key}_limit_mm"))


def sentence(facts: Facts) -> str:
    """Return what was found, in a sentence."""
    found = facts.result[ISO]
    robot = (
        f"The robot with the correction of run {found['corrected_by']}"
        if found["corrected_by"]
        else "The robot as it is, not corrected,"
    )
    worst = found["worst"]
    end = "" if found["limits"] else " No limits are stated to judge it by."
    return (
        f"{robot} attains commanded positions to {worst['ap_mm']:.3f} mm (AP) and returns to "
        f"them to {worst['rp_mm']:.3f} mm (RP) at the worst pose.{end}"
    )


def conformity_words(facts: Facts) -> str:
    """Return the decision rule, where limits are stated."""
    return (
        RULE if facts.result[ISO]["limits"] else "no limits are stated (iso9283 in the cell file)"
    )


def uncertainty_words() -> str:
    """Return the meaning of U."""
    return (
        "U: expanded uncertainty, k = 2 (about 95 %). Of AP it holds scatter, tracker, reflector, "
        "drift, temperature and the frame in which poses are commanded; of AD the tracker at both "
        "ends; of RP and RD the statistics of so many cycles. Tracker noise is in RP and RD."
    )


def method_words(facts: Facts) -> str:
    """Return cycle and approach in words."""
    found = facts.result[ISO]
    return (
        f"ISO 9283:1998, clauses 7.2 and 7.3, positions of the reflector on the flange: "
        f"{found['cycles']} cycles {', '.join(CYCLE)} on the plane {found['cube']['plane']} of a "
        f"cube of {found['cube']['side_mm']:g} mm, each pose approached directly from the one "
        "before it, measured at rest by laser tracker."
    )


def sheets(facts: Facts) -> list[Table]:
    """Return conditions, poses, angles and distance; none of a run that is no pose test."""
    if not tests_poses(facts):
        return []
    found = facts.result[ISO]
    return [
        Table(CONDITIONS, _conditions(found), "Test conditions"),
        Table(POSES, found["poses"].items(), "Pose accuracy and repeatability", POSES_NOTE),
        Table(
            TURNS,
            found.get("orientation", {}).items(),
            "Accuracy and repeatability of angles",
            TURNS_NOTE,
        ),
        Table(DISTANCE, [found["distance"]], "Distance accuracy and repeatability", DISTANCE_NOTE),
    ]


def departures(facts: Facts) -> list[str]:
    """Return in what a pose test departs from the standard, for the first page."""
    return list(facts.result[ISO]["deviations"]) if tests_poses(facts) else []


def stated_conditions(facts: Facts) -> list[tuple[str, str]]:
    """Return velocity, load and cycles of a pose test, for the first page."""
    if not tests_poses(facts):
        return []
    found = facts.result[ISO]
    return [
        ("Velocity", _velocity(found)),
        ("Load", _load(found["load_kg"], found["rated_load_kg"])),
        ("Cycles", str(found["cycles"])),
    ]


def _velocity(found: Mapping[str, Any]) -> str:
    return f"{found['velocity_percent']:g} % of the rated velocity"


CONDITIONS: tuple[Column[tuple[str, str]], ...] = (
    Column("condition", itemgetter(0)),
    Column("in this test", itemgetter(1)),
)


def _conditions(found: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    cube, celsius = found["cube"], found["temperature_c"]
    x, y, z = cube["centre_mm"]
    yield (
        "Robot",
        (f"corrected by run {found['corrected_by']}" if found["corrected_by"] else "as it is"),
    )
    yield "Test cube", f"side {cube['side_mm']:g} mm about x {x:g}, y {y:g}, z {z:g} mm in {{B}}"
    yield "Plane, cycle", f"{cube['plane']}; {', '.join(CYCLE)}, {found['cycles']} times"
    yield "Approach", "directly from the pose before, as the cycle has it"
    yield "Velocity", _velocity(found)
    yield "Load", _load(found["load_kg"], found["rated_load_kg"])
    yield "Warm-up", _stated(found["warm_up_min"], "min")
    yield "Stabilisation", f"{found['stabilisation_s']:g} s from the end of motion to measurement"
    yield (
        "Temperature",
        (f"{celsius[0]:.1f} to {celsius[1]:.1f} °C at the tracker" if celsius else "not measured"),
    )
    yield "Tracker noise", f"{found['tracker_noise_mm']:.4f} mm of one coordinate, 1 σ"
    missing = found["not_measured"]
    yield "Orientations", f"not measured: {', '.join(missing)}" if missing else "measured"


def _load(load_kg: float | None, rated_kg: float | None) -> str:
    if load_kg is None or rated_kg is None:
        return _stated(load_kg, "kg")
    share = f", {100 * load_kg / rated_kg:.0f} %" if rated_kg else ""
    return f"{load_kg:g} kg of {rated_kg:g} kg rated{share}"


def _stated(value: float | None, unit: str) -> str:
    return "not stated" if value is None else f"{value:g} {unit}"


def _of(key: str) -> Callable[[Pose], float]:
    return lambda row: float(row[1][key])


def _at(axis: int) -> Callable[[Pose], float]:
    return lambda row: float(row[1]["commanded_mm"][axis])


POSES: tuple[Column[Pose], ...] = (
    Column("pose", itemgetter(0)),
    *(Column(axis, _at(n), form=".0f") for n, axis in enumerate("xyz")),
    Column("AP_p", _of("ap_mm"), form=".3f"),
    *(Column(f"AP_{axis}", _of(f"ap_{axis}_mm"), form="+.3f") for axis in "xyz"),
    Column("U(AP_p)", _of("ap_u95_mm"), form=".3f"),
    Column("l mean", _of("l_mean_mm"), form=".4f"),
    Column("S_l", _of("s_l_mm"), form=".4f"),
    Column("RP_l", _of("rp_mm"), form=".3f"),
    Column("U(RP_l)", _of("rp_u95_mm"), form=".3f"),
    Column("RP robot", _of("rp_robot_mm"), form=".3f"),
)
POSES_NOTE = (
    "All in mm; commanded positions and AP in {B}. AP: barycentre of the attained positions less "
    "the commanded one. RP_l = mean of l + 3 S_l, l the distance from the barycentre; RP robot: "
    "the tracker's noise taken off."
)


def _angle(key: str, angle: str) -> Callable[[Pose], float | None]:
    return lambda row: row[1].get(key, {}).get(angle)


TURNS: tuple[Column[Pose], ...] = (
    Column("pose", itemgetter(0)),
    *(
        Column(name.format(angle), _angle(key, angle), "°", form)
        for key, name, form in (
            ("ap_deg", "AP_{}", "+.4f"), ("ap_u95_deg", "U(AP_{})", ".4f"),
            ("rp_deg", "RP_{} ±", ".4f"), ("rp_u95_deg", "U(RP_{})", ".4f"),
        )
        for angle in ANGLES
    ),
)  # fmt: skip
TURNS_NOTE = (
    "a, b, c: rotations about x, y, z of {B} from the commanded orientation. AP: their mean; RP = "
    "±3 S of them. AP is blank where no calibration says where the reflectors are on the flange."
)


def turn_results(facts: Facts) -> Table:
    """Return the worst angles beside their limits, for the first page."""
    if not tests_poses(facts):
        return Table((), ())
    found = facts.result[ISO]
    rows = [
        Result(
            f"{key.upper()}_{each[1]}", each[0], *each[2:], found["limits"].get(f"{key}_limit_deg")
        )
        for key in TURN_LIMITS
        if (each := worst_turn(found.get("orientation", {}), key)) is not None
    ]
    return Table(_results_in("°", ".4f", facts), rows, "Results, angles at the worst pose")


def _way(key: str) -> Callable[[Mapping[str, Any]], float]:
    return lambda row: float(row[key])


DISTANCE: tuple[Column[Mapping[str, Any]], ...] = (
    Column("from", itemgetter("from")),
    Column("to", itemgetter("to")),
    Column("commanded", _way("commanded_mm"), "mm", ".3f"),
    Column("AD", _way("ad_mm"), "mm", "+.4f"),
    *(Column(f"AD_{axis}", _way(f"ad_{axis}_mm"), "mm", "+.4f") for axis in "xyz"),
    Column("U(AD)", _way("ad_u95_mm"), "mm", ".4f"),
    Column("RD ±", _way("rd_mm"), "mm", ".4f"),
    Column("U(RD)", _way("rd_u95_mm"), "mm", ".4f"),
)
DISTANCE_NOTE = "AD: mean of the measured distances less the commanded one; RD = ±3 S of them."


# -- figures --------------------------------------------------------------------------------------


def fig_poses(facts: Facts) -> tuple[Figure, str] | None:
    """Draw the test cube with its poses, and AP and RP of each."""
    if not tests_poses(facts):
        return None
    poses = facts.result[ISO]["poses"]
    figure, axes = axes_sheet(2.6, 1, 3)
    _cube(axes[0, 0], facts.result[ISO]["cube"], poses)
    for ax, key, name, colour in zip(
        axes[0, 1:], ("ap", "rp"), ("AP_p", "RP_l"), (ORANGE, BLUE), strict=True
    ):
        values = [each[f"{key}_mm"] for each in poses.values()]
        ax.bar(list(poses), values, width=0.6, color=colour,
               yerr=[each[f"{key}_u95_mm"] for each in poses.values()],
               error_kw={"ecolor": INK, "elinewidth": 0.8, "capsize": 2.5})  # fmt: skip
        ax.set_title(f"{name}, mm")
        ax.set_ylim(bottom=0.0)
        ax.grid(visible=False, axis="x")
        if limit_mm := facts.result[ISO]["limits"].get(f"{key}_limit_mm"):
            ax.axhline(limit_mm, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    return figure, (
        "Left: the test cube in {B} and the cycle on its plane. Bars: U, k = 2. Dashed: the limit, "
        "where one is stated."
    )


def _cube(ax: Axes, cube: Mapping[str, Any], poses: Mapping[str, Any]) -> None:
    half_mm, centre = cube["side_mm"] / 2, np.array(cube["centre_mm"])
    corners = {name: AXONOMETRIC @ (np.array(at) * half_mm) for name, at in CORNERS.items()}
    for one, other in EDGES:
        for a, b in ((one, other), (one + 4, other + 4), (one, one + 4)):
            ends = np.array([corners[f"C{a}"], corners[f"C{b}"]])
            ax.plot(*ends.T, color=MUTED, linewidth=0.7)
    ax.fill(*np.array([corners[name] for name in PLANE]).T, color=PLANE_FILL, alpha=0.7, zorder=0)
    for name, at in corners.items():
        ax.text(
            at[0] * 1.14, at[1] * 1.14, name, ha="center", va="center", fontsize=6.5, color=MUTED
        )
    places = {
        name: AXONOMETRIC @ (np.array(each["commanded_mm"]) - centre)
        for name, each in poses.items()
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
    clouds = {name: each.error_mm for name, each in attained(facts.log).items()}
    reach_mm = 1.15 * max(
        *(float(from_mean_mm(cloud).max()) for cloud in clouds.values()),
        *(each["rp_mm"] for each in facts.result[ISO]["poses"].values()),
    )
    tick_mm = float(f"{0.6 * reach_mm:.1g}")
    figure, axes = axes_sheet(3.1, 2, len(clouds), sharex=True, sharey=True)
    for column, (name, cloud) in enumerate(clouds.items()):
        off_mm = cloud - cloud.mean(axis=0)
        for ax, (across, up) in zip(axes[:, column], ((0, 1), (0, 2)), strict=True):
            ax.plot(off_mm[:, across], off_mm[:, up], "o", color=BLUE, markersize=2.2, alpha=0.75)
            turn = np.linspace(0.0, 2.0 * np.pi, 73)
            rp_mm = facts.result[ISO]["poses"][name]["rp_mm"]
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
