"""KRL programs on disk: the pair is found, read as it is, and written together or not at all."""

import re
from pathlib import Path

import pytest

from drivers.kuka.program_krl.files import load_program
from hilcell.atomic_files import NotWritten
from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs
from hilcell.compensation.programs import write_program
from hilcell.compensation.targets import CorrectedBefore, Stamp
from tests.drivers.kuka.program_krl.samples import DAT, SRC

STAMP = Stamp("a-run", "2026-11-22T14:00:00Z", "S1100")
NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def pair(folder: Path, src: str = "drill.src", dat: str = "drill.dat") -> Path:
    (folder / src).write_bytes(SRC.replace("\n", "\r\n").encode())
    (folder / dat).write_bytes(f";\xfcber {DAT}".encode("latin-1"))
    return folder / src


def write(source: Path, out: str) -> list[Path]:
    """Write a program as it was read."""
    program = load_program(source)
    return write_program(program, program.values()[:, :3], source, source.parent / out, stamp=STAMP)


@pytest.mark.parametrize(
    ("src", "dat", "out", "names"),
    [
        ("drill.src", "drill.dat", "corrected", ["corrected.src", "corrected.dat"]),
        ("drill.src", "drill.dat", "corrected.DAT", ["corrected.src", "corrected.dat"]),
        ("DRILL.SRC", "Drill.Dat", "v1.2", ["v1.2.SRC", "v1.2.Dat"]),  # controllers ignore case
    ],
)
def test_the_pair_is_written_and_its_numbers_alone_differ(
    tmp_path: Path, src: str, dat: str, out: str, names: list[str]
) -> None:
    source = pair(tmp_path, src, dat)
    (tmp_path / "out").mkdir()
    paths = write(source, f"out/{out}")
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(names)
    for path, before in zip(paths, (source, tmp_path / dat), strict=True):
        lines = path.read_bytes().splitlines(keepends=True)
        (stamp,) = [n for n, line in enumerate(lines) if STAMP.text.encode() in line]
        assert lines[stamp - 1].startswith(b"DEF")
        assert lines.pop(stamp).endswith(b"\r\n") == lines[stamp - 1].endswith(b"\r\n")
        assert NUMBER.sub(b"#", b"".join(lines)) == NUMBER.sub(b"#", before.read_bytes())


def test_a_source_alone(tmp_path: Path) -> None:
    source = tmp_path / "drill.src"
    source.write_bytes(b"LIN {X 1,Y 2,Z 3,A 0,B 75,C 0}")
    assert write(source, "out.dat") == [tmp_path / "out.src"]


def test_nothing_is_written_where_one_file_cannot_be_or_is_the_input(tmp_path: Path) -> None:
    source = pair(tmp_path)
    (tmp_path / "out.src").write_text("old")
    (tmp_path / "out.dat").mkdir()
    (tmp_path / "link.src").symlink_to(tmp_path / "drill.dat")
    for out in ("out.src", "drill", "link"):
        with pytest.raises(NotWritten):
            write(source, out)
    assert (tmp_path / "out.src").read_text() == "old"
    assert not list(tmp_path.glob("*.part"))


def test_files_that_are_no_programs(tmp_path: Path) -> None:
    (tmp_path / "wide.src").write_text("LIN {X 1}", "utf-16")
    pair(tmp_path)
    (tmp_path / "drill.DAT").write_text("")
    several = ["drill"] * (len(list(tmp_path.glob("drill.*"))) == 3)  # a disk may ignore case
    for name in ("nowhere", "wide", *several):
        with pytest.raises(SettingsError):
            load_program(tmp_path / f"{name}.src")


def test_a_corrected_program_is_refused_by_either_file(tmp_path: Path) -> None:
    """Fed to `compensate` it would be corrected twice."""
    for stamped in write(pair(tmp_path), "out"):
        again = pair(tmp_path)
        again.with_suffix(stamped.suffix).write_bytes(stamped.read_bytes())
        with pytest.raises(CorrectedBefore, match="a-run for S1100"):
            programs.load_program(again)
