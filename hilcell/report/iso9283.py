"""The pose test of ISO 9283 in the standard's terms: first page and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import ClassVar

from hilcell.calibration.iso9283 import ANGLES, CYCLE, Angles, Distance, Pose, PoseTest, Worst
from hilcell.decoding import typed
from hilcell.model.outcome import RULE
from hilcell.model.verdicts import AP, AP_ANGLES, ISO, RP, RP_ANGLES, Characteristic
from hilcell.present.table import Column, Table, listed
from hilcell.report.facts import Facts


def is_pose_test(facts: Facts) -> bool:
    """Whether the run is a pose test that has come to its end."""
    return ISO in facts.result


@dataclass(frozen=True, eq=False)
class PoseReport:
    """The report of one run's test."""

    POSES_NOTE: ClassVar = (
        "All in mm; commanded positions and AP in {B}. AP: barycentre of the attained positions "
        "less the commanded one. RP_l = mean of l + 3 S_l, l the distance from the barycentre; RP "
        "robot: the tracker's noise taken off."
    )
    TURNS_NOTE: ClassVar = (
        "a, b, c: rotations about x, y, z of {B} from the commanded orientation. AP: their mean; "
        "RP = ±3 S of them. AP is blank where no calibration says where the reflectors are on the "
        "flange."
    )

    UNCERTAINTY: ClassVar = (
        "U: expanded uncertainty, k = 2 (about 95 %). Of AP it holds scatter, tracker, reflector, "
        "drift, temperature and the frame in which poses are commanded; of AD the tracker at both "
        "ends; of RP and RD the statistics of so many cycles. Tracker noise is in RP and RD."
    )

    facts: Facts

    def tested(self) -> PoseTest:
        return typed(self.facts.result[ISO], PoseTest)

    def results_table(self) -> Table:
        rows = [each for each in self.tested().figures() if each.of.unit == "mm"]
        columns = self._columns("mm", ".3f", lambda row: f"{row.symbol}, {row.of.title}")
        return Table(columns, rows, "Results, at the worst pose")

    def orientation_results(self) -> Table:
        figures = self.tested().figures() if is_pose_test(self.facts) else []
        rows = [each for each in figures if each.of.unit == "deg"]
        columns = self._columns("°", ".4f", attrgetter("symbol"))
        return Table(columns, rows, "Results, angles at the worst pose")

    def sentence(self) -> str:
        test = self.tested()
        robot = "The robot as it is, not corrected,"
        if test.corrected_by:
            robot = f"The robot with the correction of run {test.corrected_by}"
        end = "" if test.limits else " No limits are stated to judge it by."
        return (
            f"{robot} attains commanded positions to {test.worst.ap_mm:.3f} mm (AP) and returns "
            f"to them to {test.worst.rp_mm:.3f} mm (RP) at the worst pose.{end}"
        )

    def conformity_text(self) -> str:
        """Return the decision rule, where limits are stated."""
        return RULE if self.tested().limits else "no limits are stated (iso9283 in the cell file)"

    def method_text(self) -> str:
        test = self.tested()
        return (
            f"ISO 9283:1998, clauses 7.2 and 7.3, positions of the reflector on the flange: "
            f"{test.cycles} cycles {', '.join(CYCLE)} on the plane {test.cube.plane} of a "
            f"cube of {test.cube.side_mm:g} mm, each pose approached directly from the one "
            "before it, measured at rest by laser tracker."
        )

    def tables(self) -> list[Table]:
        """Return conditions, poses, angles and distance; none of a run that is no pose test."""
        if not is_pose_test(self.facts):
            return []
        test = self.tested()
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
        note = "AD: mean of the measured distances less the commanded one; RD = ±3 S of them."
        return [
            Table(listed("condition", "in this test"), self._conditions(test), "Test conditions"),
            Table(POSES, test.poses.items(), "Pose accuracy and repeatability", self.POSES_NOTE),
            Table(
                TURNS,
                test.orientation.items(),
                "Accuracy and repeatability of angles",
                self.TURNS_NOTE,
            ),
            Table(distance, [test.distance], "Distance accuracy and repeatability", note),
        ]

    def departures(self) -> list[str]:
        """Return in what a pose test departs from the standard, for the first page."""
        return self.tested().deviations if is_pose_test(self.facts) else []

    def stated_conditions(self) -> list[tuple[str, str]]:
        """Return velocity, load and cycles of a pose test, for the first page."""
        if not is_pose_test(self.facts):
            return []
        test = self.tested()
        load = ("Load", self._load(test))
        return [("Velocity", self._velocity(test)), load, ("Cycles", str(test.cycles))]

    @staticmethod
    def _velocity(test: PoseTest) -> str:
        return f"{test.velocity_percent:g} % of the rated velocity"

    def _load(self, test: PoseTest) -> str:
        load_kg, rated_kg = test.load_kg, test.rated_load_kg
        if load_kg is None or rated_kg is None:
            return self._stated(load_kg, "kg")
        share = f", {100 * load_kg / rated_kg:.0f} %" if rated_kg else ""
        return f"{load_kg:g} kg of {rated_kg:g} kg rated{share}"

    @staticmethod
    def _stated(value: float | None, unit: str) -> str:
        return "not stated" if value is None else f"{value:g} {unit}"

    def _conditions(self, test: PoseTest) -> Iterator[tuple[str, str]]:
        cube, celsius, missing = test.cube, test.temperature_c, test.not_measured
        x, y, z = cube.centre_mm
        corrected = f"corrected by run {test.corrected_by}" if test.corrected_by else "as it is"
        yield "Robot", corrected
        yield "Test cube", f"side {cube.side_mm:g} mm about x {x:g}, y {y:g}, z {z:g} mm in {{B}}"
        yield "Plane, cycle", f"{cube.plane}; {', '.join(CYCLE)}, {test.cycles} times"
        yield "Approach", "directly from the pose before, as the cycle has it"
        yield "Velocity", self._velocity(test)
        yield "Load", self._load(test)
        yield "Warm-up", self._stated(test.warm_up_min, "min")
        yield "Stabilisation", f"{test.stabilisation_s:g} s from the end of motion to measurement"
        air = f"{celsius[0]:.1f} to {celsius[1]:.1f} °C at the tracker" if celsius else ""
        yield "Temperature", air or "not measured"
        yield "Tracker noise", f"{test.tracker_noise_mm:.4f} mm of one coordinate, 1 σ"
        yield "Orientations", f"not measured: {', '.join(missing)}" if missing else "measured"

    def _columns(
        self, unit: str, form: str, name: Callable[[Worst], str]
    ) -> tuple[Column[Worst], ...]:
        return (
            Column("characteristic", name),
            Column("at", attrgetter("where")),
            Column("value", attrgetter("value"), unit, form),
            Column("U", attrgetter("U"), unit, form),
            Column("limit", attrgetter("limit"), unit, form),
            Column(
                "verdict", lambda row: self.facts.outcome_text(row.outcome, "not judged"), form="s"
            ),
        )


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


def _angle(
    of: Characteristic, part: int, angle: str
) -> Callable[[tuple[str, Angles]], float | None]:
    return lambda row: row[1].figures(of)[part].get(angle)


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
