"""Rule I18: the devices and the version of a resumed session are those of the one before."""

from __future__ import annotations

from typing import Any

from hilcell.invariants.scene import Scene
from hilcell.invariants.tally import Tally
from hilcell.journal.asset import asset_of
from hilcell.journal.journal import Record

Known = dict[str, tuple[str, ...]]


class Identities:
    """Compares what answered with what answered before."""

    def __init__(self, tally: Tally, scene: Scene) -> None:
        self._check, self._scene = tally.check, scene
        self._before: Known = {}
        self._accepted = False  # since the last connection

    def take(self, record: Record) -> None:
        """Judge a record."""
        match record.body.get("what") if record.kind == "event" else "":
            case "changes accepted":
                self._accepted = True
            case "connected":
                now = _identities(record.body)
                if self._before:
                    changed = _changed(self._before, now)
                    what = f"changed, and nobody has accepted it: {', '.join(changed)}"
                    self._check("I18", record, self._accepted or not changed, what)
                self._before, self._accepted = now, False


def _identities(body: dict[str, Any]) -> Known:
    """Return what identifies each part: the devices by kind, and hilcell."""
    assets = [asset_of(entry) for entry in body["devices"]]
    found: Known = {
        each.kind: (each.maker, each.model, each.serial, each.firmware) for each in assets
    }
    version = body.get("hilcell")
    return found | ({"hilcell": (version,)} if version else {})


def _changed(before: Known, now: Known) -> list[str]:
    kinds = before.keys() | now.keys()
    if not ("hilcell" in before and "hilcell" in now):  # a journal that did not keep it
        kinds -= {"hilcell"}
    return sorted(kind for kind in kinds if before.get(kind) != now.get(kind))
