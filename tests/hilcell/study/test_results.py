"""Results are kept as they come, once each, and only with their own study."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hilcell.cell.file import Cell
from hilcell.errors import HilcellError
from hilcell.run.cell_lock import CellLocked
from hilcell.study.case import CaseResult
from hilcell.study.cluster import ClusterError
from hilcell.study.design import Case, cases
from hilcell.study.results import OtherStudy, Results, case_row, open_results
from hilcell.study.study_file import study_cell
from tests.hilcell.commands.full_disk import files_limited_to
from tests.hilcell.study.studies import TWO_FACTORS, Bench, performed, study
from tests.whole.bench import command

NO_PITCH = TWO_FACTORS.replace("grid.centre.x_mm", "grid.pitch_mm").replace("3850.0", "400.0")


def found(case: Case, cell: Cell) -> CaseResult:
    assert cell.name == "paper"
    figures = {"mean_mm": case.number / 1000.0, "covered": 0.95, "targets": 50.0}
    return CaseResult("done", "", 10.0, figures)


@pytest.fixture
def results(tmp_path: Path) -> Results:
    """Return a folder of a study whose 8 cases are done."""
    made = Results(tmp_path / "r", study(tmp_path))
    assert performed(made, Bench(found)) == {"done": 8}
    return made


def test_a_study_is_kept_in_one_file(results: Results, tmp_path: Path) -> None:
    (file,) = (tmp_path / "r/cases").iterdir()
    table = pq.read_table(tmp_path / "r/cases")  # as pandas, Polars and DuckDB read it
    assert table.num_rows == pq.read_table(file).num_rows == 8
    assert table["case"].to_pylist() == list(range(1, 9))
    assert table["readings"].to_pylist() == [2.0, 2.0, 5.0, 5.0] * 2
    assert table["place"].to_pylist() == ["near", "far"] * 4
    assert table["cost"].to_pylist() == [0.0, 0.0, 100.0, 100.0] * 2
    assert table["mean_mm"].to_pylist()[:2] == [0.001, 0.002]
    assert table["max_mm"].null_count == 8  # not found by this bench


NEW_THREADS = """
import os, sys
from pathlib import Path
from hilcell.study.results import open_results
results = open_results(Path(sys.argv[1]))
before = set(os.listdir("/proc/self/task"))
with results.held():
    results.add(results.rows())
    results.merge()
print(results.table().num_rows, *set(os.listdir("/proc/self/task")) - before)
"""


@pytest.mark.process
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are seen on Linux")
def test_rows_are_read_and_written_without_threads(results: Results) -> None:
    """Arrow's threads now and then abort a process that has done all its work, at its end."""
    words = [sys.executable, "-c", NEW_THREADS, str(results.folder)]
    assert subprocess.check_output(words, text=True).split() == ["8"]


@pytest.mark.parametrize("name", ["s3:", "hdfs:a b", "~", "*[é]\n", "\udcff"])
def test_a_folder_may_have_any_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    results = Results(Path(name), study(tmp_path))
    assert performed(results, Bench(found)) == {"done": 8}
    assert len(open_results(Path(name)).finished()) == 8


def test_a_study_goes_on_with_the_cases_that_are_left(tmp_path: Path) -> None:
    results, asked = Results(tmp_path / "r", study(tmp_path)), study(tmp_path)
    with pytest.raises(ClusterError):
        performed(results, Bench(found, most=3))
    assert results.finished() == {1, 2, 3}
    bench = Bench(found)
    assert performed(Results(tmp_path / "r", asked), bench) == {"done": 5}
    assert performed(results, bench) == {}
    assert bench.measured == [4, 5, 6, 7, 8]
    whole = Results(tmp_path / "once", asked)
    performed(whole, Bench(found))
    assert results.table() == whole.table()


def test_a_row_in_two_files_counts_once(tmp_path: Path) -> None:
    """A kill between the whole file and the removal of its parts leaves both."""
    asked = study(tmp_path)
    results = Results(tmp_path / "r", asked)
    with results.held():
        rows = [case_row(case, found(case, study_cell(asked, {})), asked) for case in cases(asked)]
        results.add(rows[:3])
        part = next((tmp_path / "r/cases").iterdir())
        kept = part.read_bytes()
        results.add(rows[3:])
        results.merge()
        part.write_bytes(kept)
        assert results.table()["case"].to_pylist() == list(range(1, 9))


def test_a_cell_that_cannot_be_is_a_row(tmp_path: Path) -> None:
    results = Results(tmp_path / "r", study(tmp_path, NO_PITCH.replace("1850.0", "450.0")))
    assert performed(results, Bench(found)) == {"done": 4, "cannot be": 4}
    rows = [row for row in results.rows() if row.state == "cannot be"]
    assert {row.levels["place"] for row in rows} == {"far"}
    assert "400.0 mm" in rows[0].reason
    assert rows[0].figures["mean_mm"] is None


def test_results_of_another_study_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of other machines, of another base cell, of another version of hilcell."""
    text = Path("hilcell/cells/paper.toml").read_text("utf-8")
    (tmp_path / "own.toml").write_text(text)
    head = 'machines = 2\ncell = "own.toml"'
    asked = study(tmp_path, head=head)
    performed(Results(tmp_path / "r", asked), Bench(found))
    with pytest.raises(OtherStudy, match="machines"):
        performed(
            Results(tmp_path / "r", study(tmp_path, head=head.replace("2", "3"))), Bench(found)
        )
    (tmp_path / "own.toml").write_text(text + "\n# another hand\n")
    with pytest.raises(OtherStudy, match="cell"):
        performed(Results(tmp_path / "r", study(tmp_path, head=head)), Bench(found))
    monkeypatch.setattr("hilcell.study.case.__version__", "9.9.9")
    with pytest.raises(OtherStudy, match=r"9\.9\.9"):
        performed(Results(tmp_path / "r", asked), Bench(found))


@pytest.mark.parametrize("place", ["r/cases", "r/cases/../cases/deeper", "link"])
@pytest.mark.usefixtures("results")
def test_a_folder_within_other_results_is_refused_and_not_made(tmp_path: Path, place: str) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "r/cases")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(OtherStudy):
        performed(Results(tmp_path / place, study(tmp_path)), Bench(found))
    assert sorted(tmp_path.rglob("*")) == before


def test_two_studies_do_not_write_one_folder(tmp_path: Path) -> None:
    asked = study(tmp_path)
    with (
        Results(tmp_path / "r", asked).held(),
        pytest.raises(CellLocked),
        Results(tmp_path / "r", asked).held(),
    ):
        raise AssertionError("both hold it")


def test_a_damaged_file_is_named(results: Results) -> None:
    (file,) = (results.folder / "cases").iterdir()
    file.write_bytes(file.read_bytes()[:-40])
    with pytest.raises(OtherStudy, match=r"all\.parquet"):
        results.table()
    file.unlink()
    bench = Bench(found)
    performed(results, bench)
    assert bench.measured == list(range(1, 9))


def test_no_bit_that_has_turned_changes_a_figure(results: Results) -> None:
    """Without sums of its pages a file whose figures have changed reads as if it were sound."""
    (file,) = (results.folder / "cases").iterdir()
    sound, wanted, named = file.read_bytes(), results.table(), 0
    for at in range(0, len(sound), 97):
        file.write_bytes(sound[:at] + bytes([sound[at] ^ 4]) + sound[at + 1 :])
        try:
            assert results.table() == wanted, at
        except OtherStudy:
            named += 1
    assert named > 0


@pytest.mark.parametrize(
    "wrong",
    [{"mean_mm": float("nan")}, {"minutes": None}, {"case": 9}, {"case": None},
     {"state": "perhaps"}, {"readings": 3.0}, {"place": None}],
)  # fmt: skip
def test_a_row_that_no_study_wrote_is_named(results: Results, wrong: dict[str, object]) -> None:
    (file,) = (results.folder / "cases").iterdir()
    rows = pq.read_table(file).to_pylist()
    rows[1] |= wrong
    pq.write_table(pa.Table.from_pylist(rows, pq.read_schema(file)), file)
    with pytest.raises(OtherStudy, match=r"all\.parquet"):
        results.table()


@pytest.mark.parametrize("place", ["mine", "new/r"])
def test_a_full_disk_at_the_start_leaves_nothing(tmp_path: Path, place: str) -> None:
    study(tmp_path)  # writes its file
    (tmp_path / "mine").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with files_limited_to(0):  # names are taken, but nothing stands in them
        done = command("study", tmp_path / "study.toml", "-o", tmp_path / place)
    assert (done.returncode, done.stdout) == (7, "")
    assert str(tmp_path / place) in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_rows_of_another_study_with_the_same_columns_are_refused(
    results: Results, tmp_path: Path
) -> None:
    performed(Results(tmp_path / "other", study(tmp_path, head="machines = 3")), Bench(found))
    strange = tmp_path / "r/cases/part-0000001.parquet"
    (tmp_path / "other/cases/all.parquet").rename(strange)
    wanted = r"part-0000001\.parquet"
    with pytest.raises(OtherStudy, match=wanted):
        performed(Results(tmp_path / "r", study(tmp_path)), Bench(found))
    with pytest.raises(OtherStudy, match=wanted):
        open_results(tmp_path / "r").table()
    strange.unlink()
    assert open_results(tmp_path / "r").table() == results.table()


@pytest.mark.parametrize(
    "change",
    [
        lambda found: found.replace_schema_metadata(None),  # which says whose rows they are
        lambda found: found.drop_columns(["minutes"]),
    ],
)
def test_a_file_of_another_form_is_named(
    results: Results, change: Callable[[pa.Table], pa.Table]
) -> None:
    file = results.folder / "cases/all.parquet"
    pq.write_table(change(pq.read_table(file)), file)
    with pytest.raises(OtherStudy, match=r"all\.parquet"):
        open_results(results.folder).table()


@pytest.mark.parametrize(
    "make", [os.mkfifo, Path.mkdir, lambda place: place.symlink_to("/dev/zero")]
)
def test_rows_that_are_no_file_are_named(results: Results, make: Callable[[Path], None]) -> None:
    make(results.folder / "cases/part-0000009.parquet")
    with pytest.raises(OtherStudy, match=r"0009\.parquet"):
        results.table()


@pytest.mark.parametrize(
    "make",
    [
        lambda place: None,
        lambda place: place.write_bytes(b'{"study": 3}'),
        lambda place: place.write_bytes(b"\xff"),
        os.mkfifo,
        lambda place: place.symlink_to("/dev/zero"),
        lambda place: place.symlink_to(place),
        Path.mkdir,
    ],
)
def test_a_folder_without_results_is_refused(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    (tmp_path / "r").mkdir()
    make(tmp_path / "r/study.json")
    with pytest.raises(OtherStudy):
        open_results(tmp_path / "r")
    if (tmp_path / "r/study.json").exists():
        with pytest.raises(HilcellError):
            performed(Results(tmp_path / "r", study(tmp_path)), Bench(found))
