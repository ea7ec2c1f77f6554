"""A cell file copied from a built-in one is noticed."""

from importlib import resources
from pathlib import Path

import pytest

from hilcell.cell.differences import check_identity
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError

PAPER = (resources.files("hilcell.cells") / "paper.toml").read_text("utf-8")
REAL = PAPER.split("[simulation]")[0]


def warning_of(file: Path, text: str) -> str:
    file.write_text(text)
    return check_identity(str(file), load_cell(str(file)))


def own(text: str) -> str:
    text = text.replace('certificate = "simulated"', 'certificate = "K-4711"')
    return text.replace('"paper"', '"shop"', 1).replace("HC-2014", "HC-7")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "cell.toml"


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        (REAL, ["name", "serial"]),
        (own(REAL).replace("HC-7", "HC-2014"), ["serial"]),
        (REAL.replace("HC-2014", "HC-7"), ["name"]),
    ],
)
def test_a_real_cell_with_name_or_serial_of_a_built_in_one_is_refused(
    file: Path, text: str, keys: list[str]
) -> None:
    with pytest.raises(SettingsError) as caught:
        warning_of(file, text)
    assert [problem.split(":")[0] for problem in caught.value.problems] == keys


def test_a_simulated_cell_that_differs_is_warned_of(file: Path) -> None:
    warning = warning_of(file, PAPER.replace("speed_mm_s = 250.0", "speed_mm_s = 200.0"))
    assert "name: " in warning
    assert str(file) in warning


def test_cells_of_their_own_and_the_built_in_ones_are_not(file: Path) -> None:
    assert warning_of(file, own(REAL)) == ""
    assert warning_of(file, PAPER) == ""  # the same cell
    assert check_identity("paper", load_cell("paper", {"rail.speed_mm_s": "9.0"})) == ""
    overridden = {"name": "shop", "serial": "HC-7"}
    file.write_text(own(REAL).replace("HC-7", "HC-2014"))
    assert check_identity(str(file), load_cell(str(file), overridden)) == ""


def test_a_real_cell_s_lengths_need_a_certificate(file: Path) -> None:
    text = own(REAL).replace('certificate = "K-4711"', 'certificate = "simulated"')
    assert "layout.length B1 to B2" in warning_of(file, text)


def test_an_attended_run_pauses_before_it_leaves_the_cube_of_a_real_cell(file: Path) -> None:
    stated = "[robot]\nfirst_pass_pause = "
    for text, pauses in (
        (own(REAL), True),
        (own(REAL).replace("[robot]\n", f"{stated}false\n"), False),
        (PAPER, False),
        (PAPER.replace("[robot]\n", f"{stated}true\n"), True),
    ):
        file.write_text(text)
        assert load_cell(str(file)).pauses_at_first_pass is pauses
