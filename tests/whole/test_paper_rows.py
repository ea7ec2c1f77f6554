"""Every row of the paper holds in a right run, and fails when the mistake that it names is made.

The mistakes are made on the journal of one right run, or in the computation.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from hilcell.calibration import frames as calibration
from hilcell.calibration.frames import Frames, axis_circle
from hilcell.calibration.grid import grid_errors_mm, grid_of, measured_grid
from hilcell.calibration.position_errors import position_errors
from hilcell.cell.file import Cell
from hilcell.compensation.correction import corrected
from hilcell.compensation.interpolation import Idw
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.jacobian import parameter_jacobian
from hilcell.geometry.kinematics import Arm, forward
from hilcell.geometry.statistics import figures_of
from hilcell.journal.log import Log, positions_mm
from hilcell.model.frame import MeasuredBase
from hilcell.model.point import Point
from hilcell.model.results import PaperRow
from hilcell.ports import Array
from hilcell.programs import plan as planning
from hilcell.programs.plan import HolePlan
from procedures import rail, station_frames
from procedures.paper import ROWS, Compared, Experiments, PaperRows, Row
from procedures.plan import joints_for, poses_at
from procedures.station_frames import Moved, station_fit, tool_uncertainty_mm
from tests.hilcell.compensation.models import predicted_mm
from tests.whole.golden import GoldenRun

pytestmark = pytest.mark.timeout(240)
SET = {
    "fig10.repeats", "sec5.1.temperature.min", "sec5.1.temperature.max", "fig11.vertices",
    "fig11.cells", "fig12.targets", "fig12.before.mean", "fig13.targets", "abstract.before.max",
}  # fmt: skip

BY_NAME: Mapping[str, Row] = {row.name: row for row in ROWS}
REFERENCE, OTHERS = "S1100", ("S300", "S1900")


def rows_of(log: Log) -> dict[str, PaperRow]:
    """Return all rows, judged on this log alone."""
    found = PaperRows.experiments(log)
    return {row.name: row.judged(log, found) for row in ROWS}


def failing(log: Log) -> set[str]:
    return {name for name, row in rows_of(log).items() if not row.holds}


def fails(name: str, log: Log) -> bool:
    return not BY_NAME[name].judged(log, PaperRows.experiments(log)).holds


def changed(log: Log, points: Iterable[Point]) -> Log:
    """Return the log with these points in the places of those with their keys."""
    other = copy.copy(log)
    new = {point.key: point for point in points}
    other.points = {**log.points} | new
    air = {key: each.temperature_c for key, each in new.items() if each.temperature_c is not None}
    other.celsius = {**log.celsius} | air
    return other


def framed(log: Log, frames: Mapping[str, dict[str, Any]]) -> Log:
    """Return the log with these facts of frames changed."""
    other = copy.copy(log)
    other.frames = log.frames | {
        name: msgspec.structs.replace(log.frames[name], **new) for name, new in frames.items()
    }
    return other


def placed(point: Point, xyz_mm: Array, **others: Any) -> Point:
    return msgspec.structs.replace(point, xyz_mm=tuple(xyz_mm.tolist()), **others)


def as_if_sent(log: Log, correct: Callable[[Array], Array], stations: Iterable[str]) -> Log:
    """Return the log as if P - correct(P) had been sent in the place of the paper's method.

    ``correct`` maps targets (N, 3) to what is taken off, (N, 3), both in {B} of the grid's station.
    """
    points = []
    T_L_W, T_B_W = inverse(log.matrix("world")), inverse(log.matrix("base"))
    for station in stations:
        targets = log.select("validate", station, how="idw")
        nominal_mm = np.array([point.nominal_mm for point in targets])
        in_base_mm = apply(T_B_W @ moved_to_reference(log, station), nominal_mm)
        off_mm = correct(in_base_mm) @ inverse(T_B_W)[:3, :3].T
        before_mm = position_errors(log, log.select("validate", station, how="before")).error_mm
        reached_mm = apply(T_L_W, nominal_mm + before_mm - off_mm)
        points += [placed(point, at_mm) for point, at_mm in zip(targets, reached_mm, strict=True)]
    return changed(log, points)


def moved_to_reference(log: Log, station: str) -> Array:
    """Return the motion (4, 4) in {W} that takes the slide back to the grid's station."""
    T_W_Si = log.matrix(f"station.{station}")
    back: Array = log.matrix(f"station.{REFERENCE}") @ inverse(T_W_Si)
    return back


def by_idw(log: Log) -> Callable[[Array], Array]:
    model = Idw.of_grid(measured_grid(log))
    return lambda at_mm: model.predict(poses_at(log.cell, at_mm)).error_mm


def judged(name: str, paper: GoldenRun) -> PaperRow:
    return BY_NAME[name].judged(paper.log, typed(paper.result, Experiments))


@pytest.fixture
def log(paper: GoldenRun) -> Log:
    return paper.log


def test_every_row_of_the_paper_passes(paper: GoldenRun) -> None:
    rows = {row["row"]: row for row in paper.result["rows"]}
    assert [name for name, row in rows.items() if not row["holds"]] == [], paper.done.stderr
    assert list(rows) == [row.name for row in ROWS]
    assert rows["fig12.after.mean"]["paper"] == 0.1168
    for row in rows.values():
        assert set(row) == {
            "row", "paper", "here", "chosen", "unit", "holds", "criterion", "set", "fails",
        }  # fmt: skip


def test_the_journal_gives_the_rows_again(paper: GoldenRun) -> None:
    assert msgspec.to_builtins([*rows_of(paper.log).values()]) == paper.result["rows"]


def test_rows_that_cannot_fail_say_so_and_all_others_say_when_they_fail(paper: GoldenRun) -> None:
    rows = {row["row"]: row for row in paper.result["rows"]}
    assert {name for name, row in rows.items() if row["set"]} == SET
    for name, row in rows.items():
        assert bool(row["fails"]) is (name not in SET)
    shown = {cells[0]: cells[-1] for cells in PaperRows.table(paper.result).rows}
    assert {name for name, word in shown.items() if word == "set"} == SET


def test_round_off_is_shown_without_its_digits_which_differ_between_pcs(paper: GoldenRun) -> None:
    shown = {cells[0]: cells[2] for cells in PaperRows.table(paper.result).rows}
    assert {name for name, here in shown.items() if here == "< 1e-09"} == {
        "eq1-7.jacobian", "eq9.weights",
    }  # fmt: skip


def test_a_real_machine_sets_nothing(log: Log) -> None:
    """A row that the simulated machine sets is judged where the machine is real."""
    real = copy.copy(log)
    assert real.plan is not None
    real.plan = msgspec.structs.replace(real.plan, simulated=False)
    cold = [msgspec.structs.replace(real.select("grid")[0], temperature_c=19.0)]
    rows = rows_of(changed(real, cold))
    assert rows["sec5.1.temperature.min"].set is False
    assert rows["sec5.1.temperature.min"].holds is False
    assert rows["fig12.before.mean"].holds is True
    assert rows["fig11.cells"].set is True


def test_a_figure_that_is_no_number_fails(paper: GoldenRun) -> None:
    nothing = Row("x", None, "", lambda run: np.nan, BY_NAME["fig1.backlash"].limits)
    assert nothing.judged(paper.log, typed(paper.result, Experiments)).holds is False


def test_a_way_back_in_the_order_of_the_way_there(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    def in_order(log: Log, way: str, name: str) -> Array:
        return path_mm(log, way, name)[:: -1 if way == rail.BACK else 1]

    path_mm = rail.path_mm
    monkeypatch.setattr(rail, "path_mm", in_order)
    assert fails("fig1.error.max", log)


def test_a_way_back_from_the_same_side_shows_no_backlash(log: Log) -> None:
    last = max(point.id.number or 0 for point in log.select("survey", direction="forth"))
    same = []
    for point in log.select("survey", direction="back"):
        assert point.id.number is not None
        forth = msgspec.structs.replace(point.id, direction="forth", number=last - point.id.number)
        same.append(msgspec.structs.replace(point, xyz_mm=log.point(forth).xyz_mm))
    assert fails("fig1.backlash", changed(log, same))


def test_the_closest_station_of_every_hole_is_more_than_the_fewest(
    paper: GoldenRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closest(cell: Cell, holes: Any) -> HolePlan:
        along_mm = (holes.points_mm - cell.layout.nominal_base(0.0)[:3, 3]) @ np.array(
            cell.layout.rail_direction
        )
        rails_mm = np.array([station.rail_mm for station in cell.station])
        taken = np.unique(np.abs(along_mm[:, None] - rails_mm).argmin(axis=1))
        return HolePlan([None] * len(taken))  # type: ignore[list-item]  # only counted

    assert judged("fig2.stations", paper).holds is True
    monkeypatch.setattr(planning, "plan", closest)
    assert judged("fig2.stations", paper).holds is False


def test_a_links_error_left_in_the_tools_frame(
    paper: GoldenRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    def in_tool(arm: Arm, joints_rad: Array) -> Array:
        """Return d^n in {T}: R_T is left out."""
        R = forward(arm, joints_rad)[:, :3, :3]
        J: Array = parameter_jacobian(arm, joints_rad).copy()
        J[:, :3] = np.einsum("nji,njk->nik", R, J[:, :3])
        return J

    monkeypatch.setattr("procedures.paper.parameter_jacobian", in_tool)
    assert judged("eq1-7.jacobian", paper).holds is False


def test_errors_of_other_vertices_are_not_similar(log: Log) -> None:
    vertices = log.select("grid")
    errors = position_errors(log, vertices).error_mm[
        np.random.default_rng(1).permutation(len(vertices))
    ]
    nominal_mm = np.array([point.nominal_mm for point in vertices])
    dealt_mm = apply(inverse(log.matrix("world")), nominal_mm + errors)
    points = [placed(point, at_mm) for point, at_mm in zip(vertices, dealt_mm, strict=True)]
    assert fails("eq8.similarity", changed(log, points))


def nearest_of_the_grid(log: Log, at_mm: Array) -> Array:
    return weighted(log, at_mm, power=1, among=lambda near, far: near <= np.sort(near)[7])


def squared_distances(log: Log, at_mm: Array) -> Array:
    pitch_mm = log.cell.grid.pitch_mm
    return weighted(log, at_mm, power=2, among=lambda near, far: far <= pitch_mm)


def weighted(
    log: Log, at_mm: Array, *, power: int, among: Callable[[Array, Array], NDArray[np.bool_]]
) -> Array:
    """Return errors (N, 3) from vertices chosen by their distance and their largest coordinate."""
    vertices_mm = grid_of(log.cell).vertices_mm().reshape(-1, 3)
    errors = grid_errors_mm(log).reshape(-1, 3)
    blended = []
    for at in at_mm:
        distance = np.linalg.norm(vertices_mm - at, axis=1)
        taken = among(distance, np.abs(vertices_mm - at).max(axis=1))
        weights = distance[taken] ** -power
        blended.append(weights / weights.sum() @ errors[taken])
    return np.array(blended)


@pytest.mark.parametrize(
    "wrong",
    [
        nearest_of_the_grid,
        squared_distances,
        lambda log, at_mm: -by_idw(log)(at_mm),
        lambda log, at_mm: predicted_mm(
            Idw, grid_of(log.cell), grid_errors_mm(log).transpose(2, 1, 0, 3), at_mm
        ),
    ],
    ids=["nearest of the grid", "squared distances", "sign", "axes of the grid exchanged"],
)
def test_commands_by_another_equation(
    paper: GoldenRun, wrong: Callable[[Log, Array], Array]
) -> None:
    log = paper.log
    points = log.select("validate", REFERENCE, how="idw")[::5]
    nominal_mm = np.array([point.nominal_mm for point in points])
    wanted_mm = apply(inverse(log.matrix("base")), nominal_mm)
    commands_deg = np.degrees(joints_for(log.cell, wanted_mm - wrong(log, wanted_mm)))
    sent = [
        msgspec.structs.replace(point, commanded_deg=tuple(joints.tolist()))
        for point, joints in zip(points, commands_deg, strict=True)
    ]
    row = BY_NAME["eq9.weights"].judged(changed(log, sent), typed(paper.result, Experiments))
    assert row.holds is False
    right_mm = corrected(
        grid_of(log.cell), poses_at(log.cell, wanted_mm), Idw.of_grid(measured_grid(log))
    )
    right_deg = np.degrees(joints_for(log.cell, right_mm))
    sent_deg = np.degrees(Compared.commanded_rad(points))
    np.testing.assert_allclose(right_deg, sent_deg, atol=1e-6)


@pytest.mark.parametrize("share", [2.0, 1.0, 0.5], ids=["added", "not applied", "half"])
def test_a_correction_that_is_not_taken_off(log: Log, share: float) -> None:
    before, corrected = log.points["sign/before"], log.points["sign/corrected"]
    (error_mm,) = position_errors(log, [before]).error_mm
    at_mm = apply(inverse(log.matrix("world")), [np.array(before.nominal_mm) + share * error_mm])
    assert fails("sec3.3.sign", changed(log, [placed(corrected, at_mm[0])]))


def strip_alone(log: Log, station: str) -> Array:
    """Return {S} (4, 4) at a station as the strip's travel alone says."""
    cell = log.cell
    travel_mm = cell.station_named(station).strip_mm - cell.station_named(REFERENCE).strip_mm
    T: Array = log.matrix(f"station.{REFERENCE}").copy()
    T[:3, 3] += travel_mm * np.array(cell.layout.rail_direction)
    return T


def test_a_slide_shifted_by_the_strip_alone(log: Log) -> None:
    frames = {f"station.{name}": {"matrix": strip_alone(log, name).tolist()} for name in OTHERS}
    assert fails("eq13-17.transfer", framed(log, frames))


def test_the_factors_of_eq_17_exchanged(paper: GoldenRun, monkeypatch: pytest.MonkeyPatch) -> None:
    def exchanged(T_W_S1: Array, T_W_Si: Array, T_W_B1: Array) -> Array:
        return inverse(T_W_S1) @ T_W_Si @ T_W_B1

    monkeypatch.setattr(calibration, "base_at", exchanged)
    assert judged("eq13-17.transfer", paper).holds is False


def test_a_point_of_a_sweep_measured_while_axis_2_moves(log: Log) -> None:
    """0.05 deg before its end; the swept axis itself would only shift the point on its circle."""
    early = log.points["base/axis1/000"]
    joints_rad = Compared.commanded_rad([early])
    arm, back = log.cell.robot.arm(), np.radians([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    step_mm = (forward(arm, joints_rad + back) - forward(arm, joints_rad))[:, :3, 3]
    turn = (inverse(log.matrix("world")) @ log.matrix("base"))[:3, :3]
    at_mm = positions_mm([early]) + step_mm @ turn.T
    other = changed(log, [placed(early, at_mm[0])])
    rms_mm = axis_circle(log.cell, other, 1, other.select("base", axis=1)).rms_mm
    frames = {"base": {"circle_rms_mm": [rms_mm, log.frame(MeasuredBase, "base").circle_rms_mm[1]]}}
    assert fails("fig6.circle.rms", framed(other, frames))


def test_a_nest_that_was_moved_between_stations_stays_in_the_fit(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = log.cell
    all_kept = Moved((), tuple(range(len(cell.layout.slide))), 0.0, 0.0)
    monkeypatch.setattr(station_frames, "moved_nests", lambda *_: all_kept)
    nest = log.points["slide/S300/P4"]
    other = changed(log, [placed(nest, np.array(nest.xyz_mm) + [0.0, 0.0, 0.1])])
    fit = station_fit(other, cell.station_named("S300"))
    frames = {"station.S300": {"tool_uncertainty_mm": tool_uncertainty_mm(cell, fit)}}
    assert fails("fig7.tool.u", framed(other, frames))


def test_a_station_frame_that_is_built_from_circles(log: Log) -> None:
    T_B_S = inverse(log.matrix(f"base.{REFERENCE}")) @ log.matrix(f"station.{REFERENCE}")
    frames = {
        f"station.{name}": {"matrix": (log.matrix(f"base.{name}") @ T_B_S).tolist()}
        for name in (REFERENCE, *OTHERS)
    }
    assert fails("fig8.ratio", framed(log, frames))


def approaches_as(log: Log, one: tuple[str, str], other: tuple[str, str]) -> Log:
    """Return the log with approaches (how, way) measured as others."""
    first, second = (log.select("repeat", how=how, direction=way) for how, way in (one, other))
    pairs = zip(first, second, strict=True)
    return changed(log, [placed(one, np.array(two.xyz_mm)) for one, two in pairs])


def test_without_the_loop_of_the_strip(log: Log) -> None:
    other = approaches_as(log, ("strip", "random"), ("plain", "random"))
    assert fails("fig10.strip.range", other)


@pytest.mark.parametrize("other", [("plain", "one_side"), ("strip", "random")])
def test_approaches_that_do_not_see_the_backlash(log: Log, other: tuple[str, str]) -> None:
    found = approaches_as(log, ("plain", "random"), other)
    assert fails("fig10.plain.range", found)


def test_single_readings_of_the_tracker(log: Log) -> None:
    rng = np.random.default_rng(3)
    nests = [*log.select("control"), *log.select("world")]
    single = [
        placed(p, positions_mm([p])[0] + np.sqrt(1 - 1 / p.samples) * rng.normal(0.0, p.std_mm))
        for p in nests
    ]
    assert fails("sec5.1.tracker", changed(log, single))


def test_a_tracker_that_is_moved_by_20_um_once_the_world_is_framed(log: Log) -> None:
    late = [placed(p, positions_mm([p])[0] + [0.02, 0.0, 0.0]) for p in log.select("control")]
    assert fails("sec5.1.tracker", changed(log, late))


def test_a_correction_is_modelled_as_it_acts(log: Log) -> None:
    """The model of the tests below: the right correction leaves what was found."""
    modelled = rows_of(as_if_sent(log, by_idw(log), (REFERENCE, *OTHERS)))
    found = rows_of(log)
    for name in ("fig12.after.mean", "fig13.after.mean"):
        assert modelled[name].here == pytest.approx(found[name].here, rel=0.15)
        assert modelled[name].holds is True


@pytest.mark.parametrize(
    "wrong",
    [
        lambda error_mm: -error_mm,
        lambda error_mm: 0 * error_mm,
        lambda error_mm: 0.5 * error_mm,
        lambda error_mm: error_mm[:, [1, 0, 2]],
        lambda error_mm: error_mm[:, [2, 1, 0]],
    ],
    ids=["added", "not sent", "half", "x and y exchanged", "x and z exchanged"],
)
def test_a_correction_that_is_sent_wrongly(log: Log, wrong: Callable[[Array], Array]) -> None:
    correct = by_idw(log)
    other = as_if_sent(log, lambda at_mm: wrong(correct(at_mm)), (REFERENCE, *OTHERS))
    assert failing(other) >= {
        "fig12.after.mean", "abstract.reduction.reference", "abstract.reduction.others",
    }  # fmt: skip


def by_cell_file(log: Log, station: str) -> Array:
    """Return {B} (4, 4) in {W} at a station as the cell file has it."""
    return log.cell.layout.nominal_base(log.cell.station_named(station).rail_mm)


def by_strip_alone(log: Log, station: str) -> Array:
    """Return {B} (4, 4) in {W} at a station as the strip's travel takes it (slip 13)."""
    T_S_B = inverse(log.matrix(f"station.{REFERENCE}")) @ log.matrix("base")
    return strip_alone(log, station) @ T_S_B


@pytest.mark.parametrize(
    ("wrong", "failed"),
    [
        (by_cell_file, {"fig13.before.mean", "fig13.after.mean"}),
        (by_strip_alone, {"fig13.after.mean"}),
    ],
)
def test_targets_placed_by_another_base(
    log: Log, wrong: Callable[[Log, str], Array], failed: set[str]
) -> None:
    points = []
    frames = Frames(log.cell, log)
    for name in OTHERS:
        T = wrong(log, name) @ inverse(frames.base_in_world(log.cell.station_named(name)))
        for how in ("before", "idw", "chosen"):
            for point in log.select("validate", name, how=how):
                (wrong_mm,) = apply(T, np.array([point.nominal_mm]))
                points.append(msgspec.structs.replace(point, nominal_mm=tuple(wrong_mm.tolist())))
    assert failing(changed(log, points)) >= failed


def test_measured_data_that_are_not_turned_with_the_slide(log: Log) -> None:
    """The robot is sent where the strip alone takes the base to be."""
    correct = by_idw(log)
    frames = Frames(log.cell, log)

    def shifted(at_mm: Array, name: str) -> Array:
        T_B_B = inverse(by_strip_alone(log, name)) @ frames.base_in_world(
            log.cell.station_named(name)
        )
        return correct(at_mm) + at_mm - apply(T_B_B, at_mm)

    other = log
    for name in OTHERS:
        other = as_if_sent(other, partial(shifted, name=name), [name])
    assert fails("fig13.after.mean", other)


def test_one_wrong_vertex(log: Log) -> None:
    errors = grid_errors_mm(log).copy()
    errors[1, 2, 1] += [0.0, 0.0, 2.0]
    grid = grid_of(log.cell)
    other = as_if_sent(log, lambda at_mm: predicted_mm(Idw, grid, errors, at_mm), [REFERENCE])
    assert fails("abstract.after.max", other)


def test_one_target_that_is_sent_as_it_is(log: Log) -> None:
    sent, asis = (log.points[f"validate/{REFERENCE}/{how}/020"] for how in ("idw", "before"))
    other = changed(log, [placed(sent, np.array(asis.xyz_mm))])
    assert failing(other) == {"abstract.after.max"}


def test_averaged_squares(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "hilcell.calibration.position_errors.figures_of",
        lambda lengths_mm: figures_of(lengths_mm**2),
    )
    assert fails("abstract.reduction.reference", log)
