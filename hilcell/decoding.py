"""Typed values from plain ones, and from JSON: `msgspec`'s, for several threads.

msgspec learns a type when it is first used, and marks it as known before it has its fields. A
second thread that uses it meanwhile reads them all the same, and the process dies of a
segmentation fault (msgspec 0.22). So each type is learnt under a lock.
"""

from __future__ import annotations

import threading
from functools import cache
from typing import Any, TypeAlias, TypeVar, cast, overload

import msgspec

T = TypeVar("T")
Json: TypeAlias = dict[str, Any]  # a plain object: an error's facts, a cell as it is written
_LEARNING = threading.Lock()


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
    """Have msgspec know a type, and all that are in it, before a second thread uses one."""
    with _LEARNING:
        msgspec.json.Decoder(kind)
