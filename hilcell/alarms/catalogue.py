"""The catalogue: what each fault means to a technician, and what he does about it.

The entries stand in TOML beside this module, one file a kind. A finding belongs to the
first entry whose ``when`` fits it, so the one that takes everything is the last of its kind.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import Literal

from hilcell.alarms.finding import Finding

Severity = Literal["notice", "warning", "fault"]
SEVERITIES: tuple[Severity, ...] = ("notice", "warning", "fault")
FILES = ("strip", "rail", "robot", "tracker", "verdict", "journal", "cell")
REST = "99"  # the end of the codes that take what no other entry takes


@dataclass(frozen=True, slots=True)
class When:
    """What fits: a device by name ("" for none, "*" for any), the others by regular expressions."""

    device: str = ""
    operation: str = ""
    found: str = ""

    def fits(self, finding: Finding) -> bool:
        """Whether ``finding`` is one of these."""
        return (
            self.device in (finding.device, "*")
            and re.search(self.operation, finding.operation) is not None
            and re.search(self.found, finding.found) is not None
        )


@dataclass(frozen=True, slots=True)
class Entry:
    """One kind of alarm. ``then`` says how work goes on after ``do``."""

    code: str
    title: str
    means: str
    do: tuple[str, ...]
    when: tuple[When, ...]
    severity: Severity = "fault"
    then: Literal["resume", "anew", "nothing"] = "resume"
    passes: bool = False  # it tells how something stands, and goes when that is put right

    @property
    def specific(self) -> bool:
        """Whether this entry knows its fault, and does not just take the rest."""
        return not self.code.endswith(REST)


@cache
def catalogue() -> tuple[Entry, ...]:
    """Return all entries, in the order in which they are asked."""
    import tomllib  # here and not above: the screen shows itself before it shows alarms
    from importlib import resources

    import msgspec

    folder = resources.files(__package__)
    pages = (tomllib.loads((folder / f"{name}.toml").read_text("utf-8")) for name in FILES)
    rows = [row for page in pages for row in page["alarm"]]
    return tuple(msgspec.convert(rows, list[Entry]))


def entry_of(finding: Finding) -> Entry:
    """Return the entry that a finding belongs to; the last one takes everything."""
    return next(entry for entry in catalogue() if any(when.fits(finding) for when in entry.when))
