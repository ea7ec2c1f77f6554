"""The manual's page of alarms, written from the catalogue: ``python -m hilcell.alarms.page``."""

from __future__ import annotations

import sys

from hilcell.alarms.catalogue import Entry, catalogue

HEAD = """# Alarms

Every alarm of hilcell: its code, its meaning, the steps to take. This page is written from the
catalogues of hilcell, its drivers and its procedures by `python -m hilcell.alarms.page`.

A **fault** has stopped the run; devices are stopped, measured points are kept. A **warning** asks
for somebody: the run waits, or its result is in doubt. A **notice** is worth knowing. A warning
that nobody can answer, because the run is unattended, suspends it until a look finds that the cause
has gone, at most `plan.unattended_wait_s`; then it ends as a fault. A warning that a repetition has
healed is shown as a notice. `hilcell explain CODE` prints one entry. An alarm stays on the screen
until its cause is gone and somebody has acknowledged it.

A step marked *(controller)* is checked by hilcell itself: it asks the device's controller before
anything moves again. All other steps are checked by you.

On the screen an alarm also states its place, the found and the wanted value. Where this list does
not know a fault (codes that end in 99), the first step there is the failing operation's own advice.
A stop on the screen is a software stop, not the E-stop.
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
        parts += [f"## {title}\n", *map(_section, of_chapter)]
    others = [_section(each) for each in entries if not each.code.startswith("HC-")]
    return "\n".join(parts + (["## Other makes\n", *others] if others else []))


def _section(entry: Entry) -> str:
    pairs = zip(entry.do, entry.checked_by, strict=True)
    steps = [step if by == "you" else f"{step} *({by})*" for step, by in pairs]
    then = {
        "resume": "Continue: space, or `hilcell resume RUN`.",
        "new run": "Start a new run: `hilcell run`.",
        "nothing": "The run needs nothing to go on.",
    }
    steps.append(then[entry.then])
    numbered = "\n".join(f"{number}. {step}" for number, step in enumerate(steps, start=1))
    head = f"### {entry.code} {entry.title}\n\n{entry.severity.capitalize()}. {entry.means}"
    return f"{head}\n\n{numbered}\n"


if __name__ == "__main__":
    sys.stdout.write(page())
