"""KRL values as text: ``{E6AXIS: A1 0.0, A2 -90.0, ...}``, ``#EX``, ``TRUE``, ``100``, ``"text"``.

Only single values and flat structures are read. A controller with another locale, or a stale
interface, answers ``1,234`` or ``NaN``: everything except finite numbers with a decimal point is
refused, never guessed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from drivers.device_errors import ProtocolError

Value = float | int | bool | str
JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE = ("X", "Y", "Z", "A", "B", "C")
SLIDE = "E1"

_PADDING = "\0 \t\r\n"
_NAME = r"[#$]?[A-Za-z_$][\w$]*(?:\[[\d,\s]*\])?"
_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_TEXT = r'"[^"]*"'
_COMPONENT = re.compile(rf"({_NAME})\s+(?:({_NUMBER})|{_TEXT}|{_NAME})", re.ASCII)
_ANY = rf"{_NAME}\s+(?:{_NUMBER}|{_TEXT}|{_NAME})"
_STRUCTURE = re.compile(rf"\{{\s*(?:{_NAME}\s*:)?\s*({_ANY}(?:\s*,\s*{_ANY})*)\s*\}}", re.ASCII)
LARGEST = 1e6  # mm or deg: beyond any rail, and any revolution that an axis counts


def parse(text: str) -> Value:
    """Return a single value: a number or bool, ``#ENUM`` and strings as str."""
    form = rf"(?P<whole>[+-]?\d+)|(?P<real>{_NUMBER})|(?P<text>{_TEXT})|(?P<name>{_NAME})"
    match = re.fullmatch(form, text.strip(_PADDING), re.ASCII)
    if match is None:
        raise ProtocolError(f"{text[:80]!r} is no single KRL value")
    part = match[0]
    if match.lastgroup == "name":
        part = part.upper()  # KRL's names have no case
        return {"TRUE": True, "FALSE": False}.get(part, part)
    if match.lastgroup == "text":
        return part[1:-1]
    value = _finite(part)
    return int(part) if match.lastgroup == "whole" else value


def numbers(text: str, names: tuple[str, ...]) -> list[float]:
    """Return components of a flat structure; raises `ProtocolError` where one is missing."""
    match = _STRUCTURE.fullmatch(text.strip(_PADDING))
    if match is None:
        raise ProtocolError(f"expected a structure of single values, got {text[:80]!r}")
    components = _COMPONENT.findall(match[1])
    found = {name.upper(): number for name, number in components}
    if len(found) != len(components):
        raise ProtocolError(f"a component occurs twice in {text[:80]!r}")
    values = {name: float(number) for name, number in found.items() if number}
    for name, value in values.items():
        if not -LARGEST <= value <= LARGEST:
            raise ProtocolError(f"{name} is {_finite(found[name]):g}, no position of a robot")
    for name in names:
        if name not in values:
            raise ProtocolError(f"{name} is missing or no number in {text[:80]!r}")
    return [values[name] for name in names]


def structure(kind: str, components: Mapping[str, float], decimals: int = 6) -> str:
    """Return ``{KIND: A1 1.000000, ...}``; raises `ProtocolError` if a value is not finite."""
    for name, number in components.items():
        if not math.isfinite(number):
            raise ProtocolError(f"{name} {number} is not finite")
    body = ", ".join(f"{name} {number:.{decimals}f}" for name, number in components.items())
    return f"{{{kind}: {body}}}"


def _finite(number: str) -> float:
    value = float(number)
    if not math.isfinite(value):
        raise ProtocolError(f"{number[:20]} is not finite")
    return value
