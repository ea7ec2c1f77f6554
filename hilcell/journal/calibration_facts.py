"""The calibration of a run, made, changed, judged or revoked, and its verdict, from its journal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import msgspec

from hilcell.errors import EXIT_REFUSED
from hilcell.language import marked
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import (
    VALIDATION,
    ChangedSince,
    InstrumentChecked,
    Judged,
    PoseTested,
    Rechecked,
    Verdict,
)

NOT_JUDGED = marked(("measured", "done"))  # runs without a verdict, and without a point either
SUSPECTED = marked("suspected")  # of a run that suspects a cause, alone or behind its outcome

Kind = Literal["", "made", "base", "targets", "touch"]


class CalibrationFacts(msgspec.Struct, frozen=True, kw_only=True):
    """``kind`` is the origin of the run's calibration: measured, or an earlier one with base,
    targets or a station's base changed; "" is none. ``used`` is the run of the calibration that it
    used, ``validated`` whether places were validated and all pass, ``recheck`` the verdict on the
    used one, ``doubt`` another explanation of its update. ``carried`` is the run whose arm a
    re-calibration has. ``revoked`` is the reason of the run's revocation. ``suspected``: a
    suspected cause was not cleared; ``judged``: the robot was compared with limits, ``checked``:
    the instrument; ``outcome`` is that of all verdicts, None where no robot was judged and no check
    failed. ``changed_since`` is
    the run of a calibration from which this one differs, if nothing else is against it: an operator
    decides which is right.
    """

    kind: Kind = ""
    used: str = ""
    carried: str = ""
    validated: bool = False
    recheck: Literal["", "valid", "update", "redo"] = ""
    doubt: str = ""
    revoked: str = ""
    suspected: bool = False
    judged: bool = False
    checked: bool = False
    outcome: Outcome | None = None
    changed_since: str = ""

    @property
    def verdict(self) -> str:
        """Return the outcome as text, with a suspected cause."""
        rechecked = marked({"valid": "still valid", "update": "updated", "redo": "calibrate again"})
        words = rechecked.get(self.recheck, "")
        if not words and self.outcome is not None:
            words = self.outcome.text
        elif not words and self.kind == "made" and not self.validated:
            words = marked("not validated")
        elif not words and self.checked:
            words = marked("nothing proven wrong")
        return "; ".join(filter(None, (words, SUSPECTED if self.suspected else "")))


def facts_of(
    verdicts: Mapping[str, Verdict], used: str = "", revoked: str = "", carried: str = ""
) -> CalibrationFacts:
    all_of = list(verdicts.values())
    broken = [each for each in all_of if not each.holds]
    places = [each for key, each in verdicts.items() if key.startswith(VALIDATION)]
    missed = [each.outcome for each in places if not each.holds]
    recheck = next((each for each in all_of if isinstance(each, Rechecked)), None)
    since = next((each for each in broken if isinstance(each, ChangedSince)), None)
    kind, validated = _kind(verdicts, recheck), bool(places) and not missed
    suspected = any(each.suspects for each in broken)
    judged = any(isinstance(each, Judged | PoseTested) for each in all_of)
    found: Outcome | None = None
    if missed and set(missed) == {Outcome.UNDECIDED}:
        found = Outcome.UNDECIDED
    elif any(not each.suspects for each in broken):
        found = Outcome.REJECTED
    elif judged and not suspected and (validated or kind != "made"):
        found = Outcome.ACCEPTED
    return CalibrationFacts(
        kind=kind,
        used=used,
        carried=carried,
        validated=validated,
        recheck="" if recheck is None else recheck.verdict,
        doubt="" if recheck is None else recheck.doubt,
        revoked=revoked,
        suspected=suspected,
        judged=judged,
        checked=InstrumentChecked.by(verdicts) is not None,
        outcome=None if recheck is not None else found,
        changed_since=since.before if since is not None and broken == [since] else "",
    )


def _kind(verdicts: Mapping[str, Verdict], recheck: Rechecked | None) -> Kind:
    if "fit" in verdicts:
        return "made"
    if "touch" in verdicts:
        return "touch"
    if "targets" in verdicts:
        return "targets" if verdicts["targets"].holds else ""
    return "base" if recheck is not None and recheck.verdict == "update" else ""


def outcome(facts: CalibrationFacts, state: str, code: int | None, points: int) -> str:
    """Return the outcome of a run in ``state`` with exit ``code``; "" without an end.

    A run without verdicts is "measured", or "done" without points.
    """
    if code is None:
        return ""
    if code == EXIT_REFUSED:  # devices may have connected, nothing moved
        return marked("refused")
    if state == "idle":
        return marked("not begun")
    if state != "finished":
        return state
    if code and facts.verdict in ("", Outcome.ACCEPTED.text):
        return Outcome.REJECTED.text
    return facts.verdict or NOT_JUDGED[0 if points else 1]
