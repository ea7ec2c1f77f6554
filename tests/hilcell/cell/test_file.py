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
        "tracker.samples: a whole number is wanted, found 'three'; allowed: >= 1, <= 1000",
        "grid.pitch_mm: a number is wanted, found -1.0; allowed: >= 0.01, <= 1e+06",
    ]


def test_who_carries_the_reflectors_changes_nothing_that_stands() -> None:
    assert load_cell("paper").layout.reflectors == "mounted"
    by_hand = load_cell("paper", {"layout.reflectors": "by_hand"})
    assert by_hand.layout.by_hand
    assert by_hand.digest == load_cell("paper").digest
    (problem,) = refused({"layout.reflectors": "by_feet"})
    assert problem.startswith("layout.reflectors: ")
    assert problem.endswith('found \'by_feet\'; allowed: "mounted", "by_hand"')


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999"])
def test_numbers_must_be_finite(value: str) -> None:
    assert any("not a finite number" in line for line in refused({"rail.speed_mm_s": value}))
    assert any("not a finite" in line for line in refused({"grid.size_mm": f"[1.0, 2.0, {value}]"}))


def test_collinear_slide_nests_are_refused() -> None:
    nests = ", ".join(f'{{name="P{n}", x_mm={n}.0, y_mm=0.0, z_mm=0.0}}' for n in range(3))
    problems = refused({"layout.slide": f"[{nests}]"})
    (problem,) = [each for each in problems if "P0, P1, P2 lie on one line" in each]
    assert "move one nest aside" in problem


@pytest.mark.parametrize(
    ("key", "value", "part"),
    [
        ("grid.pitch_mm", "310.0", "not a whole number of pitches"),
        ("grid.pitch_mm", "290.0", "not a whole number of pitches"),
        ("grid.station", '"S1"', "is none of S300, S1100, S1900"),
        ("layout.rail_direction", "[0.0, 2.0, 0.0]", "length 1"),
        ("layout.rail_direction", "[0.0, 0.5, 0.0]", "length 1"),
        ("rail.travel_max_mm", "1500.0", "station S1900: rail_mm 1900.0 is outside"),
        ("robot.joint", "[]", "six joints are wanted, found 0"),
        ("name", '"a/b"', "1 to 64 letters, digits, '_'"),
        ("rail", "3", "rail: a table is expected, found 3"),
        ("grid.size_mm", "[9000.0, 9000.0, 9000.0]", "29791 vertices, at most 1000"),
        ("grid.pitch_mm", "0.1", "vertices, at most 1000"),
        ("grid.pitch_mm", "5e-324", "allowed: >= 0.01, <= 1e+06"),
        ("station", "[]", "1 .. 1000 stations are needed, found 0"),
        ("layout.floor", "[]", "3 .. 100 nests are needed, found 0"),
        (
            "validation.per_cell",
            "200",
            "200 targets in each of 27 grid cells are 5400, at most 1000",
        ),
        ("validation.per_cell", "1001", "allowed: >= 1, <= 1000"),
        ("validation.others", "100001", "allowed: >= 1, <= 100000"),
        ("survey.step_mm", "110.0", "is not three or more steps of 110.0 mm"),
        ("survey.step_mm", "120.0", "is not three or more steps of 120.0 mm"),
        ("survey.step_mm", "0.01", "200000 steps, at most 10000"),
        ("settle.robot_s", "3601.0", "allowed: >= 0, <= 3600"),
        ("settle.rail_s", "-1.0", "allowed: >= 0, <= 3600"),
        ("rail.standstill_dwell_s", "0.0001", "allowed: >= 0.05, <= 5"),
        ("settle.reading_age_s", "0.001", "allowed: >= 0.01, <= 10"),
        ("settle.reading_age_s", "11.0", "allowed: >= 0.01, <= 10"),
        ("rail.acceleration_mm_s2", "0.5", "allowed: >= 1, <= 1e+06"),
        ("rail.speed_mm_s", "1e-9", "allowed: >= 0.1, <= 100000"),
        ("rail.travel_max_mm", "1e7", "allowed: >= -1e+06, <= 1e+06"),
        ("rail.travel_max_mm", "-1.0", "travel_min_mm 0.0 must be below travel_max_mm -1.0"),
        ("robot.smr_mm", "[1e9, 0.0, 0.0]", "allowed: >= -1e+06, <= 1e+06"),
        ("robot.more_smr_mm", "[[0.0, 90.0, 0.0]]", "2 .. 5 reflectors besides smr_mm are wanted"),
        (
            "robot.more_smr_mm",
            "[[0, 90, 0], [0, 200, 0], [0, 300, 0], [90, 0, 0], [200, 0, 0], [300, 0, 0]]",
            "2 .. 5 reflectors besides smr_mm are wanted, found 6",
        ),
        (
            "robot.more_smr_mm",
            "[[98.0, 45.0, 127.0], [0.0, 200.0, 0.0]]",
            "reflectors 1 and 2 are 45.0 mm apart, wanted at least 50 mm",
        ),
        (
            "robot.more_smr_mm",
            "[[98.0, 100.0, 127.0], [98.0, 200.0, 130.0]]",
            "the reflectors lie nearly on one line",
        ),
        ("robot.more_smr_mm", "[[98.0, 100.0, nan], [0.0, 0.0, 0.0]]", "nan"),
        ("robot.home_deg", "[1e9, 0.0, 0.0, 0.0, 0.0, 0.0]", "allowed: >= -3600, <= 3600"),
        (
            "robot.safe_deg",
            "[186.0, -100.0, 110.0, 0.0, -30.0, 0.0]",
            "safe_deg: A1 at 186.0 deg is outside its limits -185.0 .. 185.0 deg",
        ),
        (
            "robot.home_deg",
            "[0.0, -1.0, 169.0, 0.0, -30.0, 0.0]",
            "home_deg: A3 at 169.0 deg is outside its limits -120.0 .. 168.0 deg",
        ),
        ("tracker.min_range_mm", "20000.0", "min_range_mm 20000.0 must be below max_range_mm"),
        ("base_frame.axis_1_sweep_deg", "[0.0, 0.0]", "axis_1_sweep_deg: 0.0 .. 0.0 deg is no arc"),
        ("base_frame.axis_6_sweep_deg", "[30.0, 30.0]", "axis_6_sweep_deg: 30.0 .. 30.0 deg is"),
        ("simulation.simulator", "5", "a text is wanted, found 5"),
    ],
)
def test_what_makes_no_sense_is_refused(key: str, value: str, part: str) -> None:
    assert any(part in line for line in refused({key: value}))


@pytest.fixture(autouse=True)
def _small_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep what the tests could build small, should a limit fail."""
    monkeypatch.setattr("hilcell.cell.file.MOST_POINTS", 1000)


def stations(*rows: tuple[str, float, float]) -> dict[str, str]:
    tables = (f'{{name="{n}", rail_mm={rail}, strip_mm={strip}}}' for n, rail, strip in rows)
    return {"station": f"[{', '.join(tables)}]"}


def test_two_stations_at_one_strip_reading_are_refused() -> None:
    problems = refused(stations(("S300", 300.0, 300.0), ("S1100", 1100.0, 300.0)))
    assert (
        "station[1].strip_mm: station S1100: strip_mm 300.0 is also that of station S300 "
        "(300.0 mm); they must differ by more than 0.01 mm" in problems
    )


def test_a_station_whose_strip_and_rail_disagree_is_refused() -> None:
    problems = refused(stations(("S300", 300.0, 300.0), ("S1100", 1100.0, 1103.0)))
    wanted = "strip_mm 1103.0 and rail_mm 1100.0 differ by more than rail.slip_limit_mm 2.0"
    assert problems == [f"station[1].strip_mm: station S1100: {wanted}"]
    (problem,) = refused(stations(("S300", 300.0, 300.0), ("S1100", 1100.0, 1097.0)))
    assert "strip_mm 1097.0 and rail_mm 1100.0 differ" in problem
    assert load_cell("paper", stations(("S1100", 1100.0, 1101.9))).station[0].strip_mm == 1101.9


def test_stations_and_sweeps_may_be_stated_downwards() -> None:
    down = stations(("S1900", 1900.0, 1900.0), ("S1100", 1100.0, 1100.0), ("S300", 300.0, 300.0))
    down["base_frame.axis_1_sweep_deg"] = "[60.0, -60.0]"
    cell = load_cell("paper", down)
    assert [station.name for station in cell.station] == ["S1900", "S1100", "S300"]
    assert cell.base_frame.axis_1_sweep_deg == (60.0, -60.0)


def nests(*rows: tuple[str, float, float, float]) -> str:
    tables = (f'{{name="{n}", x_mm={x}, y_mm={y}, z_mm={z}}}' for n, x, y, z in rows)
    return f"[{', '.join(tables)}]"


TRIANGLE = (("P1", 100.0, 0.0, 0.0), ("P2", 0.0, 100.0, 0.0), ("P3", -100.0, 0.0, 0.0))


@pytest.mark.parametrize("table", ["floor", "slide"])
def test_the_first_three_nests_form_a_triangle(table: str) -> None:
    line = (("N1", 100.0, 0.0, 0.0), ("N2", 200.0, 0.0, 0.0), ("N3", 300.0, 0.0, 0.0))
    rows = (*line, ("N4", 0.0, 900.0, 0.0))
    (problem,) = refused({f"layout.{table}": nests(*rows)})
    assert "nests N1, N2, N3 lie on one line" in problem


def test_nests_have_names_of_their_own() -> None:
    problems = refused({"layout.slide": nests(*TRIANGLE, ("F1", 0.0, -100.0, 0.0))})
    assert problems == ["layout.slide[3].name: nest names must differ, found F1 twice"]


def test_nests_at_one_place_are_refused() -> None:
    problems = refused({"layout.slide": nests(*TRIANGLE, ("P4", 110.0, 10.0, 0.0))})
    assert problems == [
        "layout.slide[3]: nests P1 and P4 are 14.1 mm apart, wanted at least 20.0 mm"
    ]


def test_all_problems_of_a_table_are_reported_at_once() -> None:
    safe = "[186.0, -4.0, 110.0, 0.0, -30.0, 0.0]"
    assert len(refused({"robot.safe_deg": safe})) == 2


def test_a_byte_order_mark_is_no_problem(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    built_in = resources.files("hilcell.cells") / "paper.toml"
    file.write_text("\ufeff" + built_in.read_text("utf-8"), "utf-8")
    assert load_cell(str(file)).name == "paper"


@pytest.mark.parametrize("value", ["[" * 5000 + "]" * 5000, "9" * 5000])
def test_what_toml_cannot_hold_is_refused(tmp_path: Path, value: str) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(f"name = {value}", "utf-8")
    with pytest.raises(SettingsError, match=r"nested too deeply|not valid TOML"):
        load_cell(str(file))


def test_an_override_is_one_line() -> None:
    assert refused({"rail.speed_mm_s": "250.0\nname = 'x'"}) == [
        "rail.speed_mm_s: a value on one line is wanted, found \"250.0\\nname = 'x'\""
    ]


def test_missing_keys_are_named(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text('name = "x"\n', "utf-8")
    with pytest.raises(SettingsError) as error:
        load_cell(str(file))
    assert "robot: missing" in error.value.problems
    assert "layout.base: missing" in error.value.problems


@pytest.mark.parametrize(
    ("text", "part"),
    [(b"name = ", "not valid TOML"), (b"\xff\xfe", r"is no text in UTF-8; save it as UTF-8$")],
)
def test_files_that_are_no_toml(tmp_path: Path, text: bytes, part: str) -> None:
    file = tmp_path / "cell.toml"
    file.write_bytes(text)
    with pytest.raises(SettingsError, match=part):
        load_cell(str(file))


def test_a_cell_that_does_not_exist_names_those_that_do() -> None:
    with pytest.raises(SettingsError, match=r"built in: .*paper"):
        load_cell("papper")


@pytest.mark.parametrize("where", ["", "  "])
def test_a_cell_that_was_not_named_names_those_that_are_built_in(where: str) -> None:
    with pytest.raises(SettingsError) as error:
        load_cell(where)
    known = ", ".join(built_in_cells())
    assert "paper" in known
    assert str(error.value) == (
        "cell: 1 problem\n"
        f"  no cell was named; built in are: {known}; or give a path to a TOML file"
    )


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        (".", "is a folder, not a cell file"),
        ("x" * 300, "cannot be read: File name too long"),
        ("cell.toml/x", "cannot be read: Not a directory"),
    ],
)
def test_what_is_no_file_is_said_in_plain_words(tmp_path: Path, name: str, problem: str) -> None:
    (tmp_path / "cell.toml").touch()
    with pytest.raises(SettingsError) as error:
        load_cell(str(tmp_path / name))
    assert error.value.problems == [problem]


def test_the_digest_is_of_the_cell_and_not_of_its_simulation() -> None:
    cell = load_cell("paper")
    assert load_cell("paper", {"simulation.address": "127.0.0.1:1"}).digest == cell.digest
    assert load_cell("paper", {"rail.speed_mm_s": "251.0"}).digest != cell.digest


def test_the_digest_leaves_out_how_long_devices_take() -> None:
    """It changes nothing that stands there, and calibrations written earlier keep their cell."""
    times = {"rail.homing_mm_s": "50.0", "rail.standstill_dwell_s": "1.0", "robot.ramp_s": "1.0"}
    times |= {"tracker.pointing_s": "2.0", "tracker.reading_s": "2.0"}
    assert load_cell("paper", times).digest == load_cell("paper").digest


def test_the_digest_leaves_out_how_stations_are_measured_and_judged() -> None:
    """Calibrations written before there were touch poses keep their cell."""
    judged = {"touch.poses": "20", "layout.max_tool_std_mm": "0.05"}
    assert load_cell("paper", judged).digest == load_cell("paper").digest


def test_an_override_may_be_bare_text() -> None:
    cell = load_cell("paper", {"rail.options.channel": "socket://127.0.0.1:1"})
    assert cell.rail.options["channel"] == "socket://127.0.0.1:1"


FLOOR = '{name="floor", centre={x_mm=0.0, y_mm=0.0, z_mm=-100.0}, size_mm=[9.0, 9.0, 9.0]}'


def test_what_the_arm_keeps_clear_of_changes_nothing_that_was_measured() -> None:
    """A calibration stays that of its cell when a volume is stated later."""
    cell = load_cell("paper")
    assert load_cell("paper", {"keep_out": f"[{FLOOR}]"}).digest == cell.digest
    assert load_cell("paper", {"robot.envelope.clearance_mm": "70.0"}).digest == cell.digest


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("keep_out", "[]", "robot: envelope: there is no keep_out; state at least the floor"),
        ("keep_out", f"[{FLOOR}, {FLOOR}]", "keep_out: names must differ, found floor twice"),
        ("keep_out", '[{name="floor"}]', "keep_out[0].centre: missing"),
        ("robot.envelope.radius_mm", "[1.0, 2.0]", "robot.envelope.radius_mm: "),
        (
            "robot.envelope.radius_mm",
            "[0.0, 1.0, 1.0, 1.0, 1.0, 1.0]",
            "allowed: > 0, <= 1e+06",
        ),
        ("robot.envelope.clearance_mm", "nan", "clearance_mm: nan is not a finite number"),
        ("robot.envelope.clearence_mm", "5.0", 'unknown key; did you mean "clearance_mm"?'),
        (
            "robot.envelope.capsule",
            "[{link=7, from_mm=[0.0, 0.0, 0.0], to_mm=[0.0, 0.0, 1.0], radius_mm=5.0}]",
            "robot.envelope.capsule[0].link: a whole number is wanted",
        ),
        ("keep_out", f"[{', '.join([FLOOR] * 101)}]", "keep_out: 101 volumes, at most 100"),
        (
            "keep_out",
            f"[{FLOOR.replace('9.0]', '-9.0]')}]",
            "keep_out[0].size_mm: ",
        ),
        *(
            (key, value, f"found {found} mm, at least 5 mm is wanted; are these metres?")
            for key, value, found in (
                ("keep_out", f"[{FLOOR.replace('[9.0, 9.0', '[9.0, 0.9')}]", 0.9),
                ("robot.envelope.radius_mm", "[50.0, 50.0, 50.0, 50.0, 50.0, 0.12]", 0.12),
                (
                    "robot.envelope.capsule",
                    "[{link=1, from_mm=[0.0, 0.0, 0.0], to_mm=[0.0, 0.0, 1.0], radius_mm=0.2}]",
                    0.2,
                ),
            )
        ),
        (
            "keep_out",
            f'[{FLOOR[:-1]}, frame="base"}}]',
            "keep_out[0].frame: a known word is wanted",
        ),
    ],
)
def test_volumes_that_make_no_sense_are_refused(key: str, value: str, problem: str) -> None:
    assert any(problem in line for line in refused({key: value}))


def test_volumes_without_an_arm_are_refused(tmp_path: Path) -> None:
    text = (resources.files("hilcell.cells") / "replay.toml").read_text("utf-8")
    (tmp_path / "cell.toml").write_text(text)
    assert load_cell(str(tmp_path / "cell.toml")).surroundings is None
    with pytest.raises(SettingsError, match=r"keep_out: the arm's shape is unknown"):
        load_cell(str(tmp_path / "cell.toml"), {"keep_out": f"[{FLOOR}]"})


@pytest.mark.parametrize(("margin_deg", "low_deg"), [(0.0, 0.5), (2.0, 2.0)])
def test_a_pose_leaves_room_to_come_from_below(margin_deg: float, low_deg: float) -> None:
    robot = load_cell("paper", {"robot.joint_margin_deg": f"{margin_deg}"}).robot
    limits_deg = np.degrees(robot.margin_limits_rad)
    assert limits_deg[0] == pytest.approx([joint.min_deg + low_deg for joint in robot.joint])
    assert limits_deg[1] == pytest.approx([joint.max_deg - margin_deg for joint in robot.joint])


def test_every_other_station_has_a_target() -> None:
    with pytest.raises(SettingsError, match=r"validation.others: 1 targets, wanted one at each of"):
        load_cell("paper", {"validation.others": "1"})


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
    assert (
        one.digest == "b669038506a059db8f6c9a5011fe6d88df32c06b4f4d31ea4a07036b009195cc"
    )  # files of before are of this cell


def test_several_reflectors_cannot_be_carried_by_hand() -> None:
    problems = refused(SEATS | {"layout.reflectors": '"by_hand"'})
    assert any("wants all of them mounted" in line for line in problems)


def test_a_station_that_cannot_be_read_hides_no_other(tmp_path: Path) -> None:
    text = resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")
    file = tmp_path / "cell.toml"
    text = text.replace("rail_mm = 300.0", 'rail_mm = "x"').replace("= 1900.0", "= 91900.0", 1)
    file.write_text(text, "utf-8")
    with pytest.raises(SettingsError) as error:
        load_cell(str(file))
    found = "\n".join(error.value.problems)
    assert "station[0].rail_mm" in found
    assert "station[2].rail_mm: station S1900: rail_mm 91900.0 is outside" in found


LIMIT = "validation.max_tolerance_deg"


def test_a_limit_of_orientation_wants_reflectors_and_is_of_the_cell_where_it_is_stated() -> None:
    three = load_cell("paper", SEATS)
    assert three.validation.max_tolerance_deg is None
    assert load_cell("paper", SEATS | {LIMIT: "0.05"}).digest != three.digest
    (problem,) = refused({LIMIT: "0.05"})
    assert "validation.max_tolerance_deg: one reflector measures no orientation" in problem
    for value in ("0.0", "-0.05", "nan", "181.0"):
        assert refused(SEATS | {LIMIT: value})


def test_options_of_a_driver_that_is_exchanged_are_left_behind() -> None:
    kept = load_cell("paper", {"robot.driver": "kuka-c3", "robot.speed_percent": "20"})
    assert kept.robot.options == load_cell("paper").robot.options != {}
    other = load_cell("paper", {"robot.options.model": "KR16", "robot.driver": "kuka-eki"})
    assert (other.robot.driver, other.robot.options) == ("kuka-eki", {"model": "KR16"})
