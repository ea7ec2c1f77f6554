"""A whole run in this process and in one thread, without a runner: for studies of simulated cells.

Procedures, session and mathematics are those of every run. There are no wires, nobody attends, and
the journal is in memory; so there is nothing to stop, to resume or to display.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from hilcell import __version__
from hilcell.cell.devices import Devices, connect_all, in_process_cell
from hilcell.cell.file import Cell
from hilcell.journal.journal import Body, Record, plain_body
from hilcell.journal.log import Log
from hilcell.model.events import Connected
from hilcell.model.records import Kind
from hilcell.ports import NoReading
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Plan, Procedure
from hilcell.run.prompts import Prompt, Verification, unanswered


class MemoryJournal:
    """Satisfies `hilcell.journal.log.Records`."""

    def __init__(self, folder: Path, moment: str) -> None:
        """``folder`` takes the streams; every record has the one time ``moment``, ISO 8601."""
        self.log = Log(packed=False)  # a study's run ends in seconds, and asks for them all
        self.path = folder / "journal"
        self._moment, self._seq = moment, 0

    def append(self, kind: Kind, key: str, body: Body) -> Record:
        """Apply one record to the log and return it; raises `NotFinite`."""
        plain, _ = plain_body(body, f"record {self._seq + 1} ({kind} {key or '-'})")
        self._seq += 1
        record = Record(self._seq, self._moment, kind, key, plain)
        self.log.take(record)
        return record


def run_in_process(
    cell: Cell,
    procedure: Procedure,
    *,
    seed: int,
    machine_seed: int,
    folder: Path,
    plan: Plan | None = None,
) -> Log:
    """Perform a procedure on a simulated cell; return its log, without an end.

    ``seed`` draws the random targets, ``machine_seed`` the machine; ``folder`` takes streams, which
    the log refers to. ``plan`` is the procedure's for this cell and seed, where it is known.
    Raises `HilcellError` as a run of its own would end by it.
    """
    plan = plan or procedure.plan(cell, seed)
    simulated = in_process_cell(cell, machine_seed)
    journal = MemoryJournal(folder, datetime.now(UTC).isoformat(timespec="milliseconds"))
    journal.append(
        "plan",
        "",
        procedure.inputs(cell, plan)
        | {
            "cell_file": cell.name,
            "seed": seed,
            "machine_seed": machine_seed,
            "speed": None,
            "unattended": True,
            "operator": "",
            "job": "",
            "versions": {"hilcell": __version__},
            "settings": {},
        },
    )
    devices = Devices(simulated.rail, simulated.robot, simulated.tracker)
    identities = connect_all(devices, lambda _: None)
    journal.append("event", "", Connected(devices=identities))
    session = CellSession(
        cell, devices, simulated.clock, journal, checkpoint=lambda: None, ask=_nobody
    )
    procedure.perform(session)
    return journal.log


def _nobody(
    prompt: Prompt, look: Callable[[], Verification], cause: NoReading | None
) -> Verification:
    """Refuse what only an operator can do."""
    raise unanswered(prompt, cause) from cause
