"""KRL values as text: ``{E6AXIS: A1 0.0, A2 -90.0, ...}``, ``#EX``, ``TRUE``, ``100``, ``"text"``.

A controller with another locale, or a stale interface, answers ``1,234`` or ``NaN``. Only finite
numbers with a decimal point are taken; anything else is refused, never guessed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

Value = float | int | bool | str | dict[str, "Value"]

MAX_DEPTH = 4
_TOKEN = re.compile(
    r"""\s*(?:
        (?P<punctuation>[{}:,])
      | (?P<text>"[^"]*")
      | (?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])
      | (?P<name>[#$]?[A-Za-z_$][\w$]*(?:\[[\d,\s]*\])?)
    )""",
    re.VERBOSE | re.ASCII,
)


class KrlError(ValueError):
    """Text that is no KRL value."""


def parse(text: str) -> Value:
    """Return the value: numbers, bools, ``#ENUM`` and strings as str, structures as dict."""
    tokens = _tokens(text)
    value, end = _value(tokens, 0, 0)
    if end != len(tokens):
        raise KrlError(f"{tokens[end][1]!r} follows the value in {text[:80]!r}")
    return value


def numbers(text: str, names: tuple[str, ...]) -> list[float]:
    """Return components of a structure as floats; raises `KrlError` where one is missing."""
    value = parse(text)
    if not isinstance(value, dict):
        raise KrlError(f"a structure is expected, found {text[:80]!r}")
    found = []
    for name in names:
        number = value.get(name)
        if isinstance(number, bool) or not isinstance(number, float | int):
            raise KrlError(f"{name} is missing or no number in {text[:80]!r}")
        found.append(float(number))
    return found


def structure(kind: str, components: Mapping[str, float], decimals: int = 6) -> str:
    """Return ``{KIND: A1 1.000000, ...}``; raises `KrlError` for a value that is not finite."""
    for name, number in components.items():
        if not math.isfinite(number):
            raise KrlError(f"{name} {number} is not finite")
    body = ", ".join(f"{name} {number:.{decimals}f}" for name, number in components.items())
    return f"{{{kind}: {body}}}"


def _tokens(text: str) -> list[tuple[str, str]]:
    tokens: list[tuple[str, str]] = []
    text = text.strip("\0 \t\r\n")
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise KrlError(f"{text[position : position + 20]!r} is no KRL in {text[:80]!r}")
        tokens.append((match.lastgroup, match.group(match.lastgroup)))
        position = match.end()
    if not tokens:
        raise KrlError("the value is empty")
    return tokens


def _value(tokens: list[tuple[str, str]], at: int, depth: int) -> tuple[Value, int]:
    if at >= len(tokens):
        raise KrlError("the value ends too early")
    kind, part = tokens[at]
    if kind == "number":
        return _number(part), at + 1
    if kind == "text":
        return part[1:-1], at + 1
    if kind == "name":
        return {"TRUE": True, "FALSE": False}.get(part.upper(), part), at + 1
    if part == "{" and depth < MAX_DEPTH:
        return _structure(tokens, at + 1, depth + 1)
    raise KrlError(f"{part!r} stands where a value is expected")


def _structure(tokens: list[tuple[str, str]], at: int, depth: int) -> tuple[Value, int]:
    if [token for _, token in tokens[at + 1 : at + 2]] == [":"]:
        at += 2  # the name of the structure's type
    found: dict[str, Value] = {}
    while True:
        if at >= len(tokens) or tokens[at][0] != "name":
            raise KrlError("a component's name is expected")
        name = tokens[at][1].upper()
        if name in found:
            raise KrlError(f"{name} occurs twice")
        found[name], at = _value(tokens, at + 1, depth)
        separator = tokens[at][1] if at < len(tokens) else ""
        if separator == "}":
            return found, at + 1
        if separator != ",":
            raise KrlError(f"',' or '}}' is expected after {name}, found {separator!r}")
        at += 1


def _number(token: str) -> float | int:
    value = float(token)
    if not math.isfinite(value):
        raise KrlError(f"{token[:20]} is not finite")
    return int(token) if re.fullmatch(r"[+-]?\d+", token) else value
