"""Suspected causes of unexplained errors."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

import msgspec

from hilcell.decoding import Json, typed


class Cause(StrEnum):
    """A cause as text."""

    TRACKER_MOVED = "tracker moved"
    MOUNT_SLIPPED = "mount slipped"
    ZERO_LOST = "zero lost"
    MOUNT_OFFSET = "mount offset"
    SCALE = "scale"
    REVERSAL = "reversal"
    TEMPERATURE = "temperature"
    STRIP = "strip"
    NEST_MOVED = "nest moved"
    CHANGED_SINCE = "changed since"
    REPEATABILITY = "repeatability"
    DRIFT = "drift"
    INSTRUMENT = "instrument"
    REFLECTOR = "reflector"
    BASE_MISPLACED = "base misplaced"
    UNKNOWN = "unknown"

    @property
    def advice(self) -> str:
        """Advice on a calibration whose run suspects this cause."""
        if self is Cause.CHANGED_SINCE:
            return "`hilcell revoke` the wrong one of both calibrations."
        return "Do not use this calibration."


class Suspicion(msgspec.Struct, frozen=True):
    """A matching cause, its size, and the comparison that detected it."""

    cause: Cause
    size: float
    unit: str
    noticed_by: str

    @property
    def facts(self) -> Json:
        found: Json = msgspec.to_builtins(self)
        return found

    @property
    def label(self) -> str:
        return f"{self.cause} ({self.size:.4g} {self.unit})"

    @property
    def text(self) -> str:
        return f"{self.label}, noticed by {self.noticed_by}"


def blamed(facts: Json) -> Json:
    """Result of a run that ended with an error; with the cause, where its fields form a
    `Suspicion`.
    """
    try:
        found = typed(facts.get("fields", {}), Suspicion)
    except msgspec.ValidationError:  # it names no cause, or a size that is no number
        return {}
    return {"suspicions": [found.facts]}


def suspected_in(result: Mapping[str, object]) -> list[Suspicion]:
    return typed(result.get("suspicions", []), list[Suspicion])
