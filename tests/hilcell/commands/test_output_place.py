"""A name that contradicts the form is refused, and the right one is named."""

from pathlib import Path

import pytest

from hilcell.commands.cli import main
from hilcell.commands.output_place import CSV, check_output
from hilcell.planning.holes import NORMALS
from hilcell.writing import NotWritten
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.commands.workplace import Workplace


@pytest.mark.parametrize(
    ("words", "name", "part"),
    [
        (["report"], "x.csv", "a report is written; name it x.html"),
        (["report"], "x.docx", "is a .docx file by its name, and a report is written; name it x."),
        (["report"], "x.xml", "a report is written; name it x.html"),
        (["export", "--csv"], "x.dcc", "is a .dcc file by its name, and CSV is written; name it"),
        (["export", "--dcc"], "x.svg", "a DCC is written; name it x.xml"),
        (["export", "--csv"], "x.pdf", "CSV is written; name it x.csv"),
        (["export", "--xlsx"], "x.xls", "a workbook is written; name it x.xlsx"),
        (["export", "--json"], "x.HTML", "JSON is written; name it x.json"),
    ],
)
def test_reports_and_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], name: str, part: str
) -> None:
    finished(tmp_path / "runs", "1-made", MADE)
    where = ["--runs", str(tmp_path / "runs")]
    command, *form = words
    assert main([command, "1-made", *form, *where, "-o", str(tmp_path / name)]) == 2
    assert part in capsys.readouterr().err
    assert not (tmp_path / name).exists()


def test_lists(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "targets.csv").write_text(
        "name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\nH1,0,0,1200,0,75,0\n"
    )
    desk = Workplace(tmp_path, "targets.csv", "out.csv")
    assert desk.compensate(out=tmp_path / "out.src") == 2
    assert "is a .src file by its name, and a list is written; name it out.csv" in (
        capsys.readouterr().err
    )
    assert desk.compensate("--bounds", str(tmp_path / "b.xlsx")) == 2
    assert "name it b.csv" in capsys.readouterr().err
    holes = tmp_path / "holes.csv"
    holes.write_text(f"{','.join(NORMALS)}\nH1,0,0,1200,0,0,1\n")
    assert main(["plan", str(holes), "-o", str(tmp_path / "plan.json")]) == 2
    assert "name it plan.csv" in capsys.readouterr().err
    assert desk.files == ["calibration.json", "holes.csv", "targets.csv"]


@pytest.mark.parametrize("name", ["out", "out.csv", "out.TXT", "out.v1", "o.2026-11-22"])
def test_names_that_say_nothing_else_are_taken(tmp_path: Path, name: str) -> None:
    check_output(tmp_path / name, CSV, "a list")


def test_a_place_is_checked_before_its_name(tmp_path: Path) -> None:
    with pytest.raises(NotWritten, match="is a folder"):
        check_output(tmp_path, CSV, "a list")
