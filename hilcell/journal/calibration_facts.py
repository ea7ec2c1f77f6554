"""The calibration of a run, made, changed, judged or revoked, and its verdict, from its journal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import msgspec

from hilcell.errors import EXIT_REFUSED
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import VALIDATION, ChangedSince, Judged, PoseTested, Rechecked, Verdict

NOT_JUDGED = ("measured", "done")  # runs without a verdict, and without a point either
SUSPECTED = "suspected"  # of a run that suspects a cause, alone or behind its outcome

Kind = Literal["", "made", "base", "targets", "touch"]


class CalibrationFacts(msgspec.Struct, frozen=True, kw_only=True):
    """``kind`` says how a run that finishes comes to a calibration: measured, or one of before with
    base, targets or a station's base changed; "" is none. ``used`` is the run whose calibration it
    took, ``validated`` whether places were validated and all hold, ``recheck`` what a re-check says
    of the used one, and ``doubt`` what would explain an update of it as well. ``revoked`` is why
    somebody has revoked its own. ``suspected`` says that the run suspects a cause that was not
    cleared, ``judged`` that it held the robot against limits, ``outcome`` is that of all verdicts,
    None where nothing was judged and no check failed. ``changed_since`` is the run of a calibration
    that this one differs from, where nothing else is against it: a person says which is right.
    """

    kind: Kind = ""
    used: str = ""
    validated: bool = False
    recheck: Literal["", "valid", "update", "redo"] = ""
    doubt: str = ""
    revoked: str = ""
    suspected: bool = False
    judged: bool = False
    outcome: Outcome | None = None
    changed_since: str = ""

    @property
    def verdict(self) -> str:
        """Return the outcome in words, and whether a cause is suspected."""
        rechecked = {"valid": "still valid", "update": "updated", "redo": "calibrate again"}
        words = rechecked.get(self.recheck, "")
        if not words and self.outcome is not None:
            words = self.outcome.text
        elif not words and self.kind == "made" and not self.validated:
            words = "not validated"
        return "; ".join(filter(None, (words, SUSPECTED if self.suspected else "")))


def facts_of(
    verdicts: Mapping[str, Verdict], used: str = "", revoked: str = ""
) -> CalibrationFacts:
    """Return what verdicts say, by their keys."""
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
        validated=validated,
        recheck="" if recheck is None else recheck.verdict,
        doubt="" if recheck is None else recheck.doubt,
        revoked=revoked,
        suspected=suspected,
        judged=judged,
        outcome=None if recheck is not None else found,
        changed_since=since.before if since is not None and broken == [since] else "",
    )


def _kind(verdicts: Mapping[str, Verdict], recheck: Rechecked | None) -> Kind:
    """Return the kind, as `calibration_after` tells them apart."""
    if "fit" in verdicts:
        return "made"
    if "touch" in verdicts:
        return "touch"
    if "targets" in verdicts:
        return "targets" if verdicts["targets"].holds else ""
    return "base" if recheck is not None and recheck.verdict == "update" else ""


def outcome(facts: CalibrationFacts, state: str, code: int | None, points: int) -> str:
    """Return in a word how a run in ``state`` with exit ``code`` came out; "" without an end.

    List of runs, history, screen and report say this word. A run that judged nothing has
    "measured", or "done" where it measured nothing either.
    """
    if code is None:
        return ""
    if code == EXIT_REFUSED:  # the devices may have been asked, and nothing moved
        return "refused"
    if state == "idle":
        return "not begun"
    if state != "finished":
        return state
    if code and facts.verdict in ("", Outcome.ACCEPTED.text):
        return Outcome.REJECTED.text
    return facts.verdict or NOT_JUDGED[0 if points else 1]
