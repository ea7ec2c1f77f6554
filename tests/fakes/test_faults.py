from __future__ import annotations

import re
from pathlib import Path

import pytest

from fakes import faults as faults_module
from fakes.faults import KNOWN, Faults, load_faults
from hilcell.cell.settings import SettingsError


def test_strikes_after_and_as_often_as_wanted() -> None:
    faults = Faults()
    faults.set("robot.no_reply", after=2, count=2)
    struck = [faults.take("robot.no_reply") for _ in range(6)]
    assert struck == [None, None, True, True, None, None]


def test_count_zero_strikes_until_cleared() -> None:
    faults = Faults()
    faults.set("tracker.noisy", 0.2, count=0)
    assert [faults.number("tracker.noisy") for _ in range(50)] == [0.2] * 50
    faults.clear("tracker.noisy")
    assert faults.number("tracker.noisy") is None


def test_clear_without_a_name_clears_all() -> None:
    faults = Faults()
    faults.set("tracker.eof")
    faults.set("rail.eof")
    faults.clear()
    assert faults.take("tracker.eof") is None
    assert faults.take("rail.eof") is None


def test_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r'did you mean "rail.heartbeat_loss"'):
        Faults().set("rail.heartbeat_los")


def test_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nname = "rail.emcy"\nvalue = 0x8611\nafter = 1\n')
    faults = load_faults(str(file))
    assert [faults.take("rail.emcy") for _ in range(3)] == [None, 0x8611, None]


def test_file_names_all_problems(tmp_path: Path) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nname = "rail.emci"\n[[fault]]\nname = "tracker.eoff"\n')
    with pytest.raises(SettingsError) as error:
        load_faults(str(file))
    assert len(error.value.problems) == 2


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("rail.emcy", '"0x8611"', "a number"),
        ("tracker.noisy", '"much"', "a number"),
        ("tracker.bad_number", "3.0", "text"),
    ],
)
def test_a_value_of_the_wrong_type_is_refused(
    tmp_path: Path, name: str, value: str, wanted: str
) -> None:
    file = tmp_path / "faults.toml"
    file.write_text(f'[[fault]]\nname = "{name}"\nvalue = {value}\n')
    with pytest.raises(SettingsError, match=f"fault '{name}': the value .* is not {wanted}"):
        load_faults(str(file))


def test_missing_and_broken_files_are_refused(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("[[fault]\n")
    for path in (broken, tmp_path / "none.toml"):
        with pytest.raises(SettingsError, match="cannot be read"):
            load_faults(str(path))


def test_every_fault_states_its_occasion() -> None:
    assert all(text.count("|") == 1 for text in KNOWN.values())


def test_every_known_fault_is_asked_for_and_no_other() -> None:
    folder = Path(faults_module.__file__).parent
    sources = [file for file in folder.rglob("*.py") if file.name != "faults.py"]
    text = "".join(file.read_text("utf-8") for file in sources)
    asked = set(re.findall(r'"((?:rail|robot|tracker)\.[a-z_0-9]+)"', text))
    assert asked == set(KNOWN)


def test_what_waits_for_a_motion_strikes_at_rest_only_where_it_is_set_so() -> None:
    faults = Faults()
    faults.set("rail.emcy")
    assert faults.take("rail.emcy", moving=False) is None
    assert faults.take("rail.emcy") is True
    faults.set("rail.emcy", at_rest=True)
    assert faults.take("rail.emcy", moving=False) is True
