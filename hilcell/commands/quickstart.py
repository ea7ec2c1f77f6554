"""``quickstart``: a robot on the floor, three nests, one reflector; from no cell file to an arm.

It is `commission` with all that such a cell has in common already in its file, then `run`, then the
report and the identified arm beside the cell file.
"""

from __future__ import annotations

from pathlib import Path

from hilcell.atomic_files import write_whole
from hilcell.cell.devices import load_entry
from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.commands.commission import Terminal
from hilcell.commands.console import print_message
from hilcell.commands.signatures import Quickstart
from hilcell.commission.cell_text import CellText
from hilcell.commission.draft import write_floor_robot
from hilcell.commission.steps import StepEnded, motions, refuse_built_in, steps_to_perform
from hilcell.errors import EXIT_OK, EXIT_OUT_OF_TOLERANCE, HilcellError
from hilcell.report.export import urdf_of_run
from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from hilcell.run.last_word import last_word

NESTS = 3
CALIBRATE = "calibrate"


def quickstart(args: Quickstart) -> int:
    """Commission, calibrate, write; the same command goes on where the last one ended."""
    refuse_built_in(args.cell)
    _begin(args.cell)
    person = Terminal(args)
    if not person.commissions(steps_to_perform(args.cell, "", "")):
        return EXIT_OUT_OF_TOLERANCE
    cell = load_cell(str(args.cell))
    person.dialogue.real = cell.simulation is None
    if not person.dialogue.agree(motions(cell, load_entry("procedures", CALIBRATE))):
        raise HilcellError("the calibration was not agreed to; nothing moved", code="HC-C40")
    try:
        name, log = person.run(CALIBRATE)
    except StepEnded as ended:  # it has said why, and how it is resumed
        return ended.exit_code
    folder = args.runs / name
    print_message(last_word(log, folder, None).text)
    _write(args.cell, folder)
    assert log.end is not None  # noqa: S101 - it has ended without a fault
    if log.end.exit == EXIT_OK:
        print_message(
            f"a program that exists already: `hilcell compensate {name} PROGRAM --station "
            f"{cell.grid.station} --cell {args.cell} -o CORRECTED`"
        )
    return log.end.exit


def _begin(path: Path) -> None:
    """Begin the cell file; raises `SettingsError` for one of another kind of cell."""
    text = CellText.read(path)
    rail, by_hand = text.get("rail"), text.get("layout.reflectors") == "by_hand"
    if rail is not None or (text.values and not by_hand):
        what = "it has a rail" if rail is not None else "its reflectors are mounted"
        problem = f"this cell is of another kind, {what}: use `hilcell commission {path}`"
        raise SettingsError(str(path), [problem])
    write_floor_robot(text, NESTS)
    text.write(path)


def _write(cell: Path, folder: Path) -> None:
    """Write the report and the identified arm beside the cell file."""
    facts = read_facts(folder)
    for place, content in (
        (cell.with_suffix(".report.html"), report_html(facts).encode()),
        (cell.with_suffix(".urdf"), urdf_of_run(facts)),
    ):
        write_whole(place, content, inputs=[cell])
        print_message(f"{place} written")
