"""A cell lists the errors that its runs cannot detect, each with its effect."""

from __future__ import annotations

import msgspec
import pytest

from hilcell.cell.file import load_cell
from hilcell.cell.undetectable_errors import undetectable_errors

WITHOUT = {"layout.length": "[]", "layout.bar": "[]"}
ACROSS = {
    "layout.length": '[{nests = ["B1", "B2"], length_mm = 2000.0, u_mm = 0.004}, '
    '{nests = ["F1", "F2"], length_mm = 1500.0, u_mm = 0.01}]'
}


@pytest.mark.parametrize(
    ("values", "two_faces", "more"),
    [
        ({}, True, ["one direction"]),
        (ACROSS, True, []),
        (ACROSS, False, ["turned over"]),
        (WITHOUT, True, ["100 ppm move targets by 0.12 mm"]),
        (ACROSS | {"plan.quick": "true"}, True, ["in 10% of the volume at that station"]),
    ],
)
def test_each_is_listed_with_its_effect(
    values: dict[str, str], two_faces: bool, more: list[str]
) -> None:
    errors = undetectable_errors(load_cell("paper", values), two_faces=two_faces)
    always = ["a prism", "robot.smr_mm", "0.03 mm in each floor nest"]
    assert len(errors) == len([*more, *always])
    assert all(part in text for part, text in zip([*more, *always], errors, strict=True))


@pytest.mark.parametrize(("share", "missed"), [("0.1", "0.43"), ("0.3", "0.06")])
def test_a_quick_plan_misses_a_small_part_of_one_station(share: str, missed: str) -> None:
    cell = load_cell("paper", {"plan.quick": "true", "plan.share_above_max": share})
    (text,) = [each for each in undetectable_errors(cell, two_faces=True) if "quick plan" in each]
    assert f"up to {missed}" in text


def test_worse_repeatability_is_not_detected_without_a_data_sheet() -> None:
    cell = load_cell("paper")
    without = msgspec.structs.replace(cell, robot=msgspec.structs.replace(cell.robot, rp_mm=None))
    (text,) = [
        each for each in undetectable_errors(without, two_faces=True) if "robot.rp_mm" in each
    ]
    assert "0.11 mm" in text


def test_a_length_whose_u_is_in_another_unit_detects_no_scale() -> None:
    """4 um typed as 4 mm: a scale of 100 ppm passed, and nothing named it."""
    for u_mm, listed in ((0.004, False), (0.02, False), (0.04, True), (4.0, True)):
        length = f'[{{nests = ["B1", "B2"], length_mm = 2000.0, u_mm = {u_mm}}}]'
        errors = undetectable_errors(load_cell("paper", {"layout.length": length}), two_faces=True)
        assert any("is u_mm in mm?" in each for each in errors) == listed
    assert "above 4000 ppm" in errors[0]
