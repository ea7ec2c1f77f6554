"""`show RUN --check` prints what the trace checker finds, and ends with 1 where it is broken."""

import json
from pathlib import Path

from hilcell.invariants.tally import INVARIANTS
from hilcell.journal.journal import Journal
from hilcell.journal.runs import JOURNAL
from tests.hilcell.invariants.doctored import Doctored
from tests.whole.bench import command


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
