"""Thread-safe conversion of plain values and JSON to types, with `msgspec`.

msgspec inspects a type at its first use and marks it as known before its fields are complete. A
second thread that uses it meanwhile causes a segmentation fault (msgspec 0.22). So each type is
inspected under a lock.
"""

from __future__ import annotations

import threading
from functools import cache
from typing import Any, TypeAlias, TypeVar, cast, overload

import msgspec

T = TypeVar("T")
Json: TypeAlias = dict[str, Any]  # a plain object: facts of an error, a cell file
_INSPECTING = threading.Lock()


@overload
def typed(value: object, kind: type[T], *, from_attributes: bool = False) -> T: ...
@overload
def typed(value: object, kind: Any) -> Any: ...
def typed(value: object, kind: Any, *, from_attributes: bool = False) -> Any:
    """Return a plain value as ``kind``; raises `msgspec.ValidationError`."""
    learn(kind)
    return msgspec.convert(value, kind, from_attributes=from_attributes)


def decoded(text: bytes | str, kind: type[T]) -> T:
    """Return JSON as ``kind``; raises `msgspec.DecodeError`."""
    learn(cast("Any", kind))
    return msgspec.json.decode(text, type=kind)


@cache
def learn(kind: Any) -> None:
    """Let msgspec inspect a type and its nested types before a second thread uses one."""
    with _INSPECTING:
        msgspec.json.Decoder(kind)
