"""A report as PDF: by a browser where there is one, else what to do."""

from pathlib import Path

import pytest

from hilcell.commands.cli import main
from hilcell.report.pdf import pages_of, pdf_of
from hilcell.writing import NotWritten
from tests.hilcell.report.browser import browser
from tests.hilcell.report.journals import validated_run


def test_a_pdf_is_printed(tmp_path: Path) -> None:
    browser()  # skips where there is none
    folder, out = validated_run(tmp_path / "r").ended(), tmp_path / "x.pdf"
    assert main(["report", str(folder), "-o", str(out)]) == 0
    assert out.read_bytes().startswith(b"%PDF-")


def test_without_a_browser_it_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delattr("hilcell.commands.report.read_facts")  # refused before anything is read
    folder, out = validated_run(tmp_path / "r").ended(), tmp_path / "x.pdf"
    assert main(["report", str(folder), "-o", str(out)]) == 2
    err = capsys.readouterr().err
    assert "install chromium, or write FILE.html" in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_a_browser_that_prints_nothing(tmp_path: Path) -> None:
    broken = tmp_path / "chromium"
    broken.write_text("#!/bin/sh\necho no display\n")
    broken.chmod(0o755)
    with pytest.raises(NotWritten, match="printed no PDF: no display"):
        pdf_of("<p>x</p>", str(broken))


def test_the_page_of_each_part_is_read_from_the_print() -> None:
    print_ = b"""1 0 obj <</Type /Pages /Kids [2 0 R 7 0 R]>> endobj
2 0 obj
<</Type /Page /Parent 1 0 R>> endobj
7 0 obj
<</Type /Page /Parent 1 0 R>> endobj
9 0 obj <</first [2 0 R /XYZ 0 841 0] /second [7 0 R /XYZ 0 1 0] /gone [5 0 R /XYZ 0 0 0]>>"""
    assert pages_of(print_, ("first", "second", "gone", "none")) == {"first": 1, "second": 2}
