"""Cell files: every problem at once, the nearest key, nothing that is not finite."""

from pathlib import Path

import pytest

from hilcell.cell import built_in_cells, load_cell
from hilcell.settings import SettingsError


def refused(overrides: dict[str, str]) -> list[str]:
    with pytest.raises(SettingsError) as error:
        load_cell("paper", overrides)
    return error.value.problems


@pytest.mark.parametrize("name", built_in_cells())
def test_built_in_cells_are_sound(name: str) -> None:
    assert load_cell(name).name == name


def test_all_problems_are_told_at_once_with_the_nearest_key() -> None:
    problems = refused(
        {
            "rail.travel_mx_mm": "5.0",
            "robot.speed_percent": "nan",
            "tracker.samples": '"three"',
            "grid.pitch_mm": "-1.0",
        }
    )
    assert problems == [
        'rail.travel_mx_mm: unknown key; did you mean "travel_max_mm"?',
        "robot.speed_percent: nan is not a finite number",
        "tracker.samples: Expected `int`, got `str`, found 'three'; allowed: >= 1, <= 1000",
        "grid.pitch_mm: Expected `float` > 0.0, found -1.0; allowed: > 0",
    ]


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999"])
def test_numbers_must_be_finite(value: str) -> None:
    assert any("not a finite number" in line for line in refused({"rail.speed_mm_s": value}))
    assert any("not a finite" in line for line in refused({"grid.size_mm": f"[1.0, 2.0, {value}]"}))


def test_collinear_slide_nests_are_refused() -> None:
    nests = ", ".join(f'{{name="P{n}", x_mm={n}.0, y_mm=0.0, z_mm=0.0}}' for n in range(3))
    (problem,) = refused({"layout.slide": f"[{nests}]"})
    assert "P0, P1, P2 lie on one line" in problem
    assert "move one nest aside" in problem


@pytest.mark.parametrize(
    ("key", "value", "part"),
    [
        ("grid.pitch_mm", "310.0", "not a whole number of pitches"),
        ("grid.station", '"S1"', "is none of S300, S1100, S1900"),
        ("layout.rail_direction", "[0.0, 2.0, 0.0]", "length 1"),
        ("rail.travel_max_mm", "1500.0", "station S1900: rail_mm 1900.0 is outside"),
        ("robot.joint", "[]", "six joints are wanted, found 0"),
        ("name", '"a/b"', "Expected `str` matching regex"),
        ("rail", "3", "a table is expected"),
        ("simulation.simulator", "5", "Expected `str`, got `int`"),
    ],
)
def test_what_makes_no_sense_is_refused(key: str, value: str, part: str) -> None:
    assert any(part in line for line in refused({key: value}))


def test_missing_keys_are_named(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text('name = "x"\n', "utf-8")
    with pytest.raises(SettingsError) as error:
        load_cell(str(file))
    assert "rail: missing" in error.value.problems
    assert "station: missing" in error.value.problems


@pytest.mark.parametrize(
    ("text", "part"),
    [(b"name = ", "not valid TOML"), (b"\xff\xfe", "cannot be read")],
)
def test_files_that_are_no_toml(tmp_path: Path, text: bytes, part: str) -> None:
    file = tmp_path / "cell.toml"
    file.write_bytes(text)
    with pytest.raises(SettingsError, match=part):
        load_cell(str(file))


def test_a_cell_that_does_not_exist_names_those_that_do() -> None:
    with pytest.raises(SettingsError, match=r"built in: .*paper"):
        load_cell("papper")


def test_the_digest_is_of_the_cell_and_not_of_its_simulation() -> None:
    cell = load_cell("paper")
    assert load_cell("paper", {"simulation.address": "127.0.0.1:1"}).digest == cell.digest
    assert load_cell("paper", {"rail.speed_mm_s": "251.0"}).digest != cell.digest


def test_an_override_may_be_bare_text() -> None:
    cell = load_cell("paper", {"rail.options.channel": "socket://127.0.0.1:1"})
    assert cell.rail.options["channel"] == "socket://127.0.0.1:1"
