"""The manual's page of alarms, written from the catalogue: ``python -m hilcell.alarms.page``."""

from __future__ import annotations

import sys

from hilcell.alarms.catalogue import Entry, catalogue

HEAD = """# Alarms

All alarms by code, generated from the catalogues of hilcell, its drivers and its procedures
(`python -m hilcell.alarms.page`). `hilcell explain CODE` prints one entry.

- **Fault**, if the row names no severity: the run has stopped, the devices are stopped, the
  measured points are kept. *Warning*: the run waits for an answer, or its result is in doubt;
  an unattended run suspends until the cause is gone, for at most `plan.unattended_wait_s`, then
  ends with a fault. *Notice*: for information, as is a warning that a retry cleared.
- An alarm stays on the screen until its cause is gone **and** it is acknowledged (**k**).
- After the last step continue with **space** or `hilcell resume RUN`. *New run*: this run cannot
  continue, start another one with `hilcell run`. *No action*: the run needs nothing to continue.
- ✓ marks a step that hilcell verifies: it asks the device's controller before anything moves. You
  check all other steps yourself.
- The screen also shows where the alarm was raised, the actual and the expected value. For codes
  that end in 99 the first step is the advice of the operation that failed.
- A stop on the screen is a software stop. It is not the E-stop.
"""


def page() -> str:
    entries = sorted(catalogue().values(), key=lambda each: each.code)
    parts = [HEAD]
    chapters = {
        "R": "Rail",
        "S": "Strip",
        "B": "Robot",
        "T": "Tracker",
        "V": "Verdicts",
        "J": "Journal",
        "C": "Cell",
        "D": "Design studies",
    }
    for letter, title in chapters.items():
        of_chapter = [each for each in entries if each.code.startswith(f"HC-{letter}")]
        parts.append(_chapter(title, of_chapter))
    others = [each for each in entries if not each.code.startswith("HC-")]
    return "\n".join(parts + ([_chapter("Other makes", others)] if others else []))


def _chapter(title: str, entries: list[Entry]) -> str:
    columns = "| code | alarm | meaning | steps |\n|---|---|---|---|"
    return "\n".join([f"## {title}\n", columns, *map(_row, entries), ""])


def _row(entry: Entry) -> str:
    marks = {"you": "", "controller": " ✓"}
    ends = {"resume": "", "new run": " *New run.*", "nothing": " *No action.*"}
    severity = "" if entry.severity == "fault" else f" (*{entry.severity}*)"
    steps = [step + marks[by] for step, by in zip(entry.do, entry.checked_by, strict=True)]
    if len(steps) > 1:
        steps = [f"{number}. {step}" for number, step in enumerate(steps, start=1)]
    last = f"{' '.join(steps)}{ends[entry.then]}"
    cells = (entry.code, f"{entry.title}{severity}", entry.means, last)
    return f"| {' | '.join(each.replace('|', chr(92) + '|') for each in cells)} |"


if __name__ == "__main__":
    sys.stdout.write(page())
