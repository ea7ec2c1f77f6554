"""The identity of an asset: as a device states it, as journals keep it, as reports show it.

Apart from `hilcell.ports`, so that a journal can be read without loading arrays.
"""

from __future__ import annotations

from collections.abc import Mapping

import msgspec


class Identity(msgspec.Struct, frozen=True):
    """A robot, a tracker, a rail's drive or its strip; strings were cleaned at the driver's edge.

    ``device`` is the port by which it was reached: drive and strip are both at "Rail". ``kind`` is
    robot, tracker, drive or strip; without one it is that of the device. A field that the device
    does not report is "". ``simulated`` is its own statement: see
    `hilcell.ports.is_simulated_name`.
    """

    device: str = ""
    model: str = ""
    serial: str = ""
    address: str = ""
    simulated: bool = False
    kind: str = ""
    maker: str = ""
    firmware: str = ""

    def __post_init__(self) -> None:
        """Name a device without a kind by its port."""
        if not self.kind:
            msgspec.structs.force_setattr(self, "kind", self.device.lower())

    @property
    def text(self) -> str:
        """Model and serial number as text."""
        return f"{self.model}, serial {self.serial}"


def changed_asset_kinds(before: Mapping[str, Identity], now: Mapping[str, Identity]) -> list[str]:
    """Return the kinds of assets that have changed; an unknown firmware is no change."""

    def same(one: Identity | None, other: Identity | None) -> bool:
        if one is None or other is None:
            return False
        known = (one.maker, one.model, one.serial) == (other.maker, other.model, other.serial)
        return known and (one.firmware == other.firmware or "" in (one.firmware, other.firmware))

    kinds = sorted(before.keys() | now.keys())
    return [kind for kind in kinds if not same(before.get(kind), now.get(kind))]


def different_assets(
    first: list[Identity], second: list[Identity]
) -> list[tuple[Identity, Identity]]:
    """Return the pairs of assets of one kind whose serial numbers differ."""
    there = {asset.kind: asset for asset in second}
    pairs = ((one, there[one.kind]) for one in first if one.kind in there)
    return [pair for pair in pairs if pair[0].serial != pair[1].serial]
