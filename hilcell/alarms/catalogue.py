"""The catalogue: the meaning of each code for a technician, and the steps to take.

Entries are TOML files in packages: this one has those of the core; the entry points
``hilcell.alarms`` name the packages beside the code of drivers and procedures. An error says its
code itself, so nothing here has to recognise it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal

from hilcell.decoding import typed
from hilcell.errors import HilcellError

Severity = Literal["notice", "warning", "fault"]
By = Literal["you", "controller"]
SEVERITIES: tuple[Severity, ...] = ("notice", "warning", "fault")
GROUP = "hilcell.alarms"
# By device, for errors whose code no catalogue has: their own words and advice are shown.
UNKNOWN = {"Rail": "HC-R99", "Robot": "HC-B99", "Tracker": "HC-T99", "": "HC-C99"}
UNKNOWN_VERDICT = "HC-V99"


class CatalogueError(HilcellError):
    """A package's catalogue cannot be read, or has a code that another one has."""

    code = "HC-C11"


@dataclass(frozen=True, slots=True)
class Entry:
    """One kind of alarm. ``then`` says how work goes on after ``do``.

    ``by`` says for each step of ``do`` who knows that it is done: a person, or a controller that
    is asked before anything moves again; empty where it is always a person.
    """

    code: str
    title: str
    means: str
    do: tuple[str, ...]
    severity: Severity = "fault"
    then: Literal["resume", "new run", "nothing"] = "resume"
    passes: bool = False  # it shows a condition, and goes when that is put right
    verdict: str = ""  # the verdict that raises it where it does not hold
    outcome: str = ""  # the one of that verdict which alone raises it
    by: tuple[By, ...] = ()

    def __post_init__(self) -> None:
        if self.by and len(self.by) != len(self.do):
            raise ValueError(f"{self.code}: by: expected {len(self.do)} words, one a step")

    @property
    def checked_by(self) -> tuple[By, ...]:
        """Return who knows that a step is done, for each step."""
        return self.by or tuple("you" for _ in self.do)

    @property
    def specific(self) -> bool:
        """Whether this entry knows its fault."""
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
    """Return the entry of a code; of one that no catalogue has, the device's general one."""
    entries = catalogue()
    return entries.get(code) or entries[UNKNOWN.get(device, UNKNOWN[""])]


def code_of_verdict(name: str, outcome: str = "") -> str:
    """Return the code that a verdict raises: by its name, or by the part before its first dot.

    An entry of its very outcome goes before one of any.
    """
    kind = name.partition(".")[0]
    found = {e.outcome: e.code for e in catalogue().values() if e.verdict == kind}
    return found.get(outcome) or found.get("", UNKNOWN_VERDICT)
