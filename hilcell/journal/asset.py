"""The assets of a cell as the journal names them: one entry per device with a serial number."""

from __future__ import annotations

from typing import Any

import msgspec

from hilcell.typed import typed


class Asset(msgspec.Struct, frozen=True, kw_only=True):
    """A robot, a tracker, a rail's drive or its strip. "" where a device does not say.

    ``device`` is the port by which it was reached: drive and strip are both at "Rail".
    """

    kind: str = ""
    device: str = ""
    maker: str = ""
    model: str = ""
    serial: str = ""
    firmware: str = ""
    address: str = ""
    simulated: bool = False

    @property
    def text(self) -> str:
        """Return it in words: model and serial number."""
        return f"{self.model}, serial {self.serial}"


def asset_of(entry: dict[str, Any]) -> Asset:
    """Return a device of the event `connected`; its name is its kind where it has no other."""
    asset = typed(entry, Asset)
    return asset if asset.kind else msgspec.structs.replace(asset, kind=asset.device.lower())


def same(before: Asset | None, now: Asset | None) -> bool:
    """Whether two assets of a kind are one; a firmware that was not stated once proves nothing."""
    if before is None or now is None:
        return before is now
    known = (before.maker, before.model, before.serial) == (now.maker, now.model, now.serial)
    return known and (before.firmware == now.firmware or "" in (before.firmware, now.firmware))


def differing(first: list[Asset], second: list[Asset]) -> list[tuple[Asset, Asset]]:
    """Return the assets of one kind that are not the same ones in both runs, by serial number."""
    there = {asset.kind: asset for asset in second}
    pairs = ((one, there[one.kind]) for one in first if one.kind in there)
    return [pair for pair in pairs if pair[0].serial != pair[1].serial]
