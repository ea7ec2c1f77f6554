"""The catalogue: the meaning of each code for a technician, and the steps to take.

Entries are TOML files in packages: this one has those of the core; the entry points
``hilcell.alarms`` name those of drivers and procedures. An error has its code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal

from hilcell.decoding import typed
from hilcell.errors import HilcellError
from hilcell.language import marked

Severity = Literal["notice", "warning", "fault"]
By = Literal["you", "controller"]
SEVERITIES: tuple[Severity, ...] = marked(("notice", "warning", "fault"))
GROUP = "hilcell.alarms"
# By device, for codes that no catalogue has: the error's own text and advice are shown.
UNKNOWN = {"Rail": "HC-R99", "Robot": "HC-B99", "Tracker": "HC-T99", "": "HC-C99"}
UNKNOWN_VERDICT = "HC-V99"


class CatalogueError(HilcellError):
    """A package's catalogue cannot be read or has a duplicate code."""

    code = "HC-C11"


@dataclass(frozen=True, slots=True)
class Entry:
    """One kind of alarm. ``then`` is how work continues after ``do``.

    ``by`` is who verifies each step of ``do``: the operator, or a controller that is queried before
    anything moves again; empty if always the operator.
    """

    code: str
    title: str
    means: str
    do: tuple[str, ...]
    severity: Severity = "fault"
    then: Literal["resume", "new run", "nothing"] = "resume"
    passes: bool = False  # a condition that may end by itself
    verdict: str = ""  # the verdict that raises it if it fails
    outcome: str = ""  # the verdict's outcome that raises it, "" for any
    by: tuple[By, ...] = ()

    def __post_init__(self) -> None:
        if self.by and len(self.by) != len(self.do):
            raise ValueError(f"{self.code}: by: expected {len(self.do)} words, one a step")

    @property
    def checked_by(self) -> tuple[By, ...]:
        return self.by or tuple("you" for _ in self.do)

    @property
    def specific(self) -> bool:
        return self.code not in (*UNKNOWN.values(), UNKNOWN_VERDICT)


@cache
def catalogue() -> Mapping[str, Entry]:
    """Return all entries by their codes; raises `CatalogueError`."""
    entries: dict[str, Entry] = {}
    owners: dict[str, str] = {}
    for package in packages():
        for entry in entries_of(package):
            if entry.code in entries:
                there = f"{entry.code} is there already, in {owners[entry.code]}"
                raise CatalogueError(f"alarms of {package}: {there}; give one another code")
            entries[entry.code], owners[entry.code] = entry, package
    return entries


def packages() -> list[str]:
    """Return the names of the packages that have entries, hilcell's own first."""
    from importlib.metadata import entry_points

    found = {
        (point.dist is None or point.dist.name != "hilcell", point.module)
        for point in entry_points(group=GROUP)
    }
    return ["hilcell.alarms", *(module for _, module in sorted(found))]


def entries_of(package: str) -> list[Entry]:
    """Return the entries of one package; raises `CatalogueError`."""
    import tomllib  # here and not above: the screen shows itself before it shows alarms
    from importlib import resources

    try:
        files = [each for each in resources.files(package).iterdir() if each.name.endswith(".toml")]
    except (ImportError, OSError) as error:
        raise CatalogueError(f"alarms of {package} cannot be read: {error}") from error
    found: list[Entry] = []
    for file in files:
        where = file.name
        try:
            for n, row in enumerate(tomllib.loads(file.read_text("utf-8"))["alarm"], start=1):
                where = f"{file.name}, alarm {n}"
                found.append(typed(row, Entry))
        except (OSError, ValueError, KeyError, TypeError) as error:
            problem = f"no {error}" if isinstance(error, KeyError) else str(error)
            reason = f"cannot be read: {where}: {problem}"
            raise CatalogueError(f"alarms of {package} {reason}") from error
    return found


def entry_of(code: str, device: str = "") -> Entry:
    """Return the entry of a code, or the device's general one."""
    entries = catalogue()
    return entries.get(code) or entries[UNKNOWN.get(device, UNKNOWN[""])]


def code_of_verdict(name: str, outcome: str = "") -> str:
    """Return the code of a failed verdict by its name up to the first dot.

    An entry with the verdict's outcome takes precedence.
    """
    kind = name.partition(".")[0]
    codes = {e.outcome: e.code for e in catalogue().values() if e.verdict == kind}
    return codes.get(outcome) or codes.get("", UNKNOWN_VERDICT)
