"""Objects by key, packed: points of a month would take 3 kB each as objects, and take 0.5 kB."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping
from typing import Generic, TypeVar

import msgspec

from hilcell.typed import learn, typed

T = TypeVar("T", bound=msgspec.Struct)


class Packed(MutableMapping[str, T], Generic[T]):
    """Holds structs of one kind; each access gives a new object, equal to the one that was set.

    ``row`` is the kind, with ``array_like``: packed without the names of its fields.
    """

    def __init__(self, row: type[T]) -> None:
        learn(row)
        self._row = row
        self._encoder, self._decoder = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(row)
        self._rows: dict[str, bytes] = {}

    def __getitem__(self, key: str) -> T:
        return self._decoder.decode(self._rows[key])

    def __setitem__(self, key: str, value: T) -> None:
        row = typed(value, self._row, from_attributes=True)
        self._rows[key] = self._encoder.encode(row)

    def __delitem__(self, key: str) -> None:
        del self._rows[key]

    def __contains__(self, key: object) -> bool:
        return key in self._rows

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)
