"""Whether the assets of two runs, or of two sessions, are the same ones."""

from __future__ import annotations

from hilcell.model.events import Asset


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
