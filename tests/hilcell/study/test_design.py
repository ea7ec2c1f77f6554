"""The cases of a study are a pure function of its file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.study.design import cases, points
from tests.hilcell.study.studies import study

RANGES = """
[[factor]]
name = "readings"
setting = "layout.nest_samples"
low = 2
high = 9
costs = [0, 700]

[[factor]]
name = "x"
setting = "grid.centre.x_mm"
low = 1800.0
high = 1900.0

[[factor]]
name = "sweeps"
setting = "sweeps.enabled"
levels = [false, true]
minutes = [0, 30]
"""
SOBOL = 'design = "sobol"\nsamples = 16\nmachines = 3\nseeds = 2'


def test_a_factorial_has_every_combination(tmp_path: Path) -> None:
    found = points(study(tmp_path))
    assert [each.number for each in found] == [1, 2, 3, 4]
    assert found[3].values == {"layout.nest_samples": 5, "grid.centre.x_mm": 3850.0}
    assert [each.cost for each in found] == [0, 0, 100, 100]


def test_all_points_come_on_the_first_machine_first(tmp_path: Path) -> None:
    found = list(cases(study(tmp_path, head="machines = 2\nseeds = 2")))
    assert [each.number for each in found] == list(range(1, 17))
    assert [each.machine for each in found] == [1] * 8 + [2] * 8
    assert [each.seed for each in found[:8]] == [1] * 4 + [2] * 4
    assert [each.point.number for each in found[:4]] == [1, 2, 3, 4]


def test_a_sobol_design_fills_its_ranges(tmp_path: Path) -> None:
    asked = study(tmp_path, RANGES, SOBOL)
    found = points(asked)
    assert len(list(cases(asked))) == 16 * 3 * 2
    readings, x, sweeps = zip(*([c.value for c in each.choices] for each in found), strict=True)
    assert all(isinstance(each, int) and 2 <= each <= 9 for each in readings)
    assert all(1800.0 <= each <= 1900.0 for each in x)
    assert sum(each < 1850.0 for each in x) == 8  # what Sobol promises
    assert sweeps.count(True) == sweeps.count(False) == 8
    assert found[0].values == {
        "layout.nest_samples": 2, "grid.centre.x_mm": 1800.0, "sweeps.enabled": False,
    }  # fmt: skip
    for each in found:
        reading, _, sweep = each.choices
        assert isinstance(reading.value, int)
        assert each.cost == pytest.approx(100.0 * (reading.value - 2))
        assert each.minutes == (30.0 if sweep.value else 0.0)


def test_the_same_file_gives_the_same_list(tmp_path: Path) -> None:
    one, other = (list(cases(study(tmp_path, RANGES, SOBOL))) for _ in range(2))
    assert one == other
