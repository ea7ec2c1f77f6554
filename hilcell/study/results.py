"""The folder of a study's results: the question (`study.json`), and rows as Parquet.

Each batch of rows is a file (`cases/part-*.parquet`), written completely or not at all; at the end
they are merged (`cases/all.parquet`). A row in a file is final.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from hilcell.atomic_files import STORAGE, DiskFailed, NotWritten, write_whole
from hilcell.cell.settings import convert, read_text
from hilcell.cell.source import read_source
from hilcell.decoding import decoded, typed
from hilcell.errors import HilcellError
from hilcell.journal.journal import StorageError
from hilcell.run.cell_lock import CellLocked, locked
from hilcell.study.case import DONE, STATES, CaseResult, Row, versions
from hilcell.study.design import Case, chosen
from hilcell.study.study_file import BOUND, Study

QUESTION = "study.json"
CASES = "cases"
QUESTION_KEY = (
    b"hilcell.study"  # a file's metadata: the digest of the question that its rows answer
)


class OtherStudy(HilcellError):
    """A folder of results belongs to another study, or is damaged."""

    code = "HC-D02"


class Question(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The study, cell and versions to which the results of a folder belong."""

    study: dict[str, object]
    cell_sha256: str
    versions: dict[str, str]

    @property
    def digest(self) -> bytes:
        """The digest by which a file's rows refer to this question."""
        content = msgspec.json.encode(self, order="deterministic")
        return hashlib.sha256(content).hexdigest().encode()

    def differences(self, other: Question) -> Iterator[str]:
        """Yield the differences to another question, as text."""
        if self.study != other.study:
            keys = self.study.keys() | other.study.keys()
            yield ", ".join(
                key for key in sorted(keys) if self.study.get(key) != other.study.get(key)
            )
        if self.cell_sha256 != other.cell_sha256:
            yield "the base cell's file"
        for name in sorted(self.versions.keys() | other.versions.keys()):
            ours, theirs = self.versions.get(name), other.versions.get(name)
            if ours != theirs:
                yield f"{name} (there {ours}, here {theirs})"


def asked(study: Study) -> Question:
    text = read_source(study.cell)
    plain = {key: each for key, each in msgspec.to_builtins(study).items() if key != "cell"}
    # The path of the cell may change: its text counts.
    return Question(
        study=plain | {"cell": Path(study.cell).name},
        cell_sha256=hashlib.sha256(text.encode()).hexdigest(),
        versions=versions(),
    )


class Results:
    """The rows of one study in one folder; a writer locks the folder."""

    def __init__(self, folder: Path, study: Study, question: Question | None = None) -> None:
        self.folder, self.study = folder, study
        self._question = question or asked(study)
        self._schema = schema(study).with_metadata({QUESTION_KEY: self._question.digest})

    @contextmanager
    def held(self) -> Iterator[None]:
        """Lock the folder for this study; raises `OtherStudy` if it has another's results."""
        self._check_place()
        lock = self.folder / ".study.lock"
        made = self._make(self.folder / CASES)
        try:
            with locked(lock, f"results {self.folder}", "study"):
                self._check_question()
                try:
                    yield
                finally:
                    if (
                        not any((self.folder / CASES).iterdir())
                        and not self._question_file.exists()
                    ):
                        self._remove(made, lock)
        except CellLocked:
            raise CellLocked(
                f"results {self.folder} are being written by another `hilcell study`"
            ) from None
        except StorageError as error:
            if made:
                self._remove(made, lock)
            raise self._unusable(self.folder, error.__cause__) from error

    def add(self, rows: Sequence[Row]) -> None:
        """Store rows durably."""
        if rows:
            if not self._question_file.exists():
                write_whole(
                    self._question_file, msgspec.json.format(msgspec.json.encode(self._question))
                )
            first = min(row.case for row in rows)
            flat = [msgspec.structs.asdict(row) | row.levels | row.figures for row in rows]
            self._write(pa.Table.from_pylist(flat, self._schema), f"part-{first:07d}.parquet")

    def table(self) -> pa.Table:
        """Return all rows in the order of their cases; raises `OtherStudy` for a damaged file."""
        tables = [self._read(path) for path in self._parts()]
        every = pa.concat_tables([*tables, self._schema.empty_table()])
        first: dict[int, int] = {}
        for row, case in enumerate(every["case"].to_pylist()):
            first.setdefault(case, row)
        return every.take(pa.array([first[case] for case in sorted(first)], pa.int64()))

    def rows(self) -> list[Row]:
        return [self._row(each) for each in self.table().to_pylist()]

    def finished(self) -> set[int]:
        return set(self.table()["case"].to_pylist())

    def merge(self) -> None:
        """Merge all files; rows in two files, after an interruption, count once."""
        parts = [path for path in self._parts() if path.name != "all.parquet"]
        if parts:
            self._write(self.table(), "all.parquet")
            for path in parts:
                path.unlink()

    def files(self) -> list[Path]:
        return [self._question_file, *self._parts()]

    @property
    def _question_file(self) -> Path:
        return self.folder / QUESTION

    def _check_question(self) -> None:
        """Raise `OtherStudy` if the folder has results of another question, or of none."""
        if not self._question_file.exists():
            if any((self.folder / CASES).iterdir()):
                raise OtherStudy(f"{self.folder} has results but no {QUESTION}; use another folder")
        elif differ := list(_read_question(self.folder).differences(self._question)):
            raise OtherStudy(
                f"{self.folder} has results of another study: {'; '.join(differ)} differ; use "
                "another folder (-o), or delete this one"
            )

    def _check_place(self) -> None:
        """Refuse a folder within other results, whose files would be mixed up."""
        for outer in self.folder.absolute().resolve().parents:
            if (outer / QUESTION).is_file() and (outer / CASES).is_dir():
                raise OtherStudy(
                    f"{self.folder} is within the results of a study, {outer}; use another folder "
                    "(-o)"
                )

    def _parts(self) -> list[Path]:
        return sorted((self.folder / CASES).glob("*.parquet"))

    def _write(self, table: pa.Table, name: str) -> None:
        content = io.BytesIO()
        pq.write_table(table, content, write_page_checksum=True)
        path = self.folder / CASES / name
        write_whole(path, content.getvalue())
        for place in (path, path.parent):
            number = os.open(place, os.O_RDONLY)
            try:
                os.fsync(number)
            finally:
                os.close(number)

    def _row(self, flat: Mapping[str, object]) -> Row:
        """Return the row of these columns; raises `msgspec.ValidationError`."""
        levels = {factor.name: flat[factor.name] for factor in self.study.factor}
        figures = {name: flat[name] for name in figure_names(self.study)}
        return typed({**flat, "levels": levels, "figures": figures}, Row)

    def _read(self, path: Path) -> pa.Table:
        try:
            if not path.is_file():
                raise pa.ArrowInvalid("it is not a file")
            with path.open("rb") as file:  # pyarrow would interpret paths such as `s3:` and `~`
                parquet = pq.ParquetFile(file, page_checksum_verification=True, pre_buffer=False)
                found = parquet.read(use_threads=False)  # its threads may abort an exit
            if (found.schema.metadata or {}).get(QUESTION_KEY) != self._schema.metadata[
                QUESTION_KEY
            ]:
                question = path.parent.with_name(QUESTION)
                raise OtherStudy(f"{path} has rows of another study than {question}; move it away")
            if found.schema != self._schema:
                raise pa.ArrowInvalid("its columns differ from the study's")
            for row in found.to_pylist():
                self._check_row(self._row(row))
        except msgspec.ValidationError as error:
            raise self._damaged(path, f"a row is not a case of the study: {error}") from error
        except (pa.ArrowException, OSError) as error:
            raise self._damaged(path, str(error).splitlines()[0]) from error
        return found

    @staticmethod
    def _damaged(path: Path, reason: str) -> OtherStudy:
        return OtherStudy(f"{path} is damaged: {reason}; delete it to repeat its cases")

    def _check_row(self, row: Row) -> None:
        """Raise `ArrowInvalid` for an impossible row."""
        study, number, figures = self.study, row.case, row.figures
        used = [row.minutes, *(figures[name] for name in (study.accuracy, "covered", "targets"))]
        if not (1 <= number <= study.most_cases and row.state in STATES):
            raise pa.ArrowInvalid(f"a row is not a case of the study: {number}, {row.state!r}")
        if row.state == DONE and not all(each is not None and math.isfinite(each) for each in used):
            raise pa.ArrowInvalid(f"case {number} is done but has no figures")
        try:
            chosen(study, row)
        except ValueError:
            raise pa.ArrowInvalid(f"case {number} has a level that is not the study's") from None

    @classmethod
    def _make(cls, folder: Path) -> list[Path]:
        """Create the folder of the rows; return the new folders, the outermost first.

        Raises `NotWritten`.
        """
        made = [each for each in (*reversed(folder.parents), folder) if not each.exists()]
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            cls._remove(made)
            raise cls._unusable(folder.parent, error) from error
        for each in (folder.parent, folder):
            if not os.access(each, os.W_OK | os.X_OK):
                cls._remove(made)
                raise NotWritten(f"{each} is not writable; use another folder (-o)")
        return made

    @staticmethod
    def _unusable(folder: Path, error: BaseException | None) -> NotWritten:
        number = error.errno if isinstance(error, OSError) else None
        reason = error.strerror if isinstance(error, OSError) else error
        failed = DiskFailed if number in STORAGE else NotWritten
        return failed(f"folder of results {folder} cannot be used: {reason}; use another (-o)")

    @staticmethod
    def _remove(made: Sequence[Path], *files: Path) -> None:
        for file in files:
            with suppress(OSError):
                file.unlink()
        for each in reversed(made):
            with suppress(OSError):
                each.rmdir()


def open_results(folder: Path) -> Results:
    """Return the results of a folder for reading; raises `OtherStudy`."""
    question = _read_question(folder)
    return Results(folder, convert(question.study, Study, str(folder / QUESTION)), question)


def schema(study: Study) -> pa.Schema:
    """Return the columns: the case, its factors, its state, its figures."""
    factors = [
        (factor.name, pa.float64() if factor.is_number else pa.string()) for factor in study.factor
    ]
    figures = [(name, pa.float64()) for name in figure_names(study)]
    return pa.schema([
        ("case", pa.int64()), ("point", pa.int64()), ("machine", pa.int64()), ("seed", pa.int64()),
        *factors,
        ("state", pa.string()), ("reason", pa.string()),
        ("minutes", pa.float64()), ("cost", pa.float64()), *figures,
    ])  # fmt: skip


def figure_names(study: Study) -> list[str]:
    """Return the stored figures: those of the study file, and those that a report needs."""
    needed = [study.accuracy, *filter(None, [study.truth]), BOUND, "covered", "targets"]
    return list(dict.fromkeys([*study.results, *needed]))


def case_row(case: Case, result: CaseResult, study: Study) -> Row:
    point, minutes = case.point, result.minutes
    return Row(
        case=case.number,
        point=point.number,
        machine=case.machine,
        seed=case.seed,
        levels={each.factor.name: each.shown for each in point.choices},
        state=result.state,
        reason=result.reason,
        minutes=None if minutes is None else minutes + point.minutes,
        cost=point.cost,
        figures={name: result.figures.get(name) for name in figure_names(study)},
    )


def _read_question(folder: Path) -> Question:
    path = folder / QUESTION
    try:
        return decoded(read_text(path), Question)
    except OSError as error:
        reason = f"{path} cannot be read: {error.strerror}"
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        reason = f"{path} is damaged: {error}"
    raise OtherStudy(f"{folder} is not a folder of results: {reason}")
