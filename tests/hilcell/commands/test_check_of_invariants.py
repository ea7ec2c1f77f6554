"""`show RUN --check` prints what the trace checker finds, and ends with 1 where it is broken."""

import json
from pathlib import Path

import pytest

from hilcell.commands.cli import main
from hilcell.invariants.tally import INVARIANTS
from hilcell.journal.journal import Journal
from hilcell.journal.runs import JOURNAL
from tests.hilcell.invariants.doctored import Doctored


def written(runs: Path, journal: Doctored) -> list[str]:
    """Write a journal to a folder of runs; return the words that check it."""
    folder = runs / "one"
    folder.mkdir()
    file = Journal(folder / JOURNAL, "one", create=True)
    for _, kind, key, body in journal.rows:
        file.append(kind, key, body)
    file.close()
    return ["show", "one", "--check", "--runs", str(runs)]


def test_a_good_run_holds_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*written(tmp_path, Doctored()), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["run"] == "one"
    assert list(found["invariants"]) == list(INVARIANTS)
    for facts in found["invariants"].values():
        assert facts["holds"] is True
        assert facts["checked"] > 0
        assert facts["broken"] == facts["unproven"] == []


def test_what_is_broken_is_named_with_its_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    journal = Doctored().change("move 1", seen__powered=True)
    words = written(tmp_path, journal.change("closed", problems={"Rail": "\x1b[31mno answer"}))
    assert main([*words, "--json"]) == 1
    found = json.loads(capsys.readouterr().out)["invariants"]
    assert [name for name, each in found.items() if not each["holds"]] == ["I2"]
    (broken,) = found["I2"]["broken"]
    assert broken == {
        "record": journal.at("move 1") + 1,
        "what": "robot.move grid/1: the drive had power to move",
    }
    assert main(words) == 1
    out, err = capsys.readouterr()
    assert "BROKEN" in out
    assert f"I2 broken at record {broken['record']}: {broken['what']}" in err
    assert "I12 not proven at record" in err
    assert "\x1b" not in out + err


def test_only_the_first_places_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    journal = Doctored().change("plan", cell__rail__strip_tolerance_mm=0.0)
    assert main(written(tmp_path, journal)) == 1
    assert "I2 broken at 2 more records" in capsys.readouterr().err


def test_nothing_is_claimed_of_what_was_not_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    journal = Doctored()
    journal.rows = journal.rows[:3]
    assert main(written(tmp_path, journal)) == 0
    out = capsys.readouterr().out
    assert out.count("not checked") == 16  # all but I8 and I9
