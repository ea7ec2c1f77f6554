"""Values as KRL writes them: ``{E6AXIS: A1 0.00000, A2 -90.00000}``, ``#EX``, ``TRUE``, ``100``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

_AGGREGATE = re.compile(r"^\{\s*(?:(\w+)\s*:)?\s*(.*?)\s*\}$", re.DOTALL)
_NUMBER = re.compile(r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")


class KrlError(ValueError):
    """A text that KRL would not take."""


def members(values: Mapping[str, float | int]) -> str:
    """Return the text of a structure's members; integers stay so, reals get five decimals."""
    return ", ".join(
        f"{name} {value}" if isinstance(value, int) else f"{name} {round(value, 5) + 0.0:.5f}"
        for name, value in values.items()
    )


def aggregate(kind: str, values: Mapping[str, float | int], *more: str) -> str:
    """Return a structure's text; ``more`` are texts of further members."""
    return f"{{{kind}: {', '.join([members(values), *more])}}}"


def raw_members(text: str) -> dict[str, str]:
    """Return the members of a structure as text; raises `KrlError`."""
    match = _AGGREGATE.match(text.strip())
    if match is None:
        raise KrlError(text)
    parts = (part.split() for part in match[2].split(","))
    return {name: value for name, value in parts if value}


def boolean(value: bool) -> str:
    """Return TRUE or FALSE."""
    return "TRUE" if value else "FALSE"


def parse_boolean(text: str) -> bool:
    """Return the value of TRUE or FALSE; raises `KrlError`."""
    try:
        return {"TRUE": True, "FALSE": False}[text.strip().upper()]
    except KeyError:
        raise KrlError(text) from None


def parse_integer(text: str) -> int:
    """Return the value of an INT; raises `KrlError`."""
    try:
        return int(text.strip())
    except ValueError:
        raise KrlError(text) from None


def parse_rounded(text: str) -> int:
    """Return a number for an INT to which a REAL may be assigned; raises `KrlError`."""
    if not _NUMBER.match(text.strip()) or not math.isfinite(float(text)):
        raise KrlError(text)
    return math.floor(float(text) + 0.5)


def parse_aggregate(text: str, kind: str) -> dict[str, float]:
    """Return the members of a structure of ``kind``, which the text may leave out."""
    match = _AGGREGATE.match(text.strip())
    if match is None or (match[1] or kind).upper() != kind:
        raise KrlError(text)
    found: dict[str, float] = {}
    for part in match[2].split(","):
        name, _, number = part.strip().partition(" ")
        if not _NUMBER.match(number.strip()):
            raise KrlError(text)
        found[name.upper()] = float(number)
    return found
