"""``sim --train``: a menu of faults of the simulated cell, for technicians to practise on."""

from __future__ import annotations

import random
import sys
import threading
from queue import Empty, SimpleQueue

from hilcell.alarms.catalogue import entry_of
from hilcell.commands.output import print_message
from hilcell.ports import Exercise, Training

LOOK_S = 0.1
HELP = "A number strikes that fault, Enter one that is not named; q ends the simulated cell."
STRUCK = (
    "It strikes as soon as the run gives it occasion. Find the cause by the screen and the alarm, "
    "and decide what to do; then press Enter here."
)


class Trainer:
    """Strikes one fault at a time, and afterwards says what it was and what is right to do."""

    def __init__(self, cell: Training, chance: random.Random) -> None:
        self._cell, self._chance = cell, chance
        self._struck: Exercise | None = None

    def menu(self) -> None:
        """Print the faults."""
        rows = [f"{n:3d}  {each.title}" for n, each in enumerate(self._cell.exercises, start=1)]
        print_message("\n".join(["training:", *rows, HELP]))

    def take(self, line: str) -> bool:
        """Obey one line of the keyboard; return whether more are wanted."""
        word = line.strip().lower()
        if word == "q":
            return False
        if self._struck is not None:
            self._explain(self._struck)
        elif not word:
            self._strike(self._chance.choice(self._cell.exercises))
        elif word.isdecimal() and 1 <= int(word) <= len(self._cell.exercises):
            self._strike(self._cell.exercises[int(word) - 1])
        else:
            print_message(HELP)
        return True

    def _strike(self, exercise: Exercise) -> None:
        self._cell.strike(exercise)
        self._struck = exercise
        print_message(STRUCK)

    def _explain(self, exercise: Exercise) -> None:
        """Say what it was, and put the cell right."""
        entry = entry_of(exercise.alarm)
        steps = [f"  {number}. {step}" for number, step in enumerate(entry.do, start=1)]
        print_message(
            "\n".join(
                [
                    f"It was: {exercise.title}.",
                    f"The alarm is {entry.code}, {entry.title}: {entry.means}",
                    "The right reaction:",
                    *steps,
                    "The simulated cell is put right; resume the run.",
                ]
            )
        )
        self._cell.heal()
        self._struck = None
        self.menu()


def train(cell: Training, ended: threading.Event) -> None:
    """Train until ``ended`` is set, or the keyboard says or is at its end."""
    trainer = Trainer(cell, random.Random())  # noqa: S311 - a surprise, not a secret
    lines: SimpleQueue[str | None] = SimpleQueue()
    threading.Thread(target=_read, args=(lines,), name="keyboard", daemon=True).start()
    trainer.menu()
    while not ended.is_set():
        try:
            line = lines.get(timeout=LOOK_S)
        except Empty:
            continue
        if line is None or not trainer.take(line):
            return


def _read(lines: SimpleQueue[str | None]) -> None:
    """Hand on the lines of the keyboard, and its end."""
    for line in sys.stdin:
        lines.put(line)
    lines.put(None)
