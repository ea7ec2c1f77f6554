"""Rule I18: the devices and the version of a resumed session are those of the one before."""

from __future__ import annotations

from hilcell.invariants.scene import Scene
from hilcell.invariants.tally import Tally
from hilcell.journal.asset import Asset, asset_of, same
from hilcell.journal.journal import Record


class Identities:
    """Compares what answered with what answered before."""

    def __init__(self, tally: Tally, scene: Scene) -> None:
        self._check, self._scene = tally.check, scene
        self._before: dict[str, Asset] = {}
        self._hilcell = ""
        self._accepted = False  # since the last connection

    def take(self, record: Record) -> None:
        """Judge a record."""
        match record.body.get("what") if record.kind == "event" else "":
            case "changes accepted":
                self._accepted = True
            case "connected":
                self._connected(record)

    def _connected(self, record: Record) -> None:
        now = {each.kind: each for each in map(asset_of, record.body["devices"])}
        hilcell = record.body["hilcell"]
        if self._before:
            kinds = self._before.keys() | now.keys()
            changed = [k for k in sorted(kinds) if not same(self._before.get(k), now.get(k))]
            changed += ["hilcell"] if self._hilcell not in ("", hilcell) else []
            what = f"changed, and nobody has accepted it: {', '.join(changed)}"
            self._check("I18", record, self._accepted or not changed, what)
        self._before, self._hilcell, self._accepted = now, hilcell, False
