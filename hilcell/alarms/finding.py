"""An error's facts as a journal has them, with the code of its alarm.

A text may come from a device, so nothing of it reaches a screen uncleaned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hilcell.clean import clean

PARTS = ("code", "device", "operation", "found", "wanted", "act")


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


def findings_of(error: Mapping[str, Any]) -> list[Finding]:
    """Return the findings of an error's facts; devices that failed together have one each."""
    if causes := error.get("causes"):
        return [finding for cause in causes for finding in findings_of(cause)]
    return [Finding(*(str(error.get(name, "")) for name in PARTS))]
