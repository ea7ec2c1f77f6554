"""A study file is read strictly: every mistake at once, and values that a setting can take."""

from __future__ import annotations

import json
import re
import tomllib
from datetime import date
from operator import attrgetter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.settings import SettingsError, convert
from hilcell.study.design import points
from hilcell.study.factor import Factor, is_stated
from hilcell.study.study_file import read_study, study_cell, toml_text
from tests.hilcell.study.studies import study, written

EXAMPLES = sorted(Path("docs/examples").glob("study-*.toml"))


def factor(**keys: object) -> str:
    given = {"name": "f", "setting": "layout.nest_samples"} | keys
    return "\n[[factor]]\n" + "\n".join(
        f"{key} = {toml_text(each) if isinstance(each, list) else json.dumps(each)}"
        for key, each in given.items()
    )


def refused(folder: Path, factors: str, head: str = "machines = 2") -> list[str]:
    """Return the keys of a study file that are refused."""
    with pytest.raises(SettingsError) as found:
        study(folder, factors, head)
    assert found.value.source == str(folder / "study.toml")
    return keys(found.value.problems)


def keys(problems: list[str]) -> list[str]:
    """Return what each problem names first; of a setting or a base cell, its key as well."""
    found = []
    for each in problems:
        key, _, rest = each.partition(": ")
        outer = key.endswith((".setting", ".levels")) or key.startswith("cell ")
        inner = rest.partition(": ")[0]
        found.append(f"{key} {inner}" if outer and re.fullmatch(r"[\w.]+", inner) else key)
    return found


def test_a_study_is_read(tmp_path: Path) -> None:
    found = study(tmp_path)
    assert [each.name for each in found.factor] == ["readings", "place"]
    assert (found.design, found.machines, found.seeds) == ("factorial", 2, 1)
    assert found.has_costs


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_shipped_examples_are_sound(path: Path) -> None:
    assert len(EXAMPLES) == 4
    asked = read_study(path)
    assert asked.name == path.stem
    for point in points(asked):
        assert study_cell(asked, point.values).name == "paper"


def test_settings_reach_the_cell(tmp_path: Path) -> None:
    cell = study_cell(study(tmp_path), {"layout.nest_samples": 5, "grid.pitch_mm": 300.0})
    assert (cell.layout.nest_samples, cell.grid.pitch_mm) == (5, 300.0)
    assert cell.validation.others == 8  # of [settings]


LAYERS = """
name = "trial"
machines = 0
seeds = "two"
samples = 3

[settings]
"layout.nest_samples" = 0
"grid.ptch_mm" = 450.0
"simulation.machine" = "papr"

[[factor]]
name = "grid (mm)"
setting = "grid.pich_mm"
levels = [450.0, 300.0]

[[factor]]
name = "mean_mm"
setting = "tracker.samples"
levels = [0]

[[factor]]
setting = "grid.centre.x_mm"
levels = 3
costs = ["a"]
minutes = "b"

[[factor]]
name = "speed"
setting = "rail.speed_mm_s"
low = -1
high = "x"
distribution = { kind = "normal", mean = "x" }
labels = ["a", "b"]

[[factor]]
name = "speed"
setting = "simulation.sizes.rail.backlas_mm"
levels = [0.1, 0.2]
costs = [1]
weights = [0]
"""
REFUSED = """
machines, seeds, samples, factor[0].name, factor[1].levels, factor[2].name, factor[2].levels,
factor[2].costs[0], factor[2].minutes, factor[3].high, factor[3].labels,
factor[3].distribution.mean, factor[3].distribution.sd, factor[3].distribution,
factor[4].weights[0], factor[4].weights, factor[4].costs, factor, factor,
cell paper grid.ptch_mm, cell paper layout.nest_samples, cell paper,
factor[0].setting grid.pich_mm, factor[1].setting tracker.samples, factor[4].setting
"""


def test_no_mistake_hides_another(tmp_path: Path) -> None:
    """Of the file, its factors, the base cell, the values of a setting, the machine."""
    path = tmp_path / "study.toml"
    path.write_text(LAYERS)
    with pytest.raises(SettingsError) as found:
        read_study(path)
    wanted = [each.strip() for each in REFUSED.split(",")]
    assert sorted(keys(found.value.problems)) == sorted(wanted)


SIZES = "simulation.sizes.rail"
SETTING = "factor[0].setting"


@pytest.mark.parametrize(
    ("given", "key"),
    [
        ({}, "factor[0]"),
        ({"low": 1}, "factor[0]"),
        ({"low": 1, "high": 3, "levels": [1, 2]}, "factor[0]"),
        ({"low": 3, "high": 3}, "factor[0]"),
        ({"low": 1, "high": 3, "labels": ["a", "b"]}, "factor[0].labels"),
        ({"levels": [2, 2]}, "factor[0].levels"),
        ({"levels": [2, 5], "labels": ["a"]}, "factor[0].labels"),
        ({"levels": [2, 5], "costs": [1, 2, 3]}, "factor[0].costs"),
        ({"levels": [2, 5], "minutes": []}, "factor[0].minutes"),
        ({"levels": [2, 5], "name": "mean_mm"}, "factor"),
        ({"levels": [2, 5], "labels": ["a", 3]}, "factor[0].labels[1]"),
        ({"setting": "layout.nest_sample", "levels": [2, 5]}, f"{SETTING} layout.nest_sample"),
        ({"setting": "lay.nests", "levels": [2, 5]}, f"{SETTING} lay"),
        ({"levels": [2, "five"]}, f"{SETTING} layout.nest_samples"),
        ({"levels": [2, 0]}, f"{SETTING} layout.nest_samples"),
        ({"levels": [2, date(2026, 1, 31)]}, f"{SETTING} layout.nest_samples"),
        ({"low": 1.5, "high": 4.0}, f"{SETTING} layout.nest_samples"),
        ({"setting": f"{SIZES}.backlash_mm", "low": -1.0, "high": 1.0}, SETTING),
        ({"setting": "simulation.machine", "levels": ["paper", "papr"]}, SETTING),
    ],
)
def test_a_factor_that_cannot_be(tmp_path: Path, given: dict[str, object], key: str) -> None:
    assert set(refused(tmp_path, factor(**given))) == {key}


@pytest.mark.parametrize(
    ("head", "key"),
    [
        ('design = "sobol"', "samples"),
        ("samples = 1", "samples"),
        ('design = "sobol"\nsamples = 100', "samples"),
        ('accuracy = "covered"', "accuracy"),
        ('results = ["mean_mm", "maxmm"]', "results"),
    ],
)
def test_a_design_that_cannot_be_drawn(tmp_path: Path, head: str, key: str) -> None:
    assert key in refused(tmp_path, factor(levels=[2, 5]), head)


@pytest.mark.parametrize(
    "setting",
    [
        '"simulation.machine" = "papr"',
        '"simulation.simulator" = "none"',
        '"simulation.sizes.rail.backlash_mm" = -1.0',
    ],
)
def test_a_base_cell_without_a_machine_is_refused(tmp_path: Path, setting: str) -> None:
    """Every case of it could not be."""
    path = written(tmp_path)
    path.write_text(path.read_text().replace("[settings]", f"[settings]\n{setting}"))
    with pytest.raises(SettingsError) as found:
        read_study(path)
    (problem,) = found.value.problems
    assert problem.startswith("cell paper: ")


QUICK = factor(setting="plan.quick", levels=[False, True])


def test_an_accuracy_that_no_quick_plan_has_is_refused(tmp_path: Path) -> None:
    """It sends no targets by the paper's method."""
    by_idw = 'machines = 1\naccuracy = "idw_mm"'
    assert refused(tmp_path, QUICK, by_idw) == [f"{SETTING} plan.quick"]
    path = written(tmp_path, head=by_idw)
    path.write_text(path.read_text().replace("[settings]", '[settings]\n"plan.quick" = true'))
    with pytest.raises(SettingsError) as found:
        read_study(path)
    (problem,) = found.value.problems
    assert problem == (
        "cell paper: plan.quick: a quick plan sends no targets by the paper's method, so it has no "
        'idw_mm; leave plan.quick out, or state another accuracy, such as "mean_mm"'
    )


def test_a_reflector_that_somebody_carries_is_refused(tmp_path: Path) -> None:
    """Nobody is there: all its cases failed."""
    carried = factor(setting="layout.reflectors", levels=["mounted", "by_hand"])
    assert refused(tmp_path, carried) == [f"{SETTING} layout.reflectors"]
    path = written(tmp_path)
    by_hand = '[settings]\n"layout.reflectors" = "by_hand"'
    path.write_text(path.read_text().replace("[settings]", by_hand))
    with pytest.raises(SettingsError) as found:
        read_study(path)
    assert keys(found.value.problems) == ["cell paper layout.reflectors"]
    assert '"mounted"' in found.value.problems[0]


def test_a_quick_plan_may_be_a_factor(tmp_path: Path) -> None:
    assert study(tmp_path, QUICK).factor[0].ends == [False, True]


def test_too_many_cases_are_refused_with_the_rest(tmp_path: Path) -> None:
    problems = refused(tmp_path, factor(levels=[2, 0]), "machines = 9999\nseeds = 9999")
    assert problems == ["file", f"{SETTING} layout.nest_samples"]


def test_a_value_that_only_goes_ill_with_others_is_no_mistake(tmp_path: Path) -> None:
    """A pitch of 400 mm does not divide this cube; it may divide that of another factor."""
    found = study(tmp_path, factor(setting="grid.pitch_mm", levels=[450.0, 400.0]))
    assert found.factor[0].ends == [450.0, 400.0]


def test_two_factors_of_one_setting(tmp_path: Path) -> None:
    """The one that is set last undoes the other; its column would be one of luck."""
    twice = factor(levels=[2, 5]) + factor(levels=[2, 3])
    assert refused(tmp_path, twice) == ["factor", "factor"]  # of the name, and of the setting
    table = {"name": "g", "setting": "layout", "levels": [{"nest_samples": 3}, {"nest_samples": 4}]}
    within = factor(**table, labels=["a", "b"]) + factor(levels=[2, 5])
    assert refused(tmp_path, within) == ["factor"]
    several = STRIP + factor(setting="rail.strip_tolerance_mm", levels=[0.01, 0.02])
    assert refused(tmp_path, several) == ["factor"]


def test_levels_that_differ_little_are_two(tmp_path: Path) -> None:
    pitch = factor(setting="grid.pitch_mm", levels=[450.0, 450.0001])
    assert study(tmp_path, pitch).factor[0].names == ["450", "450.0001"]


def test_a_mistake_of_a_cell_file_has_its_line(tmp_path: Path) -> None:
    text = Path("hilcell/cells/paper.toml").read_text("utf-8")
    (tmp_path / "own.toml").write_text(text.replace("pitch_mm", "ptch_mm"))
    with pytest.raises(SettingsError) as found:
        study(tmp_path, factor(levels=[2, 0]), 'cell = "own.toml"')
    first, *_, last = found.value.problems
    assert first.startswith(f"cell {tmp_path}/own.toml: {tmp_path}/own.toml:")
    assert last.startswith(f"{SETTING}: ")


def test_a_cell_without_a_simulation_or_a_file_is_refused(tmp_path: Path) -> None:
    text = Path("hilcell/cells/paper.toml").read_text("utf-8")
    (tmp_path / "real.toml").write_text(text.partition("[simulation]")[0])
    for name in ("real.toml", "papr"):
        (problem,) = refused(tmp_path, factor(levels=[2, 5]), f'cell = "{name}"')
        assert problem == f"cell {tmp_path / name}"


@pytest.mark.parametrize(
    "stated", ["factor = 3", "factor = [3]", "factor = [{ levels = [nan] }, 3]"]
)
def test_factors_that_are_no_tables_are_refused(tmp_path: Path, stated: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(f'name = "trial"\n{stated}\n')
    with pytest.raises(SettingsError) as found:
        read_study(path)
    assert all(key.startswith("factor") for key in keys(found.value.problems))


def test_a_typo_in_a_check_is_never_skipped() -> None:
    """Of a table that could not be read, either."""
    for values in ({"name": "f", "levels": [1, 2]}, {"name": 3}):
        with pytest.raises(AttributeError, match="hihg"):
            convert(values, Factor, "file", lambda it: [str(is_stated(it, attrgetter("hihg")))])


def test_a_file_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    for content in (None, b"\xff\xfe"):
        if content:
            path.write_bytes(content)
        with pytest.raises(SettingsError):
            read_study(path)


VALUES = st.recursive(
    st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.floats(allow_nan=False)
    | st.text("aä\"'\\ .😀\x00\x1f\x7f\u2028")
    | st.dates()
    | st.times()
    | st.datetimes(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("ab ."), inner, max_size=3),
    max_leaves=8,
)


@given(VALUES)
def test_values_are_written_as_toml_reads_them(value: object) -> None:
    assert tomllib.loads(f"value = {toml_text(value)}")["value"] == value


def test_a_machine_of_another_robot_is_a_finding(tmp_path: Path) -> None:
    """It goes with the cell of its own robot, which another factor may set."""
    study(tmp_path, factor(setting="simulation.machine", levels=["paper", "six-r"]))


STRIP = """
[[factor]]
name = "strip"
labels = ["strip", "none"]
levels = [
  { "simulation.sizes.rail.strip" = true },
  { "simulation.sizes.rail.strip" = false, "rail.strip_tolerance_mm" = 0.2 },
]
"""


def test_a_level_may_be_several_settings(tmp_path: Path) -> None:
    asked = study(tmp_path, STRIP)
    with_strip, without = (study_cell(asked, point.values) for point in points(asked))
    assert with_strip.rail.strip_tolerance_mm == 0.01
    assert without.rail.strip_tolerance_mm == 0.2
    assert without.simulation is not None
    assert without.simulation.sizes == {"rail": {"strip": False}}


@pytest.mark.parametrize(
    ("before", "after", "key"),
    [
        ('labels = ["strip", "none"]\n', "", "factor[0].labels"),
        ('{ "simulation.sizes.rail.strip" = true }', "true", "factor[0].setting"),
        ("_tolerance_mm", "_tolerence_mm", "factor[0].levels rail.strip_tolerence_mm"),
        ("= 0.2", "= -0.2", "factor[0].levels rail.strip_tolerance_mm"),
        ('rail.strip" = false', 'rail.stirp" = false', "factor[0].levels"),
    ],
)
def test_levels_of_several_settings_are_read_strictly(
    tmp_path: Path, before: str, after: str, key: str
) -> None:
    assert key in refused(tmp_path, STRIP.replace(before, after))


def test_all_values_that_are_none_are_named(tmp_path: Path) -> None:
    levels = 'name = "p"\nsetting = "grid.pitch_mm"\nlevels = [450.0, -3.0, nan, inf]'
    assert refused(tmp_path, f"[[factor]]\n{levels}") == [
        "factor[0].levels[2]", "factor[0].levels[3]", f"{SETTING} grid.pitch_mm",
    ]  # fmt: skip
