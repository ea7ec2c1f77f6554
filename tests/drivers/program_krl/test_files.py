"""KRL programs on disk: the pair is found, read as it is, and written together or not at all."""

import re
from pathlib import Path

import pytest

from drivers.kuka.program_krl.files import load_program
from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs
from hilcell.compensation.programs import write_program
from hilcell.compensation.stamp import CorrectedBefore, Stamp
from hilcell.writing import NotWritten
from tests.drivers.program_krl.samples import DAT, SRC

STAMP = Stamp("a-run", "2026-11-22T14:00:00Z", "S1100")
NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def pair(folder: Path, src: str = "drill.src", dat: str = "drill.dat") -> Path:
    (folder / src).write_bytes(SRC.replace("\n", "\r\n").encode())
    (folder / dat).write_bytes(f";\xfcber {DAT}".encode("latin-1"))
    return folder / src


def written(folder: Path, out: str, src: str = "drill.src", dat: str = "drill.dat") -> list[str]:
    source = pair(folder, src, dat)
    program = load_program(source)
    (folder / "out").mkdir()
    paths = write_program(
        program, program.values()[:, :3], source, folder / "out" / out, stamp=STAMP
    )
    for path, before in zip(paths, (source, folder / dat), strict=True):
        lines = path.read_bytes().splitlines(keepends=True)
        (stamp,) = [n for n, line in enumerate(lines) if STAMP.text.encode() in line]
        assert lines[stamp - 1].startswith(b"DEF")
        assert lines.pop(stamp).endswith(b"\r\n") == lines[stamp - 1].endswith(b"\r\n")
        assert NUMBER.sub(b"#", b"".join(lines)) == NUMBER.sub(b"#", before.read_bytes())
    assert sorted(each.name for each in (folder / "out").iterdir()) == sorted(p.name for p in paths)
    return [path.name for path in paths]


@pytest.mark.parametrize("out", ["corrected", "corrected.src", "corrected.DAT"])
def test_the_pair_is_written_and_its_numbers_alone_differ(tmp_path: Path, out: str) -> None:
    assert written(tmp_path, out) == ["corrected.src", "corrected.dat"]


@pytest.mark.parametrize("data", ["DRILL.Dat", "Drill.Dat"])  # controllers ignore case
def test_suffixes_keep_their_case(tmp_path: Path, data: str) -> None:
    names = written(tmp_path, "v1.2", "DRILL.SRC", data)
    assert names == ["v1.2.SRC", "v1.2.Dat"]


def test_a_source_alone(tmp_path: Path) -> None:
    source = tmp_path / "drill.src"
    source.write_bytes(b"LIN {X 1,Y 2,Z 3,A 0,B 75,C 0}")
    program = load_program(source)
    written = write_program(
        program, program.values()[:, :3], source, tmp_path / "out.dat", stamp=STAMP
    )
    assert written == [tmp_path / "out.src"]


def test_nothing_is_written_where_one_file_cannot(tmp_path: Path) -> None:
    source = pair(tmp_path)
    program = load_program(source)
    (tmp_path / "out.src").write_text("old")
    (tmp_path / "out.dat").mkdir()
    with pytest.raises(NotWritten, match=r"out\.dat is a folder"):
        write_program(program, program.values()[:, :3], source, tmp_path / "out.src", stamp=STAMP)
    assert (tmp_path / "out.src").read_text() == "old"
    assert not list(tmp_path.glob("*.part"))


def test_a_program_is_not_replaced_by_itself(tmp_path: Path) -> None:
    source = pair(tmp_path)
    program = load_program(source)
    with pytest.raises(NotWritten, match="is what is read"):
        write_program(program, program.values()[:, :3], source, tmp_path / "drill", stamp=STAMP)
    (tmp_path / "out.src").symlink_to(tmp_path / "drill.dat")
    with pytest.raises(NotWritten, match="is what is read"):
        write_program(program, program.values()[:, :3], source, tmp_path / "out", stamp=STAMP)


def test_files_that_are_no_programs(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        load_program(tmp_path / "nowhere.src")
    (tmp_path / "wide.src").write_text("LIN {X 1}", "utf-16")
    with pytest.raises(SettingsError, match="NUL bytes"):
        load_program(tmp_path / "wide.src")
    pair(tmp_path)
    (tmp_path / "drill.DAT").write_text("")
    if len(list(tmp_path.glob("drill.*"))) == 3:  # not on a disk that ignores case
        with pytest.raises(SettingsError, match="several data lists"):
            load_program(tmp_path / "drill.src")


def test_a_corrected_program_is_refused_by_either_file(tmp_path: Path) -> None:
    """Fed to `compensate` it would be corrected twice."""
    source = pair(tmp_path)
    program = load_program(source)
    src, dat = write_program(
        program, program.values()[:, :3], source, tmp_path / "out", stamp=STAMP
    )
    for stamped in (src, dat):
        again = pair(tmp_path)
        again.with_suffix(stamped.suffix).write_bytes(stamped.read_bytes())
        with pytest.raises(CorrectedBefore, match="corrected by a-run for S1100 on 2026-11-22"):
            programs.load_program(again)
