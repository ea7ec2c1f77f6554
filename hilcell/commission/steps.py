"""The steps of commissioning, in sequence, and the loop that performs them.

A step that needs devices is a run of a procedure. Its verdicts carry values for the cell file: the
step is repeated with them until it proves what the file says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.commission.cell_text import CellText
from hilcell.commission.dialogue import Dialogue
from hilcell.commission.first_steps import WhichDevices, what_devices_can
from hilcell.commission.record import Check, Commissioned, StepRecord
from hilcell.errors import HilcellError
from hilcell.journal.log import Log
from hilcell.model.verdicts import Proved

ABILITIES, LACKS = "abilities", "has not"
REPEATS = 6  # of a step whose values are written and proved again


class Step(NamedTuple):
    """One step; ``procedure``: of its run, "" for one without a run."""

    name: str
    title: str
    moves: str
    procedure: str = ""


STEPS = (
    Step("devices", "which devices there are", "nothing"),
    Step(ABILITIES, "what the devices can", "nothing"),
    Step(
        "controller",
        "settings of the robot's controller, the safe pose",
        "nothing",
        "commission-controller",
    ),
    Step(
        "rail",
        "signs, scales, speed and stop of the rail, small first",
        "the slide by 0.5, 5, 20, 100 and 500 mm towards the middle of its travel, and back, the "
        "first at 0.5 mm/s; a quick stop at 1.2 times each distance plus 3 mm",
        "commission-rail",
    ),
    Step(
        "robot",
        "each axis by a degree",
        "each axis of the robot alone by 1 deg at 1 % of its speed, and back",
        "commission-robot",
    ),
    Step(
        "tracker",
        "the tracker's pose, by the floor nests in any order",
        "nothing; a person puts the beam on the nests",
        "commission-tracker",
    ),
    Step(
        "base",
        "the robot's base and the reflector on its flange",
        "each axis of the robot, at most 15 deg around its safe pose, at 5 % of its speed",
        "commission-base",
    ),
    Step(
        "slide",
        "the nests on the slide and the rail's direction",
        "the slide by 300 mm; a person puts the beam on the slide's nests",
        "commission-slide",
    ),
    Step(
        "stations",
        "the stations, by the strip",
        "the slide to each station",
        "commission-stations",
    ),
    Step(
        "proof",
        "a first pass, a correction that must go the right way, a stop",
        "the robot to the corners of its grid at 10 % of its speed",
        "commission-proof",
    ),
)
Perform = Callable[[str], tuple[str, Log]]  # a procedure to its end: the run's name, its log


@dataclass(frozen=True)
class Commissioning:
    """One cell's commissioning: performs steps, writes the cell file and the record."""

    path: Path
    dialogue: Dialogue
    operator: str
    run: Perform

    def perform(self, steps: Sequence[Step]) -> bool:
        """Perform steps in sequence up to the first that does not prove; return whether all did."""
        for number, step in enumerate(steps, start=1):
            self.dialogue.say(f"step {number} of {len(steps)}, {step.name}: {step.title}")
            if not self._perform(step):
                return False
        return True

    def _perform(self, step: Step) -> bool:
        self._agree(step)
        for _ in range(REPEATS):
            record = self._once(step)
            text = CellText.read(self.path)
            before = {path: text.get(path) for path in record.values}
            for path, value in record.values.items():
                text.set(path, value, f"by `hilcell commission`, step {step.name}")
            changed = [path for path, value in before.items() if value != text.get(path)]
            if changed:
                text.write(self.path)
                load_cell(str(self.path))
            Commissioned.read(self.path).add(record, self.path)
            self._show(step, record.checks)
            for path in changed:
                self.dialogue.say(f"  {self.path.name}: {path} = {text.get(path)}")
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

    def _show(self, step: Step, checks: Sequence[Check]) -> None:
        """Print the checks; of a device's many abilities only those that it lacks."""
        shown = checks
        if step.name == ABILITIES:
            shown = [each for each in checks if each.found.startswith(LACKS)]
            self.dialogue.say(f"  {len(checks)} abilities, {len(shown)} of them lacking")
        for each in shown:
            mark = "" if each.holds else " DIFFERS:"
            self.dialogue.say(f"  {each.what}:{mark} {each.found}; expected {each.expected}")

    def _agree(self, step: Step) -> None:
        """Ask before anything moves; raises `HilcellError` without agreement."""
        if step.moves.partition(";")[0] == "nothing":
            return
        self.dialogue.real = load_cell(str(self.path)).simulation is None
        question = f"this step moves {step.moves}; is the cell clear, and somebody at the E-stop?"
        if not self.dialogue.agree(question):
            raise HilcellError(f"step {step.name} was not agreed to; nothing moved", code="HC-C40")

    def _once(self, step: Step) -> StepRecord:
        """Perform a step once."""
        if not step.procedure:
            return self._record(step, self._without_run(step))
        run, log = self.run(step.procedure)
        checks = [
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
        return self._record(step, checks, run)

    def _without_run(self, step: Step) -> list[Check]:
        if step.name == "devices":
            return WhichDevices(self.path, CellText.read(self.path), self.dialogue).perform()
        return [
            Check(
                what=f"{ability.device}: {ability.feature}",
                found=" ".join(filter(None, (ability.state, ability.note))),
                expected=ability.needed,
                holds=ability.state != "has not" or ability.needed == "optional",
            )
            for _, abilities in what_devices_can(load_cell(str(self.path)))
            for ability in abilities
        ]

    def _record(self, step: Step, checks: list[Check], run: str = "") -> StepRecord:
        return StepRecord(
            step=step.name,
            ended=datetime.now(UTC).isoformat(timespec="seconds"),
            operator=self.operator,
            holds=all(each.holds for each in checks),
            checks=checks,
            run=run,
        )


def steps_to_perform(path: Path, first: str, only: str) -> Sequence[Step]:
    """Return the steps to perform: one, those from one on, or from the first that is not proved.

    Raises `SettingsError` for an unknown name.
    """
    names = [step.name for step in STEPS]
    for name in filter(None, (first, only)):
        if name not in names:
            raise SettingsError("step", [f"unknown step {name!r}; known: {', '.join(names)}"])
    if only:
        return [STEPS[names.index(only)]]
    if first:
        return STEPS[names.index(first) :]
    record, text = Commissioned.read(path), CellText.read(path)
    begun = (n for n, step in enumerate(STEPS) if record.status(step.name, text) != "proved")
    return STEPS[next(begun, len(STEPS)) :]
