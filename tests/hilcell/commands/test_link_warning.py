"""A CAN link that loses frames is warned of wherever a run's end is read."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.cell.devices import load_entry
from hilcell.commands.cli import main
from hilcell.commands.run_output import RunOutput, print_end
from hilcell.journal.link_record import LinkRecord
from hilcell.journal.runs import read_log
from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from tests.hilcell.report.journals import Writer
from tests.hilcell.report.pages import Page

LOSES = "the rail's CAN link loses {} %"


def run_with(runs: Path, bad_lines: int) -> Path:
    writer = Writer(runs / "r1").began()
    link = {"frames": 1000 - bad_lines, "bad_lines": bad_lines, "refused": 0, "malformed": 0}
    writer.journal.append("event", "", {"what": "link"} | link)
    return writer.ended()


@pytest.mark.parametrize(("bad_lines", "warned"), [(4, False), (5, True)])
def test_the_warning_stands_at_the_end_in_show_and_in_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bad_lines: int, warned: bool
) -> None:
    folder, loses = run_with(tmp_path, bad_lines), LOSES.format("0.50")
    log = read_log(folder)
    print_end(folder, log, load_entry("procedures", "home"), RunOutput(as_json=False), None)
    assert (f"warning: {loses}" in " ".join(capsys.readouterr().err.split())) is warned
    assert main(["show", "r1", "--runs", str(tmp_path)]) == 0
    assert (loses in capsys.readouterr().out) is warned
    assert (f"Warning: {loses}" in Page(report_html(read_facts(folder))).text) is warned


def test_a_link_that_carried_nothing_but_garbage_is_warned_of() -> None:
    assert LinkRecord(1, 0, 0, 0).warning == ""
    assert LinkRecord(0, 1, 0, 0).warning.startswith(LOSES.format("100.00"))
