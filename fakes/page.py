"""The manual's page of faults on demand, from their table: ``python -m fakes.page``."""

from __future__ import annotations

import sys

from fakes.exercises import EXERCISES
from fakes.faults import KNOWN, TEXTS

HEAD = """# Training, and faults on demand

## Training

`hilcell sim --train` runs the simulated cell and offers faults to practise on. In another terminal,
`hilcell tui` or `hilcell run` with the printed `--set simulation.address=...` works on that cell.

| key | effect |
| --- | --- |
| a number | that fault strikes |
| Enter | a fault strikes that is not named: find out by the screen and the alarm |
| Enter again | says which fault it was, its alarm and the steps to take, and puts the cell right |
| `m` | lists the faults again |
| `q`, or ctrl-C | ends the simulated cell |

Resume the run then, as after the real fault. The faults, and the alarm that each raises:
"""
MIDDLE = """
## Faults on demand

`hilcell sim --faults FILE` strikes faults by a TOML file:

```toml
[[fault]]
name = "rail.emcy"
value = 0x7305  # without one the fault has its usual value
after = 2       # so many occasions pass first
count = 1       # it strikes so often; 0: until it is cleared
at_rest = false # true: a fault that waits for a motion strikes at rest, too
```

Each name, its effect (its value), and the occasion on which it strikes. Values are numbers, or text
where the name has a *.

| name | effect | occasion |
| --- | --- | --- |
"""


def page() -> str:
    """Return the page as Markdown."""
    exercises = [f"- {each.title}: [{each.alarm}](alarms.md)" for each in EXERCISES]
    faults = [_row(name, *text.split(" | ")) for name, text in KNOWN.items()]
    return "\n".join([HEAD, *exercises]) + "\n" + MIDDLE + "\n".join(faults) + "\n"


def _row(name: str, effect: str, occasion: str) -> str:
    return f"| `{name}`{' *' if name in TEXTS else ''} | {effect} | {occasion} |"


if __name__ == "__main__":
    sys.stdout.write(page())
