"""`check` as a command, in this process."""

import json
import re
from importlib import resources
from pathlib import Path

import pytest

from hilcell.cell.source import read_source
from hilcell.commands.cli import main


@pytest.mark.parametrize(
    "setting", ["touch.station=NIX", 'targets={file="targets.csv", station="NIX"}']
)
def test_stations_of_other_procedures_are_known(
    capsys: pytest.CaptureFixture[str], setting: str
) -> None:
    assert main(["check", "paper", "--set", setting]) == 2
    assert "station 'NIX' is unknown; known here: S300, S1100" in capsys.readouterr().err


def test_an_unknown_driver_is_named_beside_the_other_problems(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")
    cell = tmp_path / "mine.toml"
    for changed in (text, text.replace("pitch_mm", "pitch")):
        cell.write_text(changed.replace('driver = "canopen"', 'driver = "canopn"'), "utf-8")
        assert main(["check", str(cell)]) == 2
        found = capsys.readouterr().err
        assert f"{cell}:" in found
        assert "rail.driver: 'canopn' is not installed; did you mean \"canopen\"?" in found
        assert ("grid.pitch: unknown key" in found) is (changed is not text)


@pytest.mark.parametrize("words", [["check"], ["run", "home", "--cell"]])
def test_options_of_a_driver_that_was_exchanged_are_not_the_files(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")
    cell = tmp_path / "mine.toml"
    own = text.replace('name = "paper"', 'name = "mine"', 1).replace("HC-2014", "M-1")
    cell.write_text(own.partition("[simulation]")[0], "utf-8")
    assert main([*words, str(cell), "--set", "robot.driver=kuka-eki"]) == 2
    found = capsys.readouterr().err
    assert "  robot.options: host: missing; the options of 'kuka-c3' in the cell file do" in found
    assert "to 'kuka-eki': state them by --set robot.options.KEY=VALUE, or" in found


def test_a_file_that_is_no_toml_is_refused_by_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = tmp_path / "mine.toml"
    cell.write_text("name = 'x'\nserial = \n")
    assert main(["check", str(cell)]) == 2
    assert f"{cell}:2: not valid TOML" in capsys.readouterr().err


def test_a_huge_file_is_not_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = tmp_path / "mine.toml"
    with cell.open("wb") as file:
        file.truncate(10**12)
    assert main(["check", str(cell)]) == 2
    assert "wanted at most" in capsys.readouterr().err


def test_steps_that_do_nothing_are_named_with_their_cost(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["check", "paper", "--set", "tracker.driver=leica-geocom"]
    note = (
        "axis-sweeps does nothing: tracker driver 'leica-geocom' does not stream; "
        "the ripple of the gears stays in the error after correction"
    )
    assert main(words) == 0
    assert note in capsys.readouterr().err.splitlines()
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == [note]
    assert main(["check", "paper", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == []


@pytest.mark.parametrize(
    ("settings", "warned"),
    [
        ((), "U = 0.70 mm (k = 2) with 1 reading a target at 4.4 m"),
        (("tracker.samples=5",), "U = 0.31 mm (k = 2) with 5 readings"),
        (("tracker.samples=6",), ""),
        (("validation.max_tolerance_mm=0.8",), ""),
        (("tracker.options.distance_mm=0.1",), ""),
        (("tracker.driver=leica-emscon",), ""),
    ],
)
def test_an_instrument_whose_class_leaves_no_room_is_a_warning_and_no_refusal(
    capsys: pytest.CaptureFixture[str], settings: tuple[str, ...], warned: str
) -> None:
    words = ["--set", "tracker.driver=leica-geocom", *(w for s in settings for w in ("--set", s))]
    assert main(["check", "paper", *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["warnings"]
    assert len(found) == bool(warned)
    assert warned in "".join(found)
    assert all("State tracker.samples 6 or more" in each for each in found)
    for command in (["check", "paper"], ["run", "--cell", "paper", "--dry-run"]):
        assert main([*command, *words]) == 0
        said = capsys.readouterr().err
        assert ("warning: validate: no result can be shown to be in tolerance" in said) is bool(
            warned
        )


def test_problems_stand_in_the_order_of_their_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")
    text = text.replace('driver = "canopen"', 'driver = "canopn"').replace("pitch_mm", "pitch")
    cell = tmp_path / "mine.toml"
    cell.write_text(f"{text}\n[survey]\nfrom_mm = 'x'\nto_mm = 'y'\n", "utf-8")
    assert main(["check", str(cell)]) == 2
    found = [int(n) for n in re.findall(r"mine\.toml:(\d+): ", capsys.readouterr().err)]
    assert len(found) >= 4
    assert found == sorted(found)


def test_both_ends_of_the_survey_have_their_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")
    cell = tmp_path / "mine.toml"
    cell.write_text(f"{text}\n[survey]\nfrom_mm = -90000.0\nto_mm = 90000.0\n", "utf-8")
    assert main(["check", str(cell)]) == 2
    said, count = capsys.readouterr().err, text.count("\n")
    assert f"{cell}:{count + 3}: survey.from_mm: -90000.0 mm is outside the travel" in said
    assert f"{cell}:{count + 4}: survey.to_mm: 90000.0 mm is outside the travel" in said


def test_a_cell_file_in_another_coding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cell = tmp_path / "mine.toml"
    cell.write_bytes("name = 'Zelle für Löcher'".encode("latin-1"))
    assert main(["check", str(cell)]) == 2
    assert "is no text in UTF-8; save it as UTF-8" in capsys.readouterr().err


def test_many_problems_are_shown_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "cell.toml"
    odd = "".join(f"odd_{n} = {n}\n" for n in range(14))
    file.write_text(odd + read_source("paper"), "utf-8")
    assert main(["check", str(file)]) == 2
    shown = capsys.readouterr().err
    assert [f"odd_{n}:" in shown for n in range(14)] == [True] * 14
    assert "more" not in shown
