"""Cell files: every problem at once, the nearest key, nothing that is not finite."""

import unicodedata
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells


def refused(overrides: dict[str, str]) -> list[str]:
    with pytest.raises(SettingsError) as error:
        load_cell("paper", overrides)
    return error.value.problems


@pytest.mark.parametrize("name", built_in_cells())
def test_built_in_cells_are_sound(name: str) -> None:
    assert load_cell(name).name == name


def test_all_problems_are_reported_at_once_with_the_nearest_key() -> None:
    wrong = {
        "rail.travel_mx_mm": "5.0",
        "robot.speed_percent": "nan",
        "tracker.samples": '"three"',
        "grid.pitch_mm": "-1.0",
    }
    problems = refused(wrong)
    assert [problem.split(": ")[0] for problem in problems] == [*wrong]
    assert "travel_max_mm" in problems[0]


def test_who_carries_the_reflectors_changes_nothing_that_stands() -> None:
    assert load_cell("paper").layout.reflectors == "mounted"
    by_hand = load_cell("paper", {"layout.reflectors": "by_hand"})
    assert by_hand.layout.by_hand
    assert by_hand.digest == load_cell("paper").digest
    (problem,) = refused({"layout.reflectors": "by_feet"})
    assert problem.startswith("layout.reflectors: ")


CAPSULE = "{{link={}, from_mm=[0.0, 0.0, 0.0], to_mm=[0.0, 0.0, 1.0], radius_mm={}}}"
FLOOR = '{name="floor", centre={x_mm=0.0, y_mm=0.0, z_mm=-100.0}, size_mm=[9.0, 9.0, 9.0]}'


@pytest.mark.parametrize(
    ("key", "value", "at"),
    [
        ("name", '"a/b"', "name: "),
        ("rail", "3", "rail: "),
        ("station", "[]", "station: "),
        ("grid.station", '"S1"', "grid.station: "),
        ("grid.pitch_mm", "310.0", "grid.size_mm: "),
        ("grid.pitch_mm", "5e-324", "grid.pitch_mm: "),
        ("grid.size_mm", "[1.0, 2.0, inf]", "grid.size_mm[2]: "),
        ("grid.size_mm", "[1.0, 2.0, nan]", "grid.size_mm[2]: "),
        ("grid.size_mm", "[9000.0, 9000.0, 9000.0]", "grid: expected at most 1000 vertices"),
        ("layout.rail_direction", "[0.0, 0.5, 0.0]", "layout: rail_direction"),
        ("layout.floor", "[]", "layout.floor: "),
        ("layout.slide", "[]", "layout.slide: "),  # a rail needs nests on its slide
        ("rail.travel_max_mm", "1500.0", "station[2].rail_mm: "),
        ("rail.travel_max_mm", "-1.0", "rail: travel_min_mm"),
        ("rail.speed_mm_s", "250.0\nname = 'x'", "rail.speed_mm_s: "),
        ("robot.joint", "[]", "robot: "),
        ("robot.smr_mm", "[1e9, 0.0, 0.0]", "robot.smr_mm: "),
        ("robot.more_smr_mm", "[[0.0, 90.0, 0.0]]", "robot.more_smr_mm: "),
        (
            "robot.more_smr_mm",
            "[[0, 90, 0], [0, 200, 0], [0, 300, 0], [90, 0, 0], [200, 0, 0], [300, 0, 0]]",
            "robot.more_smr_mm: ",
        ),
        (
            "robot.more_smr_mm",
            "[[98.0, 45.0, 127.0], [0.0, 200.0, 0.0]]",
            "robot.more_smr_mm: reflectors 1 and 2 are 45.0 mm",
        ),
        ("robot.more_smr_mm", "[[98.0, 100.0, 127.0], [98.0, 200.0, 130.0]]", "robot.more_smr_mm"),
        ("robot.safe_deg", "[186.0, -100.0, 110.0, 0.0, -30.0, 0.0]", "robot.safe_deg: A1"),
        ("robot.home_deg", "[0.0, -1.0, 169.0, 0.0, -30.0, 0.0]", "robot.home_deg: A3"),
        ("tracker.min_range_mm", "20000.0", "tracker: min_range_mm"),
        ("validation.per_cell", "200", "validation: expected at most"),
        ("validation.others", "1", "validation.others: expected one"),
        ("survey.step_mm", "110.0", "survey: "),
        ("survey.step_mm", "0.01", "survey: expected at most 10000 steps"),
        ("settle.reading_age_s", "11.0", "settle.reading_age_s: "),
        ("base_frame.axis_1_sweep_deg", "[0.0, 0.0]", "base_frame.axis_1_sweep_deg: "),
        ("base_frame.axis_6_sweep_deg", "[30.0, 30.0]", "base_frame.axis_6_sweep_deg: "),
        ("simulation.simulator", "5", "simulation.simulator: "),
        ("keep_out", "[]", "robot: envelope"),
        ("keep_out", f"[{FLOOR}, {FLOOR}]", "keep_out: "),
        ("keep_out", f"[{', '.join([FLOOR] * 101)}]", "keep_out: 101 volumes"),
        ("keep_out", '[{name="floor"}]', "keep_out[0].centre: "),
        ("keep_out", f"[{FLOOR.replace('[9.0, 9.0', '[9.0, 0.9')}]", "keep_out[0].size_mm: "),
        ("keep_out", f'[{FLOOR[:-1]}, frame="base"}}]', "keep_out[0].frame: "),
        ("robot.envelope.radius_mm", "[1.0, 2.0]", "robot.envelope.radius_mm: "),
        ("robot.envelope.radius_mm", "[50, 50, 50, 50, 50, 0.12]", "robot.envelope.radius_mm: "),
        ("robot.envelope.clearance_mm", "nan", "robot.envelope.clearance_mm: "),
        ("robot.envelope.capsule", f"[{CAPSULE.format(7, 5.0)}]", "robot.envelope.capsule[0].link"),
        ("robot.envelope.capsule", f"[{CAPSULE.format(1, 0.2)}]", "robot.envelope.capsule[0].radi"),
    ],
)
def test_what_makes_no_sense_is_refused(key: str, value: str, at: str) -> None:
    assert any(line.startswith(at) for line in refused({key: value}))


@pytest.fixture(autouse=True)
def _small_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what the tests could build small, should a limit fail."""
    monkeypatch.setattr("hilcell.cell.file.MOST_POINTS", 1000)


def stations(*rows: tuple[str, float, float]) -> dict[str, str]:
    tables = (f'{{name="{n}", rail_mm={rail}, strip_mm={strip}}}' for n, rail, strip in rows)
    return {"station": f"[{', '.join(tables)}]"}


@pytest.mark.parametrize("strip_mm", [300.0, 1097.0, 1103.0])
def test_a_station_whose_strip_is_another_s_or_disagrees_with_its_rail(strip_mm: float) -> None:
    problems = refused(stations(("S300", 300.0, 300.0), ("S1100", 1100.0, strip_mm)))
    assert {problem.split(": ")[0] for problem in problems} == {"station[1].strip_mm"}
    assert load_cell("paper", stations(("S1100", 1100.0, 1101.9))).station[0].strip_mm == 1101.9


def nests(*rows: tuple[str, float, float, float]) -> str:
    tables = (f'{{name="{n}", x_mm={x}, y_mm={y}, z_mm={z}}}' for n, x, y, z in rows)
    return f"[{', '.join(tables)}]"


TRIANGLE = (("P1", 100.0, 0.0, 0.0), ("P2", 0.0, 100.0, 0.0), ("P3", -100.0, 0.0, 0.0))


@pytest.mark.parametrize("table", ["floor", "slide"])
def test_the_first_three_nests_form_a_triangle(table: str) -> None:
    line = (("N1", 100.0, 0.0, 0.0), ("N2", 200.0, 0.0, 0.0), ("N3", 300.0, 0.0, 0.0))
    rows = (*line, ("N4", 0.0, 900.0, 0.0))
    (problem,) = refused({f"layout.{table}": nests(*rows)})
    assert "N1, N2, N3" in problem


def test_nests_have_names_and_places_of_their_own() -> None:
    for row in (("F1", 0.0, -100.0, 0.0), ("P4", 110.0, 10.0, 0.0)):
        (problem,) = refused({"layout.slide": nests(*TRIANGLE, row)})
        assert problem.startswith("layout.slide[3]")


def test_a_byte_order_mark_is_no_problem(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    built_in = resources.files("hilcell.cells") / "paper.toml"
    file.write_text("\ufeff" + built_in.read_text("utf-8"), "utf-8")
    assert load_cell(str(file)).name == "paper"


def test_missing_keys_are_named(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text('name = "x"\n', "utf-8")
    with pytest.raises(SettingsError) as error:
        load_cell(str(file))
    assert {"robot", "layout.base"} <= {each.split(": ")[0] for each in error.value.problems}


@pytest.mark.parametrize(
    "text",
    [b"name = ", b"\xff\xfe", b"name = " + b"[" * 5000 + b"]" * 5000, b"name = " + b"9" * 5000],
    ids=["no value", "no UTF-8", "too deep", "too long"],
)
def test_a_file_that_is_no_toml_is_refused(tmp_path: Path, text: bytes) -> None:
    file = tmp_path / "cell.toml"
    file.write_bytes(text)
    with pytest.raises(SettingsError):
        load_cell(str(file))


@pytest.mark.parametrize(
    ("where", "named"),
    [
        (".", ""), ("x" * 300, ""), ("pyproject.toml/x", ""),
        ("papper", "paper"), ("", "paper"), ("  ", "paper"),  # the cells that exist
    ],
)  # fmt: skip
def test_a_path_that_is_no_file_is_refused(where: str, named: str) -> None:
    with pytest.raises(SettingsError, match=named or None):
        load_cell(where)


@pytest.mark.parametrize(
    "same",
    [
        {"simulation.address": "127.0.0.1:1"},
        {"rail.homing_mm_s": "50.0", "rail.standstill_dwell_s": "1.0", "robot.ramp_s": "1.0"},
        {"tracker.pointing_s": "2.0", "tracker.reading_s": "2.0"},
        {"touch.poses": "20", "layout.max_tool_std_mm": "0.05"},
        {"keep_out": f"[{FLOOR}]", "robot.envelope.clearance_mm": "70.0"},
    ],
)
def test_the_digest_leaves_out_what_changes_nothing_that_stands_there(same: dict[str, str]) -> None:
    cell = load_cell("paper")
    assert load_cell("paper", same).digest == cell.digest
    assert load_cell("paper", {"rail.speed_mm_s": "251.0"}).digest != cell.digest


def test_volumes_without_an_arm_are_refused(tmp_path: Path) -> None:
    text = (resources.files("hilcell.cells") / "replay.toml").read_text("utf-8")
    (tmp_path / "cell.toml").write_text(text)
    assert load_cell(str(tmp_path / "cell.toml")).surroundings is None
    with pytest.raises(SettingsError, match="keep_out: "):
        load_cell(str(tmp_path / "cell.toml"), {"keep_out": f"[{FLOOR}]"})


@pytest.mark.parametrize(("margin_deg", "low_deg"), [(0.0, 0.5), (2.0, 2.0)])
def test_a_pose_leaves_room_to_come_from_below(margin_deg: float, low_deg: float) -> None:
    robot = load_cell("paper", {"robot.joint_margin_deg": f"{margin_deg}"}).robot
    limits_deg = np.degrees(robot.margin_limits_rad)
    assert limits_deg[0] == pytest.approx([joint.min_deg + low_deg for joint in robot.joint])
    assert limits_deg[1] == pytest.approx([joint.max_deg - margin_deg for joint in robot.joint])


def test_names_have_letters_of_every_language_however_typed(tmp_path: Path) -> None:
    text = resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")
    file = tmp_path / "cell.toml"
    typed = unicodedata.normalize("NFD", text.replace("S1900", "Süd").replace('"F1"', '"床1"'))
    file.write_text(typed, "utf-8")
    cell = load_cell(str(file))
    assert "Süd" in [station.name for station in cell.station]
    assert "床1" in [nest.name for nest in cell.layout.floor]


SEATS = {"robot.more_smr_mm": "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]"}


def test_several_reflectors_on_the_flange_are_those_of_another_cell() -> None:
    one, three = load_cell("paper"), load_cell("paper", SEATS)
    assert one.robot.seats_mm.tolist() == [[98.0, 0.0, 127.0]]
    assert three.robot.seats_mm[1].tolist() == [-40.0, 110.0, 127.0]
    assert one.digest != three.digest
    (problem,) = refused(SEATS | {"layout.reflectors": '"by_hand"'})
    assert problem.startswith("robot.more_smr_mm: ")


def test_a_station_that_cannot_be_read_hides_no_other(tmp_path: Path) -> None:
    text = resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")
    file = tmp_path / "cell.toml"
    text = text.replace("rail_mm = 300.0", 'rail_mm = "x"').replace("= 1900.0", "= 91900.0", 1)
    file.write_text(text, "utf-8")
    with pytest.raises(SettingsError) as error:
        load_cell(str(file))
    found = "\n".join(error.value.problems)
    assert "station[0].rail_mm: " in found
    assert "station[2].rail_mm: " in found


LIMIT = "validation.max_tolerance_deg"


def test_a_limit_of_orientation_wants_reflectors_and_is_of_the_cell_where_it_is_stated() -> None:
    three = load_cell("paper", SEATS)
    assert three.validation.max_tolerance_deg is None
    assert load_cell("paper", SEATS | {LIMIT: "0.05"}).digest != three.digest
    (problem,) = refused({LIMIT: "0.05"})
    assert LIMIT in problem
    for value in ("0.0", "nan", "181.0"):
        assert refused(SEATS | {LIMIT: value})


@pytest.mark.parametrize(
    "key",
    [
        "validation.mean_tolerance_mm", "validation.max_tolerance_mm", "rail.strip_tolerance_mm",
        "rail.max_backlash_mm", "tracker.max_std_mm", "iso9283.ap_limit_mm", "iso9283.rd_limit_mm",
    ],
)  # fmt: skip
def test_a_tolerance_that_accepts_whatever_happens_is_refused(key: str) -> None:
    for value in ("1e6", "10.5", "0.0", "nan"):
        (problem,) = refused({key: value})
        assert key in problem
    load_cell("paper", {key: "10.0"})


def test_options_of_a_driver_that_is_exchanged_are_left_behind() -> None:
    kept = load_cell("paper", {"robot.driver": "kuka-c3", "robot.speed_percent": "20"})
    assert kept.robot.options == load_cell("paper").robot.options != {}
    other = load_cell("paper", {"robot.options.model": "KR16", "robot.driver": "kuka-eki"})
    assert (other.robot.driver, other.robot.options) == ("kuka-eki", {"model": "KR16"})
