"""The loop that performs the steps of commissioning.

A step that needs devices is a run of a procedure. Its verdicts carry values for the cell file: the
step is repeated with them until it proves what the file says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from hilcell.atomic_files import write_whole
from hilcell.cell.devices import load_entry, self_stop_s
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.source import built_in_cells
from hilcell.commission.cell_text import CellText, shown
from hilcell.commission.dialogue import Dialogue
from hilcell.commission.first_steps import WhichDevices, ask_the_person, what_devices_can
from hilcell.commission.page import page_html, page_path
from hilcell.commission.record import Check, Commissioned, StepRecord
from hilcell.commission.sequence import ABILITIES, LACKS, Step, steps_of
from hilcell.errors import EXIT_ABORTED, DeviceRefused, HilcellError
from hilcell.identity import Identity
from hilcell.journal.log import Log
from hilcell.model.verdicts import Proved
from hilcell.run.procedure import Procedure, announced

NOT_NOW = "not now"
REPEATS = 6  # of a step whose values are written and proved again
Perform = Callable[[str], tuple[str, Log]]  # a procedure to its end: the run's name, its log


@dataclass(frozen=True)
class Commissioning:
    """One cell's commissioning: performs steps, writes the cell file and the record."""

    path: Path
    dialogue: Dialogue
    operator: str
    run: Perform

    def perform(self, steps: Sequence[Step]) -> bool:
        """Perform steps in sequence up to the first that does not prove; return whether all did.

        The page of the record is written in any case.
        """
        try:
            for step in steps:
                # The first step shows whether there is a rail.
                of_cell = [each for each in steps if each in steps_of(CellText.read(self.path))]
                if step not in of_cell:
                    continue
                self.dialogue.begin(step.name, step.title, of_cell.index(step) + 1, len(of_cell))
                if not self._perform(step):
                    return False
            return True
        finally:
            write_whole(page_path(self.path), page_html(self.path).encode())

    def _perform(self, step: Step) -> bool:
        began, asked = _now(), self.dialogue.questions
        if self._is_put_off(step):
            return True
        self._agree(step)
        for _ in range(REPEATS):
            record = msgspec.structs.replace(
                self._once(step), began=began, questions=self.dialogue.questions - asked
            )
            began, asked = record.ended, self.dialogue.questions
            text = CellText.read(self.path)
            before = {path: text.get(path) for path in record.values}
            for path, value in record.values.items():
                text.set(path, value, f"by `hilcell commission`, step {step.name}")
            changed = [path for path, value in before.items() if value != text.get(path)]
            if changed:
                text.write(self.path)
                load_cell(str(self.path))
            Commissioned.read(self.path).add(record, self.path)
            written = [f"{self.path.name}: {path} = {shown(text.get(path))}" for path in changed]
            self.dialogue.show(record, lines_of(record), written)
            if record.holds:
                return True
            if not changed:
                break
            self.dialogue.say(f"  step {step.name} is repeated with these values")
        failed = "; ".join(each.what for each in record.checks if not each.holds)
        self.dialogue.say(
            f"step {step.name} has not proved {failed or 'all it should'}; mend that, then "
            "the same command goes on here"
        )
        return False

    def _is_put_off(self, step: Step) -> bool:
        """Ask whether a step that needs somebody at a cable is performed now; one that has failed
        is.
        """
        last = Commissioned.read(self.path).last(step.name)
        if not step.pulls or (last is not None and not last.holds):
            return False
        try:
            self_stop_s(str(CellText.read(self.path).get("rail.driver")))
        except DeviceRefused as unable:
            self.dialogue.say(f"  step {step.name} is not proved: {unable}")
            return True

        def parse(answer: str) -> bool:
            if answer.lower() in ("y", "yes", NOT_NOW):
                return answer.lower() == NOT_NOW
            raise ValueError(f'expected "yes" or "{NOT_NOW}", got {answer!r}')

        put_off = self.dialogue.ask(
            f"somebody must pull the cable of the {step.pulls} while it moves slowly, and plug it "
            f'in again: "yes", or "{NOT_NOW}"',
            parse,
        )
        if put_off:
            later = f"hilcell commission {self.path} --only {step.name}"
            self.dialogue.say(f"  step {step.name} is not proved; later: {later}")
        return put_off

    def _agree(self, step: Step) -> None:
        """Ask before anything moves; raises `HilcellError` without agreement."""
        if not step.procedure:
            return
        cell = load_cell(str(self.path))
        self.dialogue.real = cell.simulation is None
        moves = motions(cell, load_entry("procedures", step.procedure))
        for question in filter(None, (step.confirms(cell), moves)):
            if not self.dialogue.agree(question):
                raise HilcellError(
                    f"step {step.name} was not agreed to; nothing moved", code="HC-C40"
                )

    def _once(self, step: Step) -> StepRecord:
        """Perform a step once."""
        if not step.procedure:
            return self._record(step, self._without_run(step))
        if step.pulls:
            ask_the_person(load_cell(str(self.path)), step.pulls)
        run, log = self.run(step.procedure)
        return self._record(step, checks_of(log), run, log.assets)

    def _without_run(self, step: Step) -> list[Check]:
        if step.name == "devices":
            return WhichDevices(self.path, CellText.read(self.path), self.dialogue).perform()
        return [
            Check(
                what=f"{ability.device}: {ability.feature}",
                found="; ".join(filter(None, (ability.state, ability.note))),
                expected=ability.needed,
                holds=ability.state != "has not" or ability.needed == "optional",
            )
            for ability in what_devices_can(load_cell(str(self.path)))
        ]

    def _record(
        self, step: Step, checks: list[Check], run: str = "", devices: Sequence[Identity] = ()
    ) -> StepRecord:
        return StepRecord(
            step=step.name,
            ended=_now(),
            operator=self.operator,
            holds=all(each.holds for each in checks),
            checks=checks,
            run=run,
            devices=[*devices],
        )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def checks_of(log: Log) -> list[Check]:
    """Return what the run of a step has verified so far."""
    return [
        Check(
            what=key.partition(".")[2],
            found=verdict.found,
            expected=verdict.expected,
            holds=verdict.holds,
            values=verdict.values,
        )
        for key, verdict in log.verdicts.items()
        if isinstance(verdict, Proved)
    ]


def lines_of(record: StepRecord) -> list[str]:
    """Return a line a check; of the devices' many abilities those that are lacking or read only."""
    lines, shown = [], record.checks
    if record.step == ABILITIES:
        shown = [each for each in record.checks if each.found.startswith(LACKS)]
        lines = [f"{len(record.checks)} abilities, {len(shown)} of them lacking or read only"]
    for each in shown:
        mark = "" if each.holds else " DIFFERS:"
        lines.append(f"{each.what}:{mark} {each.found}; expected {each.expected}")
    return lines


class StepEnded(HilcellError):
    """The run of a step was stopped, or has ended early; the command ends with its exit code."""

    code = "HC-C40"

    def __init__(self, procedure: str, exit_code: int) -> None:
        stopped = exit_code == EXIT_ABORTED
        ended = "was stopped;" if stopped else "ended early; mend the cause, then"
        super().__init__(f"{procedure} {ended} the same command goes on with this step")
        self.exit_code = exit_code


def motions(cell: Cell, procedure: Procedure) -> str:
    """Return the question before a run that moves something, "" for one that moves nothing."""
    moves = [(announced(each, cell), each.needs) for each in procedure.steps]
    moving = [f"  {words} (needs {needs})" for words, needs in moves if words != "nothing"]
    if not moving:
        return ""
    safe = ", ".join(f"A{n} {deg:.1f}" for n, deg in enumerate(cell.robot.safe_deg, start=1))
    robot = f"the robot at {cell.robot.speed_percent:g} %"
    slide = f"the slide at {cell.rail.speed_mm_s:g} mm/s, " if cell.has_rail else ""
    return "\n".join(
        [
            "it moves, in sequence:",
            f"  the robot to its safe pose ({safe} deg), unless it stands there",
            *moving,
            f"where no speed is given: {slide}{robot}",
            "is the cell clear, and somebody at the E-stop?",
        ]
    )


def unproved(path: Path) -> list[str]:
    """Return the steps that are not proved with the values that the cell file has."""
    return Commissioned.read(path).unproved(CellText.read(path))


def standing(path: Path) -> str:
    """Return what a cell file still lacks, or that its cell is ready."""
    if left := unproved(path):
        return f"not proved yet: {', '.join(left)}"
    return f"this cell is ready to calibrate: hilcell run --cell {path}"


def check_proved(path: Path) -> None:
    """Refuse a cell file whose commissioning has begun and has left steps unproved, or was edited
    since, or whose volumes nobody has proved. Raises `HilcellError`.
    """
    record, text = Commissioned.read(path), CellText.read(path)
    held = {each.step for each in record.steps if each.holds}
    held -= {each.name for each in steps_of(text) if each.pulls}  # of a drive, the last try counts
    never = [name for name in record.unproved(text) if name not in held]
    if record.steps and never:
        raise HilcellError(
            f"{path}: commissioning has not proved {', '.join(never)} yet, so places and signs in "
            f"this file may be assumed; go on with `hilcell commission {path}`",
            code="HC-C41",
        )
    if text.get("volumes") is not None and text.get("keep_out") is None:
        raise HilcellError(
            f"{path}: [volumes] names keep-out volumes, and there is no [[keep_out]] yet: nothing "
            f"would keep the arm clear of them; prove them with `hilcell commission {path}`",
            code="HC-C41",
        )
    changed = [key for step in steps_of(text) for key in record.changed(step.name, text)]
    if record.steps and changed:
        raise HilcellError(
            f"{path}: {', '.join(changed)} differ from what commissioning has proved; set them "
            f"back, or prove the new values with `hilcell commission {path}`",
            code="HC-C41",
        )


def refuse_built_in(path: Path) -> None:
    """Raise `SettingsError` for the name of a built-in cell: it is no file to be written."""
    if str(path) in built_in_cells():
        problem = "it is a built-in cell; name a file of your own, such as mycell.toml"
        raise SettingsError(str(path), [problem])


def steps_to_perform(path: Path, first: str, only: str) -> Sequence[Step]:
    """Return the steps to perform: one, those from one on, or from the first that is not proved.

    Raises `SettingsError` for an unknown name, and for a step before which another is not proved:
    it would move by assumed values.
    """
    steps, open_steps = steps_of(CellText.read(path)), unproved(path)
    name, names = only or first, [step.name for step in steps]
    if only and first:
        raise SettingsError("step", ["expected --only or --from, got both"])
    if not (name or open_steps):
        return []
    if name and name not in names:
        raise SettingsError("step", [f"unknown step {name!r}; known: {', '.join(names)}"])
    begin = names.index(name or open_steps[0])
    before_it = steps[begin - 1]
    if not name and before_it.pulls and Commissioned.read(path).last(before_it.name) is None:
        begin -= 1  # it was put off
    if before := [each for each in open_steps if each in names[:begin]]:
        raise SettingsError("step", [f"{name}: {', '.join(before)} must be proved before it"])
    return steps[begin : begin + 1] if only else steps[begin:]
