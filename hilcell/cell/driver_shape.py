"""The shape of a driver's class, judged before it is built: its methods and its options."""

from __future__ import annotations

import inspect
from typing import Any

import msgspec

from hilcell.errors import one_line

BUILT_WITH = ("options", "clock")


def misfits(kind: Any, port: type) -> list[str]:
    """Return what keeps a driver's class from being one of a port, in words."""
    options = getattr(kind, "Options", None)
    typed = isinstance(options, type) and issubclass(options, msgspec.Struct)
    methods = [name for name in vars(port) if not name.startswith("_")]
    lacking = [name for name in methods if not callable(getattr(kind, name, None))]
    if missing := ([] if typed else ["Options (a msgspec.Struct)"]) + lacking:
        return [f"it has no {', '.join(missing)}"]
    asked = {name: [*inspect.signature(getattr(port, name)).parameters] for name in methods}
    found = [_misfit(name, getattr(kind, name), words) for name, words in asked.items()]
    built = _misfit("__init__", kind, BUILT_WITH)
    return [each for each in (_of_options(options), built, *found) if each]


def _of_options(options: Any) -> str:
    """Return why the options' types mean nothing; "" where they do."""
    try:
        msgspec.json.Decoder(options)
    except Exception as error:  # noqa: BLE001 - an annotation is any expression
        return f"its Options have a type that cannot be used: {one_line(error)}"
    return ""


def _misfit(name: str, call: Any, words: Any) -> str:
    """Return why a method does not take the values that it is called with; "" where it does."""
    try:
        signature = inspect.signature(call)
    except (TypeError, ValueError):  # of a callable that is not Python's
        return ""
    try:
        signature.bind(*words)
    except TypeError as error:
        wanted = ", ".join(each for each in words if each != "self")
        return f"its {name} does not take ({wanted}): {error}"
    return ""
