"""A study file is read strictly: every mistake at once, and values that a setting can take."""

from __future__ import annotations

import json
import tomllib
from datetime import date
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.settings import SettingsError
from hilcell.study.design import points
from hilcell.study.study_file import cell_of, read_study
from hilcell.study.toml_value import toml_value
from tests.hilcell.study.studies import study, written

EXAMPLES = sorted(Path("docs/examples").glob("study-*.toml"))


def factor(**keys: object) -> str:
    given = {"name": "f", "setting": "layout.nest_samples"} | keys
    return "\n[[factor]]\n" + "\n".join(
        f"{key} = {toml_value(each) if isinstance(each, list) else json.dumps(each)}"
        for key, each in given.items()
    )


def refused(folder: Path, factors: str, head: str = "machines = 2") -> list[str]:
    with pytest.raises(SettingsError) as found:
        study(folder, factors, head)
    assert found.value.source == str(folder / "study.toml")
    return found.value.problems


def test_a_study_is_read(tmp_path: Path) -> None:
    found = study(tmp_path)
    assert [each.name for each in found.factor] == ["readings", "place"]
    assert (found.design, found.machines, found.seeds) == ("factorial", 2, 1)
    assert found.has_costs


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_shipped_examples_are_sound(path: Path) -> None:
    asked = read_study(path)
    assert asked.name == path.stem
    for point in points(asked):
        assert cell_of(asked, point.values).name == "paper"


def test_there_are_three_examples() -> None:
    assert len(EXAMPLES) == 3


def test_settings_reach_the_cell(tmp_path: Path) -> None:
    cell = cell_of(study(tmp_path), {"layout.nest_samples": 5, "grid.pitch_mm": 300.0})
    assert (cell.layout.nest_samples, cell.grid.pitch_mm) == (5, 300.0)
    assert cell.validation.others == 8  # of [settings]


def test_every_mistake_is_named_at_once(tmp_path: Path) -> None:
    head = 'machines = 0\ndesgin = "sobol"\naccuracy = "meen_mm"\nresults = ["mean_mm", "maxmm"]'
    problems = "\n".join(refused(tmp_path, factor(levels=[2]), head))
    for words in (
        'desgin: unknown key; did you mean "design"?',
        "machines: ",
        "accuracy: 'meen_mm' is none; did you mean \"mean_mm\"?",
        "results: 'maxmm' is none; did you mean \"max_mm\"?",
        "factor[0].levels: two or more are wanted, found 1",
    ):
        assert words in problems


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
FOUND = """
machines: a whole number is wanted, found 0; allowed: >= 1, <= 10000
seeds: a whole number is wanted, found 'two'; allowed: >= 1, <= 10000
samples: these are for design = "sobol"
factor[0].name: 1 to 64 letters, digits
factor[1].levels: two or more are wanted, found 1
factor[2].name: missing
factor[2].levels: a list is wanted, found 3
factor[2].costs[0]: a number is wanted, found 'a'; allowed: >= -1e+12, <= 1e+12
factor[2].minutes: a list is wanted, found 'b'
factor[3].high: a number is wanted, found 'x'
factor[3].labels: these are for levels
factor[3].distribution.mean: a number is wanted, found 'x'
factor[3].distribution.sd: missing; normal wants it
factor[3].distribution: this is for design = "sobol"
factor[4].weights[0]: a number is wanted, found 0; allowed: > 0, <= 1e+12
factor[4].weights: this is for design = "sobol"
factor[4].costs: 2 are wanted, found 1
factor: two have the name 'speed'
factor: the name 'mean_mm' is one of a result
cell paper: grid.ptch_mm: unknown key; did you mean "pitch_mm"?
cell paper: layout.nest_samples: a whole number is wanted, found 0; allowed: >= 1, <= 1000
cell paper: simulation.machine 'papr': no such file, and no machine of that name
factor[0].setting: grid.pich_mm: unknown key; did you mean "pitch_mm"?
factor[1].setting: tracker.samples: a whole number is wanted, found 0; allowed: >= 1, <= 1000
factor[4].setting: simulation.sizes of paper: rail.backlas_mm: unknown key
"""


def test_no_mistake_hides_another(tmp_path: Path) -> None:
    """Of the file, its factors, the base cell, the values of a setting, the machine."""
    path = tmp_path / "study.toml"
    path.write_text(LAYERS)
    with pytest.raises(SettingsError) as found:
        read_study(path)
    missed = [
        wanted
        for wanted in FOUND.strip().splitlines()
        if not any(line.startswith(wanted) for line in found.value.problems)
    ]
    assert missed == []
    assert len(found.value.problems) == len(FOUND.strip().splitlines())


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('"simulation.machine" = "papr"', "simulation.machine 'papr': no such file"),
        ('"simulation.simulator" = "none"', "simulation.simulator: 'none' is not installed"),
        ('"simulation.sizes.rail.backlash_mm" = -1.0', "rail.backlash_mm: a number is wanted"),
    ],
)
def test_a_base_cell_without_a_machine_is_refused(tmp_path: Path, setting: str, words: str) -> None:
    """Every case of it could not be."""
    path = written(tmp_path)
    path.write_text(path.read_text().replace("[settings]", f"[settings]\n{setting}"))
    with pytest.raises(SettingsError) as found:
        read_study(path)
    (problem,) = found.value.problems
    assert problem.startswith("cell paper: ")
    assert words in problem


def test_too_many_cases_are_refused_with_the_rest(tmp_path: Path) -> None:
    problems = refused(tmp_path, factor(levels=[2, 0]), "machines = 9999\nseeds = 9999")
    assert problems[0] == "file: 199960002 cases, at most 1000000 are measured"
    assert problems[1].startswith("factor[0].setting: layout.nest_samples: ")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "levels are wanted, or low and high"),
        ({"low": 1}, "levels are wanted, or low and high"),
        ({"low": 1, "high": 3, "levels": [1, 2]}, "levels are wanted, or low and high"),
        ({"low": 3, "high": 3}, "low 3 must be below high 3"),
        ({"low": 1, "high": 3, "labels": ["a", "b"]}, "labels: these are for levels"),
        ({"levels": [2, 2]}, "two are alike"),
        ({"levels": [2, 5], "labels": ["a"]}, "labels: 2 are wanted, found 1"),
        ({"levels": [2, 5], "costs": [1, 2, 3]}, "costs: 2 are wanted, found 3"),
        ({"levels": [2, 5], "minutes": []}, "minutes: 2 are wanted, found 0"),
        ({"levels": [2, 5], "name": "mean_mm"}, "is one of a result"),
        (
            {"levels": [2, 5], "weights": [1, 0]},
            "weights[1]: a number is wanted, found 0; allowed: > 0, <= 1e+12",
        ),
        ({"levels": [2, 5], "labels": ["a", 3]}, "labels[1]: a text is wanted, found 3"),
    ],
)
def test_a_factor_that_says_no_range(tmp_path: Path, keys: dict[str, object], words: str) -> None:
    assert words in "\n".join(refused(tmp_path, factor(**keys)))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"setting": "layout.nest_sample", "levels": [2, 5]}, 'mean "nest_samples"'),
        ({"setting": "lay.nests", "levels": [2, 5]}, "unknown key"),
        ({"levels": [2, "five"]}, "whole number is wanted, found 'five'"),
        ({"levels": [2, 0]}, "layout.nest_samples: "),
        ({"levels": [2, date(2026, 1, 31)]}, "layout.nest_samples: a whole number is wanted"),
        ({"low": 1.5, "high": 4.0}, "whole number is wanted"),
    ],
)
def test_a_value_that_the_setting_never_takes(
    tmp_path: Path, keys: dict[str, object], words: str
) -> None:
    problem, *_ = refused(tmp_path, factor(**keys))
    assert problem.startswith("factor[0].setting: ")
    assert words in problem


def test_a_value_that_only_goes_ill_with_others_is_no_mistake(tmp_path: Path) -> None:
    """A pitch of 400 mm does not divide this cube; it may divide that of another factor."""
    found = study(tmp_path, factor(setting="grid.pitch_mm", levels=[450.0, 400.0]))
    assert found.factor[0].ends == [450.0, 400.0]


def test_two_factors_of_one_setting(tmp_path: Path) -> None:
    twice = factor(levels=[2, 5]) + factor(levels=[2, 3]) + factor(setting="", levels=3)
    problems = "\n".join(refused(tmp_path, twice))
    assert "two have the name 'f'" in problems
    assert "two have the setting 'layout.nest_samples'" in problems


def test_a_factor_within_a_table_of_another(tmp_path: Path) -> None:
    """The one that is set last undoes the other; its column would be one of luck."""
    table = {"name": "g", "setting": "layout", "levels": [{"nest_samples": 3}, {"nest_samples": 4}]}
    problems = refused(tmp_path, factor(**table, labels=["a", "b"]) + factor(levels=[2, 5]))
    assert problems == [
        "factor: 'layout' contains 'layout.nest_samples'; one of them would undo the other"
    ]


def test_levels_that_differ_little_are_two(tmp_path: Path) -> None:
    pitch = factor(setting="grid.pitch_mm", levels=[450.0, 450.0001])
    assert study(tmp_path, pitch).factor[0].names == ["450", "450.0001"]


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ('design = "sobol"', "samples: missing"),
        ("samples = 1", "samples: a whole number is wanted, found 1; allowed: >= 2, <= 65536"),
        ('design = "sobol"\nsamples = 100', "a power of two is wanted: 64 or 128"),
        ("samples = 8", 'samples: these are for design = "sobol"'),
        ('accuracy = "covered"', "accuracy: 'covered' is none"),
        ('cell = "papr"', "cell"),
    ],
)
def test_a_design_that_cannot_be_drawn(tmp_path: Path, head: str, words: str) -> None:
    assert words in "\n".join(refused(tmp_path, factor(levels=[2, 5]), head))


def test_a_mistake_of_a_cell_file_has_its_line(tmp_path: Path) -> None:
    text = Path("hilcell/cells/paper.toml").read_text("utf-8")
    (tmp_path / "own.toml").write_text(text.replace("pitch_mm", "ptch_mm"))
    problems = refused(tmp_path, factor(levels=[2, 0]), 'cell = "own.toml"')
    assert [line.partition(": ")[0] for line in problems] == [
        f"cell {tmp_path}/own.toml", f"cell {tmp_path}/own.toml", "factor[0].setting",
    ]  # fmt: skip
    assert f"cell {tmp_path}/own.toml: {tmp_path}/own.toml:" in problems[0]


def test_a_cell_of_real_devices_is_refused(tmp_path: Path) -> None:
    text = Path("hilcell/cells/paper.toml").read_text("utf-8")
    (tmp_path / "real.toml").write_text(text.partition("[simulation]")[0])
    (problem,) = refused(tmp_path, factor(levels=[2, 5]), 'cell = "real.toml"')
    assert "it has real devices only" in problem


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        read_study(tmp_path / "none.toml")
    path = written(tmp_path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(SettingsError, match="UTF-8"):
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
    assert tomllib.loads(f"value = {toml_value(value)}")["value"] == value


SIZES = "simulation.sizes.rail"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"setting": f"{SIZES}.backlas_mm", "levels": [0.1, 0.2]}, 'did you mean "backlash_mm"?'),
        ({"setting": f"{SIZES}.backlash_mm", "low": -1.0, "high": 1.0}, "rail.backlash_mm: "),
        ({"setting": "simulation.machine", "levels": ["paper", "papr"]}, "no such file, and no "),
    ],
)
def test_a_machine_that_cannot_be_is_no_factor(
    tmp_path: Path, keys: dict[str, object], words: str
) -> None:
    (problem,) = refused(tmp_path, factor(**keys))
    assert problem.startswith("factor[0].setting: simulation.")
    assert words in problem


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
    with_strip, without = (cell_of(asked, point.values) for point in points(asked))
    assert with_strip.rail.strip_tolerance_mm == 0.01
    assert without.rail.strip_tolerance_mm == 0.2
    assert without.simulation is not None
    assert without.simulation.sizes == {"rail": {"strip": False}}


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('labels = ["strip", "none"]\n', "", "labels: missing"),
        ('{ "simulation.sizes.rail.strip" = true }', "true", "setting: missing"),
        ("_tolerance_mm", "_tolerence_mm", 'did you mean "strip_tolerance_mm"?'),
        ("= 0.2", "= -0.2", "factor[0].levels: rail.strip_tolerance_mm: "),
        ('rail.strip" = false', 'rail.stirp" = false', 'did you mean "strip"?'),
    ],
)
def test_levels_of_several_settings_are_read_strictly(
    tmp_path: Path, before: str, after: str, words: str
) -> None:
    assert words in "\n".join(refused(tmp_path, STRIP.replace(before, after)))


def test_a_setting_in_two_factors(tmp_path: Path) -> None:
    twice = STRIP + factor(setting="rail.strip_tolerance_mm", levels=[0.01, 0.02])
    assert "two have the setting 'rail.strip_tolerance_mm'" in "\n".join(refused(tmp_path, twice))


def test_all_values_that_are_none_are_named(tmp_path: Path) -> None:
    levels = 'name = "p"\nsetting = "grid.pitch_mm"\nlevels = [450.0, -3.0, nan, inf]'
    assert refused(tmp_path, f"[[factor]]\n{levels}") == [
        "factor[0].levels[2]: nan is not a finite number",
        "factor[0].levels[3]: inf is not a finite number",
        (
            "factor[0].setting: grid.pitch_mm: a number is wanted, found -3.0; allowed: >= 0.01, "
            "<= 1e+06"
        ),
    ]
