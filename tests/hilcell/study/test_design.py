"""The cases of a study are a pure function of its file; what a Sobol design draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from hilcell.study.design import cases, points
from tests.hilcell.study.studies import study
from tests.hilcell.study.test_study_file import factor, refused

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
OPTIMISE = 'design = "optimise"\noptimise = { trials = 8, most_minutes = 90.0 }\n'
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


@pytest.mark.parametrize("design", ["", OPTIMISE])
def test_a_second_study_has_new_machines(tmp_path: Path, design: str) -> None:
    """Its machines are numbered on; its cases are numbered from 1, and at the same points."""
    old = [*cases(study(tmp_path, head=f"{design}machines = 3"))]
    new = [*cases(study(tmp_path, head=f"{design}machines = 3\nfirst_machine = 4"))]
    assert {each.machine for each in old} == {1, 2, 3}
    assert [(each.number, each.machine, each.point, each.seed) for each in new] == [
        (each.number, each.machine + 3, each.point, each.seed) for each in old
    ]


@pytest.mark.parametrize("number", [0, -1])
def test_machines_are_numbered_from_1(tmp_path: Path, number: int) -> None:
    head = f"first_machine = {number}"
    assert refused(tmp_path, RANGES.partition('[[factor]]\nname = "x"')[0], head) == [
        "first_machine"
    ]


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


MANY = 'design = "sobol"\nsamples = 512\nmachines = 1'


def drawn(folder: Path, table: str, low: float = 1.0, high: float = 9.0) -> list[float]:
    """Return the sorted values of a factor with such a distribution."""
    text = (
        '\n[[factor]]\nname = "f"\nsetting = "layout.base.x_mm"\n'
        f"low = {low}\nhigh = {high}\ndistribution = {{ {table} }}\n"
    )
    found = [each.choices[0].value for each in points(study(folder, text, MANY))]
    assert all(isinstance(each, float) and low <= each <= high for each in found)
    return sorted(float(str(each)) for each in found)


@pytest.mark.parametrize(
    ("table", "wanted"),
    [
        ('kind = "normal", mean = 4.0, sd = 1.5', stats.truncnorm(-2.0, 5 / 1.5, 4.0, 1.5)),
        (
            'kind = "lognormal", median = 3.0, ratio = 1.5',
            stats.lognorm(np.log(1.5), scale=3.0),
        ),
        ('kind = "loguniform"', stats.loguniform(1.0, 9.0)),
        ('kind = "triangular", mode = 2.0', stats.triang(0.125, 1.0, 8.0)),
    ],
    ids=["normal", "lognormal", "loguniform", "triangular"],
)
def test_a_sobol_design_follows_it(tmp_path: Path, table: str, wanted: stats.rv_continuous) -> None:
    """Within 0.5 % everywhere, which 512 random draws would miss by far."""
    found = np.array(drawn(tmp_path, table))
    low, high = wanted.cdf(1.0), wanted.cdf(9.0)
    shares = (wanted.cdf(found) - low) / (high - low)
    assert np.abs(shares - (np.arange(512) + 0.5) / 512).max() < 0.005
    assert found[0] == pytest.approx(1.0)


BESIDE = factor(name="beside", setting="layout.base.x_mm", low=1.0, high=9.0)  # no point repeated


def test_whole_numbers_stay_whole(tmp_path: Path) -> None:
    text = factor(low=2, high=9, distribution={}).replace(
        "{}", '{ kind = "normal", mean = 5, sd = 2.0 }'
    )
    values = [each.choices[0].value for each in points(study(tmp_path, text + BESIDE, MANY))]
    assert set(values) == set(range(2, 10))
    assert values.count(5) == pytest.approx(512 * 0.1974 / 0.9105, abs=3)  # within 0.25 sd


def test_levels_have_weights(tmp_path: Path) -> None:
    text = factor(levels=[2, 3, 5], weights=[1, 5, 2]) + BESIDE
    values = [each.choices[0].value for each in points(study(tmp_path, text, MANY))]
    assert [values.count(level) for level in (2, 3, 5)] == [64, 320, 128]


THREE = factor(levels=[2, 3, 5])
PLACES = factor(name="p", setting="grid.centre.x_mm", levels=[1850.0, 3850.0, 5850.0])


@pytest.mark.parametrize(
    ("factors", "samples", "count"),
    [
        (THREE + PLACES, 8, 8),
        (THREE + PLACES, 64, 9),  # all that there are
        (factor(levels=[2, 3, 5], weights=[1, 1e12, 1]) + PLACES, 8, 8),
        (factor(low=2, high=6) + PLACES, 16, 15),
        (BESIDE, 64, 64),
    ],
)
def test_no_point_of_a_sobol_design_is_drawn_twice(
    tmp_path: Path, factors: str, samples: int, count: int
) -> None:
    asked = study(tmp_path, factors, f'design = "sobol"\nsamples = {samples}\nmachines = 2')
    found = points(asked)
    assert len({each.words for each in found}) == len(found) == count
    assert [each.number for each in found] == list(range(1, count + 1))
    assert len(list(cases(asked))) == asked.most_cases == 2 * count


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ('kind = "norml", mean = 2, sd = 1', ".kind"),
        ('kind = "normal", mean = 2', ".sd"),
        ('kind = "normal", mean = 2, sd = 0.0', ".sd"),
        ('kind = "normal", mean = 2, sd = 1, mode = 2', ".mode"),
        ('kind = "normal", mean = 2, meddian = 1', ".meddian"),
        ('kind = "normal", mean = 90, sd = 1.0', ""),
        ('kind = "lognormal", median = 3, ratio = 1.0', ".ratio"),
        ('kind = "triangular", mode = 12', ".mode"),
        ('kind = "normal", mean = nan, sd = 1.0', ".mean"),
    ],
)
def test_a_distribution_that_says_none(tmp_path: Path, table: str, key: str) -> None:
    text = factor(low=2, high=9, distribution={}).replace("{}", f"{{ {table} }}")
    assert f"factor[0].distribution{key}" in refused(tmp_path, text, MANY)


@pytest.mark.parametrize(
    ("given", "head", "key"),
    [
        ({"levels": [2, 5], "weights": [1]}, MANY, "weights"),
        ({"levels": [2, 5], "weights": [1, -1]}, MANY, "weights[1]"),
        ({"low": 2, "high": 5, "weights": [1, 2]}, MANY, "weights"),
        ({"levels": [2, 5], "weights": [1, 2]}, "machines = 1", "weights"),
    ],
)
def test_weights_that_say_nothing(
    tmp_path: Path, given: dict[str, object], head: str, key: str
) -> None:
    assert refused(tmp_path, factor(**given), head) == [f"factor[0].{key}"]
