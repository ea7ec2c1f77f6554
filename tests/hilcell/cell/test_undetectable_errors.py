"""A cell says which errors its runs cannot see, each with its size."""

from __future__ import annotations

import msgspec
import pytest

from hilcell.cell.file import load_cell
from hilcell.cell.undetectable_errors import unseen

WITHOUT = {"layout.length": "[]", "layout.bar": "[]"}
ACROSS = {
    "layout.length": '[{nests = ["B1", "B2"], length_mm = 2000.0, u_mm = 0.004}, '
    '{nests = ["F1", "F2"], length_mm = 1500.0, u_mm = 0.01}]'
}


@pytest.mark.parametrize(
    ("values", "turns_over", "words"),
    [
        (
            {},
            True,
            [
                "along one direction",
                "a prism",
                "than robot.smr_mm says",
                "0.03 mm in each floor nest",
            ],
        ),
        (ACROSS, True, ["a prism", "than robot.smr_mm says", "0.03 mm in each floor nest"]),
        (
            ACROSS,
            False,
            ["turned over", "a prism", "than robot.smr_mm says", "0.03 mm in each floor nest"],
        ),
        (
            WITHOUT,
            True,
            [
                "100 ppm move targets by 0.12 mm",
                "a prism",
                "than robot.smr_mm says",
                "0.03 mm in each floor nest",
            ],
        ),
    ],
)
def test_each_is_stated_with_its_size(
    values: dict[str, str], turns_over: bool, words: list[str]
) -> None:
    found = unseen(load_cell("paper", values), turns_over=turns_over)
    assert len(found) == len(words)
    for part, text in zip(words, found, strict=True):
        assert part in text


def test_a_robot_without_a_stated_repeatability_may_repeat_worse() -> None:
    cell = load_cell("paper")
    unstated = msgspec.structs.replace(cell.robot, rp_mm=None)
    found = unseen(msgspec.structs.replace(cell, robot=unstated), turns_over=True)
    (text,) = [each for each in found if "robot.rp_mm" in each]
    assert "0.003 deg, is not seen; it moves targets by 0.11 mm" in text


def test_a_length_whose_u_is_in_another_unit_tells_no_scale() -> None:
    """4 um typed as 4 mm: a scale of 100 ppm passed, and nothing named it."""
    for u_mm, told in ((0.004, False), (0.02, False), (0.04, True), (4.0, True)):
        length = f'[{{nests = ["B1", "B2"], length_mm = 2000.0, u_mm = {u_mm}}}]'
        found = unseen(load_cell("paper", {"layout.length": length}), turns_over=True)
        assert any("is u_mm in mm?" in each for each in found) == told
    assert "beyond 4000 ppm alone" in found[0]
