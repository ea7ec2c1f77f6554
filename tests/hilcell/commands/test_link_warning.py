"""A CAN link that loses frames is warned of wherever a run's end is read."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import pytest

from hilcell.alarms.alarm import alarms_of
from hilcell.cell.devices import load_entry
from hilcell.commands.cli import main
from hilcell.commands.run_output import RunOutput, print_end
from hilcell.journal.link_record import LinkRecord
from hilcell.journal.runs import read_log
from hilcell.report.export import xlsx_bytes
from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from tests.hilcell.report.journals import Writer
from tests.hilcell.report.pages import Page

LOSES = "the rail's CAN link loses {} %"


def link(writer: Writer, **lost: int) -> None:
    counts = {"bad_lines": 0, "refused": 0, "malformed": 0} | lost
    counts["frames"] = 1000 - sum(lost.values())
    writer.journal.append("event", "", {"what": "link"} | counts)


def run_with(runs: Path, bad_lines: int) -> Path:
    writer = Writer(runs / "r1").began()
    link(writer, bad_lines=bad_lines)
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


def test_losses_of_earlier_sessions_stay_counted_when_a_run_is_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    writer = Writer(tmp_path / "r1").began()
    link(writer, refused=20, malformed=1)
    writer.state("run", "faulted")
    writer.began()
    link(writer, bad_lines=3)
    folder = writer.ended()
    found = "1976 frames, 3 bad lines, 20 refused, 1 malformed (1.20 % lost)"
    assert main(["show", "r1", "--json", "--runs", str(tmp_path)]) == 0
    shown, loses = json.loads(capsys.readouterr().out), LOSES.format("1.20")
    assert shown["link"] == found
    assert shown["link_warning"].startswith(loses)
    page = Page(report_html(facts := read_facts(folder))).text
    assert f"CAN link: {found}. Warning: {loses}" in page
    with ZipFile(BytesIO(xlsx_bytes(facts))) as book:
        assert any(found.encode() in book.read(name) for name in book.namelist())
    log = read_log(folder)
    assert [alarm.found for alarm in alarms_of(log, "r1", live=False)] == [found]


def test_how_the_slide_was_held_is_of_the_last_end() -> None:
    held, not_so = LinkRecord(1, 0, 0, 0, held_by_sdo=1), LinkRecord(1, 0, 0, 0)
    assert held.followed_by(not_so).held_by_sdo == 0
    assert not_so.followed_by(held).held_by_sdo == 1


def test_a_link_that_carried_nothing_but_garbage_is_warned_of() -> None:
    assert LinkRecord(1, 0, 0, 0).warning == ""
    assert LinkRecord(0, 1, 0, 0).warning.startswith(LOSES.format("100.00"))
