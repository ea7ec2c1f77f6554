"""The page of a commissioning: proofs with names and times, and all that nobody has proved."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from hashlib import sha256
from operator import attrgetter
from pathlib import Path

from hilcell import __version__
from hilcell.cell.settings import read_file
from hilcell.commission.cell_text import CellText, shown
from hilcell.commission.record import Check, Commissioned, StepRecord, StepStatus, cell_names
from hilcell.commission.sequence import ABILITIES, LACKS, Step, steps_of
from hilcell.identity import Identity
from hilcell.present.renderers import environment
from hilcell.present.table import Column, Table, listed

SUFFIX = ".commissioning.html"
# As docs/commissioning.md has it.
NEVER_PROVED = (
    "Volumes that nobody has listed or shown; people, cables, the arm against itself.",
    "That the robot stops by itself when the PC dies: pull its cable (docs/hardware.md).",
    "Speed above that of the steps.",
    "Certified lengths: scale bars that the cell file does not have.",
    "The travel beyond the one by tape.",
    "Kinematics of a robot that hilcell does not know.",
)
Shown = tuple[StepRecord, Check]


class CommissioningPage:
    """All that one page says of a cell file and its record."""

    def __init__(self, path: Path) -> None:
        """Raises `SettingsError` for a file or a record that cannot be read."""
        self.file = path.name
        self._text, self._record = CellText.read(path), Commissioned.read(path)
        self.sequence = steps_of(self._text)
        self.name, self.serial = cell_names(self._text)
        self.digest = sha256(read_file(path)).hexdigest() if path.exists() else ""
        self.simulated = self._text.get("simulation") is not None

    @property
    def unproved(self) -> list[str]:
        return self._record.unproved(self._text)

    @property
    def operators(self) -> str:
        named = [each.operator for each in self._record.steps if each.operator]
        return ", ".join(dict.fromkeys(named))

    @property
    def times(self) -> str:
        """Return begin and end of all steps, and what they took together."""
        steps = self._record.steps
        if not steps:
            return "not yet"
        began, ended = _time(steps[0].began), _time(steps[-1].ended)
        return f"{began} to {ended} UTC; {_took(steps)} in all, {_questions(steps)} questions"

    @property
    def last_day(self) -> str:
        return self._record.steps[-1].ended[:10] if self._record.steps else ""

    def status(self, step: Step) -> StepStatus:
        return self._record.status(step.name, self._text)

    # -- tables ---------------------------------------------------------------------------------

    def steps(self) -> Table:
        """Return each step with all that its performances took."""
        return Table(
            [
                Column[Step]("step", attrgetter("name")),
                Column[Step]("proves", attrgetter("title")),
                Column[Step]("status", self.status),
                Column("operator", self.operator),
                Column[Step]("run", lambda step: self._last(step, "run")),
                Column[Step]("attempts", lambda step: len(self._performed(step)) or None, form="d"),
                Column[Step]("questions", lambda step: _questions(self._performed(step)), form="d"),
                Column[Step]("took", lambda step: str(_took(self._performed(step))), form="s"),
                Column("ended, UTC", self.ended, form="s"),
            ],
            self.sequence,
            "Steps",
        )

    def operator(self, step: Step) -> str:
        """Return who has performed a step last."""
        return self._last(step, "operator")

    def ended(self, step: Step) -> str:
        """Return when a step was performed last."""
        return _time(self._last(step, "ended"))

    def _performed(self, step: Step) -> list[StepRecord]:
        return [each for each in self._record.steps if each.step == step.name]

    def _last(self, step: Step, of: str) -> str:
        record = self._record.last(step.name)
        return "" if record is None else str(getattr(record, of))

    def checks(self) -> Table:
        """Return all checks of each step's last performance."""
        return _checks(self._shown(), "What each step has proved")

    def attempts(self) -> Table:
        """Return what differed in earlier performances of the steps that were repeated."""
        last = [self._record.last(step.name) for step in self.sequence]
        rows = [
            (each, check)
            for each in self._record.steps
            if each not in last
            for check in each.checks
            if not check.holds
        ]
        return _checks(rows, "Repeated: readings of earlier attempts that differ")

    def changed(self) -> Table:
        proved = self._record.proved
        rows = [
            (step.name, path, shown(proved[path][1]), shown(self._text.get(path)))
            for step in self.sequence
            if self.status(step) == "changed"
            for path in self._record.changed(step.name, self._text)
        ]
        columns = listed("step", "value", "proved", "in the file now")
        return Table(columns, rows, "Changed by hand since")

    def written(self) -> str:
        """Return the values of the cell file that were proved last, in one text."""
        proved = self._record.proved.items()
        return "; ".join(f"{path} = {shown(value)}" for path, (_, value) in proved)

    def devices(self) -> Table:
        columns: tuple[Column[Identity], ...] = tuple(
            Column(name, attrgetter(name))
            for name in ("kind", "maker", "model", "serial", "firmware", "address")
        )
        connected = [each.devices for each in self._record.steps if each.devices]
        return Table(columns, connected[-1] if connected else (), "Devices, as last connected")

    def not_proved(self) -> list[str]:
        """Return all that nobody has proved, a line each."""
        open_steps = (step for step in self.sequence if self.status(step) != "proved")
        return [f"{step.name}: {step.title}." for step in open_steps] + [*NEVER_PROVED]

    def _shown(self) -> Iterator[Shown]:
        for step in self.sequence:
            record = self._record.last(step.name)
            if record is not None and step.name == ABILITIES:
                yield record, _lacking(record)
            elif record is not None:
                yield from ((record, check) for check in record.checks)


def page_html(path: Path) -> str:
    """Return the page of a cell file, the same from the same record."""
    packages = ("hilcell.commission", "hilcell.report")
    template = environment(*packages).get_template("commissioning.html.j2")
    return template.render(page=CommissioningPage(path), version=__version__)


def page_path(cell: Path) -> Path:
    return cell.with_suffix(SUFFIX)


def _checks(rows: Iterator[Shown] | list[Shown], title: str) -> Table:
    return Table(
        [
            Column[Shown]("step", lambda row: row[0].step),
            Column[Shown]("verified", lambda row: row[1].what),
            Column[Shown]("found", lambda row: _found(row[1])),
            Column[Shown]("expected", lambda row: row[1].expected),
        ],
        rows,
        title,
        mark=lambda row: "" if row[1].holds else "stop",
    )


def _lacking(record: StepRecord) -> Check:
    """Return the many abilities of the devices as one, which names those lacking or read only."""
    lacks = [f"{each.what}: {each.found}" for each in record.checks if each.found.startswith(LACKS)]
    return Check(
        what=f"{len(record.checks)} abilities",
        found="; ".join([f"{len(lacks)} lacking or read only", *lacks]),
        expected="none of them mandatory",
        holds=record.holds,
    )


def _found(check: Check) -> str:
    return check.found if check.holds else f"DIFFERS: {check.found}"


def _time(moment: str) -> str:
    return moment[:19].replace("T", " ")


def _took(steps: Sequence[StepRecord]) -> timedelta:
    timed = (each for each in steps if each.began)
    return sum(
        (datetime.fromisoformat(each.ended) - datetime.fromisoformat(each.began) for each in timed),
        timedelta(),
    )


def _questions(steps: Sequence[StepRecord]) -> int:
    return sum(each.questions for each in steps)
