"""The table of deliberate breaks is true of this checkout; the program tells what survives."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.mutants.judging import Copy
from tests.mutants.table import ROOT, Mutant, TableError, mutants

TABLE = mutants()
ROOMS = ("drivers", "fakes", "procedures", "hilcell")
LEAST = 40


def test_every_break_can_be_made() -> None:
    problems = []
    for mutant in TABLE:
        try:
            mutant.check(ROOT)
        except TableError as error:
            problems.append(str(error))
    if problems:
        pytest.fail("\n".join(problems))


def test_there_are_enough_in_all_rooms() -> None:
    assert len({mutant.name for mutant in TABLE}) == len(TABLE) >= LEAST
    assert {mutant.file.split("/")[0] for mutant in TABLE} == set(ROOMS)
    rooms = {path.parent.name for path in ROOT.glob("hilcell/*/__init__.py")}
    broken = {mutant.file.split("/")[1] for mutant in TABLE if mutant.file.startswith("hilcell/")}
    assert rooms <= broken


SOUND = Mutant("sign", "arm.py", "a - e", "a + e", "The sign.", ("test_arm.py",))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A project of one module and its test."""
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "arm.py").write_text("def sent(a, e):\n    return a - e\n\n\nUNUSED = 3\n")
    (folder / "test_arm.py").write_text(
        "import arm\n\n\ndef test_sign():\n    assert arm.sent(5, 2) == 3\n"
    )
    return folder


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"old": "a * e"}, "0 times, wanted once"),
        ({"old": "e"}, "times, wanted once"),
        ({"file": "leg.py"}, "no file leg.py"),
        ({"new": "a +"}, "no Python"),
        ({"tests": ("test_leg.py",)}, "no test test_leg.py"),
        ({"tests": ("test_arm.py::test_leg",)}, "no test test_arm.py::test_leg"),
    ],
)
def test_a_row_that_has_rotted_is_an_error(
    root: Path, change: dict[str, object], message: str
) -> None:
    rotten = replace(SOUND, **change)  # type: ignore[arg-type] # fields of different types
    with pytest.raises(TableError, match=message):
        rotten.check(root)


def test_a_break_is_made_in_a_copy_and_caught_there(root: Path, tmp_path: Path) -> None:
    before = (root / "arm.py").read_bytes()
    verdict = Copy(root, tmp_path / "copy").judge(SOUND)
    assert verdict.caught, verdict.output
    assert "assert 7 == 3" in verdict.output
    assert (root / "arm.py").read_bytes() == before


@pytest.mark.parametrize(
    ("code", "verdict"), [(0, "SURVIVED"), (1, "caught"), (2, "NOT RUN"), (None, "TIMEOUT")]
)
def test_a_test_that_fails_catches_and_nothing_else(
    root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    code: int | None,
    verdict: str,
) -> None:
    monkeypatch.setattr(Copy, "run", lambda *_: (code, ""))
    assert Copy(root, tmp_path / "copy").judge(SOUND).verdict == verdict
