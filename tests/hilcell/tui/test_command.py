"""The command itself: what a defect of the screen looks like from a shell."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hilcell.commands.cli import main
from hilcell.tui.app import HilcellApp

LOADED = "import sys, hilcell.tui.app as _; print(*sys.modules)"
DEFECT = "three hands on two clocks"


def unseen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Be a terminal that nobody sees; leave nothing behind."""
    run = HilcellApp.run
    monkeypatch.setattr(HilcellApp, "run", lambda app: run(app, headless=True))
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, "isatty", lambda: True)
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    for name in ("TEXTUAL_COLOR_SYSTEM", "TEXTUAL_ANIMATIONS", "NO_COLOR"):
        monkeypatch.setenv(name, "none")


def test_a_defect_of_the_screen_is_reported_and_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def broken(_: HilcellApp) -> None:
        raise ZeroDivisionError(DEFECT)

    monkeypatch.setattr(HilcellApp, "_open", broken)
    unseen(monkeypatch)
    assert main(["tui", "--runs", str(tmp_path)]) == 5
    reported = capsys.readouterr().err
    assert DEFECT in reported
    assert "`hilcell tui last` shows it" in reported.replace("\n", " ")


@pytest.mark.parametrize(
    ("words", "code", "reported"),
    [
        (["nope"], 2, "'nope'"),
        (["--runs", __file__], 2, __file__),
        (["--keys", "none.toml"], 2, "none.toml"),
    ],
)
def test_a_run_that_cannot_be_opened_is_reported_in_the_shell(
    words: list[str],
    code: int,
    reported: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    unseen(monkeypatch)
    assert main(["tui", "--runs", str(tmp_path), *words]) == code
    assert reported in capsys.readouterr().err


def test_a_screen_that_is_left_is_a_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def left(app: HilcellApp) -> None:
        app.do_quit()

    monkeypatch.setattr(HilcellApp, "_open", left)
    unseen(monkeypatch)
    assert main(["tui", "--runs", str(tmp_path)]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.process
def test_what_reads_journals_is_imported_after_the_first_picture() -> None:
    loaded = set(subprocess.check_output([sys.executable, "-c", LOADED], text=True).split())
    assert "hilcell.tui.app" in loaded
    assert loaded.isdisjoint({"numpy", "hilcell.journal.log"})
