"""An error's facts as a journal has them, with the code of its alarm.

A text may come from a device, so nothing of it reaches a screen uncleaned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hilcell.alarms.catalogue import UNKNOWN
from hilcell.clean import clean

PARTS = ("device", "operation", "found", "wanted", "act")


@dataclass(frozen=True, slots=True)
class Finding:
    """The parts of a `hilcell.errors.DeviceError`; of other errors the code and ``found`` alone."""

    code: str
    device: str
    operation: str
    found: str
    wanted: str = ""
    act: str = ""

    @property
    def where(self) -> str:
        """Return the device and its operation."""
        return clean(": ".join(part for part in (self.device, self.operation) if part))

    @property
    def text(self) -> str:
        """Return the found and the wanted value, as one line."""
        wanted = f", wanted {line(self.wanted)}" if self.wanted else ""
        return line(self.found) + wanted

    @property
    def advice(self) -> str:
        """Return ``act`` as a sentence."""
        text = line(self.act)
        end = "" if text.endswith((".", "?", "!")) else "."
        return f"{text[:1].upper()}{text[1:]}{end}" if text else ""


def line(text: str) -> str:
    """Return a device's or an error's text as one clean line."""
    return clean("; ".join(" ".join(each.split()) for each in text.splitlines() if each.strip()))


def findings_of(body: Mapping[str, Any]) -> list[Finding]:
    """Return the findings of a journal's record; devices that failed together have one each.

    Older records have no code, and some no parts: their alarm is the device's general one.
    """
    error = body.get("error")
    if isinstance(error, Mapping):
        return _findings(error)
    if body.get("device"):
        return [_finding(UNKNOWN.get(str(body["device"]), UNKNOWN[""]), body)]
    reason = str(body.get("reason", ""))
    head = reason.partition(": ")[0]
    return [Finding(UNKNOWN.get(head, UNKNOWN[""]), "", "", reason)]


def _findings(error: Mapping[str, Any]) -> list[Finding]:
    causes = error.get("causes")
    known = [each for each in causes if isinstance(each, Mapping)] if causes else []
    if known:
        return [finding for cause in known for finding in _findings(cause)]
    return [_finding(str(error.get("code", "")), error)]


def _finding(code: str, parts: Mapping[str, Any]) -> Finding:
    return Finding(code, *(str(parts.get(name, "")) for name in PARTS))
