"""`check` and `show RUN --check` as commands, in this process."""

import json
import re
from importlib import resources
from pathlib import Path

import pytest

from hilcell.cell.source import read_source
from hilcell.invariants import INVARIANTS
from hilcell.journal.journal import Journal
from hilcell.journal.runs import JOURNAL
from tests.hilcell.invariants.doctored import Doctored
from tests.whole.bench import command


@pytest.fixture
def text() -> str:
    return resources.files("hilcell.cells").joinpath("paper.toml").read_text("utf-8")


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return tmp_path / "mine.toml"


def refused(*words: str | Path) -> str:
    done = command("check", *words)
    assert (done.returncode, done.stdout) == (2, "")
    return done.stderr


@pytest.mark.parametrize(
    "setting", ["touch.station=NIX", 'targets={file="targets.csv", station="NIX"}']
)
def test_stations_of_other_procedures_are_known(setting: str) -> None:
    assert "S300, S1100" in refused("paper", "--set", setting)


def test_an_unknown_driver_is_named_beside_the_other_problems(cell: Path, text: str) -> None:
    for changed in (text, text.replace("pitch_mm", "pitch")):
        cell.write_text(changed.replace('driver = "canopen"', 'driver = "canopn"'), "utf-8")
        found = refused(cell)
        assert "rail.driver: " in found
        assert '"canopen"' in found
        assert ("grid.pitch: " in found) is (changed is not text)


@pytest.mark.parametrize("words", [["check", "paper"], ["run", "calibrate"]])
def test_an_unknown_driver_is_one_problem(words: list[str]) -> None:
    """`run` gave it for each act that plans with a robot, `check` for the simulator as well."""
    done = command(*words, "--set", "robot.driver=nope")
    assert done.returncode == 2
    assert done.stderr.count("'nope' is not installed") == 1


@pytest.mark.parametrize("words", [["check"], ["run", "home", "--cell"]])
def test_options_of_a_driver_that_was_exchanged_are_not_the_files(
    words: list[str], cell: Path, text: str
) -> None:
    own = text.replace('name = "paper"', 'name = "mine"', 1).replace("HC-2014", "M-1")
    cell.write_text(own.partition("[simulation]")[0], "utf-8")
    done = command(*words, cell, "--set", "robot.driver=kuka-eki")
    assert done.returncode == 2
    assert "robot.options: host: " in done.stderr


def test_an_unknown_form_of_programs_is_named_with_those_installed() -> None:
    done = command("check", "paper", "--set", "robot.program=fanuc")
    assert done.returncode == 2
    assert "robot.program: " in done.stderr
    assert "fanuc-tp, " in done.stderr
    assert command("check", "paper", "--set", "robot.program=fanuc-tp").returncode == 0


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"name = 'x'\nserial = \n", ":2:"),
        ("name = 'Zelle f\u00fcr L\u00f6cher'".encode("latin-1"), ""),
        (None, ""),
    ],
)
def test_a_file_that_is_no_text_of_a_cell_is_refused(
    cell: Path, content: bytes | None, line: str
) -> None:
    with cell.open("wb") as file:
        if content is None:
            file.truncate(10**12)  # is not read
        else:
            file.write(content)
    assert f"{cell}{line}" in refused(cell)


def test_steps_that_do_nothing_are_named_with_their_cost() -> None:
    full = ("--set", "plan.quick=false")
    words = ("check", "paper", "--set", "tracker.driver=leica-geocom", *full)
    done = command(*words, "--json")
    (_, note, _) = notes = json.loads(done.stdout)["notes"]
    assert [each.split()[0] for each in notes] == ["two-face", "axis-sweeps", "two-face-closing"]
    assert done.returncode == 0
    assert note.startswith("axis-sweeps ")
    assert note in command(*words).stderr.splitlines()
    assert json.loads(command("check", "paper", "--json", *full).stdout)["notes"] == []
    quick = json.loads(command("check", "paper", "--json").stdout)
    assert [each.split()[0] for each in quick["notes"]] == ["two-face", "two-face-closing"]


def test_a_real_cell_without_the_pause_at_a_first_pass_is_noted(cell: Path, text: str) -> None:
    own = text.replace('name = "paper"', 'name = "mine"', 1).replace("HC-2014", "M-1")
    cell.write_text(own.partition("[simulation]")[0], "utf-8")
    for pauses in ("true", "false"):
        done = command("check", cell, "--json", "--set", f"robot.first_pass_pause={pauses}")
        notes = json.loads(done.stdout)["notes"]
        assert any("first_pass_pause" in note for note in notes) is (pauses == "false")


@pytest.mark.parametrize(
    ("settings", "warned"),
    [
        ((), "U = 0.70 mm"),
        (("tracker.samples=5",), "U = 0.31 mm"),
        (("tracker.samples=6",), ""),
        (("validation.max_tolerance_mm=0.8",), ""),
        (("tracker.options.distance_mm=0.1",), ""),
        (("tracker.driver=leica-emscon",), ""),
    ],
)
def test_an_instrument_whose_class_leaves_no_room_is_a_warning_and_no_refusal(
    settings: tuple[str, ...], warned: str
) -> None:
    words = ["--set", "tracker.driver=leica-geocom", *(w for s in settings for w in ("--set", s))]
    done = command("check", "paper", *words, "--json")
    found = json.loads(done.stdout)["warnings"]
    assert (done.returncode, len(found)) == (0, bool(warned))
    assert all(warned in each and "tracker.samples 6" in each for each in found)
    if settings:
        return
    for shown in (["check", "paper"], ["run", "--cell", "paper", "--dry-run"]):
        done = command(*shown, *words)
        assert done.returncode == 0
        assert warned in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("settings", "least_mm", "warned"),
    [
        (["validation.mean_tolerance_mm=0.05"], 0.053, True),
        (["validation.mean_tolerance_mm=0.055"], 0.053, False),
        (["validation.mean_tolerance_mm=0.05", "uncertainty.smr_centring_limit_mm=0.003"],
         0.0375, False),
    ],
)  # fmt: skip
def test_a_mean_tolerance_that_cannot_be_proven_is_a_warning_with_the_least_that_can(
    settings: list[str], least_mm: float, warned: bool
) -> None:
    done = command("check", "paper", "--json", *(w for s in settings for w in ("--set", s)))
    found = json.loads(done.stdout)
    assert found["least_mean_tolerance_mm"] == pytest.approx(least_mm, abs=0.002)
    assert (done.returncode, len(found["warnings"])) == (0, warned)
    assert all(f"{found['least_mean_tolerance_mm']:.3f} mm" in each for each in found["warnings"])


def test_problems_stand_in_the_order_of_their_lines(cell: Path, text: str) -> None:
    spoilt = text.replace('driver = "canopen"', 'driver = "canopn"').replace("pitch_mm", "pitch")
    cell.write_text(f"{spoilt}\n[survey]\nfrom_mm = 'x'\nto_mm = 'y'\n", "utf-8")
    found = [int(n) for n in re.findall(r"mine\.toml:(\d+): ", refused(cell))]
    assert len(found) >= 4
    assert found == sorted(found)
    cell.write_text(f"{text}\n[survey]\nfrom_mm = -90000.0\nto_mm = 90000.0\n", "utf-8")
    said, count = refused(cell), text.count("\n")
    assert f"{cell}:{count + 3}: survey.from_mm: " in said
    assert f"{cell}:{count + 4}: survey.to_mm: " in said


def test_many_problems_are_shown_at_once(cell: Path) -> None:
    odd = "".join(f"odd_{n} = {n}\n" for n in range(14))
    cell.write_text(odd + read_source("paper"), "utf-8")
    shown = refused(cell)
    assert [f"odd_{n}:" in shown for n in range(14)] == [True] * 14


def written(runs: Path, journal: Doctored) -> list[str]:
    """Write a journal to a folder of runs; return the words that check it."""
    folder = runs / "one"
    folder.mkdir()
    file = Journal(folder / JOURNAL, "one", create=True)
    for _, kind, key, body in journal.rows:
        file.append(kind, key, body)
    file.close()
    return ["show", "one", "--check", "--runs", str(runs)]


def test_a_good_run_holds_all(tmp_path: Path) -> None:
    done = command(*written(tmp_path, Doctored()), "--json")
    found = json.loads(done.stdout)
    assert done.returncode == 0
    assert found["run"] == "one"
    assert list(found["invariants"]) == list(INVARIANTS)
    for facts in found["invariants"].values():
        assert facts["holds"] is True
        assert facts["checked"] > 0
        assert facts["broken"] == facts["unproven"] == []


def test_a_broken_one_is_named_with_its_record(tmp_path: Path) -> None:
    journal = Doctored().change("move 1", seen__powered=True)
    words = written(tmp_path, journal.change("closed", problems={"Rail": "\x1b[31mno answer"}))
    done = command(*words, "--json")
    found = json.loads(done.stdout)["invariants"]
    assert done.returncode == 1
    assert [name for name, each in found.items() if not each["holds"]] == ["I2"]
    (broken,) = found["I2"]["broken"]
    assert broken["record"] == journal.at("move 1") + 1
    shown = command(*words)
    assert shown.returncode == 1
    assert f"record {broken['record']}: {broken['what']}" in shown.stderr
    assert "\x1b" not in shown.stdout + shown.stderr


def test_nothing_is_claimed_that_was_not_judged(tmp_path: Path) -> None:
    journal = Doctored()
    journal.rows = journal.rows[:3]
    done = command(*written(tmp_path, journal))
    assert done.returncode == 0
    assert done.stdout.count("not checked") == 16  # all but I8 and I9
