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
    for name in ("tracker.noisy", "rail.eof", "robot.frozen"):
        faults.set(name, 0.2, count=0)
    assert [faults.number("tracker.noisy") for _ in range(50)] == [0.2] * 50
    faults.clear("tracker.noisy")
    assert faults.number("tracker.noisy") is None
    assert faults.take("rail.eof") is not None
    faults.clear()
    assert not faults.any_armed


def test_what_lasts_until_cleared_needs_no_count() -> None:
    faults = Faults()
    faults.set("tracker.unadjusted", 60.0, after=1)
    struck = [faults.number("tracker.unadjusted") for _ in range(50)]
    assert struck == [None, *[60.0] * 49]
    faults.clear()
    assert faults.number("tracker.unadjusted") is None


def test_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"rail\.heartbeat_loss"):
        Faults().set("rail.heartbeat_los")


def test_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nname = "rail.emcy"\nvalue = 0x8611\nafter = 1\n')
    faults = load_faults(str(file))
    assert [faults.take("rail.emcy") for _ in range(3)] == [None, 0x8611, None]


@pytest.mark.parametrize(
    ("faults", "names"),
    [
        ({"rail.emci": "1", "tracker.eoff": "1"}, ["rail.emci", "tracker.eoff"]),
        ({"rail.emcy": '"0x8611"'}, ["rail.emcy"]),
        ({"tracker.bad_number": "3.0"}, ["tracker.bad_number"]),
    ],
)
def test_file_names_all_problems(tmp_path: Path, faults: dict[str, str], names: list[str]) -> None:
    file = tmp_path / "faults.toml"
    file.write_text("".join(f'[[fault]]\nname = "{k}"\nvalue = {v}\n' for k, v in faults.items()))
    with pytest.raises(SettingsError) as error:
        load_faults(str(file))
    assert all(name in each for name, each in zip(names, error.value.problems, strict=True))


def test_missing_and_broken_files_are_refused(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("[[fault]\n")
    for path in (broken, tmp_path / "none.toml"):
        with pytest.raises(SettingsError):
            load_faults(str(path))


def test_every_known_fault_is_asked_for_and_no_other() -> None:
    table = Path(faults_module.__file__)
    sources = [file.read_text("utf-8") for file in table.parent.rglob("*.py") if file != table]
    text = "".join(sources)
    asked = set(re.findall(r'"((?:rail|robot|tracker)\.[a-z_0-9]+)"', text))
    assert asked == set(KNOWN)


def test_what_waits_for_a_motion_strikes_at_rest_only_where_it_is_set_so() -> None:
    faults = Faults()
    faults.set("rail.emcy")
    assert faults.take("rail.emcy", moving=False) is None
    assert faults.take("rail.emcy") is True
    faults.set("rail.emcy", at_rest=True)
    assert faults.take("rail.emcy", moving=False) is True
