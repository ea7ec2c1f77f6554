"""Points and deviations: the same figures as the report's, the worst first."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.decision_rule import guard_band
from hilcell.calibration.position_errors import position_errors
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log, positions_mm
from hilcell.journal.runs import read_log
from hilcell.model.point import Point, PointId
from hilcell.tui.run_view import RunView
from hilcell.tui.text.points import (
    PointRows,
    deviation_of,
    filtered,
    point_columns,
    point_page,
    row_of,
    state_of,
)
from hilcell.tui.text.run import Shown
from tests.hilcell.report.journals import Writer
from tests.hilcell.tui.sample_runs import SampleRun, measuring, validated
from tests.hilcell.tui.views import cells, drawn

ROTATION_DEG = 37.0

ONE_MM = np.ones((1, 3))  # an error


def log_of(story: SampleRun) -> Log:
    return Log(story.records)


def tilted() -> list[list[float]]:
    """Return a frame that is no identity: turned about z and moved."""
    c, s = math.cos(math.radians(ROTATION_DEG)), math.sin(math.radians(ROTATION_DEG))
    return [[c, -s, 0.0, 120.0], [s, c, 0.0, -45.0], [0.0, 0.0, 1.0, 7.5], [0.0, 0.0, 0.0, 1.0]]


@pytest.fixture
def journal(tmp_path: Path) -> Log:
    """Return a run on disk, {W} turned against the tracker, with odd errors."""
    writer = Writer(tmp_path / "run").began()
    writer.journal.append("frame", "world", {"matrix": tilted()})
    chance = np.random.default_rng(3)
    to_tracker = np.linalg.inv(np.array(tilted()))
    for number in range(25):
        nominal_mm = chance.uniform(-2000.0, 2000.0, 3)
        actual_mm = nominal_mm + chance.normal(0.0, 0.8, 3)
        xyz_mm = apply(to_tracker, actual_mm.reshape(1, 3))[0]
        for id in (
            PointId("grid", number=number),
            PointId("validate", how="chosen", number=number),
        ):
            writer.point(id, xyz_mm, "S1100", nominal_mm=tuple(nominal_mm))
    writer.point(PointId("world", nest="F1"), (1.0, 2.0, 3.0))
    return read_log(writer.ended())


# -- deviations ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["grid", "validate"])
def test_deviations_are_the_reports(journal: Log, kind: str) -> None:
    points = journal.select(kind)
    wanted = position_errors(journal, points)
    assert len(wanted) == 25
    for point, error_mm, norm_mm in zip(points, wanted.error_mm, wanted.norms_mm, strict=True):
        found = deviation_of(journal, point)
        assert found is not None
        np.testing.assert_allclose(found.error_mm, error_mm, atol=1e-9)
        assert found.norm_mm == pytest.approx(norm_mm, abs=1e-9)
        actual_mm = apply(journal.matrix("world"), positions_mm([point]))[0]
        np.testing.assert_allclose(found.actual_mm, actual_mm, atol=1e-9)


def test_only_corrected_points_have_a_limit(journal: Log) -> None:
    limits = {
        row.point.group: row.deviation and row.deviation.limit_mm
        for row in PointRows().rows(journal)
    }
    limit_mm = journal.cell.validation.max_tolerance_mm
    assert limits == {"grid": None, "validate_chosen": limit_mm, "world": None}


def test_without_a_world_frame_there_is_no_deviation() -> None:
    log = log_of(measuring())
    point = log.points["grid/0-0-0"]
    assert deviation_of(log, point) is not None
    del log.frames["world"]
    assert deviation_of(log, point) is None


def changed(log: Log, key: str, **more: Any) -> Point:
    log.points[key] = msgspec.structs.replace(log.points[key], **more)
    return log.points[key]


@pytest.mark.parametrize(
    ("more", "wanted"),
    [
        ({}, "ok"),
        ({"std_mm": (9.0, 9.0, 9.0)}, "noisy"),
        ({"std_mm": (math.nan, 0.0, 0.0)}, "noisy"),
        ({"retaken": True}, "again"),
        ({"xyz_mm": (0.0, 0.0, 0.0)}, "out"),
        ({"xyz_mm": (math.nan, 0.0, 0.0)}, "out"),
        ({"xyz_mm": (0.0, 0.0, 0.0), "retaken": True}, "out"),
    ],
)
def test_states_of_points(more: dict[str, Any], wanted: str) -> None:
    log = log_of(validated())
    point = changed(log, "validate/S1100/chosen/000", **more)
    assert state_of(log, point, deviation_of(log, point)) == wanted


# -- the table -------------------------------------------------------------------------------------


def keys_of(log: Log, wanted: str = "", *, bad: bool = False, worst: bool = False) -> list[str]:
    found = filtered(PointRows().rows(log), wanted, bad_only=bad, worst=worst)
    return [row.point.key for row in found]


def test_points_stand_in_the_order_in_which_they_were_measured() -> None:
    assert keys_of(log_of(measuring())) == [
        "world/F1",
        "world/F2",
        "world/F3",
        *[f"grid/0-0-{n}" for n in range(5)],
    ]


def test_a_filter_matches_the_words_shown() -> None:
    story = measuring()
    for number in (4, 5, 14, 15):
        story.point(
            PointId("validate", station="S1100", how="chosen", number=number), (1.0, 2.0, 3.0)
        )
    log = log_of(story)
    assert keys_of(log, "corrected 5") == ["validate/S1100/chosen/004"]
    assert keys_of(log, "corrected 15 s11") == ["validate/S1100/chosen/014"]
    assert keys_of(log, "chosen") == []
    assert keys_of(log, "grid 0-0-3") == ["grid/0-0-3"]
    assert keys_of(log, "nest f1") == ["world/F1"]


def test_worst_first_puts_points_with_a_tolerance_before_raw_ones() -> None:
    log = log_of(validated(worst_mm=1.2))
    rows = filtered(PointRows().rows(log), "", bad_only=False, worst=True)
    toleranced = [row.deviation is not None and row.deviation.limit_mm is not None for row in rows]
    assert toleranced == sorted(toleranced, reverse=True)
    for group in (True, False):
        norms = [row.norm_mm for row, has in zip(rows, toleranced, strict=True) if has == group]
        assert norms == sorted(norms, reverse=True)
    assert rows[0].point.key == "validate/S1100/chosen/001"
    assert {row.point.group for row in rows[-3:]} == {"world"}


def test_a_point_that_is_no_number_is_the_worst_of_all() -> None:
    log = log_of(validated())
    changed(log, "validate/S1100/chosen/001", xyz_mm=(math.nan, 0.0, 0.0))
    assert keys_of(log, worst=True)[0] == "validate/S1100/chosen/001"


@pytest.mark.parametrize(
    ("wanted", "found"),
    [("grid", 5), ("GRID", 5), ("0-0-3", 1), ("s1100 grid", 5), ("grid s300", 0), ("ok", 8),
     ("floor f2", 1), ("", 8), ("   ", 8), ("[/nope]", 0), ("\x1b[31m", 0)],
)  # fmt: skip
def test_filters(wanted: str, found: int) -> None:
    assert len(keys_of(log_of(measuring()), wanted)) == found


def test_only_bad_ones() -> None:
    log = log_of(validated(worst_mm=1.2))
    assert keys_of(log, bad=True) == ["validate/S1100/chosen/001"]
    changed(log, "grid/0-0-0", retaken=True)
    changed(log, "grid/0-0-1", std_mm=(0.1, 0.0, 0.0))
    assert keys_of(log, bad=True) == ["grid/0-0-0", "grid/0-0-1", "validate/S1100/chosen/001"]


def test_a_point_within_its_uncertainty_of_the_limit_is_neither_in_nor_out() -> None:
    """The screen said of it that it is in tolerance, the verdict that it is undecided."""
    log = log_of(validated())
    U_mm, limit_mm = guard_band(log, ONE_MM).max_mm, log.cell.validation.max_tolerance_mm
    point = log.points["validate/S1100/chosen/000"]
    places = {"ok": limit_mm - 1.1 * U_mm, "out": limit_mm + U_mm}
    places["undecided"] = limit_mm - 0.9 * U_mm
    x, y, z = point.nominal_mm or (0.0, 0.0, 0.0)
    for state, off_mm in places.items():
        moved = changed(log, point.key, xyz_mm=(x + off_mm + 1e-6, y, z))
        assert state_of(log, moved, deviation_of(log, moved)) == state


def test_a_row_tells_the_deviation_and_its_state() -> None:
    log = log_of(validated(worst_mm=1.2))
    row = row_of(log, log.points["validate/S1100/chosen/001"])
    bar = "▄" * 8  # the limit and all beyond it
    figures = ["+0.000", "+1.200", "+0.010", "1.200", bar, "0.010"]
    texts = [*cells(point_columns(), row).values()]
    assert texts == ["corrected 2", "S1100", *figures, "", "▲ OUT"]
    assert row.said()[1] == "*fault"
    bare = row_of(log, log.points["world/F1"])  # without a nominal place
    assert [*cells(point_columns(), bare).values()] == [
        "nest F1", "", "", "", "", "", "", "0.010", "", "· ok",
    ]  # fmt: skip


@pytest.mark.parametrize("width", [40, 59, 79, 119, 200])
def test_columns_go_where_there_is_no_room_but_never_the_error_or_the_state(width: int) -> None:
    for row in PointRows().rows(log_of(validated(worst_mm=1.2))):
        found = cells(point_columns(), row, width)
        assert {"point", "|e| mm", "state"} <= {column.title for column in found}
        assert sum(column.width + 1 for column in found) <= width
        name, *others = found.values()
        assert row.point.station in others or name.endswith(row.point.station)


# -- one point -------------------------------------------------------------------------------------


def test_the_page_of_a_point_tells_everything() -> None:
    view = RunView("r", log_of(validated()))
    text = drawn(point_page(view, "validate/S1100/chosen/001"))
    for part in ("validate/S1100/chosen/001", "validate_chosen", "S1100", "+0.0000  +0.1000",
                 "0.1005", "1.000", "SMR 1.5in", "22.50 C", "1010.0 mbar", "45 %",
                 "1100.200 / 1100.00"):  # fmt: skip
        assert part in text
    assert "nominal" not in drawn(point_page(view, "world/F1"))
    assert "no such point" in drawn(point_page(view, "grid/9-9-9"))


def measured_again(off_mm: float) -> Log:
    """Return a run whose last target, 0.4 mm off, was measured again."""
    id = PointId("validate", station="S1100", how="chosen", number=1)
    story = validated(worst_mm=0.4)
    return log_of(story.point(id, (1100.0, 301.0, 400.0), (0.0, off_mm, 0.0), retaken=True))


@pytest.mark.parametrize(("again_mm", "wanted_mm"), [(0.3, 0.4001), (0.5, 0.5)])
def test_of_a_target_measured_again_the_larger_error_counts(
    again_mm: float, wanted_mm: float
) -> None:
    log = measured_again(again_mm)
    key = "validate/S1100/chosen/001"
    row = row_of(log, log.points[key])
    assert row.norm_mm == pytest.approx(wanted_mm, abs=1e-4)
    assert row.deviation is not None
    assert row.deviation.actual_mm[1] == pytest.approx(301.0 + max(0.4, again_mm))
    assert f"{wanted_mm:.3f}" in cells(point_columns(), row).values()
    assert Shown.chosen(RunView("r", log), key).deviation == row.deviation


def test_the_page_of_a_point_names_both_readings_and_which_counts() -> None:
    key = "validate/S1100/chosen/001"
    text = drawn(point_page(RunView("r", measured_again(0.3)), key))
    assert "0.4001 (the larger: counts), 0.3000" in text
    assert "1100.0000  301.4000  400.0100" in text  # the reading that counts
    text = drawn(point_page(RunView("r", measured_again(0.5)), key))
    assert "0.4001, 0.5000 (the larger: counts)" in text
    assert "counts" not in drawn(point_page(RunView("r", log_of(validated())), key))


# -- rows are made once ----------------------------------------------------------------------------


def test_a_row_is_made_once_though_the_log_gives_a_new_point_at_each_access() -> None:
    story = validated()
    log, rows = log_of(story), PointRows()
    assert log.points["grid/0-0-0"] is not log.points["grid/0-0-0"]
    before = rows.rows(log)
    target = PointId("validate", station="S1100", how="chosen", number=2)
    log.take(story.point(target, (1100.0, 302.0, 400.0), (0.1, 0.0, 0.0)).records[-1])
    *known, new = rows.rows(log)
    assert new.point.key == target.key
    assert all(one is other for one, other in zip(before, known, strict=True))


def test_a_point_that_is_measured_again_has_a_new_row_in_its_old_place() -> None:
    story = validated()
    log, rows = log_of(story), PointRows()
    keys = [row.point.key for row in rows.rows(log)]
    id = PointId("validate", station="S1100", how="chosen", number=0)
    log.take(story.point(id, (1100.0, 300.0, 400.0), (0.9, 0.0, 0.0), retaken=True).records[-1])
    found = rows.rows(log)
    assert [row.point.key for row in found] == keys
    assert found[keys.index(id.key)].norm_mm == pytest.approx(0.9)
    assert rows.deviation(log, log.points[id.key]) == found[keys.index(id.key)].deviation


def test_another_world_frame_moves_every_row() -> None:
    story = validated()
    log, rows = log_of(story), PointRows()
    before = {row.point.key: row.norm_mm for row in rows.rows(log) if row.deviation is not None}
    log.take(story.add("frame", "world", matrix=tilted()).records[-1])
    after = {row.point.key: row.norm_mm for row in rows.rows(log) if row.deviation is not None}
    assert after.keys() == before.keys()
    assert all(abs(after[key] - before[key]) > 1.0 for key in before)


def test_at_the_end_all_rows_are_judged_by_the_u_of_the_verdict() -> None:
    """Each row kept U of the moment in which it came; the report has that of the end."""
    story = validated()
    log, rows = log_of(story), PointRows()
    early = {row.deviation.U_mm for row in rows.rows(log) if row.deviation and row.deviation.U_mm}
    for number in range(2, 6):  # noisier readings: U grows
        id = PointId("validate", station="S1100", how="chosen", number=number)
        place = (1100.0, 300.0 + number, 400.0)
        log.take(story.point(id, place, std_mm=[0.05, 0.05, 0.05]).records[-1])
    log.take(story.state("finished").add("end", state="finished", exit=0, result={}).records[-1])
    judged = [row.deviation for row in rows.rows(log) if row.deviation and row.deviation.limit_mm]
    assert len(judged) == 6
    assert {each.U_mm for each in judged} == {guard_band(log, ONE_MM).max_mm}
    assert early != {guard_band(log, ONE_MM).max_mm}
