"""``reactions.md``: fault by phase, and the reaction of the run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from campaigns.faults.judging import Judged
from campaigns.faults.phases import Phase
from campaigns.faults.script import Case
from campaigns.faults.table import FAULTS, Fault

PAGE = Path(__file__).parent / "reactions.md"
HEAD = """# Reactions to injected faults

Each fault of the catalogue, injected into the simulated cell in each phase of a run, with the
reaction of the run. `make torture` (`python -m campaigns faults`) runs all cases and writes this
page. It judges the alarm, the exit code, the trace checker (`hilcell show RUN --check`), the
result, and the resume after the cause is removed.

"went on": the result is that of a run without the fault. Codes: [alarms](../../docs/alarms.md).
"n/a": the fault has no such phase, for the reason given.
"""


def page(found: Mapping[Case, Judged]) -> str:
    head = ["#", "fault", "reaction wanted", *(phase.value for phase in Phase)]
    rows = [head, ["---"] * len(head), *(_row(fault, found) for fault in FAULTS)]
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return f"{HEAD}\n{table}\n\n## How each is brought about\n\n{_ways()}\n"


def _row(fault: Fault, found: Mapping[Case, Judged]) -> list[str]:
    return [str(fault.number), fault.name, fault.reaction, *_cells(fault, found)]


def _cells(fault: Fault, found: Mapping[Case, Judged]) -> Iterator[str]:
    for phase in Phase:
        if why := fault.skipped.get(phase):
            yield f"n/a: {why}"
            continue
        seen = [
            verdict.reaction + (" **BROKEN**" if verdict.problems else "")
            for case, verdict in found.items()
            if (case.number, case.phase) == (fault.number, phase)
        ]
        yield "; ".join(sorted(set(seen))) or "-"


def _ways() -> str:
    return "\n".join(
        f"- {fault.number}: {'; '.join(each.text for each in fault.injections)}"
        for fault in FAULTS
        if fault.injections
    )
