"""What was found, in the parts by which the catalogue knows it: device, operation, found.

A fault's record carries the parts; older journals carry only the error's text, from which they
are taken. The trap: a text may come from a device, so nothing of it reaches a face uncleaned.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from hilcell.clean import clean

DEVICES = ("Rail", "Robot", "Tracker", "Cell")
LONGEST_KEY = 60


@dataclass(frozen=True, slots=True)
class Finding:
    """A `hilcell.ports.DeviceError` in its parts; of other errors, ``found`` and ``act`` alone."""

    device: str
    operation: str
    found: str
    wanted: str = ""
    act: str = ""

    @property
    def where(self) -> str:
        """Return the device and what it was doing."""
        return clean(": ".join(part for part in (self.device, self.operation) if part))

    @property
    def told(self) -> str:
        """Return what was found and what was wanted, as one line."""
        wanted = f", wanted {line(self.wanted)}" if self.wanted else ""
        return line(self.found) + wanted

    @property
    def advice(self) -> str:
        """Return ``act`` as a sentence; that the run is to be resumed is said elsewhere."""
        text = re.sub(r"[,;]?\s*\b(then )?resume$", "", line(self.act))
        end = "" if text.endswith((".", "?", "!")) else "."
        return f"{text[:1].upper()}{text[1:]}{end}" if text else ""


def line(text: str) -> str:
    """Return a device's or an error's text as one clean line."""
    return clean("; ".join(" ".join(each.split()) for each in text.splitlines() if each.strip()))


def findings_of(text: str, parts: Mapping[str, object] | None = None) -> list[Finding]:
    """Return what an error's text says, by its own ``parts`` where they are known.

    Devices that failed to connect are told together, as a tree; each is a finding of its own.
    """
    tree = list(_branches(text))
    if tree:
        return [_of_text(branch) for branch in tree]
    if parts is not None and parts.get("device"):
        names = ("device", "operation", "found", "wanted", "act")
        return [_unwrapped(Finding(*(str(parts.get(name, "")) for name in names)))]
    return [_unwrapped(_of_text(text))]


def _branches(text: str) -> Iterator[str]:
    """Yield the errors of ``Cell: connect: ...``: their lines stand under a device's own."""
    head, *lines = text.splitlines() or [""]
    if not head.startswith("Cell: connect: "):
        return
    branch: list[str] = []
    for each in lines:
        if each.startswith("  ") and each.strip() in DEVICES:
            if branch:
                yield "\n".join(branch)
            branch = []
        else:
            branch.append(each.strip())
    if branch:
        yield "\n".join(branch)


def _of_text(text: str) -> Finding:
    """Take ``Device: operation: found, wanted W; act`` apart."""
    device, _, rest = text.partition(": ")
    operation, mark, rest = rest.partition(": ")
    if device not in DEVICES or not mark:
        if "\n" in text:  # several problems, each with advice of its own
            return Finding("", "", text)
        found, _, act = text.partition("; ")
        return Finding("", "", found, act=act)
    found, _, wanted = rest.partition(", wanted ")
    if wanted:
        wanted, _, act = wanted.partition("; ")
    else:
        found, _, act = rest.partition("; ")
    return Finding(device, operation, found, wanted, act)


def _unwrapped(finding: Finding) -> Finding:
    """Return the error inside ``KEY: Tracker: measure: ...``, which says why a run asked."""
    key, _, inner = finding.found.partition(": ")
    if len(key) > LONGEST_KEY or not inner.startswith(tuple(f"{name}: " for name in DEVICES)):
        return finding
    cause = _of_text(inner)
    return Finding(
        cause.device,
        f"{cause.operation} {key}",
        cause.found,
        cause.wanted or finding.wanted,
        cause.act or finding.act,
    )
